"""Inputs that once ended in a traceback: each is one line of field, value, allowed."""

import math

import numpy as np
import pytest

import meshtrace as mt
from meshtrace import fading, surfaces
from meshtrace.comms import budget, capacity, decisions, devices
from meshtrace.errors import Refused
from meshtrace.results import gain
from meshtrace.studies import swings
from meshtrace.surfaces import FlatSea
from paper import water as profiles

CORNERS = [(-9.0, -9.0, 0.0), (9.0, -9.0, 0.0), (9.0, 9.0, 0.0)]
LINK, SEA = mt.Link(), FlatSea()

CALLS = {
    "link": lambda: mt.simulate(1, SEA),
    "photons": lambda: mt.simulate(LINK, SEA, photons=2**31),
    "spacing": lambda: mt.simulate(LINK, SEA, spacing=10**400),
    "estimator": lambda: mt.simulate(LINK, SEA, np.array([])),
    "threads": lambda: mt.time_series(LINK, SEA, [0.0], threads=math.nan),
    "times": lambda: mt.time_series(LINK, SEA, "x"),
    "bit_rate": lambda: mt.link_performance(LINK, SEA, bit_rate=np.array("x")),
    "realizations": lambda: mt.link_performance(LINK, SEA, realizations=""),
    "flight.uav": lambda: mt.link_performance(LINK, SEA, flight=mt.Flight("x"), realizations=2),
    "n": lambda: mt.trace_paths(LINK, SEA, n=np.array("x")),
    "mesh.faces": lambda: mt.TriangleMesh(CORNERS, [[0, 1, 2**63]]),
    "mesh.vertices": lambda: mt.TriangleMesh({}, [[0, 1, 2]]),
}

GAINS, TIMES = np.array([1.0, 2.0, 3.0, 4.0]), np.arange(4.0)
OOK, WIND, UAV, SEA_OF_WAVES = mt.OokLink(), mt.Dryden(), mt.Uav(), surfaces.JonswapSea()

ROWS = [{"transmitter.depth": 5.0, "gain": 3e-4, "stderr": 3e-5}]
SERIES = mt.GainSeries("time", TIMES, GAINS, GAINS, GAINS, 1e-7)
OVER, DAY = {"receiver.fov_deg": (10.0, 60.0)}, mt.Daylight(direct=1.4, diffuse=0.3)

Z = np.array([0.0, 50.0])
WATER = profiles.WaterProfile(Z, np.array([26.0, 22.0]), np.array([35.0, 35.0]))
CHOPPY = surfaces.JonswapSea(wind_speed=5.0, waves="paper", choppy=True)

METHODS = [
    ("x_axis", lambda: SEA.grid(np.zeros((2, 2)), TIMES)),
    ("y_axis", lambda: SEA_OF_WAVES.grid(TIMES, np.zeros((2, 2)))),
    ("x_axis", lambda: CHOPPY.grid([[], [1]], TIMES)),
    ("y", lambda: CHOPPY.elevation(np.zeros(3), np.zeros((2, 2)))),
    ("depth", lambda: profiles.WaterProfile([[1.0, 2.0], [3.0]], Z, Z)),
    ("latitude", lambda: profiles.WaterProfile(Z, Z, Z, "x")),
    ("depth", lambda: WATER.n("x")),
    ("wavelength_nm", lambda: WATER.n(1.0, {})),
    ("profile", lambda: profiles.ray_deflection(None, 5.0, 0.1)),
    ("profile", lambda: profiles.ray_deflection(Z, 5.0, 0.1)),
    ("depth", lambda: profiles.ray_deflection(WATER, "x", 0.1)),
    ("zenith", lambda: profiles.ray_deflection(WATER, 5.0, None)),
    ("pressure", lambda: profiles.depth_of_pressure("x", 1.0)),
    ("latitude", lambda: profiles.depth_of_pressure(1.0, math.nan)),
    ("path", lambda: profiles.load_profiles(None)),
    ("mesh", lambda: mt.simulate(LINK, SEA, spacing=1e-300)),
    ("mesh", lambda: mt.simulate(LINK, SEA, mesh=[[], [1]])),
    ("record", lambda: mt.simulate(LINK, SEA, record=np.int64(3))),
    ("max_vertices", lambda: mt.trace_paths(LINK, SEA, n=9, max_vertices=1.8e308)),
    ("max_vertices", lambda: mt.trace_paths(LINK, SEA, n=100, max_vertices=10**7)),
    ("up", lambda: mt.duplex(None, None, SEA_OF_WAVES)),
    ("link", lambda: OOK.channel(None)),
    ("mesh", lambda: mt.EmbreeIntersector(None)),
    ("mesh", lambda: mt.BruteForceIntersector("x")),
    ("wind_speed", lambda: LINK.in_wind(np.array([0.0, 2.0]))),
    ("path", lambda: LINK.replace(np.array(["a", "b"]), 1.0)),
    ("changes", lambda: mt.Scenario.from_toml("", changes=(0.0, 0.0))),
    ("provenance", lambda: mt.Scenario.from_provenance([[1.0]])),
    ("realizations", lambda: mt.depth_sweep(LINK, realizations=np.zeros((2, 2)))),
    ("duration", lambda: mt.time_step_study(LINK, SEA_OF_WAVES, (1, 2, 4, 8), duration=10**400)),
    ("results", lambda: mt.merge({"a": 1})),
    ("results[0]", lambda: mt.merge([1])),
    ("result", lambda: mt.impulse_response(range(3))),
    ("center", lambda: SEA.mesh(center=(0.0, 0.0, 0.0))),
    ("time", lambda: SEA.mesh(time=None)),
    ("x_axis", lambda: SEA.grid([[], [1]], TIMES)),
    ("y", lambda: SEA_OF_WAVES.elevation(np.zeros(3), np.zeros((2, 2)))),
    ("y", lambda: SEA.elevation(np.zeros(3), b"x")),
    ("omega_max", lambda: SEA_OF_WAVES.slope_spectrum(np.array(["a", "b"]))),
    ("coarse_spacing", lambda: SEA.mesh(fine_extent=1.0, coarse_spacing=1j)),
    ("source", lambda: surfaces.from_trimesh(("", [[0, 1, 2]]))),
    ("source", lambda: surfaces.from_wavespectra(["w.csv"])),
    ("sea.file", lambda: mt.Scenario.from_toml('[sea]\nspectrum = "measured"\nfile = ["w.csv"]')),
    ("config", lambda: surfaces.sea_from_config(np.datetime64("2020-01-01"))),
    ("wind_speed", lambda: surfaces.sea_in_wind("")),
    ("wind_speed", lambda: surfaces.sea_in_wind(np.array([0.0, 5.0]))),
    ("link", lambda: budget.required_gain(1.0, 1e-3)),
    ("link", lambda: budget.link_budget(LINK, 1e-5, 1e-3)),
    ("link", lambda: capacity.capacity("x", 1e-5)),
    ("outage", lambda: capacity.capacity(OOK, 1e-5, outage=None)),
    ("dark_rate", lambda: capacity.wyner_capacity(1.0, "x")),
    ("n_effective", lambda: budget.average_ber(OOK, GAINS, n_effective="5")),
    ("seed", lambda: budget.average_ber(OOK, GAINS, seed=[1.0])),
    ("depth", lambda: budget.depth_at({1, 2}, GAINS, 1.0)),
    ("limit", lambda: budget.depth_at(TIMES, GAINS, "x")),
    ("wavelength", lambda: devices.photon_energy([470e-9])),
    ("m1", lambda: decisions.gaussian_decision(0.0, 3 + 4j, 1.0, 1.0)),
    ("mean", lambda: decisions.pattern_decision("5", GAINS, [True] * 4)),
    ("is_one", lambda: decisions.pattern_decision(GAINS, GAINS, True)),
    ("branching", lambda: decisions.generalized_poisson_decision(1.0, 2.0, None)),
    ("primaries", lambda: decisions.generalized_poisson_logpmf(1, [2.0, 1.0], 0.1)),
    ("branching", lambda: decisions.generalized_poisson_logpmf(1, 2.0, 1.0)),
    ("k", lambda: decisions.generalized_poisson_logpmf(-1, 2.0, 0.1)),
    ("ber", lambda: capacity.hard_information(1.5)),
    ("noise_bandwidth", lambda: devices.SiPM().p_min(470e-9, "x")),
    ("radiance_per_nm", lambda: devices.OpticalFrontEnd().background_power("x", 1e-5)),
    ("n0, n1, branching", lambda: decisions.soft_information(2.0, 20.0, 180.0)),
    ("power", lambda: OOK.ber("x")),
    ("power", lambda: mt.OokLink(model="G0").ber([1e-9, 1e12])),
    ("power", lambda: OOK.threshold({})),
    ("phase", lambda: OOK.moments(1e-9, (0.0, 0.0))),
    ("points", lambda: OOK.eye(1e-9, 2**62)),
    ("ber", lambda: OOK.required_power([[], [1]])),
    ("link", lambda: OOK.channel(b"xyz")),
    ("link", lambda: mt.OokLink.of_link(np.zeros(0))),
    ("wind", lambda: UAV.tilt_law(())),
    ("wind", lambda: UAV.tilt([1.0, 2.0])),
    ("seed", lambda: WIND.sample_wind(3, -1)),
    ("size", lambda: WIND.sample_wind(0.5, 1)),
    ("times", lambda: WIND.simulate_wind(int, 1)),
    ("lag", lambda: WIND.autocorrelation(["a"])),
    ("depth", lambda: mt.Water().profile(len)),
    ("theta", lambda: mt.HenyeyGreenstein(g=0.9).pdf(b"x")),
    ("dz", lambda: mt.HallNovarini(wind_speed=5.0).profile(None)),
    ("dz", lambda: mt.HallNovarini(wind_speed=5.0).profile(1e-12)),
    ("count", lambda: mt.HallNovarini(wind_speed=5.0).equal_area_radii(range(3))),
    ("config", lambda: mt.Scenario.from_config({1})),
    ("gain", lambda: fading.remove_noise({1})),
    ("gain_stderr", lambda: fading.remove_noise(GAINS, len)),
    ("seed", lambda: fading.scintillation_index(GAINS, seed=1e-8)),
    ("confidence", lambda: fading.outage(GAINS, confidence="x")),
    ("test_resamples", lambda: fading.fading_statistics(GAINS, test_resamples=LINK)),
    ("max_lag", lambda: fading.autocorrelation(GAINS, max_lag=0.5)),
    ("block", lambda: fading.coherence_time(TIMES, GAINS, block=54)),
    ("bins", lambda: fading.gain_pdf(GAINS, bins=-9)),
    ("bins", lambda: fading.gain_pdf(GAINS, bins="x")),
    ("link", lambda: fading.gain_autocovariance(object(), SEA_OF_WAVES, TIMES)),
    ("omega_max", lambda: fading.scintillation_of_spectrum(LINK, SEA_OF_WAVES, ["a"])),
    ("receiver.position", lambda: mt.Link(receiver={"position": [1.0, 2.0, 3.0]})),
    ("whitecaps.wind_speed", lambda: mt.Link(whitecaps={"wind_speed": 31.0})),
    ("profile", lambda: mt.Dryden(profile="log")),
    ("surface", lambda: mt.sensitivities(LINK, 1.0, ["water.a"])),
    ("surface", lambda: mt.infer(ROWS, LINK, ["water.a"], surface=len)),
    ("surface", lambda: mt.optimize(LINK, True, OVER, "gain")),
    ("wrt", lambda: mt.sensitivities(LINK, SEA, 90.0)),
    ("step", lambda: mt.sensitivities(LINK, SEA, ["water.a"], step=1e30)),
    ("unknown", lambda: mt.infer(ROWS, LINK, math.inf)),
    ("prior", lambda: mt.infer(ROWS, LINK, ["water.a"], 1.0)),
    ("prior.water.a", lambda: mt.infer(ROWS, LINK, ["water.a"], {"water.a": "ab"})),
    ("threads", lambda: mt.infer(ROWS, LINK, ["water.a"], threads="x")),
    ("measurements[0].counts", lambda: mt.infer([{"counts": "x"}], LINK, ["water.a"])),
    ("measurements.gain", lambda: mt.infer({"gain": [[1], [1, 2]]}, LINK, ["water.a"])),
    ("constraints", lambda: mt.optimize(LINK, SEA, OVER, "gain", 1.0)),
    ("bounds", lambda: mt.optimize(LINK, SEA, {"foo.bar": (10.0, 60.0)})),
    ("unknown", lambda: mt.infer(ROWS, LINK, ["foo.bar"])),
    ("bounds.receiver.fov_deg", lambda: mt.optimize(LINK, SEA, {"receiver.fov_deg": "ab"})),
    ("hover_std", lambda: mt.optimize(LINK, SEA, OVER, "gain", hover_std="ab")),
    ("step", lambda: mt.light_pattern(LINK, SEA, 1.0, "")),
    ("time", lambda: mt.light_pattern(LINK, SEA, 1.0, 0.1, time="x")),
    ("up_gain", lambda: mt.Duplex(SERIES, SERIES).outage("x", 1.0)),
    ("transmittance", lambda: mt.Daylight.overcast(transmittance="x")),
    ("times", lambda: mt.Route(times=(0, 1), positions=((0, 0), (1, 0))).at({}, 5.0)),
    ("height", lambda: mt.Route(times=(0, 1), positions=((0, 0), (1, 0))).at(0.5, [5.0, 6.0])),
    ("s", lambda: swings(2.5)),
    ("day_of_year", lambda: mt.Daylight.clear_sky(day_of_year=(0,))),
    ("link", lambda: mt.depth_sweep(1)),
    ("spacings", lambda: mt.convergence_study(LINK, SEA, 1)),
    ("normals", lambda: mt.convergence_study(LINK, SEA, normals=1.0, reference=None)),
    ("wind_speeds", lambda: mt.depth_sweep(LINK, wind_speeds=1j)),
    ("threads", lambda: mt.background(LINK, SEA, DAY, threads="x")),
]


def check(field, call):
    with pytest.raises(Refused) as caught:
        call()
    text = str(caught.value)
    assert caught.value.field == field
    assert text.isprintable()
    assert len(text) < 500
    assert "Tuple" not in text
    assert "dictionary" not in text


@pytest.mark.parametrize("field", CALLS)
def test_refused_in_one_line(field):
    check(field, CALLS[field])


@pytest.mark.parametrize(("field", "call"), METHODS)
def test_methods_refuse_in_one_line(field, call):
    check(field, call)


@pytest.mark.parametrize("content", [None, "x", "{}", '{"address": 5}', '{"address": "tcp://a"}'])
def test_a_wrong_scheduler_is_refused_without_a_client(content, tmp_path):
    """A client of a wrong address once wrote a traceback when it was deleted."""
    pytest.importorskip("distributed")
    from meshtrace.studies.cluster import _client

    file = tmp_path / "scheduler.json"
    if content is not None:
        file.write_text(content)
    for scheduler in (str(file), "nonsense", "tcp://", "foo://1:2", "tcp://1.2.3.4"):
        with pytest.raises(Refused, match="allowed: the address of a running dask scheduler"):
            with _client(scheduler, 0.1):
                pass


def test_an_unreadable_cache_folder_counts_as_empty(monkeypatch):
    """The home of another user: once an error of the command."""
    from pathlib import Path

    from meshtrace.engine.chains import gain as chain_gain
    from meshtrace.kernels import jit

    def denied(self, pattern):
        raise PermissionError(13, "Permission denied", str(self))
        yield

    jit.sources()  # the kernels themselves can be read
    monkeypatch.setattr(Path, "glob", denied)
    assert chain_gain.contributions._cache.files() == []
    jit.is_compiled(chain_gain.contributions)


def test_ranges_of_optional_parts_are_whole():
    with pytest.raises(Refused, match=r"31\.0, allowed: 0 <= wind_speed <= 30"):
        mt.Link(whitecaps={"wind_speed": 31.0})


def test_a_dark_map_has_no_error():
    """It once was 0 +- 0 with an error of nan %."""
    dark = mt.CoverageMap(Z, Z, np.zeros((2, 2)), np.zeros((2, 2)), {})
    assert "no light received" in dark.summary()
    assert "+-" not in dark.summary()
    assert "nan" not in dark.summary()


def test_counts_of_numpy_are_kept_in_files(tmp_path):
    """The provenance of an option that is numpy's integer once ended in a TypeError of json."""
    pattern = mt.light_pattern(LINK, SEA, np.int64(1), 0.2)
    pattern.save(tmp_path / "pattern.nc")
    assert mt.results.load(tmp_path / "pattern.nc").provenance["extent"] == 1


def test_one_dark_photon_bounds_the_gain_by_one():
    """3 / n is 3 for one photon, and no gain is above 1."""
    assert gain.bound_where_dark(0.0, 1) == 1.0
    link = mt.Link(receiver=mt.Receiver(radius=1e-6))
    run = mt.simulate(link, SEA, "analog", photons=1, seed=1, spacing=1.0)
    assert (run.gain, run.gain_bound) == (0.0, 1.0)


def test_control_characters_of_keys_and_files_are_escaped():
    """A terminal would obey them."""
    refused = Refused("a\x1b[2J", "b\x07", "c\x7f", "d\x9b", "e\x08.toml")
    assert str(refused) == r"e\x08.toml: a\x1b[2J: 'b\x07', d\x9b allowed: c\x7f"
