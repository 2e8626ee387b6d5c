import math

import numpy as np
import pytest

from meshtrace.errors import Refused
from meshtrace.surfaces import Elfouhaily, Jonswap, PiersonMoskowitz, Tma, waves
from meshtrace.surfaces.spectra import (
    elfouhaily_delta,
    kitaigorodskii,
)
from meshtrace.surfaces.statistics import cox_munk, hs, mean_square_slope, spectral_moment
from meshtrace.surfaces.waves import wavenumber

ALL = [
    Jonswap(wind_speed=5.0),
    Jonswap(wind_speed=13.0),
    Tma(wind_speed=8.0, depth=6.0),
    PiersonMoskowitz(wind_speed=10.0),
    Elfouhaily(wind_speed=2.0),
    Elfouhaily(wind_speed=13.0, fetch=30e3),
]


@pytest.mark.parametrize(("wind_speed", "omega_p"), [(5.0, 1.9577), (13.0, 1.4147)])
def test_jonswap_peak_of_the_paper(wind_speed, omega_p):
    assert Jonswap(wind_speed=wind_speed).omega_p == pytest.approx(omega_p, abs=5e-5)
    omega = np.linspace(0.5, 5.0, 90001)
    peak = omega[np.argmax(Jonswap(wind_speed=wind_speed)(omega))]
    assert peak == pytest.approx(omega_p, abs=1e-4)


def test_jonswap_without_enhancement_has_the_closed_variance():
    spectrum = Jonswap(wind_speed=9.0, fetch=20e3, gamma=1.0, alpha=0.0081)
    closed = 0.0081 * waves.GRAVITY**2 / (5.0 * spectrum.omega_p**4)
    assert spectral_moment(spectrum, 0) == pytest.approx(closed, rel=1e-12)


def test_jonswap_options():
    base = Jonswap(wind_speed=5.0)
    at_2 = float(base(2.0))
    assert Jonswap(wind_speed=5.0, alpha_coefficient=0.076)(2.0) == pytest.approx(
        at_2 * 0.076 / 0.075
    )
    X = waves.GRAVITY * 30e3 / 25.0
    given = Jonswap(wind_speed=5.0, alpha=0.075 * X**-0.22)
    assert given(2.0) == pytest.approx(at_2, rel=1e-14)
    sides = [0.9 * base.omega_p, 1.1 * base.omega_p]
    wide, narrow = Jonswap(wind_speed=5.0, sigma_a=0.2)(sides), base(sides)
    assert wide[0] > narrow[0]
    assert wide[1] == narrow[1]


def test_pierson_moskowitz_height_and_peak():
    wind_speed = 12.0
    u = 1.026 * wind_speed
    assert hs(PiersonMoskowitz(wind_speed=wind_speed)) == pytest.approx(
        2.0 * math.sqrt(0.0081 / 0.74) * u**2 / waves.GRAVITY, rel=1e-12
    )
    assert hs(PiersonMoskowitz(wind_speed=wind_speed)) == pytest.approx(
        0.21 * u**2 / 9.81, rel=5e-3
    )
    assert PiersonMoskowitz(wind_speed=wind_speed).omega_p == pytest.approx(
        0.877 * waves.GRAVITY / u, rel=1e-3
    )


def test_kitaigorodskii_is_the_ratio_of_wavenumber_derivatives():
    omega, depth = np.array([0.2, 0.7, 1.5, 3.0]), 8.0
    h = 1e-5 * omega
    slope = (wavenumber(omega + h, depth) - wavenumber(omega - h, depth)) / (2 * h)
    finite = wavenumber(omega, depth) ** -3 * slope
    deep = wavenumber(omega) ** -3 * 2.0 * omega / waves.GRAVITY
    np.testing.assert_allclose(kitaigorodskii(omega, depth), finite / deep, rtol=1e-8)
    # Long waves: phi = omega^2 depth / (2 g).
    assert kitaigorodskii(1e-3, depth) == pytest.approx(
        1e-6 * depth / (2 * waves.GRAVITY), rel=1e-6
    )


def test_tma_is_jonswap_in_deep_water_and_smaller_in_shallow():
    omega = np.linspace(0.5, 6.0, 50)
    deep = Jonswap(wind_speed=8.0)(omega)
    np.testing.assert_allclose(Tma(wind_speed=8.0, depth=1e4)(omega), deep, rtol=1e-14)
    assert (Tma(wind_speed=8.0, depth=3.0)(omega) < deep).all()


@pytest.mark.parametrize("wind_speed", [5.0, 8.0, 10.0, 13.0])
def test_elfouhaily_slopes_agree_with_cox_and_munk(wind_speed):
    spectrum = Elfouhaily(wind_speed=wind_speed)
    mss = mean_square_slope(spectrum, omega_max=5e4, capillary=True)
    assert 0.9 < mss / sum(cox_munk(wind_speed)) < 1.2
    # and heights with the fully developed sea of Pierson and Moskowitz
    assert 0.9 < hs(spectrum) / hs(PiersonMoskowitz(wind_speed=wind_speed)) < 1.2


@pytest.mark.parametrize("wind_speed", [5.0, 13.0])
def test_elfouhaily_slopes_along_and_across(wind_speed):
    k = np.geomspace(1e-3, 2e4, 100_001)
    omega_p = Elfouhaily(wind_speed=wind_speed).omega_p
    delta = elfouhaily_delta(k, wind_speed, omega_p)
    slope = Elfouhaily(wind_speed=wind_speed).over_wavenumber(k) * k**3
    along, across = (
        np.trapezoid(slope * (0.5 + sign * 0.25 * delta), np.log(k)) for sign in (1, -1)
    )
    target_along, target_across = cox_munk(wind_speed)
    assert 0.9 < along / target_along < 1.25
    assert 0.9 < across / target_across < 1.25


def test_elfouhaily_over_wavenumber_and_frequency_have_one_variance():
    k = np.geomspace(1e-4, 1e4, 400_001)
    spectrum = Elfouhaily(wind_speed=7.0, fetch=50e3)
    by_wavenumber = np.trapezoid(spectrum.over_wavenumber(k) * k, np.log(k))
    by_frequency = spectral_moment(spectrum, 0)
    assert by_frequency == pytest.approx(by_wavenumber, rel=1e-8)


def test_elfouhaily_contrast_of_the_slowest_wave():
    wind_speed, omega_p = 10.0, Elfouhaily(wind_speed=10.0).omega_p
    c_m, u_star = math.sqrt(2 * 9.81 / 370.0), 10.0 * math.sqrt(1e-3 * (0.8 + 0.65))
    c_p = 9.81 / omega_p
    expected = math.tanh(math.log(2) / 4 + 4 * (c_m / c_p) ** 2.5 + 0.13 * u_star / c_m)
    assert elfouhaily_delta(370.0, wind_speed, omega_p) == pytest.approx(expected, rel=1e-6)
    # Between the two regimes lies the most isotropic wave, as in print.
    k = np.geomspace(0.1, 2000.0, 400)
    delta = elfouhaily_delta(k, wind_speed, omega_p)
    assert 1.0 < k[np.argmin(delta)] < 100.0


def test_inverse_wave_age():
    def age(wind_speed, fetch=None):
        return Elfouhaily(wind_speed=wind_speed, fetch=fetch).inverse_wave_age

    assert age(10.0) == 0.84
    assert age(10.0, 1e9) == pytest.approx(0.84, rel=1e-6)
    assert age(10.0, 10e3) > age(10.0, 100e3)
    with pytest.raises(Refused, match=r"fetch: 10\.0, allowed: a fetch with inverse wave age <= 5"):
        age(13.0, 10)


@pytest.mark.parametrize("spectrum", ALL, ids=lambda s: f"{s.kind}-{s.wind_speed:g}")
def test_every_spectrum_is_finite_positive_and_zero_at_rest(spectrum):
    omega = np.concatenate([[0.0, 1e-300, 1e-12], np.geomspace(1e-3, 1e4, 2000)])
    S = spectrum(omega)
    assert S.shape == omega.shape
    assert np.isfinite(S).all()
    assert (S >= 0.0).all()
    assert S[0] == S[1] == S[2] == 0.0
    peak = omega[np.argmax(S)]
    assert 0.8 < peak / spectrum.omega_p < 1.25


@pytest.mark.parametrize("spectrum", ALL, ids=lambda s: f"{s.kind}-{s.wind_speed:g}")
def test_every_spectrum_survives_the_round_trip(spectrum):
    assert type(spectrum).model_validate(spectrum.model_dump()) == spectrum
    assert type(spectrum).model_validate_json(spectrum.model_dump_json()) == spectrum


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Jonswap(wind_speed=-3.0), "wind_speed: -3.0, allowed: 0 < wind_speed <= 60 m/s"),
        (lambda: Jonswap(wind_speed=math.nan), "wind_speed: nan, allowed: 0 < wind_speed <= 60"),
        (lambda: Jonswap(fetch=-1.0), "fetch: -1.0, allowed: 0 < fetch < inf m"),
        (lambda: Jonswap(gamma=0.5), "gamma: 0.5, allowed: 1 <= gamma <= 20"),
        (lambda: Jonswap(sigma_b=0.0), "sigma_b"),
        (lambda: Jonswap()([1.0, -1.0]), "omega: -1.0, allowed: 0 <= omega"),
        (lambda: Tma(depth=math.inf), "depth: inf, allowed: 0 < depth < inf m"),
        (lambda: Jonswap(wind=3.0), "wind"),
    ],
)
def test_refuses(call, message):
    with pytest.raises(ValueError, match=message):
        call()
