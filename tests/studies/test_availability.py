"""Availability over uncertain inputs: closed forms, direct runs, months, files and refusals."""

import math
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from mc_statistics import z_test
from scipy import optimize, special, stats

import meshtrace as mt
from meshtrace.errors import Refused
from meshtrace.fading import gamma_gamma
from meshtrace.studies import availability, availability_runs, availability_study
from meshtrace.studies.availability_shares import DAYS, ShareSurfaces
from meshtrace.studies.background import mean_sea
from meshtrace.studies.inputs import Axis, read_inputs
from meshtrace.studies.response_surface import ResponseSurface
from meshtrace.surfaces import FlatSea

CLEAR = mt.Scenario.from_toml(
    'bubbles = "none"\nwhitecaps = "none"\n[sea]\nspectrum = "flat"\n[water]\na = 0.1\nb = 0.0\n'
)
FEW = {"runs": 8, "realizations": 4, "photons": 64}
WIND = {"distribution": "weibull_min", "c": 2.2, "scale": 7.9, "clip": [1.0, 15.0]}
CHLOROPHYLL = {"distribution": "lognorm", "s": 0.7, "scale": 0.3, "clip": [0.03, 3.0]}


def answer(log_gain, variance, laws, n=32, outage=0.01, need=1.0, seed=3):
    """Return the answers of surfaces of functions of the inputs, without any run."""
    inputs = read_inputs({f"x{k}": law for k, law in enumerate(laws)})
    axes = [item.axis() for item in inputs]
    points = stats.qmc.Sobol(len(axes), rng=1).random(n)
    values = np.transpose([axis.value(points[:, k]) for k, axis in enumerate(axes)])
    gain = np.exp(log_gain(*values.T))
    rows = np.transpose([gain, 1e-4 * gain, variance(*values.T), np.full(n, need)])
    # variances over so many seas have no noise
    study = SimpleNamespace(realizations=100_000, seed=seed)
    return ShareSurfaces(study, inputs, axes, values, rows, (outage, 0.9), math.nan)


def test_shares_are_those_of_the_law_of_fades():
    """A state has a gamma-gamma law of equal shapes about its mean gain."""

    def log_gain(x, y):
        return 1.0 - x - 0.3 * y**2

    def variance(x, y):
        return 0.02 + 0.2 * y

    got = answer(log_gain, variance, [stats.uniform(0, 2), stats.uniform(0, 1)]).result({}).year
    grid = (np.arange(60) + 0.5) / 60
    x, y = (a.ravel() for a in np.meshgrid(2.0 * grid, grid))
    # shapes of which var ln h = 2 psi'(shape)
    shapes = [
        optimize.brentq(lambda u, v=v: 2.0 * special.polygamma(1, u) - v, 0.5, 1e4)
        for v in variance(0.0, grid)
    ]
    ratio = np.exp(-log_gain(x, y))
    laws = zip(ratio.reshape(60, 60), shapes, strict=True)
    works = 1.0 - np.concatenate([gamma_gamma.cdf(row, shape, shape) for row, shape in laws])
    assert got.share == pytest.approx(works.mean(), abs=0.003)
    assert got.steady_share == pytest.approx((works >= 0.99).mean(), abs=0.01)
    assert got.mean_share == pytest.approx((ratio <= 1.0).mean(), abs=0.005)
    assert 0.0 < got.share_stderr < 0.005


def test_sobol_indices_are_those_of_a_sum():
    """Of a sum of functions of one input each, indices are shares of its variance."""
    found = answer(
        lambda x, y: 3.0 * x + y, lambda x, y: np.exp(y), [stats.norm(0, 1), stats.norm(0, 1)]
    )
    x, y = found.result({}).influences
    assert x.gain_total == pytest.approx(0.9, abs=0.02)
    assert y.gain_total == pytest.approx(0.1, abs=0.02)
    assert x.fading_total == pytest.approx(0.0, abs=0.02)
    assert y.fading_total == pytest.approx(1.0, abs=0.02)
    assert x.margin_first > y.margin_first


def test_a_surface_without_fades_misleads():
    """An input without effect on the mean gain decides by fades alone."""
    found = answer(lambda x, y: 0.2 + 0.05 * y, lambda x, y: 0.01 * 30.0**x,
                   [stats.uniform(0, 1), stats.norm(0, 1)]).result({})  # fmt: skip
    wind, water = found.influences
    assert wind.gain_total < 1e-3 < 0.5 < wind.margin_first
    assert water.gain_total > 0.99
    assert found.measure_first == "x0"
    year = found.year
    assert year.mean_share > 0.999
    assert year.share < year.mean_share - 20.0 * year.share_stderr
    assert year.steady_share < 0.5


@pytest.mark.slow
def test_the_surface_states_its_error():
    """Errors of means of the surface from noisy runs are as large as stated."""
    places = stats.qmc.Sobol(2, rng=1).random(32)[:24]
    where = stats.qmc.Sobol(2, rng=2).random(64)
    weights = np.full(64, 1 / 64)

    def truth(x):
        return np.sin(2.0 * x[:, 0]) + x[:, 1] ** 2

    off = []
    for seed in range(24):
        noise = 0.05 * np.random.default_rng(seed).normal(size=24)
        surface = ResponseSurface(places, truth(places) + noise, 0.05)
        assert 0.02 < surface.error < 0.12
        (error,) = surface.errors_of_sums(where, weights[None])
        off.append((weights @ (surface.values(where) - truth(where))) / error)
    assert z_test(float(np.mean(off)), 1.0 / math.sqrt(24), 0.0)
    assert 0.6 < float(np.std(off)) < 1.5


def test_equal_results_are_exact():
    surface = ResponseSurface(np.eye(3), np.full(3, 2.0), 0.1)
    assert surface.error == surface.errors_of_sums(np.eye(3), np.ones((1, 3)))[0] == 0.0
    assert (surface.values(np.eye(3)) == 2.0).all()


def test_absorption_by_beer_and_lambert():
    """Without scattering the gain over still water falls as exp(-a d): the law of a decides."""
    law = stats.uniform(0.05, 0.3)
    base = mt.simulate(CLEAR.link, FlatSea(), photons=64).gain
    got = availability(CLEAR, {"water.a": law}, threshold=base * math.exp(-1.0), **FEW)
    # exp(-(a - 0.1) d) = 1 / e at a = 0.2, d = 10 m
    assert got.year.share == pytest.approx(0.5, abs=0.003)
    assert got.year.share == pytest.approx(got.year.mean_share, abs=1e-3)
    assert got.gain_error < 0.02
    # the range is the depth at which the 90 % quantile of the absorption closes the link
    link = CLEAR.link.at_depth(got.range).replace("water.a", float(law.ppf(0.9)))
    assert mt.simulate(link, FlatSea(), photons=64).gain == pytest.approx(got.need, rel=0.02)


def test_another_threshold_takes_no_new_runs(tmp_path, monkeypatch):
    options = FEW | {"store": tmp_path / "a.store", "bounds": {}}
    inputs = {"water.a": {"samples": np.linspace(0.05, 0.3, 40)}}
    first = availability(CLEAR, inputs, threshold=1e-5, **options)
    monkeypatch.setattr(availability_runs, "simulate", None)
    again = availability(CLEAR, inputs, threshold=1e-4, threads=1, **options)
    assert (first.run_gain == again.run_gain).all()
    assert again.year.share < first.year.share
    assert math.isnan(again.range)


def test_months_of_a_law_and_of_samples(calm_availability):
    """In December the water absorbs more."""
    months = calm_availability.months
    assert [*months] == [*range(1, 13)]
    assert months[12].share < months[6].share
    year = np.array([months[m].share for m in months]) @ DAYS
    assert calm_availability.year.share == pytest.approx(year, abs=1e-9)
    text = calm_availability.summary()
    assert "\n12 " in text
    assert "transmitter.depth at 90 % of the year" in text


@pytest.mark.parametrize("n", [2, 3, 31, 366])
def test_quantiles_are_those_of_numpy(n, rng):
    """To the bit: shares of the year are compared from run to run."""
    month = rng.lognormal(size=n)
    shares = np.linspace(0.0, 1.0, 999)
    (item,) = read_inputs({"x": {"samples": month}})
    fine = np.quantile(month, np.linspace(0.0, 1.0, 2**14))
    np.testing.assert_array_equal(item.ppf(shares), np.quantile(fine, shares))


def test_samples_of_files(tmp_path):
    times = pd.date_range("2024-01-01", periods=366, freq="D")
    wind = 5.0 + times.month.to_numpy()
    hs = 0.1 * wind
    pd.DataFrame({"time": times, "wspd": wind, "hs": hs}).to_csv(tmp_path / "buoy.csv", index=False)
    xr.Dataset({"chl": ("time", 0.1 * wind)}, {"time": times}).to_netcdf(tmp_path / "chl.nc")
    (tmp_path / "inputs.toml").write_text(
        'wind_speed = {file = "buoy.csv", variable = "wspd", clip = [7, 15]}\n'
        'sea.hs = {file = "buoy.csv", variable = "hs"}\n'
        'water.chlorophyll = {file = "chl.nc", variable = "chl"}\n'
        'water.cdom = {distribution = "uniform", scale = 0.1}\n'
    )
    speed, height, chlorophyll, cdom = read_inputs(tmp_path / "inputs.toml")
    assert (speed.name, height.name) == ("wind_speed", "sea.hs")
    assert set(speed.of_month(0)) == {7.0}
    assert set(speed.of_month(11)) == {15.0}
    assert chlorophyll.of_month(2) == pytest.approx(0.8)
    assert cdom.of_month(2).max() == pytest.approx(0.1, rel=1e-3)
    # one file: the values of the same times
    assert speed.record == height.record != ""
    speed.values, height.values = (wind * 1.0,), (hs,)
    inputs = [speed, height]
    axes = [item.axis() for item in inputs]
    values = np.transpose([axis.value(np.linspace(0, 1, 8)) for axis in axes])
    rows = np.transpose([np.exp(values[:, 0]), np.ones(8), 0.1 * np.ones(8), np.ones(8)])
    study = SimpleNamespace(realizations=4, seed=1)
    found = ShareSurfaces(study, inputs, axes, values, rows, (0.1, 0.9), math.nan)
    assert found._states[..., 1] == pytest.approx(0.1 * found._states[..., 0])


def test_axes():
    wind, chlorophyll, uniform = (
        read_inputs({"x": law})[0].axis() for law in (WIND, CHLOROPHYLL, stats.uniform(0, 1))
    )
    assert (wind.log, chlorophyll.log, uniform.log) == (False, True, False)
    assert (wind.low, wind.high) == (1.0, 15.0)
    axis = Axis("water.chlorophyll", 0.03, 3.0, True)
    assert axis.value(axis.place(np.array([0.01, 0.3, 9.0]))) == pytest.approx([0.03, 0.3, 3.0])


@pytest.mark.parametrize(
    ("inputs", "field"),
    [
        ({}, "inputs"),
        ({"water.a": 3.0}, "inputs.water.a"),
        ({"water.a": [0.1, 0.1]}, "inputs.water.a"),
        ({"water.a": [0.1, math.inf]}, "inputs.water.a"),
        ({"water.a": {"distribution": "weibul"}}, "inputs.water.a.distribution"),
        ({"water.a": {"distribution": "lognorm", "s": -1.0}}, "inputs.water.a"),
        ({"water.a": {"distribution": "lognorm", "sigma": 1.0}}, "inputs.water.a.sigma"),
        ({"water.a": {"distribution": "lognorm"}}, "inputs.water.a"),
        ({"water.a": {"distribution": "uniform", "scale": [1.0, 2.0]}}, "inputs.water.a"),
        ({"water.a": {"samples": [0.1, 0.2], "clip": [3.0, 1.0]}}, "inputs.water.a.clip"),
        ({"water.a": {"file": "none.csv", "variable": "x"}}, "none.csv"),
        ({"water.d": [0.1, 0.2]}, "water.d"),
        ({"water.a": [-0.1, 0.2]}, "water.a"),
    ],
)
def test_refusals(inputs, field):
    with pytest.raises(Refused) as refused:
        availability(CLEAR, inputs, threshold=1e-5, **FEW)
    assert refused.value.field == field


def test_refusals_of_other_arguments():
    inputs = {"water.a": [0.1, 0.2]}
    for changes, field in (
        ({"bounds": {"water.a": (0.1, 0.2)}}, "bounds"),
        ({"bounds": {"transmitter.depth": (5.0, 9.0), "receiver.height": (1.0, 9.0)}}, "bounds"),
        ({"runs": 4}, "runs"),
        ({"threshold": 0.0}, "threshold"),
    ):
        with pytest.raises(Refused) as refused:
            availability(CLEAR, inputs, **{"threshold": 1e-5} | changes)
        assert refused.value.field == field
    two = CLEAR.link.replace("receiver", (mt.Receiver(), mt.Receiver(radius=0.1)))
    with pytest.raises(Refused, match="one aperture"):
        availability(two, inputs, threshold=1e-5)


def test_a_useless_surface_is_refused():
    """Steps of the gain that no smooth surface follows."""
    with pytest.raises(Refused, match="wrong by"):
        answer(lambda x, y: 8.0 * np.sign(np.sin(40.0 * x)), lambda x, y: 0.1 + y,
               [stats.uniform(0, 1), stats.uniform(0, 1)])  # fmt: skip


@pytest.mark.thorough
def test_bits_give_the_need():
    """The need is that of the transmission, under its background."""
    day = {"model": "uniform", "direct": 0.0, "diffuse": 0.5}
    inputs = {"water.a": [0.1, 0.2]}
    dark = availability(CLEAR, inputs, bounds={}, **FEW)
    scenario = mt.Scenario.from_config(CLEAR.to_config() | {"daylight": day})
    bright = availability(scenario, inputs, bounds={}, **FEW)
    assert math.isfinite(dark.need)
    assert (bright.run_need > 2.0 * dark.run_need).all()


@pytest.mark.slow
def test_brute_force_of_200_runs(tmp_path):
    """The trial prior over the default lamp 20 m deep at 490 nm: within 1 % of direct runs."""
    base = {"transmitter.depth": 20.0, "transmitter.wavelength_nm": 490.0}
    # the study takes the very states of the brute force, whose own scatter would be 1 %
    shares = stats.qmc.Sobol(2, rng=7).random(256)[:200]
    pairs = zip(read_inputs({"wind_speed": WIND, "c": CHLOROPHYLL}), shares.T, strict=True)
    states = pd.DataFrame({item.name: item.quantile(column) for item, column in pairs})
    states.to_csv(tmp_path / "states.csv", index=False)
    gains = []
    for seed, (wind, chlorophyll) in enumerate(states.to_numpy().tolist()):
        changes = base | {"wind_speed": wind, "water.chlorophyll": chlorophyll}
        at = mt.Scenario.from_toml("", changes=changes)
        gains.append(mt.simulate(at.link, mean_sea(at.link, at.surface), seed=900 + seed).gain)
    file = str(tmp_path / "states.csv")
    inputs = {
        "wind_speed": {"file": file, "variable": "wind_speed"},
        "water.spectrum.chlorophyll": {"file": file, "variable": "c"},
    }
    scenario = mt.Scenario.from_toml("", changes=base)
    for level in (0.1, 0.2, 0.5, 0.8, 0.9):
        threshold = float(np.quantile(gains, level))
        got = availability(
            scenario, inputs, threshold=threshold, bounds={}, store=tmp_path / "runs.store",
            runs=64, realizations=4,
        )  # fmt: skip
        print(level, got.year.mean_share)
        assert got.year.mean_share == pytest.approx(np.mean(np.array(gains) > threshold), abs=0.01)
    levels = dict(zip(got.level.tolist(), got.gain_quantile, strict=True))
    for level in (0.1, 0.5, 0.9):
        assert levels[level] == pytest.approx(np.quantile(gains, level), rel=0.03)


@pytest.mark.slow
def test_fades_against_seas_of_random_states():
    """The share at the instant is that of gains over seas in random states."""
    base = {"transmitter.depth": 20.0, "transmitter.wavelength_nm": 490.0}
    scenario = mt.Scenario.from_toml("", changes=base)
    got = availability(scenario, threshold=1.5e-5, bounds={})
    wind, chlorophyll = read_inputs(availability_study.PRIOR)
    works = []
    for seed, (u, v) in enumerate(stats.qmc.Sobol(2, rng=11).random(128)):
        values = {
            "wind_speed": float(wind.quantile(u)),
            "water.chlorophyll": float(chlorophyll.quantile(v)),
        }
        at = mt.Scenario.from_toml("", changes=base | values)
        works.append((mt.ensemble(at, 8, photons=512, seed=700 + seed).gain > 1.5e-5).mean())
    # Sobol points scatter less than independent states: the error is an upper bound
    error = math.hypot(got.year.share_stderr, np.std(works) / math.sqrt(128))
    assert z_test(np.mean(works) - got.year.share, error, 0.0)
    assert got.year.share < got.year.mean_share - 0.03
