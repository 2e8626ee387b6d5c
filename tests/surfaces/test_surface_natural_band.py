"""The natural band: variance of the spectrum, no period, no lattice; and the bands before it."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad

from meshtrace.surfaces import (
    Elfouhaily,
    JonswapSea,
    SpectralSea,
    Tma,
    bands,
    sea_from_config,
)
from meshtrace.surfaces.statistics import components_slope_variance, mean_square_slope

LIMITS = {"omega_min": 1.0, "omega_max": 3.0, "d_theta": 0.2}
SEAS = [
    JonswapSea(wind_speed=5.0),
    JonswapSea(wind_speed=13.0, omega_max=6.0, fetch=5e3),
    JonswapSea(wind_speed=8.0, waves=JonswapSea(wind_speed=8.0).band.replace(d_omega=0.25)),
    SpectralSea(spectrum=Elfouhaily(wind_speed=8.0), spreading="elfouhaily", omega_max=24.0),
    SpectralSea(spectrum=Tma(wind_speed=8.0, depth=6.0), spreading="mitsuyasu"),
]


@pytest.mark.parametrize("sea", SEAS, ids=lambda sea: f"{sea.kind}-{SEAS.index(sea)}")
def test_variance_is_that_of_the_spectrum(sea):
    waves, band, peak = sea.components, sea.band, sea.spectrum.omega_p
    edges = [band.omega_min, *(p for p in (peak,) if p < band.omega_max), band.omega_max]
    whole = sum(
        quad(lambda w: float(sea.spectrum(w)), a, b, limit=200)[0] for a, b in pairwise(edges)
    )
    assert 0.5 * np.sum(waves.amplitude**2) == pytest.approx(whole, rel=1e-5)
    assert waves.omega.min() >= band.omega_min
    assert waves.omega.max() <= band.omega_max
    # octave by octave, to the width of the bins in which frequencies are drawn
    for low in (1.0, 2.0):
        low *= peak / 1.2
        inside = (waves.omega >= low) & (waves.omega < 1.5 * low)
        part = quad(lambda w: float(sea.spectrum(w)), low, min(1.5 * low, band.omega_max))[0]
        assert 0.5 * np.sum(waves.amplitude[inside] ** 2) == pytest.approx(part, rel=0.06)


def test_each_bin_holds_its_variance_for_any_seed():
    spectrum = JonswapSea(wind_speed=5.0).spectrum
    for seed in (0, 5):
        sea = JonswapSea(wind_speed=5.0, seed=seed)
        band = sea.band
        edges = band.omega_min * 2.0 ** (np.arange(30) / 16.0)
        edges[-1] = band.omega_max
        waves = sea.components
        for a, b in pairwise(edges):
            inside = (waves.omega >= a) & (waves.omega < b)
            assert inside.sum() == 37
            part = quad(lambda w: float(spectrum(w)), a, b)[0]
            assert 0.5 * np.sum(waves.amplitude[inside] ** 2) == pytest.approx(part, rel=1e-4)


def test_slopes_are_those_of_the_spectrum():
    sea = SpectralSea(
        spectrum=Elfouhaily(wind_speed=5.0, fetch=30e3), spreading="elfouhaily", omega_max=24.0
    )
    along, across = components_slope_variance(sea.components)
    band = sea.band
    whole = mean_square_slope(sea.spectrum, band.omega_max, band.omega_min, capillary=True)
    assert along + across == pytest.approx(whole, rel=0.005)
    expected = sea.slope_spectrum(24.0).along_and_across
    assert (along, across) == pytest.approx(expected, rel=0.02)


def test_no_two_waves_share_frequency_or_direction_and_some_go_down_wind():
    waves = JonswapSea(wind_speed=5.0).components
    heading = np.arctan2(waves.ky, waves.kx)
    assert len(np.unique(waves.omega)) == len(np.unique(heading)) == len(waves.omega)
    down_wind = np.abs(heading) < math.radians(2.5)
    assert down_wind.sum() >= 29  # one in each bin
    power = waves.amplitude**2
    assert power[down_wind].sum() == pytest.approx(5.0 / 180.0 * 2.0 * power.sum(), rel=0.01)


def largest_return(sea):
    """Largest autocorrelation of the elevation at a point, over lags of 10 s to 10 minutes."""
    waves = sea.components
    power = waves.amplitude**2 / np.sum(waves.amplitude**2)
    lags = np.arange(10.0, 600.0, 0.1)
    found = np.zeros(len(lags))
    for part in np.array_split(np.arange(len(power)), 8):
        found += power[part] @ np.cos(np.outer(waves.omega[part], lags))
    return np.abs(found).max()


def test_no_repeat_in_ten_minutes():
    # independent frequencies leave 1 / sqrt(2 n), n = 1 / sum of squared shares, some 300
    assert largest_return(JonswapSea(wind_speed=5.0, waves="paper")) == pytest.approx(1.0, abs=1e-3)
    for wind_speed in (5.0, 13.0):
        assert largest_return(JonswapSea(wind_speed=wind_speed)) < 0.25


def test_no_return_over_two_hundred_metres():
    """Correlation of the elevation over distance, over the footprint of a picture."""
    axis = np.arange(0.0, 200.1, 2.0)
    x, y = np.meshgrid(axis, np.concatenate([-axis[:0:-1], axis]))
    far = np.hypot(x, y) > 60.0

    def correlation(sea):
        waves = sea.components
        power = waves.amplitude**2 / np.sum(waves.amplitude**2)
        phase = np.exp(1j * np.outer(x[0], waves.kx))
        return np.real((phase * power) @ np.exp(1j * np.outer(waves.ky, y[:, 0]))).T

    paper = np.abs(correlation(JonswapSea(wind_speed=5.0, waves="paper")))[far].max()
    natural = np.abs(correlation(JonswapSea(wind_speed=5.0)))[far].max()
    assert natural < 0.2 < 0.5 < paper


def spokes(sea):
    """Share of the power spectrum over direction in the strongest sixth of its sectors."""
    axis = np.arange(-100.0, 100.0, 0.5)
    z = sea.grid(axis, axis)[0] * np.outer(np.hanning(len(axis)), np.hanning(len(axis)))
    power = np.abs(np.fft.fft2(z)) ** 2
    k = 2.0 * math.pi * np.fft.fftfreq(len(axis), 0.5)
    kx, ky = np.meshgrid(k, k, indexing="ij")
    inside = (np.hypot(kx, ky) > 0.6) & (np.hypot(kx, ky) < 1.5)
    angle = np.arctan(ky[inside] / np.where(kx[inside] == 0.0, 1e-9, kx[inside]))
    sector = np.floor((angle / math.pi + 0.5) * 36.0).astype(int).clip(0, 35)
    share = np.bincount(sector, power[inside], 36)
    middle = np.cos((np.arange(36) + 0.5) * math.pi / 36 - math.pi / 2) ** 2
    return share / share.sum() - middle / middle.sum()


def test_no_spokes_in_the_spectrum_of_a_patch():
    lattice = np.abs(spokes(JonswapSea(wind_speed=5.0, seed=3, waves="paper"))).sum()
    natural = np.abs(spokes(JonswapSea(wind_speed=5.0, seed=3))).sum()
    assert natural < 0.35 < 1.0 < lattice


def test_wider_bands_add_waves():
    narrow, wide = (JonswapSea(omega_max=w, seed=2).components for w in (4.0, 8.0))
    n = 37 * 28  # whole bins of the narrower band
    for name in ("amplitude", "omega", "kx", "phase"):
        np.testing.assert_allclose(getattr(narrow, name)[:n], getattr(wide, name)[:n], rtol=1e-12)


def wave_7(sea):
    return tuple(float(array[7]).hex() for array in sea.components)


@pytest.mark.parametrize(
    ("change", "count", "expected"),
    [
        (
            {"waves": "paper"},
            90,
            ("0x1.23cabf3be79b3p-7", "0x1.6666666666666p+0", "0x1.00f076fc27b16p+0"),
        ),
        (
            {"waves": "paper", "wind_speed": 13.0, "seed": 7},
            462,
            ("0x1.17f259d4cc636p-8", "0x1.ccccccccccccdp-1", "0x1.4a3c4c6ea1bf4p+2"),
        ),
        (
            {"waves": "scaled", "wind_speed": 8.0, "seed": 2},
            441,
            ("0x1.3b021101d49cbp-10", "0x1.004a380de9b38p+0", "0x1.62cff90f0efa7p-2"),
        ),
        (
            {"waves": bands.PAPER_BANDS[5.0].replace(d_theta=0.3), "seed": 0, "omega_max": 6.0},
            275,
            ("0x1.b23a65dfa5392p-10", "0x1.3333333333333p+0", "0x1.255914bd568efp+2"),
        ),
    ],
)
def test_equally_spaced_bands_to_the_same_bits(change, count, expected):
    sea = JonswapSea(**{"seed": 3, **change})
    amplitude, omega, _, _, phase = wave_7(sea)
    assert (len(sea.components.omega), (amplitude, omega, phase)) == (count, expected)
    assert sea_from_config(sea.to_config()) == sea


def test_paper_band_to_the_same_bits():
    z, zx, zy = JonswapSea(seed=3, waves="paper").grid([0.0, 1.0], [0.0, 2.0], 1.5)
    np.testing.assert_allclose(z, [[-0.12019605, -0.05789043], [0.00188489, 0.128854]], atol=5e-9)
    np.testing.assert_allclose(zx[0], [0.13705952, 0.24294456], atol=5e-9)
    np.testing.assert_allclose(zy[1], [0.05568272, 0.03147852], atol=5e-9)


def test_scaled_band_of_another_spectrum_to_the_same_bits():
    given = {"spreading": "elfouhaily", "waves": "scaled", "capillary": True, "seed": 6}
    sea = SpectralSea(spectrum={"kind": "elfouhaily", "wind_speed": 8.0}, **given)
    assert len(sea.components.omega) == 441
    assert wave_7(sea)[0] == "0x1.262255f32ed75p-9"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: JonswapSea(omega_max="fading"), "omega_max: 'fading', allowed: a number"),
        (lambda: JonswapSea(omega_max=-1.0), "omega_max: -1.0, allowed: > 0"),
        (lambda: JonswapSea(waves="fading"), "waves: 'fading', allowed: mean, paper, scaled or"),
        (lambda: JonswapSea(waves=8.0), "waves: 8.0, allowed: mean, paper, scaled or a Band"),
        (lambda: JonswapSea(waves={**LIMITS, "drawn": False}), "waves.d_omega: None"),
        (lambda: JonswapSea(waves={**LIMITS, "omega_max": 0.5}), "waves.omega_max: 0.5, .*> 1 "),
        (lambda: JonswapSea(waves={**LIMITS, "d_theta": 4.0}), "d_theta: 4.0"),
    ],
)
def test_refuses(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize("band", [{}, {"waves": "paper"}, {"waves": "scaled"}])
def test_seeds_share_nothing_but_the_places(band):
    """Waves of another seed of a used sea, against those of a new sea."""
    first = JonswapSea(wind_speed=13.0, seed=1, **band)
    used = first.components
    for seed in (8, 9):
        found = first.with_seed(seed).components
        for a, b in zip(
            found, JonswapSea(wind_speed=13.0, seed=seed, **band).components, strict=True
        ):
            np.testing.assert_array_equal(a, b)
        assert (found.phase != used.phase).all()
        assert (found.omega == used.omega).all()
