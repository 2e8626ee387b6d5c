"""Sensitivities: closed forms, Euler's relation, moments against differences, errors, files."""

import json
import math
from copy import copy
from pathlib import Path

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak, z_test
from scipy.stats import chi2

import meshtrace as mt
from meshtrace.comms import OokLink
from meshtrace.engine import correlated
from meshtrace.engine.chains import sets
from meshtrace.kernels.random import realization_seed
from meshtrace.stored import SHIFTS
from meshtrace.studies import Variant, neighbours, sensitivity
from meshtrace.studies.keys import parameters
from meshtrace.studies.neighbours import error_of, without_each
from meshtrace.surfaces import Band, FlatSea, JonswapSea
from meshtrace.uav import TiltFactors

REFERENCE = json.loads(
    (Path(__file__).parents[1] / "data" / "sensitivity_reference.json").read_text()
)
SEED = 5  # without a vertex within 1e-4 of the surface
NAMES = {
    "a": "water.a",
    "b": "water.b",
    "d": "transmitter.depth",
    "th": "transmitter.half_angle_deg",
    "h": "receiver.height",
    "r": "receiver.radius",
    "x": "receiver.position.0",
    "tilt": "receiver.tilt_deg",
    "zen": "transmitter.zenith_deg",
    "n": "water.n",
    "fov": "receiver.fov_deg",
    "ff_n-1": "water.phase.n",
    "ff_mu-3": "water.phase.mu",
}


def oblique(b=0.0):
    """Return the link of the closed forms: offset, tilted, with a leaning lamp."""
    link = mt.Link().replace("water.b", b).replace("receiver.position", (0.5, 0.0))
    return link.replace("receiver.tilt_deg", 5.0).replace("transmitter.zenith_deg", 3.0)


def elasticities(link, sea=None, keys=("a", "b", "d", "h", "r"), **options):
    wrt = [NAMES[key] for key in keys]
    return mt.sensitivities(link, sea or FlatSea(), wrt=wrt, **options)


def test_closed_forms_without_scattering():
    closed = REFERENCE["closed_flat_b0"]
    found = elasticities(oblique(), keys=closed["elasticity"], photons=1024)
    assert found.value == pytest.approx(closed["gain"], rel=1e-4)
    for key, expected in closed["elasticity"].items():
        row = found.table[NAMES[key]]
        assert row.elasticity == pytest.approx(expected, abs=closed["tolerance_abs"]), key
        assert not row.suspicious


@pytest.mark.parametrize("depth", [10.0, 40.0])
@pytest.mark.thorough
@pytest.mark.slow_but("10.0")
def test_euler_relation(depth):
    # lengths enter as a L, b L and ratios alone: exact on a flat sea for stretched chains
    link = oblique(0.037).replace("transmitter.depth", depth)
    found = elasticities(link, keys=("a", "b", "d", "h", "r", "x"), photons=4096)
    e = {key: found.table[NAMES[key]].elasticity for key in ("a", "b", "d", "h", "r", "x")}
    assert e["a"] + e["b"] == pytest.approx(e["d"] + e["h"] + e["r"] + e["x"], abs=1e-3)


@pytest.mark.parametrize("depth", [10.0, 40.0])
@pytest.mark.thorough
@pytest.mark.slow_but("10.0")
def test_euler_relation_gives_the_depth_derivative_on_the_axis(depth):
    link = mt.Link().replace("transmitter.depth", depth)
    # a short step: the edge of the field of view cuts off chains, and e^s bends
    found = elasticities(link, keys=("a", "b", "d", "h", "r"), photons=8192, step=3e-3)
    a, b, d, h, r = (row.elasticity for row in found.table)
    assert a + b - h - r == pytest.approx(d, abs=1e-4)


@pytest.mark.slow
def test_the_reference_with_scattering():
    expected = REFERENCE["with_scattering"]["flat-10"]
    keys = [key for key in NAMES if key in expected]
    found = elasticities(mt.Link(), keys=keys)
    assert found.value == pytest.approx(expected["gain"][0], rel=3e-3)
    for key in keys:
        row, (value, error) = found.table[NAMES[key]], expected[key]
        assert abs(row.elasticity - value) < 4.0 * math.hypot(row.stderr, error) + 1e-4, key


@pytest.mark.thorough
def test_moments_agree_with_differences():
    link, step = mt.Link(), 1e-2
    found = elasticities(link, keys=("a", "b"), photons=4096)
    mesh = FlatSea().mesh(extent=8.0)
    frozen = correlated.FrozenForced(link, 4096, 1)
    for key, tolerance in (("a", 2e-4), ("b", 1e-3)):
        base = {"a": link.water.a, "b": link.water.b}[key]
        low, high = (
            frozen.gains(link.replace(NAMES[key], base * math.exp(s)), mesh).mean()
            for s in (-step, step)
        )
        difference = math.log(high / low) / (2.0 * step)
        assert found.table[NAMES[key]].elasticity == pytest.approx(difference, abs=tolerance)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("transmitter.depth", 10.3), ("water.n", 1.38), ("transmitter.position.0", 0.5),
        ("receiver.position.0", 0.6), ("receiver.radius", 0.13), ("receiver.tilt_deg", 3.0),
    ],
)  # fmt: skip
def test_crossings_followed_from_the_base_are_those_of_a_search(key, value):
    base = mt.Link().replace("water.b", 0.3)
    frozen, moved = correlated.FrozenForced(base, 1024, 1), base.replace(key, value)
    arrays, aimed = frozen._aimed(moved, FlatSea().mesh(extent=8.0))
    drawer, together, chains = frozen._base.drawer.of_link(arrays), 0, 0
    for request, followed in zip(
        (request for request, _ in frozen._base.sets(False)[0]),
        frozen._sets(moved, arrays, aimed)[0],
        strict=True,
    ):
        found, searched = followed.crossings(0), drawer.draw(request).crossings(0)
        # a record of branch 0 ends those of a chain
        there, expected = (np.cumprod(x["branch"] != 0.0, axis=1) > 0 for x in (found, searched))
        # what is followed may be missed by a search, but not the other way round
        assert (there.sum(axis=1) >= expected.sum(axis=1)).all()
        lit = expected[:, 0]
        apart = np.hypot(found["x"] - searched["x"], found["y"] - searched["y"])[lit, 0]
        together, chains = together + np.count_nonzero(apart < 1e-6), chains + len(apart)
    # two crossings beside a fold are rare: either of them may come first
    assert together > 0.99 * chains


def test_crossings_are_followed_to_links_nearby_alone():
    frozen = correlated.FrozenForced(mt.Link(), 64, 1)
    base, of_base = frozen._base.link, frozen._base.arrays
    for key, value, near in [
        ("receiver.position.0", 0.5, True),
        ("receiver.position.0", 5.0, False),
        ("transmitter.depth", 10.5, True),
        ("transmitter.depth", 15.0, False),
        ("receiver.tilt_deg", 20.0, False),
        ("water.phase.n", 1.2, False),
    ]:
        moved = base.replace(key, value)
        arrays = correlated.forced_link(moved, of_base.frame)
        assert correlated._is_near(moved, arrays, base, of_base) is near, key


def test_level_water_has_the_crossings_of_the_flat_sea():
    link, mesh = mt.Link(receiver=mt.Receiver(position=(1.0, 0.0))), FlatSea().mesh(extent=8.0)
    thorough, usual = (
        correlated.FrozenForced(link, 1024, 1, search=search) for search in ("thorough", "usual")
    )
    np.testing.assert_allclose(thorough.gains(link, mesh), usual.gains(link, mesh), rtol=1e-8)
    # beyond the rim of a smaller sea there is none
    small = FlatSea().mesh(extent=0.8)
    np.testing.assert_allclose(thorough.gains(link, small), usual.gains(link, small), rtol=1e-8)


@pytest.mark.parametrize("wind_speed", [5.0, 13.0])
@pytest.mark.thorough
@pytest.mark.slow_but("13.0")
def test_radius_on_the_axis(wind_speed):
    sea = JonswapSea(wind_speed=wind_speed, waves="paper", seed=7)
    row = elasticities(mt.Link(), sea, keys=("r",), photons=16384).table[0]
    assert row.stderr < 3e-4
    assert row.elasticity == pytest.approx(1.9998, abs=3e-4)


@pytest.mark.slow
def test_a_discontinuity_missed_by_a_small_step_is_suspicious(monkeypatch):
    # chains that do not stretch with the depth: vertices surface, carried by rare chains
    def unstretched(self, link):
        drawer = copy(self)
        drawer.link = link
        return drawer

    monkeypatch.setattr(sets.ChainDrawer, "of_link", unstretched)
    found = elasticities(mt.Link(), keys=("d",), step=1e-4, seed=SEED)
    assert found.table[0].suspicious
    assert "over the longer step" in found.table[0].notes
    monkeypatch.undo()
    assert not elasticities(mt.Link(), keys=("d",), seed=SEED).table[0].suspicious


def shifts_followed(monkeypatch, **limits):
    """Return a row by differences, and the numbers of shifts of all gains of its study."""
    numbers, gains = [], correlated.FrozenForced.gains
    for name, limit in limits.items():
        monkeypatch.setattr(sensitivity, name, limit)

    def counted(self, link, mesh, shifts=SHIFTS):
        numbers.append(shifts)
        return gains(self, link, mesh, shifts)

    with monkeypatch.context() as patched:
        patched.setattr(correlated.FrozenForced, "gains", counted)
        row = elasticities(mt.Link(), keys=("h",), photons=256).table[0]
    return row, numbers


def test_a_longer_step_that_shows_nothing_takes_a_part_of_the_chains(monkeypatch):
    row, numbers = shifts_followed(monkeypatch)
    assert (row.suspicious, numbers) == (False, [32, 32, 8, 8, 32])  # steps, longer ones, base
    checked, numbers = shifts_followed(monkeypatch, _CLEAR=-1.0, _CURVATURE=0.0)
    assert numbers == [32, 32, 8, 8, 32, 32, 32]
    assert (checked.elasticity, checked.stderr) == (row.elasticity, row.stderr)


@pytest.mark.statistical
def test_the_jackknife_covers():
    rng = np.random.default_rng(1)
    z = []
    for _ in range(1000):
        chains, seas = rng.gamma(8.0, size=SHIFTS) / 8.0, rng.gamma(20.0, size=40) / 20.0
        gains = chains * seas[:, None]
        logs = np.log([g.mean() for g in without_each(gains)])
        z.append(logs[0] / error_of(logs))
    assert 0.93 <= np.mean(np.abs(z) < 2.0) <= 0.97


@pytest.mark.slow
@pytest.mark.statistical
def test_errors_of_elasticities_cover():
    link = mt.Link()
    rows = [elasticities(link, keys=("b",), photons=256, seed=i).table[0] for i in range(200)]
    values, errors = (np.array([row[k] for row in rows]) for k in ("elasticity", "stderr"))
    z = (values - values.mean()) / errors
    assert 0.91 <= np.mean(np.abs(z) < 2.0) <= 0.98


@pytest.mark.thorough
def test_field_of_view_from_angles_of_arrival():
    link = mt.Link().replace("transmitter.depth", 40.0).replace("receiver.fov_deg", 20.0)
    angle = elasticities(link, keys=("fov",)).table[0]
    assert angle.method == "angle"
    frozen, mesh = correlated.FrozenForced(link, 8192, 1), FlatSea().mesh(extent=30.0, spacing=0.2)
    sides = [frozen.gains(link.replace("receiver.fov_deg", 20.0 * math.exp(s)), mesh)[0]
             for s in (-0.1, 0.1)]  # fmt: skip
    means = [np.log([g.mean() for g in without_each(side[None, :])]) for side in sides]
    difference = (means[1] - means[0]) / 0.2
    off, error = angle.elasticity - difference[0], math.hypot(angle.stderr, error_of(difference))
    assert error < 0.15 * angle.elasticity
    assert abs(off) < 3.0 * error
    light = frozen.arrivals(link.replace("receiver.fov_deg", 60.0), mesh)[0]
    halves = np.radians([1.0, 3.0, 5.0, 10.0, 20.0, 30.0])
    curve = [light.weight[light.angle <= half].sum() for half in halves]
    assert np.all(np.diff(curve) > 0.0)
    plain = frozen.gains(link.replace("receiver.fov_deg", 60.0), mesh).mean()
    assert curve[-1] == pytest.approx(plain, rel=1e-9)
    reference = REFERENCE["fov_curve_flat"]["40.0"]
    for fov, gain, error in zip(
        *(reference[k] for k in ("fov_deg", "gain", "stderr")), strict=True
    ):
        if fov in (6.0, 20.0, 60.0):
            mine = light.by_shift((light.angle <= math.radians(fov / 2.0)).astype(float))
            assert abs(mine.mean() - gain) < 4.0 * math.hypot(error, mine.std() / math.sqrt(31))


def test_unscattered_light_well_inside_the_view_does_not_depend_on_it():
    link = mt.Link(water=mt.Water(b=0.0), receiver=mt.Receiver(fov_deg=2.0))
    row = elasticities(link, keys=("fov",), photons=1024).table[0]
    assert row.method == "angle"
    assert (row.elasticity, row.stderr) == (0.0, 0.0)


@pytest.mark.thorough
def test_the_error_of_light_at_the_edge_of_the_view_is_that_of_other_seeds():
    """Few chains; 0.0701(4) is the mean of four runs of 65,536 chains. Chi-square test."""
    link = mt.Link().replace("transmitter.depth", 24.0).replace("receiver.fov_deg", 20.0)
    rows = [
        elasticities(link, keys=("fov",), photons=256, seed=seed).table[0]
        for seed in range(1, 17)
    ]  # fmt: skip
    z = np.array([(row.elasticity - 0.0701) / row.stderr for row in rows])
    assert z @ z < chi2.isf(ALPHA, len(z))


EDGES = {
    "peak inside a still view": (FlatSea(), 60.0, 25.0, 0.0751, 0.0022),
    "peak near a still edge": (FlatSea(), 20.0, 8.0, 0.1235, 0.0005),
    "peak inside a wavy view": (JonswapSea(wind_speed=5.0), 60.0, 25.0, 0.0610, 0.0015),
    "on the axis": (JonswapSea(wind_speed=5.0), 10.0, 0.0, 0.0616, 0.0014),
}
"""Elasticity to the view [deg] of a receiver tilted by [deg]: means of differences over 2 % of six
runs of 65,536 photons, with common photons, and their standard errors."""


@pytest.mark.filterwarnings("ignore:receiver 0. light arrives by large angles")
@pytest.mark.statistical
@pytest.mark.parametrize("case", EDGES)
@pytest.mark.thorough_but("peak inside a still view")
def test_light_at_the_edge_of_a_view_is_resolved(case):
    """0.438(2) for the first by a window of half the half-angle: a peak 5 deg inside the edge."""
    sea, fov, tilt, wanted, error = EDGES[case]
    link = mt.Link(receiver=mt.Receiver(fov_deg=fov, tilt_deg=tilt))
    row = mt.sensitivities(link, sea, [NAMES["fov"]], photons=4096, seed=3).table[0]
    assert not row.suspicious
    assert row.stderr < 0.3 * wanted
    assert z_test(row.elasticity, math.hypot(row.stderr, error), wanted) > sidak(ALPHA, len(EDGES))


def test_a_density_that_no_window_resolves_is_suspicious():
    """All light within 1 % of the edge: every window doubles the one of twice its width."""
    found = np.zeros((1, 3, len(neighbours.WINDOWS), SHIFTS))
    found[0, 0] = (1.0 / neighbours.WINDOWS)[:, None] * (1.0 + 1e-3 * np.arange(SHIFTS))
    found[0, 1:] = 1e3
    assert neighbours.resolving_window(found) == (len(neighbours.WINDOWS) - 1, False)
    found[0, 0] = 1.0 + 1e-3 * np.arange(SHIFTS)
    assert neighbours.resolving_window(found) == (0, True)


VIEWS = [(2.0, None), (2.0, 5.0), (10.0, 5.0)]


@pytest.mark.filterwarnings("ignore:receiver 0. light arrives by large angles")
@pytest.mark.parametrize(("fov", "wind_speed"), VIEWS)
@pytest.mark.thorough
@pytest.mark.slow_but("10.0-5.0", "2.0-None")
def test_narrow_views_against_differences(fov, wind_speed):
    """Runs of their own on either side of the edge; over waves light is blurred across it."""
    sea = FlatSea() if wind_speed is None else JonswapSea(wind_speed=wind_speed, seed=7)
    link = mt.Link(receiver=mt.Receiver(fov_deg=fov))
    row = elasticities(link, sea, keys=("fov",), seed=3).table[0]
    expected, error = difference(link, sea, "receiver.fov_deg", 0.1, 40_000)
    assert not row.suspicious
    assert row.stderr < 0.1 * row.elasticity
    assert z_test(row.elasticity, math.hypot(row.stderr, error), expected) > sidak(ALPHA, 3)


def difference(link, sea, name, step, photons):
    """Return the central difference of ln gain over runs of their own, and its error."""
    variant = Variant(link, sea, None)
    (p,) = parameters(variant, [name], step, "vertex")
    logs, errors = [], []
    for seed, side in ((11, -1.0), (12, 1.0)):
        at = p.at(variant, p.shifted(side))
        found = mt.simulate(at.link, at.sea, photons=photons, seed=seed)
        logs.append(math.log(found.gain))
        errors.append(found.gain_stderr / found.gain)
    return (logs[1] - logs[0]) / (2.0 * p.step), math.hypot(*errors) / (2.0 * p.step)


UP = oblique(0.05).replace("receiver.radius", 0.1)
DOWN = mt.Link(
    water=mt.Water(b=0.05),
    transmitter=mt.AirLed(height=5.0, tilt_deg=4.0),
    receiver=mt.WaterReceiver(depth=8.0, radius=0.1, position=(0.5, 0.0), tilt_deg=5.0),
)
NARROW = {"up": (UP, 6.0), "down": (DOWN, 20.0)}
BAND = Band(omega_min=1.0, omega_max=3.0, d_omega=0.1, d_theta=math.pi / 36)
WAVES = JonswapSea(wind_speed=5.0, waves=BAND, seed=7)


@pytest.mark.parametrize("sea", [FlatSea(), WAVES], ids=["flat", "wavy"])
@pytest.mark.parametrize("view", ["wide", "narrow"])
@pytest.mark.parametrize("way", ["up", "down"])
@pytest.mark.filterwarnings("ignore::meshtrace.errors.DomainWarning")
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*scattering chains miss part:meshtrace.FewSamplesWarning")
def test_every_key_against_differences(way, view, sea):
    link, fov = NARROW[way]
    if view == "narrow":
        link = link.replace("receiver.fov_deg", fov)
    found = mt.sensitivities(link, sea, photons=16_384, seed=3)
    assert len(found.table) >= 14
    for row in found.table:
        absolute = math.isnan(row.elasticity) or ".position" in row.name or "tilt" in row.name
        absolute = absolute or "zenith" in row.name or "azimuth" in row.name
        step = 0.1
        if absolute:
            step = 1.0 if row.unit == "deg" else 0.3
        mine, factor = (row.relative, 1.0) if absolute else (row.elasticity, 1.0)
        stderr = row.stderr / (abs(row.base) if absolute and row.base else 1.0)
        expected, error = difference(link, sea, row.name, step, 40_000)
        # the long step bends by its square, and the meshes of the runs differ
        bend = (0.03 * abs(expected) + 0.01) * (0.05 if absolute else 1.0) * factor
        assert abs(mine - expected) < 4.0 * math.hypot(stderr, error) + bend, row


def test_wind_needs_an_explicit_band():
    with pytest.raises(mt.Refused, match=r"sea.wind_speed: other waves.*sea.band"):
        mt.sensitivities(mt.Link(), JonswapSea(wind_speed=5.0), wrt=["sea.wind_speed"], photons=64)
    sea = JonswapSea(wind_speed=5.0, seed=7)
    sea = sea.replace(waves=sea.band)
    found = mt.sensitivities(mt.Link(), sea, wrt=["sea.wind_speed"], photons=1024)
    assert found.table[0].method == "difference"
    assert not found.table[0].suspicious
    assert abs(found.table[0].elasticity) < 0.3


def test_wind_in_parts():
    link = mt.Link().replace(whitecaps=mt.Whitecaps(wind_speed=12.0))
    band = Band(omega_min=0.7, omega_max=2.5, d_theta=math.pi / 36)
    sea = JonswapSea(wind_speed=12.0, seed=7, waves=band)
    parts = ["wind_speed", "sea.wind_speed", "whitecaps.wind_speed"]
    found = mt.sensitivities(link, sea, wrt=parts, photons=512).table
    total = found["sea.wind_speed"].elasticity + found["whitecaps.wind_speed"].elasticity
    assert found["wind_speed"].elasticity == pytest.approx(total, abs=2e-4)
    foam = [mt.Whitecaps(wind_speed=12.0 * f).transmittance for f in (0.99, 1.01)]
    expected = math.log(foam[1] / foam[0]) / math.log(1.01 / 0.99)
    assert found["whitecaps.wind_speed"].elasticity == pytest.approx(expected, rel=1e-3)


@pytest.mark.slow
def test_range_against_full_searches():
    s = mt.sensitivities(mt.Link(), FlatSea(), wrt=["water.a"], quantity="range", photons=2048)
    depths = np.arange(52.0, 59.0, 1.0)
    ranges = []
    for factor in (0.98, 1.02):
        link = mt.Link().replace("water.a", 0.114 * factor)
        found = mt.link_performance(link, FlatSea(), depths=depths, photons=2048)
        ranges.append(found.range_at_ber()[0].value)
    expected = (ranges[1] - ranges[0]) / math.log(1.02 / 0.98)
    assert s.value == pytest.approx(np.mean(ranges), rel=0.01)
    assert s.derivative("water.a").value * 0.114 == pytest.approx(expected, rel=0.03)


@pytest.mark.thorough
def test_margin_error_rate_and_fixed_gain_follow_the_gain():
    link, keys = mt.Link().replace("transmitter.depth", 50.0), ("a", "d")
    gain, margin, fixed = (
        elasticities(link, keys=keys, quantity=of, ook=ook, photons=1024)
        for of, ook in (("gain", "physical"), ("margin", "physical"), ("range", None))
    )
    for key in keys:
        row = gain.table[NAMES[key]]
        # the response of the channel follows the water, too
        assert margin.table[row.name].elasticity == pytest.approx(row.elasticity, rel=1e-3)
    a, d = (gain.table[NAMES[key]].elasticity for key in keys)
    assert fixed.value == 50.0
    assert fixed.derivative("water.a").value == pytest.approx(-a / d * 50.0 / 0.114, rel=1e-9)
    # the receiver's own parameters count, too: 10 % more power is 0.41 dB
    power = mt.sensitivities(
        link, FlatSea(), wrt=["transmitter.power_mw"], quantity="margin", photons=256
    )
    assert power.table[0].elasticity == pytest.approx(1.0, rel=1e-9)
    ber = elasticities(link, keys=("a",), quantity="ber", photons=1024)
    ook = mt.OokLink.of_link(link)
    rates = [float(ook.ber(ook.received_power(gain.value * f))) for f in (0.99, 1.01)]
    slope = math.log(rates[1] / rates[0]) / math.log(1.01 / 0.99)
    assert ber.table[0].elasticity == pytest.approx(a * slope, rel=0.02)


@pytest.mark.thorough
def test_outage_over_common_seas():
    link = mt.Link().replace("transmitter.depth", 55.0)
    s = mt.sensitivities(
        link,
        JonswapSea(wind_speed=5.0),
        wrt=["water.a"],
        quantity="outage",
        realizations=12,
        photons=256,
    )
    assert 0.0 < s.value < 1.0
    assert s.table[0].elasticity > 0.0
    assert s.stderr > 0.0
    with pytest.raises(mt.Refused, match="realizations"):
        mt.sensitivities(link, FlatSea(), wrt=["water.a"], quantity="outage", photons=64)


def test_averages_over_seas():
    sea = JonswapSea(wind_speed=5.0)
    s = mt.sensitivities(mt.Link(), sea, wrt=["water.a"], realizations=3, photons=256, seed=4)
    means = [mt.sensitivities(mt.Link(), sea.with_seed(realization_seed(4, i)), photons=256, seed=4,
                              wrt=["water.a"]).value for i in range(3)]  # fmt: skip
    assert s.value == pytest.approx(np.mean(means), rel=0.01)


def test_forecast():
    s = elasticities(mt.Link(), keys=("a", "x"), photons=512)
    new = mt.simulate(mt.Link().replace("water.a", 0.12), FlatSea(), photons=4096).gain
    forecast = s.predict({"water.a": 0.12})
    assert abs(forecast.value - new) < 4.0 * forecast.stderr + 1e-3 * new
    moved = mt.Link().replace("receiver.position", (0.3, 0.0))
    near = mt.simulate(moved, FlatSea(), photons=4096).gain / s.value
    assert s.predict({"receiver.position.0": 0.3}).value / s.value == pytest.approx(near, abs=0.005)
    with pytest.raises(mt.Refused, match=r"water.a: 0.2, allowed: 0.08445 <= water.a <= 0.1539"):
        s.predict({"water.a": 0.2})
    with pytest.raises(mt.Refused, match="no such key"):
        s.predict({"water.aa": 0.1})


def test_file_and_covariance(tmp_path):
    s = elasticities(mt.Link(), keys=("b", "fov", "x"), photons=512)
    s.save(tmp_path / "s.nc")
    loaded = mt.Sensitivities.load(tmp_path / "s.nc")
    assert repr(loaded.table) == repr(s.table)
    assert loaded.summary() == s.summary()
    for found in (s.covariance(), loaded.covariance()):
        errors = [row.derivative_stderr for row in s.table]
        assert np.sqrt(np.diag(found)) == pytest.approx(errors)


def test_same_digits_for_any_threads_and_after_a_stop(tmp_path):
    sea = JonswapSea(wind_speed=5.0, seed=3)
    options = {"keys": ("a", "d", "h"), "photons": 256}
    store = tmp_path / "kept.store"
    first = elasticities(mt.Link(), sea, threads=1, **options)
    assert repr(first.table) == repr(elasticities(mt.Link(), sea, threads=2, **options).table)

    def stop(done):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        elasticities(mt.Link(), sea, store=store, progress=stop, **options)
    kept = store.read_bytes()
    again = elasticities(mt.Link(), sea, store=store, **options)
    assert repr(again.table) == repr(first.table)
    assert store.read_bytes().startswith(kept)  # only what it lacked was computed


TWIN = {
    "d": ("transmitter.depth", 8.0, 12.0),
    "h": ("receiver.height", 4.0, 6.0),
    "fov": ("receiver.fov_deg", 4.0, 8.0),
    "b": ("water.b", 0.02, 0.054),
}
"""Large steps, between whose ends photons one by one resolve a difference."""


@pytest.mark.slow
@pytest.mark.statistical
@pytest.mark.parametrize("key", TWIN)
def test_photons_one_by_one_have_the_same_elasticities(key):
    name, low, high = TWIN[key]
    link, sea = mt.Link().replace("receiver.radius", 0.25), FlatSea()
    frozen, mesh = correlated.FrozenForced(link, 8192, 1), sea.mesh(extent=8.0)
    shifts, logs, errors = [], [], []
    for i, value in enumerate((low, high)):
        there = link.replace(name, value)
        shifts.append(frozen.gains(there, mesh)[0])
        found = mt.simulate(there, sea, estimator="analog", photons=2_000_000, seed=i + 3)
        logs.append(math.log(found.gain))
        errors.append(found.gain_stderr / found.gain)
    step = math.log(high / low)
    analog, error = (logs[1] - logs[0]) / step, math.hypot(*errors) / step
    means = [np.log([g.mean() for g in without_each(shift[None, :])]) for shift in shifts]
    forced = (means[1] - means[0]) / step
    assert abs(analog - forced[0]) < 3.0 * math.hypot(error, error_of(forced))


@pytest.mark.slow
def test_calls_of_the_design():
    """Every argument of the three studies by name, in one call each."""
    link, sea = mt.Link(), FlatSea()
    names = ["water.a", "transmitter.half_angle_deg"]
    s = mt.sensitivities(
        link, sea, wrt=names, quantity="gain", realizations=1, photons=64, seed=1, ook="physical",
        step=None,
    )  # fmt: skip
    for column in (
        "name", "base", "unit", "elasticity", "stderr", "derivative", "second", "method", "notes",
    ):  # fmt: skip
        assert hasattr(s.table[0], column)
    assert [row.name for row in s.table] == names
    assert s.covariance().shape == (2, 2)
    assert s.predict({"water.a": 0.12}).value < s.value
    over = {"transmitter.half_angle_deg": (3, 30), "receiver.fov_deg": (6, 90)}
    o = mt.optimize(
        link, sea, bounds=over, objective="gain", constraints=[], hover_std=(1.0, 1.0), flight=None,
        realizations=2, photons=64, method="auto", seed=1,
    )  # fmt: skip
    assert isinstance(o.best, mt.Link)
    assert np.isfinite([o.value, o.stderr]).all()
    assert o.flatness.shape == (2, 2)
    assert len(o.history) > 1
    assert o.validation.best > 0.0
    rows = [
        {"transmitter.depth": d, "gain": g, "stderr": 0.02 * g}
        for d, g in ((5.0, 2.0e-4), (10.0, 6.0e-5), (20.0, 7.0e-6))
    ]
    f = mt.infer(rows, link, unknown=["water.a", "water.b", "scale"], prior=None)
    assert f.covariance.shape == f.correlation.shape == (3, 3)
    assert f.singular_values[0] > f.singular_values[-1]
    assert f.weakest
    assert f.chi2 >= 0.0
    assert set(f.value) == {"water.a", "water.b", "scale"}
    assert {*f.to_dataset().data_vars}
    assert {*s.to_dataset().data_vars}


@pytest.mark.parametrize(
    ("wrt", "options", "message"),
    [
        (["water.aa"], {}, "no such continuous key, did you mean water.a"),
        (["transmitter.kind"], {}, "no such continuous key, did you mean"),
        (["foo.bar"], {}, "no such continuous key, allowed: "),
        (["water.a", "water.a"], {}, "each name once"),
        (["water.bottom_albedo"], {}, "a value other than 0"),
        (
            ["receiver.height"],
            {"mesh": mt.Meshing(normals="facet")},
            "normals: 'facet', allowed: vertex",
        ),
        (["water.a"], {"realizations": 4}, "1 over a surface of kind flat"),
        (["water.a"], {"quantity": "gian"}, "did you mean gain"),
        (["water.a"], {"quantity": "ber", "ook": None}, "a transmission, for ber"),
        (["water.a"], {"quantity": "range", "bit_rate": 1e8}, "limit: .* that some power reaches"),
        (["water.a"], {"quantity": "margin", "bit_rate": 1e8}, "limit: .* that some power reaches"),
    ],
)
def test_refusals(wrt, options, message):
    with pytest.raises(mt.Refused, match=message):
        mt.sensitivities(mt.Link(), FlatSea(), wrt=wrt, photons=64, **options)


@pytest.mark.parametrize("of", ["ber", "capacity", "range"])
def test_tilts_out_of_the_view_bring_no_light(of):
    """Bits of a millionth of the tilts are guessed; a logarithm of 0 would be a warning."""
    quantity, gains = neighbours.Quantity(of, 1e-3), np.full((1, 32), 1e-6)
    tilt = TiltFactors(np.array([0.0, 1.0]), np.array([1e-6, 1.0 - 1e-6]))
    ook = OokLink()
    expected = math.log(0.5e-6) if of == "ber" else quantity.log(gains, ook)
    assert quantity.log(gains, ook, tilt) == pytest.approx(expected, abs=0.01)
