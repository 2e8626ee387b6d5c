"""Links from the air into the water in all studies."""

import warnings
from itertools import cycle

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.stored import Stored
from meshtrace.surfaces import FlatSea, SinusoidalSea, sea_in_wind

DOWN = mt.Link().mirrored()
BEAM = DOWN.replace(transmitter=mt.AirBeam(divergence_deg=2.0))
HAT = DOWN.replace(transmitter=mt.AirTopHatBeam(divergence_deg=5.0))
WAVE, SEA = SinusoidalSea(amplitude=0.05, wavelength=3.0), sea_in_wind(5.0)
MESH = {"photons": 64, "mesh": mt.Meshing(extent=4.0, spacing=0.3)}
FLIGHT = mt.Flight(mt.Uav(), mt.Dryden(wind_speed=5.0))
ROUTE = mt.Route(times=(0.0, 0.1), positions=((0.0, 0.0), (1.0, 0.0)))
TIMES = [0.0, 0.1]


def measured(link):
    """Return gains at three depths, of 2 % each."""
    rows = []
    for depth in (5.0, 8.0, 10.0):
        gain = float(mt.simulate(link.at_depth(depth), FlatSea(), photons=512).gain)
        rows.append({"receiver.depth": depth, "gain": gain, "stderr": 0.02 * gain})
    return rows


STUDIES = {
    "series": lambda at: mt.time_series(at, WAVE, TIMES, **MESH).gain,
    "flight": lambda at: mt.time_series(at, WAVE, TIMES, flight=FLIGHT, **MESH).gain,
    "route": lambda at: mt.time_series(at, WAVE, TIMES, route=ROUTE, **MESH).gain,
    "ensemble": lambda at: mt.ensemble(at, 2, SEA, **MESH).gain,
    "both directions": lambda at: mt.duplex(mt.Link(), at, WAVE, TIMES, **MESH).down.gain,
    "map": lambda at: mt.coverage_map(at, FlatSea(), 1.0, 0.5, photons=100_000).gain.max(),
    "impulse response": lambda at: mt.impulse_response(
        mt.simulate(at, WAVE, record=["arrivals"], **MESH)
    ).mean_delay,
    "bits": lambda at: mt.link_performance(at, WAVE, photons=64, depths=[10.0, 20.0])
    .at()
    .margin_optical_db,
    "bits over depth": lambda at: mt.depth_sweep(
        at, [10.0, 20.0], wind_speeds=[0.0], photons=64, bit_rate=1e6
    )
    .performances[0]
    .at()
    .required_power,
    "comparison": lambda at: mt.compare({"a": at, "b": at.at_depth(9.0)}, WAVE, photons=64).gain,
    "paths": lambda at: mt.trace_paths(at, WAVE, 5).length,
    "sensitivities": lambda at: [
        row.stderr
        for row in mt.sensitivities(
            at, WAVE, ["water.a", "receiver.fov_deg", "transmitter.height"], photons=64
        ).table
    ],
    "optimum": lambda at: mt.optimize(
        at, FlatSea(), {"receiver.depth": (5.0, 10.0)}, "gain", realizations=1, photons=32
    ).value,
    "inference": lambda at: mt.infer(
        measured(at), at.replace("water.a", 0.13), ["water.a"], photons=64
    ).estimate,
    "convergence": lambda at: mt.convergence_study(
        at, WAVE, (1.0, 0.7, 0.5, 0.35), photons=64, placements=2, reference=None
    ).gain,
}  # fmt: skip


@pytest.mark.parametrize("link", [DOWN, BEAM, HAT], ids=["led", "beam", "top hat"])
@pytest.mark.parametrize("study", STUDIES)
@pytest.mark.slow_but(*map("-".join, zip(STUDIES, cycle(["led", "beam", "top hat"]))))
def test_studies_take_a_downlink(study, link):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of few chains
        found = np.asarray(STUDIES[study](link), dtype=float)
    assert np.isfinite(found).all()
    assert (found > 0.0).all()


def test_results_of_a_downlink_are_stored(tmp_path):
    found = mt.time_series(DOWN, WAVE, TIMES, **MESH)
    assert isinstance(found, Stored)
    found.save(tmp_path / "down.nc")
    again = mt.GainSeries.load(tmp_path / "down.nc")
    np.testing.assert_array_equal(again.gain, found.gain)


@pytest.mark.statistical
@pytest.mark.slow
def test_elasticities_are_those_of_the_mirrored_link():
    # a Lambertian lamp and a half space of view: both directions differ by n^2 alone
    even = mt.Link(transmitter=mt.Led(half_angle_deg=60.0), receiver=mt.Receiver(fov_deg=180.0))
    names = ("water.a", "water.b", "transmitter.depth", "receiver.height", "receiver.radius")
    mirror = ("water.a", "water.b", "receiver.depth", "transmitter.height", "receiver.radius")
    up = mt.sensitivities(even, WAVE, names, photons=512)
    down = mt.sensitivities(even.mirrored(), WAVE, mirror, photons=512)
    error = np.hypot(up.stderr, down.stderr / 1.33**2)
    assert abs(up.value - down.value / 1.33**2) < 4.0 * error
    for a, b in zip(up.table, down.table, strict=True):
        assert a.method == b.method
        assert abs(a.elasticity - b.elasticity) < 4.0 * np.hypot(a.stderr, b.stderr)


@pytest.mark.thorough
def test_sensitivity_to_the_field_of_view_is_that_of_two_runs():
    link, options = DOWN.replace("receiver.fov_deg", 20.0), {"photons": 8192}
    row = mt.sensitivities(link, FlatSea(), ["receiver.fov_deg"], **options).table[0]
    low, high = (
        mt.simulate(link.replace("receiver.fov_deg", fov), FlatSea(), **options)
        for fov in (18.0, 22.0)
    )
    slope = np.log(high.gain / low.gain) / np.log(22.0 / 18.0)
    error = np.hypot(high.gain_stderr, low.gain_stderr) / low.gain / np.log(22.0 / 18.0)
    assert row.method == "angle"
    assert abs(row.elasticity - slope) < 4.0 * np.hypot(row.stderr, error)


@pytest.mark.parametrize(
    ("variable", "best"), [("transmitter.half_angle_deg", 5.0), ("receiver.fov_deg", 40.0)]
)
@pytest.mark.thorough
@pytest.mark.slow_but("receiver.fov_deg-40.0")
def test_the_gain_of_an_optimum_is_that_of_its_link(variable, best):
    found = mt.optimize(
        DOWN, FlatSea(), {variable: (5.0, 40.0)}, "gain", realizations=1, photons=2048
    )
    one = mt.simulate(found.best, FlatSea(), photons=8192)
    assert found.values[0] == pytest.approx(best)
    assert found.stderr < 0.02 * found.value
    assert abs(found.value - one.gain) < 4.0 * np.hypot(found.stderr, one.gain_stderr)


@pytest.mark.slow
def test_an_aircraft_that_hovers_with_the_lamp():
    options = {"realizations": 1, "photons": 32, "method": "bounded"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = mt.optimize(DOWN, SEA, {"transmitter.height": (3.0, 10.0)}, "gain",
                            hover_std=(0.3, 0.3), flight=mt.Flight(), **options)  # fmt: skip
    assert 0.0 < found.value < mt.simulate(found.best, FlatSea(), photons=512).gain
    with pytest.raises(mt.Refused, match=r"^transmitter\.tilt_deg: 5"):
        mt.optimize(DOWN.replace("transmitter.tilt_deg", 5.0), SEA,
                    {"transmitter.height": (3.0, 10.0)}, flight=mt.Flight(), **options)  # fmt: skip
