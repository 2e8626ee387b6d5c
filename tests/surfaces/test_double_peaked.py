"""Spectra with two peaks, by quadrature and by the published limits."""

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad

from meshtrace.surfaces import (
    Jonswap,
    JonswapSea,
    OchiHubble,
    Spectrum,
    TabulatedSpectrum,
    Torsethaugen,
    spectra,
)
from meshtrace.surfaces.statistics import hs


def variance(spectrum):
    """Integrate a spectrum between its decades, apart from the functions of the package."""
    edges = spectrum.omega_p * np.array([0.05, 0.3, 0.6, 0.9, 1, 1.1, 1.5, 2, 3, 5, 10, 100, 2000])
    return sum(
        quad(lambda omega: float(spectrum(omega)), a, b, epsrel=1e-11, limit=200)[0]
        for a, b in pairwise(edges)
    )


@pytest.mark.parametrize(
    ("hs", "tp", "lam"),
    [((2.0, 1.0), (12.0, 5.0), (3.0, 1.5)), ((0.5, 0.5), (9.0, 4.0), (6.0, 1.0))],
)
def test_ochi_hubble_has_its_variance(hs, tp, lam):
    spectrum = OchiHubble(hs=hs, tp=tp, lam=lam)
    assert variance(spectrum) == pytest.approx((hs[0] ** 2 + hs[1] ** 2) / 16.0, rel=1e-8)


def test_ochi_hubble_with_lambda_1_is_a_bretschneider_spectrum():
    both = OchiHubble(hs=(1.0, 1.0), tp=(7.0, 7.0), lam=(1.0, 1.0))
    omega, omega_p = np.array([0.5, 0.9, 2.0]), 2.0 * math.pi / 7.0
    bretschneider = (
        5.0 / 16.0 * 2.0 * omega_p**4 / omega**5 * np.exp(-1.25 * (omega_p / omega) ** 4)
    )
    np.testing.assert_allclose(both(omega), bretschneider, rtol=1e-12)
    assert both.omega_p == pytest.approx(omega_p)


@pytest.mark.parametrize(("hs", "tp"), [(4.0, 9.0), (2.0, 14.0), (0.3, 2.0), (1.0, 30.0)])
def test_torsethaugen_has_its_height_and_peak(hs, tp):
    spectrum = Torsethaugen(hs=hs, tp=tp)
    (first_hs, *_), (second_hs, *_) = spectrum.peaks
    assert 4.0 * math.sqrt(variance(spectrum)) == pytest.approx(hs, rel=1e-8)
    assert math.hypot(first_hs, second_hs) == pytest.approx(hs, rel=1e-12)
    omega = np.linspace(0.9, 1.1, 2001) * 2.0 * math.pi / tp
    assert omega[spectrum(omega).argmax()] == pytest.approx(2.0 * math.pi / tp, rel=0.02)


def test_torsethaugen_at_the_border_of_wind_sea_and_swell():
    separation = 6.6 * 2.0 ** (1.0 / 3.0)
    omega = np.linspace(0.3, 3.0, 50)
    below, above = (Torsethaugen(hs=2.0, tp=separation * f)(omega) for f in (1 - 1e-9, 1 + 1e-9))
    np.testing.assert_allclose(below, above, rtol=1e-6)
    # all of the variance is in the first peak there
    (first, _, gamma), (second, *_) = Torsethaugen(hs=2.0, tp=separation).peaks
    assert (first, second) == (pytest.approx(2.0), 0.0)
    assert gamma == pytest.approx(35.0 * (2 * math.pi * 2.0 / (9.81 * separation**2)) ** 0.857)
    # far beyond, six tenths of the height is swell
    (swell, *_), (wind_sea, tp, _) = Torsethaugen(hs=2.0, tp=spectra.LONGEST_SWELL).peaks
    assert swell == pytest.approx(2.0 * (0.6 + 0.4 * math.exp(-1 / 0.09)))
    assert tp == pytest.approx(6.6 * wind_sea ** (1.0 / 3.0))


def test_jonswap_by_height_and_period():
    spectrum = Jonswap(hs=1.7, tp=6.0, gamma=5.0)
    assert 4.0 * math.sqrt(variance(spectrum)) == pytest.approx(1.7, rel=1e-8)
    assert spectrum.omega_p == pytest.approx(2.0 * math.pi / 6.0)
    sea = JonswapSea(hs=1.7, tp=6.0, gamma=5.0)
    assert sea.spectrum == spectrum
    assert Spectrum.read(spectrum.model_dump()) == spectrum
    with pytest.raises(ValueError, match=r"alpha: 0.01, allowed: either alpha or hs"):
        Jonswap(hs=1.0, alpha=0.01)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: OchiHubble(hs=(1.0, -1.0), tp=(9.0, 5.0)), r"hs\[1\]: -1"),
        (lambda: Torsethaugen(hs=60.0, tp=9.0), "hs: 60.0, allowed: 0 < hs < 50 m"),
        (lambda: Torsethaugen(hs=1.0, tp=0.0), "tp: 0"),
        (lambda: Jonswap(hs=math.nan), "hs: nan"),
    ],
)
def test_refuses(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize(
    ("spectrum", "height"),
    [
        (OchiHubble(hs=(0.05, 3.0), tp=(900.0, 2.0), lam=(3.0, 3.0)), 3.0),
        (Torsethaugen(hs=40.0, tp=0.1), 40.0),
    ],
)
def test_a_peak_far_below_the_highest_one_is_kept(spectrum, height):
    """S(0) = 0, and the variance is hs^2 / 16, if the swell lies below 0.01 omega_p."""
    assert spectrum(0.0) == 0.0
    omega = np.geomspace(1e-4, 1e5, 200_001)
    variance = np.trapezoid(spectrum(omega) * omega, np.log(omega))
    assert 4.0 * math.sqrt(variance) == pytest.approx(height, rel=1e-3)


@pytest.mark.parametrize(
    ("spectrum", "height"),
    [
        (OchiHubble(hs=(0.5, 3.0), tp=(50.0, 2.0), lam=(3.0, 3.0)), math.hypot(0.5, 3.0)),
        (
            TabulatedSpectrum(
                omega=[0.03, 0.04, 0.05, 1.9, 2.0, 2.1], density=[0.0, 5.0, 0.0, 0.0, 5.1, 0.0]
            ),
            4.0 * math.sqrt(0.05 + 0.51),
        ),
    ],
)
def test_integrals_reach_a_peak_far_below_the_highest_one(spectrum, height):
    assert spectrum.lowest_peak < 0.05 * spectrum.omega_p
    assert hs(spectrum) == pytest.approx(height, rel=1e-3)
