"""Sound arguments of all public functions: by the name of a parameter, or for one function."""

import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import xarray as xr

import meshtrace as mt
from meshtrace import apps, comms, daylight, optics, studies, surfaces, uav
from meshtrace.comms import pulses
from meshtrace.kernels import interface

LINK, FLAT = mt.Link(), surfaces.FlatSea()
SEA = surfaces.JonswapSea(wind_speed=5.0, seed=7, waves="paper")
LIDAR = mt.Link(
    water=mt.Water(bottom_depth=3.0, bottom_albedo=0.2),
    transmitter=mt.AirTopHatBeam(height=20.0, divergence_deg=0.5),
    receiver=mt.Receiver(height=20.0, fov_deg=2.0),
)
GAIN = 1e-5 * (1.0 + np.random.default_rng(5).random(40))
TIMES = 0.5 * np.arange(40.0)
AXIS = np.linspace(-1.0, 1.0, 4)
RISING = np.array([0.1, 0.2, 0.3])
HEIGHTS = np.zeros((4, 4))
CORNERS = np.array([(-9.0, -9.0, 0.0), (9.0, -9.0, 0.0), (9.0, 9.0, 0.0), (-9.0, 9.0, 0.0)])
FACES = np.array([(0, 1, 2), (0, 2, 3)])
DOWN = np.array([[0.0, 0.0, -1.0]])
UP = np.array([[0.0, 0.6, 0.8]])
RESOLVED = surfaces.resolved_sea(5.0)
_T = 0.25 * np.arange(1024)
WAVES = np.column_stack([_T, np.sin(_T) + 0.3 * np.sin(1.7 * _T)])
"""A record of a wave gauge."""
OOK, DAY, WIND = mt.OokLink(), mt.Daylight(direct=1.4, diffuse=0.3), mt.Dryden()
JONSWAP, ITTC = surfaces.Jonswap(), surfaces.IttcSpreading()
ROUTE = mt.Route(times=(0.0, 1.0), positions=((0.0, 0.0), (1.0, 0.0)))
FEW = {"photons": 64, "threads": 1}
TRACE = mt.ChannelTrace(TIMES, GAIN, 0.01 * GAIN, GAIN, 1e-7)
ROWS = [{"transmitter.depth": d, "gain": 1e-5, "stderr": 1e-6} for d in (5.0, 10.0)]


@cache
def folder():
    """Return a folder for files, kept until the end of the process."""
    made = tempfile.TemporaryDirectory(prefix="walk-")
    folder.kept = made  # removed with the process
    return Path(made.name)


@cache
def result():
    return mt.simulate(LINK, FLAT, photons=32, threads=1, record=[mt.Arrivals()])


@cache
def series():
    return mt.GainSeries("time", TIMES, GAIN, 0.01 * GAIN, GAIN, 1e-7)


@cache
def background():
    return mt.background(LINK, FLAT, DAY, photons=64, threads=1)


@cache
def mesh():
    return FLAT.mesh(extent=3.0, spacing=1.0)


@cache
def plates():
    """Return level squares of four sizes."""
    return [mt.TriangleMesh(0.01 * k * CORNERS, FACES) for k in (1.0, 2.0, 3.0, 4.0)]


@cache
def over_a_plate():
    """Return a link of analog photons, nearly all of which are received, beside a plate."""
    body = mt.Body(plates()[0], position=(3.0, 0.0, -9.0))
    end = mt.Receiver(height=1.0, radius=5.0, fov_deg=180.0)
    link = mt.Link(transmitter=mt.TopHatBeam(), receiver=end, objects=body)
    return mt.Scenario.from_toml('[run]\nestimator = "analog"').replace(link=link)


@cache
def waves():
    return surfaces.WaveComponents(*(np.full(3, x) for x in (0.1, 1.0, 0.1, 0.0, 0.5)))


@cache
def spectrum():
    """Return a directional spectrum in the conventions of wavespectra."""
    freq, direction = np.linspace(0.05, 0.5, 8), np.arange(0.0, 360.0, 30.0)
    efth = np.outer(np.exp(-(((freq - 0.2) / 0.05) ** 2)), np.ones(12)) * 1e-3
    return xr.Dataset({"efth": (("freq", "dir"), efth)}, {"freq": freq, "dir": direction})


@cache
def sensitivities():
    return mt.sensitivities(LINK, FLAT, ["water.a"], photons=64, threads=1)


@cache
def performance():
    return mt.link_performance(
        LINK, FLAT, bit_rate=5e6, depths=[5.0, 10.0], realizations=2, photons=64, threads=1
    )


@cache
def irradiance():
    times = 0.1 * np.arange(12)
    return mt.irradiance_series(FLAT, DAY, times=times, photons=1000, threads=1)


@cache
def fraction():
    """Return a small text table of a water, a spectrum file and a link file."""
    water = folder() / "water.csv"
    water.write_text("wavelength [nm],a [1/m],b [1/m]\n400,0.1,0.2\n500,0.1,0.2\n")
    (folder() / "phase.csv").write_text("0,1\n90,0.5\n180,0.4\n")
    (folder() / "spectrum.csv").write_text("0.5,0.1\n1.0,0.5\n2.0,0.1\n")
    (folder() / "link.toml").write_text("wind_speed = 5.0\n")
    result().save(folder() / "result.nc")
    (folder() / "study.toml").write_text(
        "[sweep]\nrealizations = 2\n[sweep.parameters]\nwind_speed = [5.0, 9.0]\n"
    )
    return folder()


def file(name):
    return lambda: fraction() / name


SOUND = {
    "link": LINK, "surface": FLAT, "ook": OOK, "daylight": DAY, "gain": GAIN, "time": 0.0,
    "gain_stderr": None, "wavelength_nm": 470.0, "depth": 5.0, "seed": 1, "mesh": None,
    "wind_speed": 5.0, "power": 1e-9, "x": 0.5, "y": 0.5, "theta": 0.1, "realizations": 2,
    "photons": 64, "confidence": 0.95, "ber": 1e-3, "times": [0.0, 0.5], "omega": 1.0,
    "progress": None, "wavelengths_nm": None, "period": "night", "bit_rate": 5e6, "extent": 1.0,
    "omega_max": 6.0, "n": 4, "spectrum": JONSWAP, "omega_p": 1.0, "rounds": 1, "resamples": 99,
    "x_axis": AXIS, "y_axis": AXIS, "h_alpha": 1.0, "directions": DOWN, "spacing": 0.5,
    "flight": None, "rate": 0.5, "limit": 1e-3, "value": 1e-3, "wavelength": 470e-9,
    "relative_to": "mean", "n_effective": None, "waves": "drawn", "n1": 1.33, "n2": 1.0, "k": 1.0,
    "bit_time": 1e-7, "capillary": False, "sun_zenith_deg": 30.0, "receiver": 0, "count": 4,
    "phase": 1.0, "workers": None, "tolerance": 0.1, "rtol": None, "threshold": 0.5, "fov": 1.0,
    "branching": 0.1, "origins": UP, "edges": RISING, "points": 8, "folder": file("."),
    "trust": False, "changes": None, "step": 0.5, "depths": [5.0], "title": "x",
    "wind_direction_deg": 0.0, "block": None, "spreading": ITTC, "tilt": 0.1,
    "surface_wind": 5.0, "path": file("new.nc"), "options": None, "source": "x", "name": "gain",
    "result": result, "by_pixel": np.zeros((32, 1, 6)), "acceptance": 0.1, "dz": 0.5, "max_depth": 5.0,
    "crest": 0.0, "depth1": 1.0, "depth2": 2.0, "direction": "up", "transmittance": 0.25, "lag": 0.5,
    "size": 4, "up_gain": 1e-6, "down_gain": 1e-6, "wall_time": 1.0, "verbose": False, "r": 1e-4,
    "frequency": 1e6, "slope": 0.1, "base": "physical", "u": 0.5, "notes": False, "delimiter": None,
    "hours": 1e-4, "background_rate": 1.0, "links": {"a": LINK, "b": LINK}, "spacings": (2.0, 1.0, 0.5, 0.25),
    "placements": 1, "reference": None, "wind_speeds": [5.0], "up": LINK, "host": "127.0.0.1",
    "bin_width": 1e-10, "measurements": ROWS, "unknown": ["water.a"], "prior": None,
    "collector": 0.05, "below": "still", "patch": None, "fineness": 1.0,
    "results": lambda: [result()], "objective": "gain", "constraints": (), "hover_std": (0.0, 0.0),
    "method": "auto", "wrt": ["water.a"], "quantity": "gain", "estimator": None, "record": (),
    "steps": (1.0, 0.5, 0.25, 0.125), "duration": None, "received_only": False, "max_vertices": 99,
    "cold": False, "quick": True, "clock": None, "seeds": 2, "delay": [0.0, 1e-9],
    "weight": [1.0, 0.5], "angle": None, "pulses": 4, "radiance_per_nm": 0.1, "detector_area": 1e-5,
    "ground_albedo": 0.06, "slope_variances": (0.01, 0.01), "slope_law": None, "diffuse": 0.3,
    "max_lag": None, "within": 0.03, "common_stderr": 0.0, "test_resamples": 19, "lags": [0.0, 0.5],
    "model": "lognormal", "tilts": True, "heights": False, "vertices": CORNERS, "faces": FACES,
    "weights": "area", "kind": "led", "key": "kind", "update": None, "deep": False,
    "setting": "a=1", "i": 0, "overhangs": False, "reader": None, "site": None, "x_axis_deg": 90.0,
    "positions": None, "unit": None, "segments": 4, "f_min": None, "f_max": None,
    "probability": 0.5, "left": 0.5, "angle_deg": 10.0, "n_eff": 2.0, "scale": 1.0,
    "peak_rate": 1e6, "dark_rate": 1e4, "mean_share": 0.5, "removed": np.zeros(4),
    "thermal_std": 0.1, "m0": 1.0, "m1": 2.0, "v0": 0.1, "v1": 0.1, "primaries": 2.0, "zeros": 1.0,
    "ones": 5.0, "chance": 1.0, "is_one": [True, False], "level": RISING, "age": RISING,
    "bits_ago": 1, "nm": 470.0, "normal": UP, "facet_normal": UP, "slopes": np.zeros((3, 2)),
    "share": 0.5, "realization": 1, "word": 0, "n_water": 1.33, "r_min": 1e-5, "r_max": 1e-3,
    "sizes": 64, "rotations": 4, "backscatter_ratio": 0.01, "stem": "x", "inputs": {"a": 1.0},
    "cos_theta": 0.5, "theta_edges": None, "cos_i": 0.5, "d": DOWN, "kx": 0.1, "ky": 0.1,
    "other_kx": 0.2, "other_ky": 0.1, "gamma": 3.3, "sigma_a": 0.07, "sigma_b": 0.09,
    "target": (0.02, 0.02), "resolved": (0.01, 0.01), "slope_variance": (0.02, 0.02),
    "law": "lognormal", "view": UP, "sun": UP, "dt": 0.5, "bins": "auto", "mean": 5.0, "std": 1.0,
    "change": 0.1, "tail": None, "direction_deg": 0.0, "low": 1.0, "high": 5.0, "n0": 1.0,
    "fades": 1, "t": 1e-8, "temperature_c": 20.0, "salinity": 35.0, "half_range": 1.0,
    "z": HEIGHTS, "sx": HEIGHTS, "sy": HEIGHTS, "mss": None, "current": None, "fetch": None,
    "route": None, "quantile": 0.01, "timeout": 1.0, "noise_bandwidth": 1e6, "store": None,
    "down": "mirrored", "bounds": None, "water": None, "outage": 0.1, "aerosol": 0.1, "ozone": 0.3,
    "water_vapour": 2.0, "pressure": 101325.0, "day_of_year": 80, "width_nm": 0.0,
    "pattern": "cie-12", "sun_azimuth_deg": 0.0, "zenith_deg": 30.0, "azimuth_deg": 0.0,
    "phase_deg": 0.0, "latitude": 50.0, "longitude": 0.0, "aside": 5.0, "height": 5.0,
    "center": (0.0, 0.0), "fine_extent": None, "coarse_spacing": None, "thresholds": (0.5,),
    "order": 1, "m": 1.1 + 0j, "values": RISING, "d_theta": 0.1, "unresolved": "tilt",
    "normals": ("vertex",), "omega_min": 0.0, "parameters": {"wind_speed": [5.0, 9.0]},
    "wind": WIND, "text": "wind_speed = 5.0", "config": {"wind_speed": 5.0}, "fading": False,
    "ook_preset": "physical", "port": 8080, "open_browser": False, "type": "jerlov-II",
    "number": 1, "filters": pulses.PulseFilters(1e-8, 1e-8), "gauge": None, "run": None,
    "spread": 0.1, "coupled": False, "points_of": 8, "background": background, "data": None,
    "campaign": None, "seas": 2, "chains": 64, "most": 1, "sea": FLAT, "near": mesh,
    "scenario": lambda: mt.Scenario.from_toml(""), "provenance": lambda: result().provenance,
    "cumulants": surfaces.GramCharlier().cumulants((0.02, 0.02)), "free": waves, "roughness": interface.Roughness(0.1, 0.1, 1.0, 0.0), "sky": None, "levels": RISING,
    "obj": {}, "json_data": "{}", "dataset": lambda: result().to_dataset(), "h": 0.5, "v2": 25.0,
    "exact": lambda: mt.Uav().tilt_law(WIND), "compute": lambda: lambda: None,
    "approximation": lambda: mt.Uav().tilt_law(WIND, "gamma"), "error": None,
    "names": ("a",), "samples": np.ones((1, 32)), "s": sensitivities, "lamp": None,
}  # fmt: skip
"""Sound value of a parameter, or a function that makes it."""

OTHER = {
    "Comparison.of_samples": {"provenance": [{}]},
    "Daylight.at": {"time": "2026-06-21T12:00Z"},
    "Dryden.preset": {"physics": "paper"},
    "Dryden.simulate_wind": {"times": TIMES},
    "Uav.tilt": {"wind": [[5.0, 0.0, 0.0]]},
    "Uav.tilt_law": {"law": "exact"},
    "Link.require_no_bodies": {"allowed": "none"},
    "MeshSource.mesh": {}, "Route.at": {"times": [0.5]},
    "Scenario.case": {"surface": None}, "OokLink.preset": {"name": "physical"},
    "Physics.preset": {"name": "paper"}, "Sensitivities.derivative": {"name": "water.a"},
    "Sensitivities.predict": {"changes": {"water.a": 0.1}},
    "TabulatedPhase.from_file": {"path": file("phase.csv")},
    "Water.from_file": {"path": file("water.csv")},
    "surfaces.TabulatedSpectrum.from_file": {"path": file("spectrum.csv")},
    "Scenario.load": {"path": file("link.toml")},
    "Scenario.from_toml": {"source": None},
    "stored.Stored.load": {"path": file("result.nc")},
    "results.load": {"path": file("result.nc")},
    "stored.read_dataset": {"path": file("result.nc")},
    "stored.write_dataset": {"data": xr.Dataset({"x": ("t", [1.0])})},
    "optics.water_files.read_spectrum": {"path": file("water.csv")},
    "studies.pixel_signals": {
        "link": mt.Link(receiver=mt.Receiver(pixels=2)), "surface": SEA, "rays": 64,
    },
    "Background.of_pixel": {"i": 0, "j": 0},
    "studies.availability": {"inputs": {"water.a": {"samples": [0.1, 0.2]}}, "threshold": 1e-5,
                             "bounds": {}, "runs": 8, "realizations": 4, "target": 0.9},
    "studies.sweep_file": {"path": file("study.toml")},
    "studies.sweeps.read_study": {"path": file("study.toml")},
    "duplex": {"down": mt.Link(transmitter=mt.AirLed(), receiver=mt.WaterReceiver()),
               "surface": SEA, "realizations": None},
    "compare": {"surface": SEA}, "sensitivities": {"realizations": 1},
    "models.Model.replace": {"path": "water.a", "value": 0.1},
    "optimize": {"bounds": {"receiver.fov_deg": (10.0, 60.0)}},
    "infer": {"surface": None},
    "band_limit_study": {"surface": SEA, "omega_max": (2.0, 4.0, 6.0, 8.0), "unresolved": "none"},
    "body_study": {
        "link": over_a_plate, "surface": mesh, "meshes": plates, "body": 0, "photons": 64,
    },
    "convergence_study": {"surface": SEA, "unresolved": "none"},
    "time_step_study": {"surface": SEA},
    "apps.MarkovChannel.fit": {"thresholds": (1.0,)},
    "studies.fading_study": {"surface": surfaces.resolved_sea(5.0), "omega_max": (4.0, 8.0, 16.0, 32.0),
                             "realizations": 0},
    "design": {"realizations": 8}, "Design.choice": {"key": "receiver.radius"},
    "channel_trace": {"surface": SEA, "rate": 10.0},
    "replay": {"waveform": [1.0, 0.0, 1.0], "rate": 100.0, "trace": TRACE},
    "lidar": {"link": LIDAR, "surface": SEA, "seas": 2},
    "coverage_map": {"times": None},
    "background": {"wavelengths_nm": None},
    "time_series": {"surface": SEA}, "studies.time_series": {"surface": SEA},
    "background_series": {"surface": SEA},
    "ensemble": {"surface": SEA}, "depth_sweep": {"depths": [5.0, 10.0]},
    "light_pattern": {"step": 0.1},
    "irradiance_series": {"photons": 1000},
    "apps.TransformedGaussian.fit": {"threshold": None},
    "fading.scintillation_index": {"block": 1}, "fading.BandFading.warning": {"down": False},
    "uav.tilt_outage_note": {"wind": " at 13 m/s"},
    "fading.coherence_time": {"time": TIMES}, "fading.fade_durations": {"time": TIMES},
    "fading.fading_statistics": {"time": TIMES, "resamples": 99},
    "fading.level_crossing_rate": {"time": TIMES}, "fading.mean_fade_duration": {"time": TIMES},
    "fading.band_fading": {"surface": SEA}, "fading.fading_band": {"surface": RESOLVED},
    "Daylight.spectrum": {"wavelength_nm": [470.0, 500.0]}, "EmbreeIntersector.for_mesh": {"mesh": mesh},
    "GainResult.arrays": {"data": lambda: result().to_dataset()},
    "fading.FadingStatistics.arrays": {"data": lambda: series().fading().to_dataset()},
    "merge": {"results": lambda: [mt.simulate(LINK, FLAT, "analog", photons=64, threads=1)]},
    "models.Family.read": {"value": "led"}, "models.Family.read_several": {"value": "led"},
    "results.ByWavelength.at_wavelength": {"wavelength_nm": 450.0},
    "studies.Variant.at": {"values": []}, "studies.Variant.set": {"name": "water.a", "value": 0.1},
    "studies.Variant.value": {"name": "water.a"},
    "results.provenance.provenance": {"surface": {}, "run": {}},
    "surfaces.triangulate.read_mesh": {"source": (CORNERS, FACES)},
    "fading.resolve_band": {"surface": SEA, "waves": None},
    "fading.gain_autocovariance": {"surface": SEA},
    "fading.pointing_residual": {"surface": RESOLVED, "latency": 0.01, "radius": 0.02},
    "fading.pointing_outage": {
        "surface": RESOLVED, "latency": 0.01, "radius": 0.02, "height": 10.0, "tolerance": 0.3,
    },
    "studies.steer": {
        "link": mt.Link(transmitter=mt.GaussianBeam(tracker=mt.Tracker())), "times": [0.0],
    },
    "fading.gain_correlation": {"surface": SEA, "distances": [0.1]},
    "comms.combining.combined_ber": {"links": [mt.OokLink()], "gain": [1e-6]},
    "comms.combining.equivalent_gain": {"links": [mt.OokLink()], "gain": [1e-6]},
    "comms.combining.intensity_capacity": {"peak": [20.0]},
    "fading.scintillation_of_spectrum": {"surface": SEA},
    "comms.Tia.thermal_noise": {"electrons": 1e6},
    "comms.LedDriver.levels": {"value": 1e-9},
    "comms.SiPM.fired_cells": {"photons": 100.0},
    "comms.budget.ber_of_gains": {}, "comms.budget.faded_gains": {},
    "comms.budget.depth_at": {"depth": [5.0, 10.0], "value": [1.0, 0.1], "limit": 0.5},
    "comms.budget.range_at_ber": {"depth": [5.0, 10.0], "gain": [1e-4, 1e-8]},
    "comms.decisions.generalized_poisson_decision": {"n0": 1.0, "n1": 5.0},
    "comms.decisions.soft_information": {"n0": 1.0, "n1": 5.0},
    "comms.decisions.pattern_decision": {"mean": [5.0, 1.0], "std": [1.0, 1.0]},
    "comms.decisions.mixed_information": {"zeros": [1.0], "ones": [5.0], "chance": [1.0]},
    "comms.interleaving.mean_below": {"limit": 0.2},
    "comms.background.widest_filter_nm": {"power": 1e-8},
    "comms.spectra.background_counted": {"irradiance": lambda: lambda nm: np.ones_like(nm)},
    "comms.OpticalFrontEnd.band": {},
    "HallNovarini.equal_area_radii": {"depth": 1.0},
    "daylight.sky": {"pattern": "cie-12"},
    "daylight.sky_radiance": {"sky": lambda: daylight.sky("cie-12", 0.3, 30.0, 0.0)},
    "daylight.light.sun_position": {"time": "2026-06-21T12:00Z"},
    "daylight.glint_radiance": {"n": 1.33},
    "optics.fresnel.reflect": {"n": -DOWN}, "optics.fresnel.refract": {"n": -DOWN},
    "surfaces.MeshSequence.mesh": {}, "surfaces.Surface.slopes": {},
    "surfaces.MeshSequence.frame": {},
    "surfaces.sea_from_config": {"config": {"kind": "flat"}},
    "surfaces.from_gauge": {"source": None, "tail": None},
    "surfaces.gauge_spectrum": {"source": WAVES},
    "surfaces.from_trimesh": {"source": (CORNERS, FACES), "normals": "area", "extent": None},
    "surfaces.from_wavespectra": {"source": spectrum, "waves": "table", "time": None},
    "surfaces.bands.direction_weights": {"theta": RISING, "omega": RISING},
    "surfaces.bands.drawn_waves": {},
    "surfaces.bands.named_band": {"name": "paper"},
    "surfaces.gram_charlier.real_cumulants": {"law": "gaussian"},
    "surfaces.statistics.components_hs": {"waves": waves},
    "surfaces.statistics.components_slope_variance": {"waves": waves},
    "surfaces.statistics.meshed_slope_variance": {"waves": waves},
    "surfaces.statistics.real_slope_variance": {"mss": "cox-munk"},
    "surfaces.statistics.sampled_hs": {"mesh": mesh},
    "surfaces.statistics.sampled_slope_variance": {"mesh": mesh},
    "surfaces.triangulate.triangulate": {"unresolved": None},
    "surfaces.nonlinear.with_bound_waves": {"most": 100},
    "surfaces.spectra.peak_enhancement": {"x": RISING},
    "scenario.MeshFile.load": {}, "sweep": {"surface": None, "photons": 64},
    "uav.TiltLaw.h_moment": {"order": 1}, "validation.format_table": {"checks": ()},
}  # fmt: skip
"""Sound values of parameters of one function that differ from the above."""


def meshes():
    files = []
    for i in range(2):
        files.append(folder() / f"sea{i}.ply")
        if not files[-1].exists():
            mesh().to_trimesh().export(files[-1])
    return surfaces.MeshSequence([str(file) for file in files], times=(0.0, 1.0))


def mesh_file():
    path = folder() / "one.ply"
    if not path.exists():
        FLAT.mesh(extent=20.0, spacing=2.0).to_trimesh().export(path)
    return mt.scenario.MeshFile(file=str(path))


def channel():
    return apps.TransformedGaussian.fit(GAIN, 0.5)


def variant():
    return studies.Variant(LINK, FLAT)


def phase():
    return mt.HenyeyGreenstein()


def bubbles():
    return mt.HallNovarini(wind_speed=5.0)


def duplex():
    return mt.Duplex(series(), series())


MADE = {
    "Background": background, "BubblePopulation": bubbles, "HallNovarini": bubbles,
    "Daylight": lambda: DAY, "Dryden": lambda: WIND, "Uav": lambda: mt.Uav(), "Link": lambda: LINK,
    "GainResult": result, "GainSeries": series, "OokLink": lambda: OOK,
    "LinkPerformance": performance, "PhaseFunction": phase, "Route": lambda: ROUTE,
    "Sensitivities": sensitivities, "IrradianceSeries": irradiance, "Water": lambda: mt.Water.from_type("jerlov-II"), "Family": mt.Led,
    "Scenario": lambda: mt.Scenario.from_toml("wind_speed = 0.0"), "Stored": result,
    "TriangleMesh": mesh, "MeshFile": mesh_file, "MeshSequence": meshes, "Variant": variant,
    "TiltFactors": lambda: mt.Uav().tilt_factors(WIND, 1.0),
    "BandFading": lambda: mt.fading.band_fading(mt.Link(), SEA),
    "ChannelModel": channel, "Tia": lambda: comms.Tia(), "SiPM": lambda: comms.SiPM(),
    "LedDriver": lambda: comms.LedDriver(), "OpticalFrontEnd": lambda: comms.OpticalFrontEnd(),
    "PulseFilters": lambda: pulses.PulseFilters(1e-8, 1e-8), "Surface": lambda: FLAT,
    "WaveSurface": lambda: SEA, "RandomSea": lambda: SEA, "Elfouhaily": surfaces.Elfouhaily,
    "Jonswap": lambda: JONSWAP, "Spreading": lambda: ITTC, "IttcSpreading": lambda: ITTC,
    "Cos2sSpreading": surfaces.Cos2sSpreading, "MitsuyasuSpreading": surfaces.MitsuyasuSpreading,
    "ElfouhailySpreading": surfaces.ElfouhailySpreading, "GramCharlier": surfaces.GramCharlier,
    "TiltLaw": lambda: mt.Uav().tilt_law(WIND), "GammaTiltLaw": lambda: mt.Uav().tilt_law(WIND, "gamma"),
    "ExactTiltLaw": lambda: mt.Uav().tilt_law(WIND), "MeshSource": lambda: FLAT,
    "SurfaceModel": lambda: FLAT, "Model": lambda: LINK,
    "BruteForceIntersector": lambda: mt.BruteForceIntersector(mesh()),
    "EmbreeIntersector": lambda: mt.EmbreeIntersector(mesh()), "Duplex": duplex, "Flight": mt.Flight,
    "LidarResult": lambda: mt.lidar(LIDAR, SEA, seas=2, **FEW),
    "ChannelTrace": lambda: mt.channel_trace(LINK, SEA, hours=1e-3, rate=10.0, **FEW),
    "DepthSweep": lambda: mt.DepthSweep([5.0], (performance(),)),
    "Design": lambda: mt.design(mt.Scenario.from_toml("wind_speed = 0.0"), realizations=8, **FEW),
    "ImpulseResponse": lambda: mt.impulse_response(result()),
    "MarkovChannel": lambda: apps.MarkovChannel.fit(GAIN, 0.5, (1.0,)),
    "Body": lambda: mt.Body(mesh()), "Aperture": mt.Receiver, "Camera": mt.Receiver,
    "Curve": lambda: comms.Curve(wavelength_nm=(400.0, 500.0), value=(0.1, 0.2)),
    "WaterSpectrum": lambda: mt.Water.from_type("jerlov-II").spectrum,
    "WaterType": lambda: mt.Water.from_type("jerlov-II").spectrum,
    "Constituents": lambda: optics.Constituents(chlorophyll=1.0),
    "SpectralTable": lambda: mt.Water.from_file(file("water.csv")()).spectrum,
    "ByWavelength": lambda: mt.simulate(
        mt.Link(water=mt.Water.from_type("jerlov-II")), FLAT, wavelengths_nm=[450.0, 500.0], **FEW),
    "ConvergenceStudy": lambda: mt.convergence_study(LINK, SEA, (4, 3, 2, 1), placements=2, **FEW),
    "Band": lambda: surfaces.Band(omega_min=0.5, omega_max=6.0, d_theta=0.1),
    "LogProfile": uav.LogProfile, "PowerProfile": uav.PowerProfile,
    "QuasiSingle": lambda: daylight.QuasiSingle([mt.Water()], [None], 1.33, [DAY]),
    "AveragedPulses": comms.receivers.AveragedPulses, "CompoundPoisson": comms.receivers.CompoundPoisson,
    "CountedBits": comms.receivers.CountedBits, "IndependentBits": comms.receivers.IndependentBits,
    "SampledPulses": comms.receivers.SampledPulses, "ReceiverModel": comms.receivers.SampledPulses,
}  # fmt: skip
"""Instances of classes, for their methods."""

INSTANCES = {name: cache(make) for name, make in MADE.items()}
