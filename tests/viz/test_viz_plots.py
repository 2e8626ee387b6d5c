"""Plots show the numbers they are given, under names and units."""

import re
from dataclasses import replace
from importlib import import_module
from inspect import getsource, signature
from types import SimpleNamespace
from unittest.mock import NonCallableMock

import matplotlib as mpl
import numpy as np
import pytest
import xarray as xr

import meshtrace as mt
from meshtrace import viz
from meshtrace.apps import MarkovChannel
from meshtrace.comms import OokLink
from meshtrace.errors import Refused
from meshtrace.fading import Estimate, fading_statistics
from meshtrace.results import GainResult, ImpulseResponse
from meshtrace.results.gain import FateTally
from meshtrace.studies import Comparison, ConvergenceStudy
from meshtrace.surfaces import JonswapSea
from meshtrace.viz import style


def line(ax, i=0):
    return ax.get_lines()[i].get_data()


def legend(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def one(quantity, along, x, values):
    """Return a dataset of one curve."""
    return xr.Dataset({quantity: (along, values)}, {along: x})


def several(quantity, along, x, curves):
    """Return a dataset of curves by name."""
    data = {quantity: (("case", along), list(curves.values()))}
    return xr.Dataset(data, {"case": list(curves), along: x})


def test_phase_functions():
    theta, phase = np.radians([1.0, 10.0, 100.0]), mt.HenyeyGreenstein(g=0.9)
    values = {"HG": phase.pdf(theta), "half": 0.5 * phase.pdf(theta)}
    ax = viz.plot_phase_function(several("phase_function", "theta", theta, values))
    for i, factor in enumerate((1.0, 0.5)):
        np.testing.assert_allclose(line(ax, i), ([1.0, 10.0, 100.0], factor * phase.pdf(theta)))
    assert legend(ax) == ["HG", "half"]
    assert ax.get_ylabel() == viz.axis_label("phase_function")
    assert "[°]" in ax.get_xlabel()
    ax = viz.plot_phase_cdf(one("phase_cdf", "theta", theta, phase.cdf(theta)))
    assert ax.get_legend() is None
    np.testing.assert_array_equal(line(ax)[1], phase.cdf(theta))


def test_bubbles_over_depth_downwards():
    layer = mt.HallNovarini(wind_speed=13.0)
    depth = np.array([0.0, 1.0, 4.0])
    ax = viz.plot_bubble_profile(one("b_bub", "depth", depth, layer.b(depth)))
    np.testing.assert_allclose(line(ax), (layer.b(depth), depth))
    assert ax.get_ylim() == (4.0, 0.0)
    curves = several("n_bubbles", "depth", depth, {"13 m/s": layer.number_density(depth)})
    ax = viz.plot_bubble_profile(curves, quantity="n_bubbles")
    assert ax.get_xlabel() == viz.axis_label("n_bubbles")
    assert legend(ax) == ["13 m/s"]
    deep = np.linspace(0.0, 60.0, 61)  # 6 decades: deeper ones hold no bubble to see
    ax = viz.plot_bubble_profile(one("b_bub", "depth", deep, layer.b(deep)))
    np.testing.assert_allclose(ax.get_xlim(), layer.b(0.0) * np.array([1e-6, 2.0]))


def test_spectra_and_spreadings():
    omega = np.linspace(0.5, 2.0, 4)
    ax = viz.plot_spectrum(several("spectrum", "omega", omega, {"twice": 2.0 * omega}))
    np.testing.assert_array_equal(line(ax), (omega, 2.0 * omega))
    assert "[m$^{2}$ s rad$^{-1}$]" in ax.get_ylabel()
    theta = np.radians([-90.0, 0.0, 60.0])
    ax = viz.plot_spreading(one("spreading", "theta", theta, np.cos(theta)))
    np.testing.assert_allclose(line(ax), ([-90.0, 0.0, 60.0], [0.0, 1.0, 0.5]), atol=1e-12)


@pytest.mark.parametrize("data", [xr.Dataset(), xr.Dataset({"gain": ((), 1.0)})])
def test_datasets_without_a_curve_are_refused(data):
    with pytest.raises(Refused, match=r"gain: .*, allowed: a variable of one or two dimensions"):
        viz.plot_sweep(data)


def test_fates():
    fates = {
        "received": FateTally(3, 1e-4),
        "absorbed": FateTally(9, 0.7),
        "bottom": FateTally(0, 0),
    }
    ax = viz.plot_fates(GainResult(1e-4, 1e-5, 12, fates, {}))
    assert [bar.get_width() for bar in ax.patches] == [1e-4, 0.7]
    assert (ax.get_xscale(), ax.get_xlim()[0]) == ("linear", 0.0)  # where bars begin
    assert [text.get_text() for text in ax.texts] == ["0.0001", "0.7"]
    with pytest.raises(ValueError, match="result: no fates"):
        viz.plot_fates(GainResult(1e-4, 1e-5, 12, {}, {}))


def make_series(along="time", receivers=0):
    shape = (4, receivers) if receivers else (4,)
    gain = 1e-5 * (1.0 + np.random.default_rng(5).random(shape))
    return mt.GainSeries(along, np.arange(4) * 0.5, gain, 0.01 * gain, gain, 1e-7)


@pytest.mark.parametrize("convert", [lambda s: s, lambda s: s.to_dataset()])
def test_gain_series(convert):
    series = make_series()
    ax = viz.plot_gain_series(convert(series))
    np.testing.assert_array_equal(line(ax), (series.time, series.gain))
    assert ax.get_xlabel() == viz.axis_label("time")
    band = ax.collections[0].get_paths()[0].vertices[:, 1]
    assert band.min() == pytest.approx((series.gain - 2 * series.gain_stderr).min())
    assert band.max() == pytest.approx((series.gain + 2 * series.gain_stderr).max())


def test_gain_series_of_ensembles_and_many_receivers():
    ax = viz.plot_gain_series(make_series("realization", receivers=2))
    assert legend(ax) == ["receiver 0", "receiver 1"]
    assert ax.get_xlabel() == "realization"


def test_gain_distributions_with_fits():
    gain = 1e-5 * np.random.default_rng(6).lognormal(0.0, 0.3, 600)
    seas = one("gain", "realization", np.arange(600), gain)
    seas = seas.assign(gain_stderr=("realization", np.zeros(600)))
    ax = viz.plot_gain_pdf(seas, fits=["lognormal"])
    x, density = next(c.get_data() for c in ax.get_lines() if c.get_label().startswith("log"))
    assert np.trapezoid(density, x) == pytest.approx(1.0, abs=0.02)
    index = float(legend(ax)[0].removeprefix("lognormal, index "))
    assert index == pytest.approx(np.expm1(np.var(np.log(gain))), rel=0.02)
    ax = viz.plot_gain_cdf(seas)
    assert legend(ax) == ["simulated", "lognormal", "gamma-gamma"]
    np.testing.assert_array_equal(line(ax)[0], np.sort(gain))
    with pytest.raises(ValueError, match=r"fits: 'weibull', allowed: lognormal, gamma-gamma"):
        viz.plot_gain_pdf(seas, fits=["weibull"])


def test_autocorrelation():
    time = np.arange(0.0, 60.0, 0.1)
    gain = 1e-5 * (
        2.0 + np.sin(1.3 * time) + 0.1 * np.random.default_rng(7).standard_normal(len(time))
    )
    statistics = fading_statistics(gain, time=time)
    ax = viz.plot_autocorrelation(statistics)
    np.testing.assert_array_equal(line(ax), (statistics.lag, statistics.autocorrelation))
    assert legend(ax)[0].startswith("coherence time 0.9")
    assert legend(ax)[1] == "± 2 standard errors of 0"
    bands = [patch for patch in ax.patches if patch.get_label() == legend(ax)[1]]
    heights = [band.get_path().get_extents(band.get_transform() - ax.transData).height
               for band in bands]  # fmt: skip
    assert heights == pytest.approx([4.0 / np.sqrt(statistics.n_effective)])
    tau = statistics.coherence_time.value
    assert ax.get_xlim() == pytest.approx((0.0, min(10.0 * tau, statistics.lag[-1])))
    with pytest.raises(ValueError, match="of an ensemble"):
        viz.plot_autocorrelation(fading_statistics(gain))
    model = MarkovChannel.fit(gain, 0.1)
    ax = viz.plot(model)
    np.testing.assert_array_equal(line(ax, 1), (model.lag, model.model_autocorrelation))
    assert legend(ax) == ["series", "model"]
    short = statistics.coherence_time._replace(value=0.04)
    ax = viz.plot_autocorrelation(replace(statistics, coherence_time=short))
    assert legend(ax)[0] == "coherence time < 0.1 s"  # the samples are no finer


@pytest.mark.parametrize("convert", [lambda c: c, lambda c: c.to_dataset()])
def test_coverage_is_not_transposed(convert):
    gain = np.arange(6.0).reshape(3, 2)
    coverage = mt.CoverageMap(np.array([-1.0, 0.0, 1.0]), np.array([0.0, 1.0]), gain, gain)
    ax = viz.plot_coverage(convert(coverage), decibel=False)
    mesh = ax.collections[0]
    np.testing.assert_array_equal(np.asarray(mesh.get_array()).reshape(2, 3), gain.T)
    assert ax.get_aspect() == 1.0
    ax = viz.plot_coverage(convert(coverage))
    shown = np.ma.filled(ax.collections[0].get_array(), np.nan).reshape(2, 3)
    assert np.isnan(shown[0, 0])
    assert shown[1, 2] == pytest.approx(10.0 * np.log10(5.0))


def test_a_legend_of_numbers_says_of_what():
    depths, times = [1.0, 2.0, 5.0], [0.0, 1.0]
    data = viz.marks.dataset(
        {"spectral_irradiance": np.ones((3, 2))}, {"depth": depths, "time": times}
    )
    ax = viz.marks.lines(None, data, "spectral_irradiance")
    assert legend(ax) == ["1.0", "2.0", "5.0"]
    assert ax.get_legend().get_title().get_text() == viz.axis_label("depth")
    named = data.assign_coords(depth=["shallow", "middle", "deep"])
    assert (
        not viz.marks.lines(None, named, "spectral_irradiance").get_legend().get_title().get_text()
    )


def test_the_best_place_of_a_map_is_marked_where_it_is_resolved():
    x, y = np.linspace(-2.0, 2.0, 21), np.linspace(-1.0, 1.0, 11)
    gain = 1e-5 * np.exp(-((x[:, None] - 0.8) ** 2) - (y + 0.4) ** 2)
    ax = viz.plot_coverage(mt.CoverageMap(x, y, gain, 1e-3 * gain), decibel=True)
    np.testing.assert_allclose(line(ax), ([0.8], [-0.4]), atol=1e-12)
    assert ax.texts[-1].get_text() == "star: highest gain, at x = 0.8 m, y = −0.4 m"
    assert {"−3 dB", "−6 dB"} <= {text.get_text() for text in ax.texts}
    low, high = ax.collections[0].get_clim()
    assert high - low <= 20.0  # the noise of dark cells takes no colours
    gain[2, 9] = 1.2e-5  # one bright cell, as of a single photon, is no place to hover
    ax = viz.plot_coverage(mt.CoverageMap(x, y, gain, 0.2 * gain), decibel=True)
    assert not ax.get_lines()
    assert re.fullmatch(
        r"highest gain: \d\d cells are equal within errors", ax.texts[-1].get_text()
    )
    dark = np.zeros_like(gain)
    assert not viz.plot_coverage(mt.CoverageMap(x, y, dark, dark)).texts
    ax = viz.plot_coverage(xr.Dataset({"gain": (("x", "y"), gain)}, {"x": x, "y": y}))
    assert not any("highest" in text.get_text() for text in ax.texts)  # errors are not known


def test_sweeps():
    x, gain = np.array([5.0, 10.0]), np.array([1e-4, 1e-5])
    data = one("gain", "depth", x, gain).assign(gain_stderr=("depth", 0.1 * gain))
    ax = viz.plot_sweep(data)
    np.testing.assert_array_equal(line(ax), (x, gain))
    assert ax.get_yscale() == "log"
    assert ax.get_xlabel() == viz.axis_label("depth")
    band = ax.collections[0].get_paths()[0].vertices[:, 1]
    assert (band.min(), band.max()) == pytest.approx((0.8e-5, 1.2e-4))
    assert ax.get_legend() is None
    assert viz.plot_sweep(data, log=False).get_yscale() == "linear"


def test_sweeps_with_realizations_and_one_more_parameter():
    """Means over realizations with the error of their scatter; other parameters name the curves."""
    gain = np.array([[[1.0, 3.0], [5.0, 5.0]], [[2.0, 2.0], [4.0, 8.0]]])
    dims = ("transmitter.depth", "water.b", "realization")
    data = xr.Dataset({"gain": (dims, gain), "gain_stderr": (dims, 0.1 * gain)})
    data = data.assign_coords({"transmitter.depth": [5.0, 10.0], "water.b": [0.1, 0.2]})
    ax = viz.plot(data)
    np.testing.assert_array_equal(line(ax, 0), ([0.1, 0.2], [2.0, 5.0]))
    np.testing.assert_array_equal(line(ax, 1), ([0.1, 0.2], [2.0, 6.0]))
    assert legend(ax) == ["5", "10"]
    assert ax.get_legend().get_title().get_text() == viz.axis_label("depth")
    assert ax.get_xlabel() == viz.axis_label("b")
    band = ax.collections[0].get_paths()[0].vertices[:, 1]  # two standard errors of 1 and 3
    assert (band.min(), band.max()) == (0.0, 5.0)
    ax = viz.plot_sweep(data.isel(realization=[0], **{"water.b": [0]}))
    np.testing.assert_array_equal(line(ax), ([5.0, 10.0], [1.0, 2.0]))
    ax = viz.plot_sweep(data.expand_dims({"receiver.height": [1.0, 2.0]}))
    assert legend(ax) == ["1, 5", "1, 10", "2, 5", "2, 10"]
    labels = [viz.axis_label("height"), viz.axis_label("depth")]
    assert ax.get_legend().get_title().get_text() == "\n".join(labels)
    ax = viz.plot_sweep(data.isel({name: [0] for name in dims}))  # a single point
    assert line(ax) == ([0.1], [1.0])


def test_sweeps_over_words_and_over_many_values():
    gain = np.arange(1.0, 41.0).reshape(2, 20)
    data = xr.Dataset({"gain": (("sea.spectrum", "water.a"), gain)})
    data = data.assign_coords({"sea.spectrum": ["flat", "jonswap"], "water.a": np.arange(20.0)})
    ax = viz.plot_sweep(data.isel({"water.a": [3]}))
    assert [text.get_text() for text in ax.get_xticklabels()] == ["flat", "jonswap"]
    ax = viz.plot_sweep(data.transpose("water.a", ...).rename({"sea.spectrum": "receiver.fov_deg"})
                        .assign_coords({"receiver.fov_deg": [10.0, 20.0]}))  # fmt: skip
    assert len(ax.get_lines()) == 20
    assert legend(ax) == [f"{i}" for i in range(0, 20, 2)]
    assert viz.plot_sweep(data.rename({"water.a": "own.b_deg"})).get_xlabel() == "own.b_deg [°]"


def test_every_kind_of_result_has_a_plot():
    """Kinds of files beside kinds of plots."""
    from meshtrace import stored
    from meshtrace.viz import plots_studies as plots

    assert plots._PLOTS.keys() == stored._HOMES.keys()
    with pytest.raises(Refused, match="result: 3, allowed: a Stored or a Dataset"):
        viz.plot(3)


def test_every_file_that_a_command_writes_has_a_plot():
    """Kinds of results of the studies of all commands; a dataset is that of a sweep."""
    from meshtrace import stored
    from meshtrace.cli import studies as commands
    from meshtrace.viz import plots_studies as plots

    for home in stored._HOMES.values():
        import_module(home)
    kinds = {one.__name__: kind for kind, one in stored.Stored._classes.items()}
    named = re.findall(r"\bmt\.(?:studies\.)?([a-z]\w+)", getsource(commands))
    written = set()
    for name in set(named) - {"studies"}:
        study = getattr(mt, name, None) or getattr(mt.studies, name)
        returned = str(signature(study).return_annotation)
        written |= set(re.findall(r"\w+", returned)) & kinds.keys()
    assert len(written) >= 10
    assert {kinds[name] for name in written} <= plots._PLOTS.keys()


def test_powers_are_in_dbm_along_an_axis_and_in_watts_across_it():
    data = one("received_power", "depth", [5.0, 10.0], [1e-9, 1e-10])
    assert viz.plot_curves(data, "received_power").get_ylabel().endswith("[W]")
    data = one("ber", "received_power", [1e-10, 1e-9], [1e-2, 1e-3])
    assert viz.plot_ber(data).get_xlabel().endswith("[dBm]")


def test_labels_fit_beside_the_axes_and_long_legends_beside_them():
    data = one("part_radiance", "time", [0.0, 1.0], [1e-3, 2e-3])
    first, second = viz.plot_curves(data, "part_radiance").get_ylabel().split("\n")
    assert max(len(first), len(second)) < len(viz.axis_label("part_radiance"))
    assert second.endswith("[W m$^{-2}$ sr$^{-1}$ nm$^{-1}$]")
    gains = {f"{i} m": np.array([2.0, 1.0]) + i for i in range(10)}
    ax = viz.plot_curves(several("gain", "depth", np.array([5.0, 10.0]), gains), "gain")
    ax.figure.canvas.draw()
    assert ax.get_legend().get_window_extent().x0 >= ax.get_window_extent().x1
    ax = viz.plot_sweep(several("gain", "depth", np.array([5.0, 10.0]), gains))
    ax.figure.canvas.draw()
    assert ax.get_legend().get_window_extent().x0 >= ax.get_window_extent().x1


def test_names_along_an_axis_are_those_of_the_parameter():
    words = xr.Dataset({"gain": ("sea.spectrum", [1.0, 2.0])}, {"sea.spectrum": ["flat", "tma"]})
    assert viz.plot_sweep(words).get_xlabel() == "sea.spectrum"  # not its density [m2 s rad-1]


def test_orders_of_scattering():
    found = mt.simulate(mt.Link(), mt.surfaces.FlatSea(), photons=64)
    ax = viz.plot(found)
    heights = line(ax)[1]
    np.testing.assert_allclose(heights[0], found.gain_ballistic)
    n = len(heights) - 1
    np.testing.assert_allclose(heights[1:], found.gain_order[0][:n])
    # all dots are in the frame, and those left out are below it
    assert ax.get_ylim()[0] < heights.min()
    assert (found.gain_order[0][n:] <= 2e-6 * heights.max()).all()
    assert ax.get_title("left").startswith(f"gain {style.number(found.gain, '.3e')} ± ")


def test_comparison():
    link = mt.Link()
    found = mt.compare({"a": link, "b": link.at_depth(12.0)}, mt.surfaces.FlatSea(), photons=64)
    ax = viz.plot(found)
    assert [bar.get_width() for bar in ax.patches] == pytest.approx(found.ratio_db.tolist())
    assert [text.get_text() for text in ax.get_yticklabels()] == ["a", "b"]
    ratio, error = found.ratio_db[1], found.ratio_db_stderr[1]
    assert f"{style.number(ratio, '+.3g')} ± {error:.1g} dB" in [
        text.get_text() for text in ax.texts
    ]


def test_a_dark_link_of_a_comparison_is_named():
    samples = np.array([[1e-5, 1.1e-5], [0.0, 0.0]])
    ax = viz.plot(Comparison.of_samples(("a", "dark"), samples, [{}, {}]))
    (text,) = (text for text in ax.texts if text.get_text() == "no light")
    assert text.xy == (0.0, 1)


def test_convergence_shows_the_errors_and_the_law_of_a_study():
    spacing = np.array([0.4, 0.2, 0.1, 0.05])
    law = SimpleNamespace(order=Estimate(2.0, 1.9, 2.1), coefficient=5e-5)
    study = NonCallableMock(
        spec=ConvergenceStudy,
        parameter="spacing", values=spacing, step=spacing, normals=("vertex",),
        gain=1e-4 + 5e-5 * spacing[None] ** 2, anchor=np.array([1e-4]), reference="analytic",
        mean_stderr=np.full((1, 4), 1e-9), scatter=np.full((1, 4), np.nan),
        fits={"vertex": law}, tolerance=1e-3,
    )  # fmt: skip
    ax = viz.plot_convergence(study)
    assert legend(ax) == ["vertex normals, mean: order 2.00", "tolerance"]
    law = next(curve for curve in ax.get_lines() if curve.get_linestyle() == "-")
    percent = 100.0 / study.gain[0, -1]
    np.testing.assert_allclose(law.get_ydata(), percent * 5e-5 * spacing**2)
    assert ax.get_xlabel() == viz.axis_label("spacing")
    study.mean_stderr = np.array([[1e-9, 1e-9, 1e-9, 1e-6]])  # the finest step is noise
    curves = viz.plot_convergence(study).get_lines()
    law = next(curve for curve in curves if curve.get_linestyle() == "-")
    assert np.isfinite(law.get_ydata()).tolist() == [True, True, True, False]
    hollow = next(curve for curve in curves if curve.get_markerfacecolor() == "white")
    assert np.isfinite(hollow.get_ydata()).tolist() == [False, False, False, True]
    study.mean_stderr = np.full((1, 4), 1e-6)
    ax = viz.plot_convergence(study)
    assert legend(ax)[0] == "vertex normals, mean: order not resolved"


def test_impulse_response():
    response = ImpulseResponse(
        edges=1e-9 * np.arange(4.0),
        h=np.array([1e5, 1e3, 1e-9]),
        h_stderr=np.array([1e3, 1e2, 1e-10]),
        angle=np.zeros(3),
        first_arrival=5e-8,
        mean_delay=1e-10,
        mean_delay_stderr=1e-12,
        rms_delay_spread=2.5e-10,
        rms_delay_spread_stderr=1e-12,
        delay=np.zeros(1),
        weight=np.ones(1),
    )
    ax = viz.plot_impulse_response({"clear": response})
    assert legend(ax) == ["clear, rms delay spread 0.25 ns"]
    assert ax.get_xlim() == (0.0, 2.0)
    assert ax.get_ylim() == (1.0, 2e5)
    np.testing.assert_allclose(ax.patches[0].get_data().values, [1e5, 1e3, 1.0])
    spiky = replace(response, h=np.array([1e5, 1e3, 4e2]), h_stderr=np.array([1e3, 1e2, 4e2]))
    ax = viz.plot_impulse_response(spiky)  # a single photon: its error is its value
    np.testing.assert_array_equal(ax.patches[0].get_data().values, [1e5, 1e3, np.nan])
    assert ax.get_xlim() == (0.0, 2.0)
    assert ax.texts[0].get_text() == "band: ± 2 standard errors"


def test_eye():
    receiver = OokLink(bit_rate=5e6, memory=3)
    eye = receiver.eye(receiver.required_power(1e-3))
    ax = viz.plot_eye(eye)
    assert f"opening {eye.opening:.2f}" in ax.get_title()
    assert legend(ax) == ["one", "zero"]
    ones = np.array([curve.get_ydata() for curve in ax.get_lines()[: eye.bits[:, 0].sum()]])
    assert ones[:, -1].min() > 0.5
    assert "[ns]" in ax.get_xlabel()
    spans = {tuple(np.ptp(curve.get_xdata()[[0, -1]]) + curve.get_xdata()[:1])
             for curve in ax.get_lines() if len(curve.get_xdata())}  # fmt: skip
    assert len(spans) == 2  # both bits, with the same patterns
    assert max(c.get_xdata().max() for c in ax.get_lines() if len(c.get_xdata())) == pytest.approx(
        2e9 * receiver.bit_time
    )


def test_ber_over_power_and_depth():
    power, receiver = np.array([1e-11, 2e-11]), OokLink()
    curves = {"1 Mbit/s": receiver.ber(power)}
    ax = viz.plot_ber(several("ber", "received_power", power, curves))
    np.testing.assert_allclose(line(ax), (10.0 * np.log10(power / 1e-3), receiver.ber(power)))
    assert ax.get_xlabel().endswith("[dBm]")
    ax = viz.plot_ber(one("ber", "depth", [5.0, 10.0, 15.0], [1e-20, 1e-5, 0.0]))
    np.testing.assert_array_equal(line(ax)[1], (1e-20, 1e-5, np.nan))
    assert ax.get_legend() is None  # a part of the line is shown
    ax = viz.plot_ber(one("ber", "depth", [5.0, 15.0], [1e-20, 0.0]))
    np.testing.assert_array_equal(line(ax, 1), ([5.0, 15.0], [1e-9, 1e-9]))
    assert legend(ax) == ["below 10$^{-9}$"]
    limits = {"ber_low": ("depth", [0.0, 3e-3]), "ber_high": ("depth", [1e-4, 4e-2])}
    ax = viz.plot_ber(one("ber", "depth", [5.0, 10.0], [1e-5, 1e-2]).assign(limits))
    band = ax.collections[0].get_paths()[0].vertices[:, 1]
    assert (band.min(), band.max()) == (1e-300, 4e-2)


@pytest.mark.thorough
def test_performance_over_depth():
    sea = JonswapSea(wind_speed=5.0, seed=7)
    performance = mt.link_performance(
        mt.Link(), sea, depths=[24.0, 30.0], bit_rate=[5e6, 1e7], realizations=8, photons=64
    )
    ax = viz.plot_performance(performance)
    assert legend(ax) == ["5 Mbit/s", "10 Mbit/s", "below 10$^{-9}$"]
    value, low, high = performance.estimates("ber")[:, 1].T
    np.testing.assert_array_equal(line(ax, 1), ([24.0, 30.0], value))
    band = ax.collections[1].get_paths()[0].vertices[:, 1]
    assert (band.min(), band.max()) == (low.min(), high.max())
    assert performance.status in [text.get_text() for text in ax.texts]
    assert any(text.get_text().endswith("background light: dark") for text in ax.texts)
    shallow = replace(performance, depths=(24.0,), figures=performance.figures[:2])
    ax = viz.plot_performance(shallow)
    np.testing.assert_array_equal(line(ax), ([5.0, 10.0], shallow.estimates("ber")[0, :, 0]))
    assert ax.get_xlabel() == "bit rate $R_b$ [Mbit/s]"


def test_plots_draw_on_given_axes_and_leave_defaults_alone():
    before = mpl.rcParams["axes.grid"]
    data = one("ber", "received_power", [1e-10], OokLink().ber([1e-10]))
    figure = mpl.figure.Figure()
    ax = figure.subplots()
    assert viz.plot_ber(data, ax=ax) is ax
    assert viz.plot_ber(data) is not ax
    assert mpl.rcParams["axes.grid"] == before


def test_the_legend_of_a_sweep_covers_no_curve():
    """Curves fill the axes: no place within them is free."""
    depth, a = np.linspace(5.0, 40.0, 15), np.linspace(0.05, 0.3, 6)
    zigzag = 10.0 ** -(3.0 + 3.0 * np.arange(15) % 7.0 + a[:, None])
    data = xr.Dataset({"gain": (("water.a", "transmitter.depth"), zigzag)},
                      {"water.a": a, "transmitter.depth": depth})  # fmt: skip
    ax = viz.plot_sweep(data)
    ax.figure.draw_without_rendering()
    box = ax.get_legend().get_window_extent()
    for line in ax.lines:
        path = line.get_path().transformed(line.get_transform())
        assert not path.intersects_bbox(box, filled=False)
