"""Studies of links whose ends lie on one side: right, or refused in one line."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

import meshtrace as mt
from meshtrace.errors import Refused
from meshtrace.kernels import tally
from meshtrace.scenario import Scenario
from meshtrace.surfaces import FlatSea, JonswapSea, SinusoidalSea

EXAMPLES = Path(__file__).parents[2] / "examples"
WATER = mt.Water(a=0.114, b=0.037)
UNDER = mt.Link(
    water=WATER,
    transmitter=mt.Led(depth=5.0, zenith_deg=90.0),
    receiver=mt.WaterReceiver(
        depth=5.0, position=(20.0, 0.0), tilt_deg=90.0, tilt_azimuth_deg=180.0, fov_deg=180.0
    ),
)
OVER = mt.Link(
    transmitter=mt.AirLed(height=5.0, tilt_deg=40.0),
    receiver=mt.Receiver(
        height=5.0, position=(8.0, 0.0), tilt_deg=90.0, tilt_azimuth_deg=180.0, fov_deg=120.0
    ),
)
LINKS = pytest.mark.parametrize("link", [UNDER, OVER], ids=["under", "over"])
FLAT, SEA = FlatSea(), JonswapSea(wind_speed=5.0, seed=7)
FEW = {"photons": 64, "threads": 1}
SPEED = 299792458.0

# short runs have few samples; no band of waves has the fading of light that is mirrored
pytestmark = [
    pytest.mark.filterwarnings("ignore::meshtrace.FewSamplesWarning"),
    pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning"),
    pytest.mark.filterwarnings("ignore:the fading of short waves is left out"),
]

REFUSED = {
    "sensitivities": lambda link: mt.sensitivities(link, FLAT, ["water.a"], **FEW),
    "range": lambda link: mt.sensitivities(link, FLAT, ["water.a"], quantity="range", **FEW),
    "optimize": lambda link: mt.optimize(link, FLAT, {"water.a": (0.1, 0.2)}, **FEW),
    "infer": lambda link: mt.infer([{"water.b": 0.1, "gain": 1e-5, "stderr": 1e-6}], link,
                                   ["water.a"], **FEW),
    "design": lambda link: mt.design(Scenario.from_config({"physics": "physical"}).model_copy(
        update={"link": link}), **FEW),
    "convergence": lambda link: mt.convergence_study(link, SEA, unresolved="none", **FEW),
    "band": lambda link: mt.band_limit_study(link, SEA, (2.0, 4.0, 6.0, 8.0), **FEW),
    "step": lambda link: mt.time_step_study(link, SEA, (1.0, 0.5, 0.25, 0.125), **FEW),
}  # fmt: skip


@LINKS
@pytest.mark.parametrize("study", REFUSED)
def test_what_rests_on_chains_is_refused_in_one_line(link, study):
    with pytest.raises(Refused) as refusal:
        REFUSED[study](link)
    assert str(refusal.value) == "link: ends on one side, allowed: a link that changes sides"


@LINKS
@pytest.mark.parametrize("sea", [FLAT, SinusoidalSea(amplitude=0.01, wavelength=4.0)])
def test_received_paths_go_straight_and_by_the_mirror(link, sea):
    """Paths obey the law of reflection; straight and mirrored ones are as many as their light."""
    n, mesh, under = 400, sea.mesh(extent=21.0, spacing=0.1), link.direction == "under"
    lamp = {"half_angle_deg": 40.0, "zenith_deg": 40.0}
    if not under:
        lamp = {"half_angle_deg": 20.0, "tilt_deg": 40.0}
    link = link.replace(transmitter=link.transmitters[0].replace(**lamp))
    paths = mt.trace_paths(link, mesh, n, received_only=True, seed=3, normals="facet")
    assert paths.received.all()
    receiver, ends = link.receivers[0], paths.vertex[np.arange(n), paths.length - 1]
    assert np.linalg.norm(ends - receiver.center, axis=1).max() <= receiver.radius * (1.0 + 1e-9)
    mirrored = paths.length == 3
    start, at, end = (paths.vertex[mirrored, i] for i in range(3))
    assert np.allclose(start, link.transmitters[0].center)
    met = mt.Vertex.SURFACE_OUT if under else mt.Vertex.SURFACE_IN
    assert (paths.what[mirrored, 1] == met).all()
    incoming, outgoing = (v / np.linalg.norm(v, axis=1)[:, None] for v in (at - start, end - at))
    slopes = -((outgoing - incoming)[:, :2] / (outgoing - incoming)[:, 2:])
    _, facet = cKDTree(mesh.vertices[mesh.faces].mean(axis=1)).query(at)
    normal = mesh.face_normals[facet]
    error = np.abs(slopes + normal[:, :2] / normal[:, 2:]).max(axis=1)
    # exact where the drawn facet mirrors to the drawn point; its centroid is 5 cm off in 5 m
    assert (error < 1e-9).mean() > 0.02
    assert error.max() < 0.05
    light = mt.simulate(link, mesh, normals="facet", **FEW).gain_parts
    share = light["mirrored"] / (light["straight"] + light["mirrored"])
    # alpha 1e-4 over four cases: 4.2 standard deviations
    assert 0.02 < share < 0.98
    assert abs(mirrored.mean() - share) < 4.2 * math.sqrt(share * (1.0 - share) / n)


@LINKS
def test_closed_forms_of_fading_are_refused(link):
    assert mt.fading.spectral.band_fading(link, SEA) is None
    with pytest.raises(Refused, match=r"^(receiver|transmitter): "):
        mt.studies.fading_study(link, mt.surfaces.resolved_sea(5.0), **FEW)
    with pytest.raises(Refused, match=r"^waves: "):
        mt.fading.spectral.resolve_band(link, SEA, "fading")
    with pytest.raises(Refused, match=r"^(receiver|transmitter): "):
        mt.light_pattern(link, FLAT, step=0.1)


@LINKS
def test_mirrored_links_exchange_the_ends(link):
    back = link.mirrored()
    assert back.direction == link.direction
    assert back.transmitter.center == link.receiver.center
    assert back.receiver.center == link.transmitter.center
    # each end keeps the axis of its place: they still face each other
    assert back.transmitter.axis == pytest.approx([-x for x in link.receiver.axis], abs=1e-12)
    assert back.receiver.axis == pytest.approx([-x for x in link.transmitter.axis], abs=1e-12)
    assert back.mirrored() == link


@pytest.mark.parametrize("name", ["underwater", "mirror"])
def test_examples_are_links_under_water(name):
    scenario = Scenario.load(EXAMPLES / f"{name}.toml")
    assert scenario.link.direction == "under"
    assert scenario.run.estimator.kind == "forced"
    result = mt.simulate(scenario, seed=2, **FEW)
    again = mt.simulate(scenario.link, scenario.surface, seed=2, **FEW)
    assert (result.gain, result.gain_stderr) == (again.gain, again.gain_stderr)
    parts = result.gain_parts
    assert sum(parts.values()) == pytest.approx(result.gain, rel=1e-12)
    assert parts["mirrored"] > 0.0
    assert (parts["straight"] > 0.0) == (name == "underwater")


@LINKS
def test_arrivals_hold_all_light_with_its_times(link):
    result = mt.simulate(link, FLAT, photons=256, threads=1, record=[mt.Arrivals()])
    arrivals, parts = result.arrivals, result.gain_part[0]
    by_part = [arrivals.weight[arrivals.part == k].sum() for k in range(len(parts))]
    assert by_part == pytest.approx(parts, rel=1e-9)
    n = link.water.n if link.direction == "under" else link.n_air
    start, end = np.array(link.transmitter.center), np.array(link.receiver.center)
    for part, image in ((tally.DIRECT, end), (tally.MIRRORED, end * [1.0, 1.0, -1.0])):
        of_part = arrivals.part == part
        mean = np.average(arrivals.time[of_part], weights=arrivals.weight[of_part])
        # paths run by centroids of facets and the centre of the aperture
        assert mean == pytest.approx(n * math.dist(start, image) / SPEED, rel=1e-3)
    if link.direction == "over":
        assert not arrivals.water_path[arrivals.part == tally.MIRRORED].any()
    else:
        assert not arrivals.air_path[arrivals.part == tally.MIRRORED].any()


@LINKS
def test_unscattered_light_at_wavelengths_is_that_of_single_runs(link):
    link = link.replace(water=mt.Water.from_type("jerlov-II"))
    at = (450.0, 500.0, 550.0)
    results = mt.simulate(link, SEA, wavelengths_nm=at, record=[mt.Arrivals()], **FEW).results
    for nm, result in zip(at, results, strict=True):
        alone = mt.simulate(link.at_wavelength(nm), SEA, **FEW).gain_part[0]
        for part in (tally.DIRECT, tally.MIRRORED):
            assert result.gain_part[0, part] == pytest.approx(alone[part], rel=1e-4)
        assert result.arrivals.weight.sum() == pytest.approx(result.gain, rel=1e-3)


@LINKS
def test_receivers_and_lamps_add_up(link):
    wide = link.receiver.replace(radius=0.1)
    both = mt.simulate(link.replace(receiver=(link.receiver, wide)), SEA, **FEW)
    alone = [mt.simulate(link.replace(receiver=r), SEA, **FEW) for r in (link.receiver, wide)]
    strong = link.transmitter.replace(power_mw=200.0)
    aside = link.transmitter.replace(power_mw=50.0, position=(1.0, 1.0))
    lamps = [mt.simulate(link.replace(transmitter=t), SEA, **FEW) for t in (strong, aside)]
    sum_of_lamps = mt.simulate(link.replace(transmitter=(strong, aside)), SEA, **FEW)
    share = 0.8 * lamps[0].gain_part[0] + 0.2 * lamps[1].gain_part[0]
    for part in (tally.DIRECT, tally.MIRRORED):
        for i, result in enumerate(alone):
            assert both.gain_part[i, part] == pytest.approx(result.gain_part[0, part], rel=1e-4)
        assert sum_of_lamps.gain_part[0, part] == pytest.approx(share[part], rel=1e-4)


@LINKS
def test_results_do_not_depend_on_the_threads(link):
    link = link.replace(receiver=(link.receiver, link.receiver.replace(radius=0.1)))
    options = {"photons": 256, "record": [mt.Arrivals()]}
    one, three = (mt.simulate(link, SEA, threads=n, **options) for n in (1, 3))
    assert one.gains.tolist() == three.gains.tolist()
    assert one.stderrs.tolist() == three.stderrs.tolist()
    assert one.gain_part.tolist() == three.gain_part.tolist()
    assert one.arrivals.weight.tolist() == three.arrivals.weight.tolist()
    series = [mt.ensemble(link, 2, SEA, photons=64, threads=n).gain.tolist() for n in (1, 2)]
    assert series[0] == series[1]


def test_errors_of_compared_links_hold_the_noise_that_seas_share():
    # most of the light does not meet the sea: seas differ far less than runs of other photons
    links = {"a": UNDER, "b": UNDER.replace("receiver.radius", 0.06)}
    found = mt.compare(links, SEA, realizations=3, **FEW)
    seas = mt.ensemble(UNDER, 3, SEA, waves="mean", **FEW)
    scatter = seas.gain.std(ddof=1) / math.sqrt(3.0)
    assert found.gain[0] == pytest.approx(seas.gain.mean(), rel=1e-5)  # on the mesh of both links
    assert found.gain_stderr[0] == pytest.approx(math.hypot(scatter, seas.mean_stderr), rel=1e-3)
    assert scatter < 0.5 * found.gain_stderr[0]


def test_maps_refuse_a_tilted_receiver_in_the_plane_of_a_lamp():
    for link, end in ((UNDER, "depth"), (OVER, "height")):
        with pytest.raises(Refused, match=rf"^receiver\.{end}: 5\.0, allowed: 0\.25 m"):
            mt.coverage_map(link, FLAT, **FEW)
        upright = link.replace("receiver.tilt_deg", 180.0)
        mt.coverage_map(upright, FLAT, extent=1.0, **FEW)
        mt.coverage_map(link.replace(f"receiver.{end}", 4.0), FLAT, extent=1.0, **FEW)


def test_performance_of_a_link_without_a_depth_names_none():
    found = mt.link_performance(OVER, SEA, bit_rate=5e6, realizations=2, **FEW)
    assert "nan" not in repr(found)
    assert "nan m" not in found.summary()
    with pytest.raises(Refused, match=r"^transmitter: air-led"):
        mt.link_performance(OVER, SEA, depths=[3.0, 5.0], realizations=2, **FEW)


def test_aircraft_and_routes_need_an_end_in_the_air():
    flight = mt.Flight(mt.Uav(), mt.Dryden())
    route = mt.Route(times=(0.0, 1.0), positions=((0.0, 0.0), (1.0, 0.0)))
    for moves in ({"flight": flight}, {"route": route}):
        with pytest.raises(Refused, match=r"^receiver: water-receiver, allowed: one receiver in"):
            mt.time_series(UNDER, SEA, [0.0, 1.0], **moves, **FEW)
    with pytest.raises(Refused, match=r"^receiver\.tilt_deg: 90\.0, allowed: 0: the flight"):
        mt.time_series(OVER, SEA, [0.0, 1.0], flight=flight, **FEW)
    moved = mt.time_series(OVER, FLAT, [0.0, 1.0], route=route, **FEW)
    for gain, x in zip(moved.gain, (0.0, 1.0), strict=True):
        there = mt.simulate(OVER.replace("receiver.position", (x, 0.0)), FLAT, **FEW)
        assert gain == pytest.approx(there.gain, rel=0.01)


@pytest.mark.parametrize("tilt_deg", [0.0, 90.0, 180.0])
def test_receivers_in_the_air_see_the_sky_they_look_at(tilt_deg):
    link = OVER.replace("receiver.tilt_deg", tilt_deg).replace("receiver.fov_deg", 20.0)
    sky = mt.Daylight(direct=0.0, diffuse=0.3, pattern="uniform", water="none")
    found = mt.background(link, FLAT, sky, photons=256, threads=1)
    if tilt_deg == 180.0:  # the radiance of an even sky is its irradiance over pi
        assert found.parts["sky"] == pytest.approx(0.3 / math.pi, rel=1e-6)
    elif tilt_deg == 0.0:  # reflectance of still water at normal incidence
        assert found.parts["sky"] == pytest.approx(0.3 / math.pi * 0.0200, rel=0.02)
    else:  # half sky, half its mirror image at grazing incidence, which is darker
        assert 0.5 < found.parts["sky"] / (0.3 / math.pi) < 1.0


@pytest.mark.thorough
def test_maps_under_water_are_the_gains_of_receivers():
    lamp = mt.Led(depth=6.0, half_angle_deg=30.0)
    receiver = mt.WaterReceiver(depth=3.0, radius=0.1, tilt_deg=180.0, fov_deg=120.0)
    link = mt.Link(water=WATER, transmitter=lamp, receiver=receiver)
    found = mt.coverage_map(link, FLAT, 1.25, 0.5, photons=2_000_000, seed=3)
    places = tuple(receiver.replace(position=(x, 0.0)) for x in found.x.tolist())
    gains = mt.simulate(link.replace(receiver=places), FLAT, photons=4000, seed=3)
    middle = len(places) // 2
    errors = np.hypot(found.gain_stderr[:, middle], gains.stderrs)
    # the mean over a cell is that of its middle to second order in its edge: 1 %
    off = np.abs(found.gain[:, middle] - gains.gains) - 0.01 * gains.gains
    assert (off / errors).max() < 4.3  # two-sided alpha of 1e-4, five places


@pytest.mark.thorough
@pytest.mark.slow_but("over")
@LINKS
def test_frames_have_the_mean_of_realizations(link):
    sea = JonswapSea(wind_speed=5.0, seed=11)
    times = 40.0 * np.arange(24)  # far beyond the correlation time of the waves
    frames = mt.time_series(link, sea, times, photons=256, waves="mean")
    seas = mt.ensemble(link, 24, sea, photons=256, waves="mean", seed=2)
    spread = math.hypot(*(s.gain.std(ddof=1) / math.sqrt(len(s.gain)) for s in (frames, seas)))
    error = math.hypot(spread, frames.mean_stderr, seas.mean_stderr)
    assert abs(frames.gain.mean() - seas.gain.mean()) < 3.9 * error  # two-sided alpha of 1e-4
