"""Joined photons against a quadrature, chains and published values of other codes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from engine.photons.single_scattering import Setting, single_scattering
from mc_statistics import ALPHA, sidak, z_test
from scipy.integrate import quad
from scipy.stats import chi2

import meshtrace as mt
from meshtrace.engine.forced import ForcedDetection
from meshtrace.engine.photons import joined
from meshtrace.engine.setup import arrays
from meshtrace.errors import Refused
from meshtrace.kernels import tally
from meshtrace.stored import SHIFTS
from meshtrace.surfaces import FlatSea, JonswapSea

FLAT = FlatSea().mesh(extent=60.0, spacing=10.0)
ONCE = 1e-6  # b [m-1] so small that light is scattered once or never

# no direct light: receivers that look away, stand aside, view narrowly, lamps that point away
DARK = [
    {"tilt_deg": 33.0},
    {"tilt_deg": 40.0},
    {"tilt_deg": 60.0},
    {"tilt_deg": 75.0},
    {"tilt_deg": 50.0, "azimuth_deg": 70.0, "offset": 3.0, "g": 0.924},
    {"half_angle_deg": 60.0, "fov_deg": 20.0, "offset": 10.0},
    {"half_angle_deg": 60.0, "fov_deg": 60.0, "offset": 20.0},
    {"fov_deg": 5.0, "offset": 3.0},
    {"half_angle_deg": None, "offset": 8.0, "fov_deg": 20.0},
    {"lamp_zenith_deg": 80.0, "half_angle_deg": 15.0},
    {"g": 0.0, "tilt_deg": 45.0},
    {"height": 0.5, "depth": 1.0, "radius": 0.02, "tilt_deg": 50.0, "half_angle_deg": 45.0},
]
REPEATING = DARK[1], DARK[2], DARK[6], DARK[10]
DARKER = [
    {"tilt_deg": 31.0},
    {"tilt_deg": 45.0, "azimuth_deg": 200.0, "offset": 2.0},
    {"tilt_deg": 70.0, "half_angle_deg": 40.0},
    {"tilt_deg": 80.0, "half_angle_deg": 40.0, "height": 1.0},
    {"fov_deg": 20.0, "offset": 6.0, "half_angle_deg": 30.0},
    {
        "offset": 15.0,
        "tilt_deg": 30.0,
        "azimuth_deg": 180.0,
        "fov_deg": 10.0,
        "half_angle_deg": 60.0,
    },
    {"a": 0.366, "depth": 3.0, "tilt_deg": 45.0},
    {"n": 1.5, "tilt_deg": 55.0, "half_angle_deg": 30.0},
]


def link_of(setting, **water):
    phase = {} if setting.g is None else {"phase": mt.HenyeyGreenstein(g=setting.g)}
    if setting.half_angle_deg is None:
        lamp = mt.IsotropicSource(depth=setting.depth)
    else:
        lamp = mt.Led(
            depth=setting.depth,
            half_angle_deg=setting.half_angle_deg,
            zenith_deg=setting.lamp_zenith_deg,
        )
    return mt.Link(
        water=mt.Water(**{"a": setting.a, "b": setting.b, "n": setting.n, **phase, **water}),
        transmitter=lamp,
        receiver=mt.Receiver(
            height=setting.height,
            radius=setting.radius,
            fov_deg=setting.fov_deg,
            position=(setting.offset, 0.0),
            tilt_deg=setting.tilt_deg,
            tilt_azimuth_deg=setting.azimuth_deg,
        ),
    )


class Scattered:
    """Scattered light of joined photons, without light that the surface reflects first."""

    def __init__(self, parts):
        self.shifts = parts.groups[tally.SCATTERED]
        self.gain, self.stderr = parts.parts[tally.SCATTERED], parts.part_stderr[tally.SCATTERED]
        self.orders, self.scored = parts.orders, parts.scored[tally.SCATTERED]


def evaluate(link, photons, seed=1, mesh=FLAT, normals="vertex", threads=2):
    return Scattered(joined.JoinedPhotons(link, photons, seed, normals, threads).evaluate(mesh))


def against_quadrature(case, photons, seed):
    setting = Setting(b=ONCE, **case)
    expected = single_scattering(setting, 48)
    assert expected == pytest.approx(single_scattering(setting, 32), rel=3e-3)
    found = evaluate(link_of(setting), photons, seed)
    return (found.gain[0] - expected) / math.hypot(found.stderr[0], 1e-3 * expected)


def test_quadrature_has_the_known_values():
    """Values of three links with the default water, converged to 0.3 %."""
    for case, expected in zip(
        (DARK[1], DARK[2], DARK[5]), (5.20e-8, 1.99e-10, 2.10e-10), strict=True
    ):
        assert single_scattering(Setting(**case), 48) == pytest.approx(expected, rel=4e-3)


@pytest.mark.parametrize(
    "case",
    [pytest.param(c, marks=pytest.mark.slow) if c in REPEATING else c for c in DARK],
    ids=str,
)
@pytest.mark.thorough_but("{'tilt_deg': 33.0}", "{'tilt_deg': 75.0}")
def test_light_scattered_once(case):
    assert abs(against_quadrature(case, 2**18, 1)) < 3.5


@pytest.mark.campaign
@pytest.mark.slow
@pytest.mark.parametrize("case", DARK + DARKER, ids=str)
def test_light_scattered_once_by_many_seeds(case):
    z = [against_quadrature(case, 65536, seed) for seed in range(8)]
    assert np.abs(z).max() < 3.5
    assert chi2.sf(np.square(z).sum(), len(z)) > sidak(ALPHA, 20)


@pytest.mark.parametrize("case", DARK[1:3] + DARK[5:6], ids=str)
def test_no_seed_lies_below_the_light_scattered_once(case):
    setting = Setting(**case)
    floor = single_scattering(setting, 32)
    for seed in range(8):
        found = evaluate(link_of(setting), 8192, seed)
        assert found.gain[0] > floor - 3.5 * found.stderr[0]


@pytest.mark.thorough
def test_default_link():
    """Scattered light 1.4556e-5 and its first order 1.2587e-5, both to 0.1 %."""
    found = evaluate(mt.Link(), 2**20)
    assert z_test(found.gain[0], found.stderr[0], 1.4556e-5, 1.5e-8) > ALPHA
    assert found.orders[0].sum() == pytest.approx(found.gain[0], rel=1e-12)
    assert found.orders[0, 0] == pytest.approx(1.2587e-5, rel=0.06)
    assert found.stderr[0] < 0.06 * found.gain[0]


@pytest.mark.parametrize(
    ("link", "total"),
    [
        (mt.Link(water=mt.Water(a=0.05, b=0.2)), 7.72e-5),
        (mt.Link(transmitter=mt.Led(depth=47.0)), 6.40e-8),
    ],
    ids=["b 0.2", "47 m"],
)
@pytest.mark.thorough
def test_flat_references(link, total):
    """Values by two other estimators that agree within 0.3 %."""
    direct = ForcedDetection(link, 256, 1).evaluate(FLAT).ballistic[0]
    found = evaluate(link, 131072)
    assert z_test(found.gain[0] + direct, found.stderr[0], total, 4e-3 * total) > sidak(ALPHA, 2)


LAYERS = ((0.0, 0.1, 0.02), (4.0, 0.12, 0.1), (6.0, 0.12, 0.1), (8.0, 0.1, 0.03))


@pytest.mark.parametrize(
    ("wind_speed", "normals", "link"),
    [
        (5.0, "vertex", mt.Link()),
        (13.0, "vertex", mt.Link()),
        (13.0, "facet", mt.Link(physics=mt.Physics(unresolved="none"))),
        (13.0, "vertex", mt.Link(bubbles=mt.HallNovarini(wind_speed=13.0))),
        (13.0, "vertex", mt.Link(water=mt.Water(layers=LAYERS))),
        (0.0, "vertex", mt.Link(bubbles=mt.HallNovarini(wind_speed=13.0))),
        (0.0, "vertex", mt.Link(water=mt.Water(layers=LAYERS))),
    ],
    ids=["5 m/s", "13 m/s", "facets", "bubbles", "layers", "flat bubbles", "flat layers"],
)
@pytest.mark.thorough
@pytest.mark.slow_but("bubbles", "flat layers")
def test_forced_detection_agrees(wind_speed, normals, link):
    mesh = FLAT
    if wind_speed > 0.0:
        mesh = JonswapSea(wind_speed=wind_speed, waves="paper").mesh(
            extent=15.0, spacing=0.1, fine_extent=4.0, coarse_spacing=1.0
        )
    chains = ForcedDetection(link, 8192, 2, normals).evaluate(mesh).scattered[0]
    photons = 2**18 if normals == "vertex" else 2**14
    found = evaluate(link, photons, 1, mesh, normals)
    stderr = chains.std(ddof=1) / math.sqrt(SHIFTS)
    assert found.stderr[0] < 0.12 * found.gain[0]
    assert z_test(found.gain[0], found.stderr[0], chains.mean(), stderr) > sidak(ALPHA, 7)


SEA = JonswapSea(wind_speed=13.0, waves="paper").mesh(extent=25.0, spacing=0.2)


@pytest.mark.parametrize(
    "link",
    [mt.Link(), mt.Link(receiver=mt.Receiver(tilt_deg=40.0))],
    ids=["default", "tilted"],
)
@pytest.mark.thorough
def test_errors_are_true(link):
    """Scatter of 64 seeds over the errors stated."""
    found = [evaluate(link, 4096, seed) for seed in range(64)]
    gains, errors = (np.array([getattr(f, name)[0] for f in found]) for name in ("gain", "stderr"))
    square = ((gains - gains.mean()) ** 2 / np.mean(errors**2)).sum()
    assert chi2.ppf(1e-3, 63) < square < chi2.isf(1e-3, 63)


def scaled(link, mesh, k):
    water, lamp, receiver = link.water, link.transmitter, link.receiver
    smaller = mt.Link(
        water=mt.Water(a=water.a / k, b=water.b / k),
        transmitter=lamp.model_copy(update={"depth": lamp.depth * k}),
        receiver=receiver.model_copy(
            update={"height": receiver.height * k, "radius": receiver.radius * k}
        ),
    )
    return smaller, mt.TriangleMesh(
        mesh.vertices * k, mesh.faces, mesh.vertex_normals, mesh.unresolved
    )


@pytest.mark.parametrize("mesh", [FLAT, SEA], ids=["flat", "sea"])
@pytest.mark.parametrize("link", [mt.Link(), mt.Link(receiver=mt.Receiver(tilt_deg=40.0))])
def test_lengths_scale(link, mesh):
    """A tank of 1 cm has the gain of the sea, path by path."""
    full = evaluate(link, 8192, 1, mesh)
    small = evaluate(*scaled(link, mesh, 1e-3)[:1], 8192, 1, scaled(link, mesh, 1e-3)[1])
    # single precision finds another facet or another side of a crest for a few rays
    np.testing.assert_allclose(small.gain, full.gain, rtol=1e-6 if mesh is FLAT else 1e-3)


def test_sources_share_the_light_by_their_power():
    lamps = (mt.Led(power_mw=300.0), mt.Led(power_mw=100.0, position=(4.0, 0.0)))
    both = evaluate(mt.Link(transmitter=lamps), 65536)
    parts = [evaluate(mt.Link(transmitter=lamp), 65536, 2) for lamp in lamps]
    expected = 0.75 * parts[0].gain[0] + 0.25 * parts[1].gain[0]
    stderr = math.hypot(0.75 * parts[0].stderr[0], 0.25 * parts[1].stderr[0])
    assert z_test(both.gain[0], both.stderr[0], expected, stderr) > ALPHA


def test_more_sources_than_shifts():
    tilted = mt.Link().replace("receiver.tilt_deg", 60.0)
    one = evaluate(tilted, 4096)
    many = evaluate(tilted.replace(transmitter=(mt.Led(),) * (SHIFTS + 1)), 128 * (SHIFTS + 1), 2)
    assert z_test(many.gain[0], many.stderr[0], one.gain[0], one.stderr[0]) > ALPHA


def test_no_scatterers_no_light():
    dark = evaluate(mt.Link(water=mt.Water(b=0.0)), 256)
    assert dark.gain[0] == 0.0
    assert dark.scored[0] == 0


@pytest.mark.parametrize(
    "phase", [mt.FournierForand(), mt.HenyeyGreenstein(g=0.9), mt.Petzold()], ids=lambda p: p.kind
)
def test_angle_table(phase):
    beta, edge = arrays.angle_table(phase), arrays.angle_edges()
    assert np.sum(beta * 2.0 * np.pi * -np.diff(np.cos(edge))) == pytest.approx(1.0, rel=2e-4)
    tail = np.append(np.cumsum((beta * np.diff(edge))[::-1])[::-1], 0.0)
    for theta in (1e-6, 1e-3, 0.1, 1.0, 3.0):
        expected = quad(
            lambda x: float(phase.pdf(math.exp(x))) * math.exp(x),
            math.log(theta),
            math.log(math.pi),
            limit=500,
            epsrel=1e-4,
        )[0]
        assert np.interp(theta, edge, tail) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(
    ("link", "field"),
    [
        (mt.Link(physics="paper"), "physics.snell"),
        (mt.Link(physics=mt.Physics(second_hit="ignore")), "physics.second_hit"),
        (mt.Link(transmitter=mt.Sun()), "transmitter"),
        (mt.Link(receiver=mt.WaterAperture()), "receiver"),
        (mt.Link(transmitter=mt.GaussianBeam(divergence_deg=0.01)), "transmitter"),
        (
            mt.Link(water=mt.Water(layers=LAYERS), physics=mt.Physics(absorption="paper")),
            "physics.absorption",
        ),
    ],
    ids=["snell", "second hit", "sun", "aperture", "narrow", "absorption"],
)
def test_refuses_what_it_does_not_follow(link, field):
    with pytest.raises(Refused, match="allowed") as refused:
        joined.JoinedPhotons(link, 1000, 1)
    assert refused.value.field == field
