"""Wrong values for every argument of every function of viz: one refusal, or a picture."""

import inspect
import math
from functools import partial
from random import Random

import numpy as np
import pytest
import xarray as xr
from matplotlib import pyplot

import meshtrace as mt
from meshtrace import apps, viz
from meshtrace.apps import measured
from meshtrace.errors import Refused
from meshtrace.surfaces import FlatSea, JonswapSea
from meshtrace.viz import ScenePlotter
from meshtrace.viz.stage import stage_of

LINK, FLAT = mt.Link(), FlatSea()
RUN = {"photons": 32, "threads": 1, "spacing": 0.5}


@pytest.fixture(scope="module")
def scene():
    made = ScenePlotter(stage_of(LINK, FLAT, None), off_screen=True, window_size=(160, 100))
    viz.add_uav(made, LINK)
    made.render()
    yield made
    made.close()


@pytest.fixture(scope="module")
def sound(scene, calm_design, calm_availability):
    """Return sound arguments of each function, few of them optional."""
    gain = 1e-5 * (1.0 + np.random.default_rng(5).random(6))
    times = 0.5 * np.arange(6.0)
    series = mt.GainSeries("time", times, gain, 0.01 * gain, gain, 1e-7)
    both = np.stack([gain, gain[::-1]], axis=1)
    two = mt.GainSeries("time", times, both, 0.01 * both, both, np.full(2, 1e-7))
    result = mt.simulate(LINK, FLAT, estimator="analog", photons=64, threads=1)
    mesh = FLAT.mesh(extent=3.0, spacing=1.0)
    paths = mt.trace_paths(LINK, FLAT, n=8, seed=1)
    cells = np.array([0.0, 1.0])
    coverage = mt.CoverageMap(cells, cells, np.ones((2, 2)), np.ones((2, 2)), {})
    impulse = mt.impulse_response(mt.simulate(LINK, FLAT, record=[mt.Arrivals()], **RUN))
    style = viz.SceneStyle(off_screen=True, window_size=(160, 100))

    def curve(name, along="depth"):
        data = {name: (along, [1.0, 2.0]), f"{name}_stderr": (along, [0.1, 0.1])}
        return {"data": xr.Dataset(data, {along: [1.0, 2.0]})}

    sharp = mt.Link(physics={"unresolved": "none"})
    route = mt.Route(times=(0.0, 1.0), positions=((0.0, 0.0), (1.0, 0.0)))
    down = mt.Link(transmitter=mt.AirLed(), receiver=mt.WaterReceiver())
    rows = [{"transmitter.depth": d, "gain": g, "stderr": 0.1 * g}
            for d, g in ((5.0, 3e-4), (10.0, 6e-5))]  # fmt: skip
    few = {"photons": 64, "threads": 1}
    irradiance = mt.irradiance_series(
        FLAT, mt.Daylight(direct=1.0, diffuse=0.0), times=[0.0, 0.1], photons=1000, threads=1,
        patch=(0.1, 0.05),
    )  # fmt: skip
    drawn = {"link": LINK, "scene": scene}
    return {
        "plot_curves": {**curve("gain"), "quantity": "gain", "style": "-"},
        "plot_phase_function": curve("phase_function", "theta"),
        "plot_phase_cdf": curve("phase_cdf", "theta"),
        "plot_bubble_profile": {**curve("b_bub"), "quantity": "b_bub"},
        "plot_spectrum": curve("spectrum", "omega"),
        "plot_spreading": curve("spreading", "theta"),
        "plot_sweep": {**curve("gain"), "log": True},
        "plot_ber": curve("ber"),
        "plot_fates": {"result": result},
        "plot_gain_series": {"series": series},
        "plot_correlation": {"series": two},
        "plot_gain_pdf": {"series": series, "fits": ["lognormal"], "bins": 3},
        "plot_gain_cdf": {"series": series, "fits": ["lognormal"], "n_effective": 5.0},
        "plot_autocorrelation": {"statistics": series.fading()},
        "plot_coverage": {"coverage": coverage, "decibel": False},
        "plot_impulse_response": {"responses": impulse, "decades": 3.0},
        "plot_eye": {"eye": mt.OokLink().eye(1e-9)},
        "plot": {"result": result},
        "plot_gain": {"result": result},
        "plot_comparison": {"result": mt.compare({"a": LINK, "b": sharp}, FLAT, **few)},
        "plot_tornado": {"s": mt.sensitivities(LINK, FLAT, ["water.a"], **few), "change": 0.1},
        "plot_availability": {"a": calm_availability},
        "plot_pixels": {"signals": mt.studies.pixel_signals(
            mt.Link(receiver=mt.Receiver(pixels=2)), FLAT, mt.Daylight.overcast(), rays=64, **few
        )},
        "plot_optimum": {"o": mt.optimize(LINK, FLAT, {"receiver.fov_deg": (10.0, 60.0)}, "gain",
                                          realizations=1, **few)},
        "plot_design": {"d": calm_design, "period": "day"},
        "plot_water": {"data": mt.Water.from_type("jerlov-II").spectra()},
        "plot_wavelengths": {"result": mt.simulate(
            LINK.replace("water", mt.Water.from_type("jerlov-II")), FLAT,
            wavelengths_nm=[450.0, 500.0], **few,
        )},
        "plot_inference": {"f": mt.infer(rows, LINK, ["water.a"], **few)},
        "plot_background": {"result": mt.background(LINK, FLAT, mt.Daylight.overcast(), **few)},
        "plot_duplex": {"result": mt.duplex(LINK, down, JonswapSea(waves="paper"), [0.0, 1.0],
                                            mesh=mt.Meshing(spacing=0.5), **few)},
        "plot_channel": {"model": mt.apps.TransformedGaussian.fit(
            np.random.default_rng(1).lognormal(size=400), 0.5)},
        "plot_lidar": {"result": mt.lidar(
            mt.Link(
                water=mt.Water(bottom_depth=3.0, bottom_albedo=0.2),
                transmitter=mt.AirTopHatBeam(height=20.0, divergence_deg=0.5),
                receiver=mt.Receiver(height=20.0, fov_deg=2.0),
            ),
            FLAT,
            photons=64,
        )},
        "plot_trace": {"result": mt.channel_trace(LINK, FLAT, hours=1e-4, rate=10.0, **few)},
        "plot_irradiance": {"series": irradiance},
        "save_irradiance": {"series": irradiance, "path": "irradiance.png"},
        "plot_measured": {"table": measured.run(["cox-munk"])},
        "plot_fading_convergence": {"study": None},
        "plot_route": {"series": mt.time_series(LINK, FLAT, [0.0, 1.0], route=route, **few)},
        "plot_convergence": {"study": None},
        "plot_performance": {"performance": None, "quantity": "ber"},
        "scene": {"link": LINK, "surface": FLAT, "time": 0.0, "paths": paths, "received": 8,
                  "coverage": coverage, "seed": 1, "style": style, "plotter": scene},
        "view": {"link": LINK, "surface": FLAT, "time": 0.0, "paths": paths, "seed": 1,
                 "style": style, "screenshot": "a.png", "html": None, "movie": None,
                 "export": None, "gain": series, "frames": 2, "frame_rate": 2.0, "title": "x"},
        "save_movie": {"link": LINK, "surface": FLAT, "times": times[:2], "path": "a.gif",
                       "frame_rate": 5.0, "photons": 32, "seed": 1, "style": style},
        "save_light": {"link": sharp, "surface": FLAT, "path": "b.png", "times": [0.0], "extent": 1.0,
                       "step": 0.2, "frame_rate": 5.0},
        "save_html": {"link": None, "surface": mesh, "path": "a.html", "time": 0.0, "gain": None,
                      "title": "x"},
        "save_picture": {"picture": scene, "path": "a.png", "largest": 1000},
        "save_vtk": {"source": mesh, "path": "a.vtp"},
        "export_scene": {"scene": scene, "folder": "a"},
        "to_pyvista": {"source": mesh},
        "select_paths": {"paths": paths, "which": slice(2)},
        "add_bubbles": {"scene": scene, "mesh": mesh, "bubbles": None, "near": False},
        "add_receiver": {**drawn, "mesh": mesh, "labels": True, "aside": 1.0},
        "add_transmitter": {**drawn, "mesh": mesh, "labels": True},
        "add_surface": {"scene": scene, "mesh": mesh, "color": "slope", "color_limit": 1.0,
                        "edges": False, "opacity": 0.5},
        "add_uav": drawn,
        "add_coverage": {"scene": scene, "coverage": coverage},
        "add_footprint": {"scene": scene, "mesh": mesh, "received": paths},
        "add_paths": {"scene": scene, "paths": paths, "color": "fate"},
        "add_compass": {"scene": scene, "wind_speed": 5.0, "direction_deg": 0.0},
        "add_caption": {"scene": scene, "text": "x"},
        "add_key": {"scene": scene},
        "add_labels": {"scene": scene, "points": [np.zeros(3)], "texts": ["x"], "align": "left"},
        "add_scale": {"scene": scene},
        "look": {"scene": scene, "azimuth_deg": 0.0, "elevation_deg": 10.0},
        "axis_label": {"name": "gain"},
        "SceneStyle": {name: getattr(style, name) for name in type(style).model_fields},
        "hostile": [result, series, coverage, paths, impulse, mesh, LINK, FLAT, JonswapSea(),
                    curve("gain")["data"], xr.Dataset({"gain": ("x", ["a", "b"])})],
    }  # fmt: skip


WITHOUT = ("plot_convergence", "plot_fading_convergence", "plot_performance")
"""Functions whose sound results take a study; they are drawn in other tests."""

PLAIN = [None, "x", "", 3, -1, 0, 2.5, math.nan, math.inf, True, [], {}, [1, "x"], b"x", object(),
         10**400, np.zeros(0), np.zeros((2, 2)), np.array("x"), {"a": None}, len,
         xr.Dataset(), xr.Dataset({"gain": ((), 1.0)})]  # fmt: skip


def check(name, arguments, folder):
    """Call a function: it refuses in one line, or succeeds."""
    try:
        if name == "to_pyvista":
            viz.to_pyvista(arguments["source"])
        else:
            function_of(name)(**arguments)
    except Refused as error:
        text = str(error)
        assert "allowed: " in text
        assert len(text) < 800
        return True
    except OSError as error:
        assert error.filename is not None
        return True
    return False


def functions():
    private = {"ScenePlotter", "Stage", "marks", "style", "use_style", "water_map"}
    plots = {name for name in apps.__all__ if name.startswith("plot_")}
    return sorted((set(viz.__all__) | plots) - private)


def function_of(name):
    return getattr(viz if name in viz.__all__ else apps, name)


@pytest.mark.slow
def test_every_function_draws_its_sound_arguments(sound, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in functions():
        if name not in WITHOUT:
            assert not check(name, sound[name], tmp_path), name
            pyplot.close("all")


@pytest.mark.parametrize("name", functions())
@pytest.mark.thorough
def test_wrong_values_are_refused(name, sound, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments, random, refused = sound[name], Random(name), 0
    parameters = list(inspect.signature(function_of(name)).parameters)
    whole = name in ("save_movie", "view")  # of many parameters, whose sound values draw movies
    for argument in parameters:
        if argument == "progress":  # errors of a user's function are the user's
            continue
        # the first one, which holds the numbers, by all values; the others by some
        values = [*PLAIN, *sound["hostile"]]
        first = argument == parameters[0]
        for value in values if first else random.sample(values, 2 if whole else 4):
            refused += check(name, {**arguments, argument: value}, tmp_path)
    assert refused > 5


def test_functions_are_checked_whenever_they_are_taken():
    for _ in range(3):
        with pytest.raises(Refused, match="result: 3, allowed: a GainResult"):
            viz.plot_gain(3)
    assert viz.plot_gain is viz.plot_gain


@pytest.mark.parametrize("call", [viz.view, viz.save_movie])
def test_unknown_keywords_are_refused(call):
    with pytest.raises(Refused, match=r"recieved: 8, no such key, did you mean received\?"):
        call(LINK, FLAT, recieved=8)


def test_empty_results_are_refused():
    empty = np.zeros(0)
    series = mt.GainSeries("time", empty, empty, empty, empty, 0.0)
    for call, field in (
        (partial(viz.plot_gain_series, series), "gain"),
        (partial(viz.plot_gain_pdf, series), "gain"),
        (partial(viz.plot_impulse_response, {}), "responses"),
        (
            partial(
                viz.plot_coverage,
                mt.CoverageMap(empty, empty, np.zeros((0, 0)), np.zeros((0, 0)), {}),
            ),
            "gain",
        ),
        (partial(viz.plot_fates, mt.GainResult(0.0, 0.0, 1, {}, {})), "result"),
    ):
        with pytest.raises(Refused) as caught:
            call()
        assert caught.value.field == field
