"""Dryden gusts: intensities, lengths, and records in time against their formulas."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from meshtrace import Dryden
from meshtrace.uav import LogProfile, PowerProfile
from meshtrace.uav.wind import FOOT, HEIGHT_20FT

REFERENCE = json.loads((Path(__file__).parents[1] / "data" / "link_reference.json").read_text())
CASES = [
    (preset, speed, REFERENCE["uav"][f"{key}_U{speed}"])
    for key, preset in (("paper", "paper"), ("mil", "physical"))
    for speed in (5, 13)
]
SIDAK_ALPHA = 1e-4


@pytest.mark.parametrize(("preset", "speed", "expected"), CASES)
def test_intensities_match_reference(preset, speed, expected):
    wind = Dryden.preset(preset, wind_speed=speed, height=5.0)
    assert wind.sigma == pytest.approx(
        [expected["sigma_x"], expected["sigma_x"], expected["sigma_z"]], rel=1e-12
    )
    assert wind.std == pytest.approx(
        [expected["std_Vx"], expected["std_Vx"], expected["std_Vz"]], rel=1e-12
    )


@pytest.mark.parametrize(
    ("profile", "ratio"),
    [
        (LogProfile(), 0.954254860),
        (LogProfile(roughness_length=1e-3), 0.946261240),
        (PowerProfile(), 0.947010830),
        (PowerProfile(exponent=1.0 / 7.0), 0.931734415),
    ],
)
def test_wind_at_20_feet_follows_the_profile(profile, ratio):
    assert profile.ratio(HEIGHT_20FT) == pytest.approx(ratio, rel=1e-8)
    wind = Dryden(wind_speed=10.0, profile=profile)
    assert wind.sigma[2] == pytest.approx(ratio, rel=1e-8)


def test_explicit_w20_overrides_the_profile():
    assert Dryden(wind_speed=5.0, w20=15.4).sigma[2] == pytest.approx(1.54)


def test_length_scales_take_feet_or_metres():
    feet, metres = Dryden.preset("physical"), Dryden.preset("paper")
    assert feet.length_scales == pytest.approx([36.5674, 36.5674, 5.0], abs=1e-4)
    assert feet.length_scales[0] / FOOT == pytest.approx(119.972, abs=1e-3)
    assert metres.length_scales == pytest.approx([38.8530, 38.8530, 5.0], abs=1e-4)
    assert feet.correlation_times == pytest.approx(feet.length_scales / 5.0)


def test_wind_at_height_scales_the_mean_only():
    low = Dryden(wind_speed=10.0, wind_at_height=True)
    assert low.mean_wind[0] == pytest.approx(9.36, abs=5e-3)
    assert low.std == pytest.approx(Dryden(wind_speed=10.0).std)


def test_printed_gains_lose_pi():
    """The energy int h^2 dt of the paper's filters is sigma^2 / pi, without pi it is sigma^2."""
    tau = 7.0
    along, _ = quad(lambda t: 2.0 / tau * math.exp(-2.0 * t / tau), 0.0, 40.0 * tau)

    def across(t: float) -> float:
        kernel = math.sqrt(3.0) + (1.0 - math.sqrt(3.0)) * t / tau
        return kernel**2 / tau * math.exp(-2.0 * t / tau)

    energy, _ = quad(across, 0.0, 40.0 * tau)
    assert along == pytest.approx(1.0, rel=1e-8)
    assert energy == pytest.approx(1.0, rel=1e-8)
    ratio = Dryden.preset("paper").sigma / Dryden.preset("paper").std
    assert ratio**2 == pytest.approx(math.pi)


def _bartlett_std(rho: np.ndarray, n: int) -> np.ndarray:
    """Bartlett's standard deviation of the sample autocovariance of a unit Gaussian process."""
    full = np.concatenate((rho[:0:-1], rho))
    lags = np.arange(rho.size // 2)
    center = rho.size - 1
    reach = np.arange(-(rho.size // 2), rho.size // 2 + 1)
    return np.array(
        [
            math.sqrt(
                np.sum(
                    full[center + reach] ** 2 + full[center + reach + k] * full[center + reach - k]
                )
                / n
            )
            for k in lags
        ]
    )


@pytest.mark.parametrize("preset", ["physical", "paper"])
@pytest.mark.parametrize("step", [0.1, 1.0])
def test_record_has_the_stated_autocovariance(preset, step):
    """z-tests of the sample autocovariance at five lags of three components, alpha 1e-4 (Sidak)."""
    wind = Dryden.preset(preset, wind_speed=13.0, height=5.0)
    n, dt = 400_000, step * float(wind.correlation_times[0])
    record = wind.simulate_wind(np.arange(n) * dt, seed=11) - wind.mean_wind
    limit = norm.isf(0.5 * (1.0 - (1.0 - SIDAK_ALPHA) ** (1.0 / 60.0)))
    lags = [0, 1, 2, 5, 12]
    for axis in range(3):
        rho = wind.autocorrelation(np.arange(2000) * dt)[:, axis] / wind.std[axis] ** 2
        spread = _bartlett_std(rho, n) * wind.std[axis] ** 2
        for lag in lags:
            series = record[:, axis]
            found = float(np.mean(series[: n - lag] * series[lag:]))
            expected = wind.autocorrelation(lag * dt)[axis]
            assert abs(found - expected) < limit * spread[lag], (axis, lag)


@pytest.mark.parametrize(("preset", "factor"), [("physical", 1.0), ("paper", 1.0 / math.pi)])
def test_record_variance_to_one_percent(preset, factor):
    """Samples ten filter times apart are independent: 1 % is six standard errors of 7e5."""
    wind = Dryden.preset(preset, wind_speed=13.0, height=5.0)
    times = np.arange(700_000) * 10.0 * float(wind.correlation_times.max())
    record = wind.simulate_wind(times, seed=3)
    assert record.var(axis=0) == pytest.approx(factor * wind.sigma**2, rel=0.01)
    assert record.mean(axis=0) == pytest.approx(wind.mean_wind, abs=0.02)


def test_short_steps_do_not_lose_precision():
    """A step of a millionth of the filter time leaves the record continuous, not noisy."""
    wind = Dryden(wind_speed=5.0)
    dt = 1e-6 * float(wind.correlation_times[2])
    record = wind.simulate_wind(np.arange(1000) * dt, seed=2)
    increments = np.diff(record, axis=0)
    # E[(x(t + dt) - x(t))^2] = 2 (R(0) - R(dt)), 2 s^2 q for u and 3 s^2 q for v and w.
    q = dt / wind.correlation_times
    expected = wind.std**2 * q * np.array([2.0, 3.0, 3.0])
    assert np.mean(increments**2, axis=0) == pytest.approx(expected, rel=0.25)


def test_record_is_reproducible_and_shaped():
    wind = Dryden(wind_speed=8.0)
    times = np.arange(0.0, 10.0, 0.1)
    first, second = (wind.simulate_wind(times, seed=5) for _ in range(2))
    assert first.shape == (times.size, 3)
    assert np.array_equal(first, second)
    assert not np.array_equal(first, wind.simulate_wind(times, seed=6))
    assert wind.sample_wind(4, seed=1).shape == (4, 3)


def test_calm_has_no_gusts():
    calm = Dryden(wind_speed=0.0)
    assert np.array_equal(calm.simulate_wind([0.0, 1.0, 2.0], seed=1), np.zeros((3, 3)))
    assert calm.autocorrelation(1.0) == pytest.approx([0.0, 0.0, 0.0])


@pytest.mark.parametrize("times", [[0.0], [0.0, 1.0, 3.0], [1.0, 0.0], [0.0, 0.0], [[0.0, 1.0]]])
def test_uneven_times_are_refused(times):
    with pytest.raises(ValueError, match="times: "):
        Dryden().simulate_wind(times, seed=1)


@pytest.mark.parametrize(
    "fields",
    [
        {"wind_speed": -1.0},
        {"wind_speed": math.nan},
        {"wind_speed": 61.0},
        {"height": 0.0},
        {"height": 305.0},
        {"altitude_unit": "yard"},
        {"gust": 1.0},
    ],
)
def test_bad_fields_are_refused(fields):
    with pytest.raises(ValueError, match=next(iter(fields))):
        Dryden(**fields)


def test_unknown_preset_is_refused():
    with pytest.raises(ValueError, match="physics: 'mil', allowed: physical, paper"):
        Dryden.preset("mil")


@pytest.mark.parametrize("preset", ["physical", "paper"])
def test_round_trip(preset):
    wind = Dryden.preset(preset, profile=PowerProfile(exponent=0.2), w20=7.0)
    assert Dryden.model_validate_json(wind.model_dump_json()) == wind
