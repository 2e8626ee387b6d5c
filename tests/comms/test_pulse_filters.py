"""Filtered pulses against the reference cursors and against brute-force convolution."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from meshtrace.comms import LedDriver, SiPM
from meshtrace.comms.pulses import PulseFilters

RX = json.loads((Path(__file__).parents[1] / "data" / "link_reference.json").read_text())["rx"]
TAU_LED, TAU_SIPM = LedDriver().time_constant, SiPM().time_constant


@pytest.mark.parametrize("bit_rate", [1_000_000, 5_000_000, 10_000_000])
def test_cursors_match_reference(bit_rate):
    filters = PulseFilters(TAU_LED, TAU_SIPM)
    mean = filters.mean_cursors(1.0 / bit_rate, 5)
    shot = 2.0 * TAU_SIPM * filters.shot_cursors(1.0 / bit_rate, 5)
    assert mean == pytest.approx(RX["mean_weights"][str(bit_rate)], abs=1e-14)
    assert shot == pytest.approx(RX["var_weights_times_2tauS"][str(bit_rate)], abs=1e-14)


@pytest.mark.parametrize(
    ("bit_rate", "opening"), [(1e6, 0.999991), (5e6, 0.797495), (1e7, 0.289410)]
)
def test_worst_eye_matches_table(bit_rate, opening):
    w = PulseFilters(TAU_LED, TAU_SIPM).mean_cursors(1.0 / bit_rate, 60)
    assert w[0] - w[1:].sum() == pytest.approx(opening, abs=1e-6)


def response(filters: PulseFilters, age: np.ndarray) -> np.ndarray:
    """Signal of one count at a given age: SiPM's pole, then the average over the window."""
    tau, window = filters.tau_sipm, filters.window
    if window == 0.0:
        return np.exp(-age / tau) / tau
    return (np.exp(-np.maximum(age - window, 0.0) / tau) - np.exp(-age / tau)) / window


@pytest.mark.parametrize("window", [0.0, 30e-9, 200e-9])
@pytest.mark.parametrize("tau_led", [0.0, TAU_LED, TAU_SIPM, 0.5 * TAU_SIPM, 4.0 * TAU_SIPM])
def test_steps_against_brute_force(window, tau_led):
    """Trapezoid sums of g l and g^2 l, also where both poles or a pole and its half coincide."""
    filters = PulseFilters(tau_led, TAU_SIPM, window)
    for t in (20e-9, 150e-9, 900e-9):
        age = np.linspace(0.0, t, 400_001)
        g = response(filters, age)
        lit = -np.expm1(-(t - age) / tau_led) if tau_led > 0.0 else np.ones_like(age)
        assert filters.mean_step(t) == pytest.approx(np.trapezoid(g * lit, age), rel=1e-8)
        assert filters.shot_step(t) == pytest.approx(np.trapezoid(g * g * lit, age), rel=1e-8)
    age = np.linspace(0.0, window + 40.0 * TAU_SIPM, 400_001)
    g = response(filters, age)
    assert filters.noise_energy == pytest.approx(np.trapezoid(g * g, age), rel=1e-6)
    assert filters.peak == pytest.approx(g.max(), rel=1e-3)


def test_steps_are_causal_and_settle():
    filters = PulseFilters(TAU_LED, TAU_SIPM, 100e-9)
    assert not np.any(filters.mean_step([-1e-6, 0.0]))
    assert float(filters.mean_step(1e-3)) == pytest.approx(1.0, rel=1e-12)
    assert float(filters.shot_step(1e-3)) == pytest.approx(filters.noise_energy, rel=1e-12)


def test_noise_bandwidths_match_text():
    """ENBW of the SiPM's pole is pi/2 times 2 MHz; a long window has half its inverse."""
    assert 0.5 * PulseFilters(TAU_LED, TAU_SIPM).noise_energy == pytest.approx(math.pi * 1e6)
    long = PulseFilters(TAU_LED, TAU_SIPM, 1e-2)
    assert 0.5 * long.noise_energy == pytest.approx(0.5 / 1e-2, rel=1e-4)


@pytest.mark.parametrize("window", [0.0, 60e-9])
def test_ages_invert_the_response(window):
    filters = PulseFilters(TAU_LED, TAU_SIPM, window)
    level = filters.peak * np.array([0.01, 0.3, 0.999])
    young, old = filters.ages_above(level)
    assert response(filters, old) == pytest.approx(level)
    if window > 0.0:
        assert response(filters, young) == pytest.approx(level)
    else:
        assert not np.any(young)


def test_light_of_a_bit_adds_up():
    """All of a bit's light is one bit time; bits of all ages make steady light."""
    filters = PulseFilters(TAU_LED, TAU_SIPM)
    bit_time = 100e-9
    assert filters.light_since(np.array([5e-6]), 3, bit_time) == pytest.approx([bit_time])
    age = np.array([50e-9, 320e-9])
    total = sum(filters.light_since(age, k, bit_time) for k in range(200))
    assert total == pytest.approx(age, rel=1e-9)
