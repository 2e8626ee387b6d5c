import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meshtrace.surfaces import waves
from meshtrace.surfaces.waves import angular_frequency, group_speed, phase_speed, wavenumber

modest = settings(max_examples=60, deadline=None, derandomize=True)
depths = st.one_of(st.none(), st.floats(0.05, 5000.0))


def test_deep_water_is_the_closed_form():
    omega = np.array([0.0, 0.3, 1.2, 4.0, 60.0])
    np.testing.assert_array_equal(wavenumber(omega), omega**2 / waves.GRAVITY)
    np.testing.assert_allclose(angular_frequency(wavenumber(omega)), omega, rtol=1e-15)


@given(omega=st.floats(1e-3, 500.0), depth=depths, capillary=st.booleans())
@modest
def test_wavenumber_inverts_angular_frequency(omega, depth, capillary):
    k = wavenumber(omega, depth, capillary)
    assert angular_frequency(k, depth, capillary) == pytest.approx(omega, rel=1e-14)


@given(omega=st.floats(1e-2, 20.0), depth=st.floats(0.05, 500.0))
@modest
def test_finite_depth_satisfies_the_dispersion_relation(omega, depth):
    k = float(wavenumber(omega, depth))
    assert waves.GRAVITY * k * math.tanh(k * depth) == pytest.approx(omega**2, rel=1e-13)


def test_wavenumber_keeps_the_shape_and_the_zero():
    omega = np.array([[0.0, 1.0], [2.0, 3.0]])
    k = wavenumber(omega, depth=3.0, capillary=True)
    assert k.shape == (2, 2)
    assert k[0, 0] == 0.0
    assert wavenumber(0.0, depth=3.0).shape == ()


def test_shallow_water_speed_is_sqrt_gd():
    assert phase_speed(1e-5, depth=2.0) == pytest.approx(math.sqrt(waves.GRAVITY * 2.0), rel=1e-9)
    assert group_speed(1e-5, depth=2.0) == pytest.approx(math.sqrt(waves.GRAVITY * 2.0), rel=1e-9)


def test_slowest_wave_is_23_cm_per_s_at_17_mm():
    wavelength = np.linspace(5e-3, 50e-3, 20001)
    speed = phase_speed(2 * np.pi / wavelength, capillary=True)
    slowest = np.argmin(speed)
    assert speed[slowest] == pytest.approx(0.23, abs=1e-3)
    assert wavelength[slowest] == pytest.approx(0.017, abs=2e-4)
    # Closed form: c_min = (4 g T)^(1/4), where group and phase speed agree.
    assert speed[slowest] == pytest.approx(
        (4 * waves.GRAVITY * waves.KINEMATIC_TENSION) ** 0.25, rel=1e-8
    )
    k_m = waves.CAPILLARY_WAVENUMBER
    assert group_speed(k_m, capillary=True) == pytest.approx(
        float(phase_speed(k_m, capillary=True)), rel=1e-14
    )


@pytest.mark.parametrize(("depth", "capillary"), [(None, False), (None, True), (0.7, True)])
def test_group_speed_is_the_derivative(depth, capillary):
    k = np.array([0.05, 0.4, 3.0, 40.0, 600.0])
    h = 1e-5 * k
    upper, lower = (angular_frequency(k + s * h, depth, capillary) for s in (1, -1))
    np.testing.assert_allclose(
        group_speed(k, depth, capillary), (upper - lower) / (2 * h), rtol=1e-8
    )


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: wavenumber(-1.0), "omega: -1.0, allowed: 0 <= omega < inf"),
        (lambda: wavenumber([1.0, math.nan]), r"omega\[1\]: nan"),
        (lambda: angular_frequency(math.inf), "k: inf"),
        (lambda: wavenumber(1.0, depth=0.0), "depth: 0.0, allowed: 0 < depth < inf m"),
        (lambda: phase_speed(0.0), "k: 0.0"),
    ],
)
def test_refuses(call, message):
    with pytest.raises(ValueError, match=message):
        call()
