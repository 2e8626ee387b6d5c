"""Closed forms of the fading over a Gaussian sea, against published numbers and a twin."""

from __future__ import annotations

import math

import numpy as np
import pytest
from mc_statistics import ALPHA, z_test

import meshtrace as mt
from meshtrace import fading
from meshtrace.errors import Refused
from meshtrace.surfaces import Elfouhaily, FlatSea, JonswapSea, SpectralSea

SEA = SpectralSea(
    spectrum=Elfouhaily(wind_speed=5.0, fetch=30e3), spreading="elfouhaily", mss="elfouhaily"
)


def fast(rows):
    """Mark all rows but the first two as slow."""
    return [
        pytest.param(*row, marks=pytest.mark.slow if i > 1 else ()) for i, row in enumerate(rows)
    ]


@pytest.mark.parametrize(
    ("omega_max", "tilts", "expected"),
    fast(
        [
            (16.0, True, 0.30167),
            (16.0, False, 1.6238),
            (4.0, False, 0.0046),
            (8.0, True, 0.09104),
            (24.0, True, 0.31433),
            (24.0, False, 1.20066),
            (64.0, False, 0.49659),
            (None, True, 0.32004),
        ]
    ),
)
def test_scintillation_over_the_band(omega_max, tilts, expected):
    index = fading.scintillation_of_spectrum(mt.Link(), SEA, omega_max, tilts)
    assert index == pytest.approx(expected, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(("wind", "expected"), [(2, 0.3707), (3, 0.4873), (13, 0.0857)])
def test_scintillation_of_all_waves_over_wind(wind, expected):
    sea = SpectralSea(spectrum=Elfouhaily(wind_speed=wind, fetch=30e3), spreading="elfouhaily")
    assert fading.scintillation_of_spectrum(mt.Link(), sea) == pytest.approx(expected, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(("omega_max", "expected"), [(4, 0.0051), (8, 0.1245), (16, 1.3321)])
def test_scintillation_of_jonswap(omega_max, expected):
    sea = JonswapSea(wind_speed=5.0)
    index = fading.scintillation_of_spectrum(mt.Link(), sea, omega_max, tilts=False)
    assert index == pytest.approx(expected, rel=0.015)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("link", "expected"),
    [
        (mt.Link(receiver=mt.Receiver(radius=0.0125)), 0.3353),
        (mt.Link(receiver=mt.Receiver(radius=0.1)), 0.2868),
        (mt.Link(receiver=mt.Receiver(height=1.0)), 0.1603),
        (mt.Link(receiver=mt.Receiver(height=10.0)), 0.2991),
        (mt.Link(transmitter=mt.Led(depth=40.0)), 0.2907),
    ],
)
def test_scintillation_over_the_geometry(link, expected):
    assert fading.scintillation_of_spectrum(link, SEA) == pytest.approx(expected, rel=0.01)


def test_correlation_over_time():
    sea = SEA.model_copy(update={"omega_max": 24.0, "d_omega": 1.0})
    lags = [[0.0, 0.02], [0.1, 0.5]]
    covariance = fading.gain_autocovariance(mt.Link(), sea, lags)
    assert covariance.shape == (2, 2)
    expected = np.array([[1.0, 0.9733], [0.4776, -0.146]])
    np.testing.assert_allclose(covariance / covariance[0, 0], expected, rtol=0.02)


def disk_correlation(r):
    """Autocorrelation of the unit disk over its area, of integral 1."""
    inside = np.minimum(r, 2.0)
    area = 2.0 * np.arccos(inside / 2.0) - inside * np.sqrt(1.0 - inside**2 / 4.0)
    return np.where(r < 2.0, area / math.pi**2, 0.0)


def slope_structure(sea, omega_max, displacements):
    """Return 2 (C(0) - C(R)) as (n, 2, 2), summed over plane waves in all directions."""
    omega = np.geomspace(0.4, omega_max, 400)
    weight = np.gradient(omega)
    k = omega**2 / 9.81
    theta = (np.arange(144) + 0.5) * 2.0 * math.pi / 144
    power = (weight * sea.spectrum(omega))[:, None] * np.maximum(np.cos(theta), 0.0) ** 2
    power *= 2.0 / math.pi * (2.0 * math.pi / 144)
    kx, ky = np.outer(k, np.cos(theta)).ravel(), np.outer(k, np.sin(theta)).ravel()
    out = np.empty((len(displacements), 2, 2))
    for i, (x, y) in enumerate(displacements):
        loss = 2.0 * power.ravel() * (1.0 - np.cos(kx * x + ky * y))
        out[i] = [
            [(loss * kx * kx).sum(), (loss * kx * ky).sum()],
            [(loss * kx * ky).sum(), (loss * ky * ky).sum()],
        ]
    return out


def test_scintillation_against_pairs_of_crossings():
    """Draw distances of two crossings and the slopes at both, with the exact disk."""
    rng = np.random.default_rng(5)
    sea, omega_max, n, draws = JonswapSea(wind_speed=5.0), 8.0, 600, 400
    beta, aperture = 0.33 * 50.0 / 16.65, 0.05 / 1.665
    low, high = 1e-3, 4.0
    distance = low * (high / low) ** ((np.arange(n) + rng.random(n)) / n)
    azimuth = 2.0 * math.pi * rng.random(n)
    displacement = distance[:, None] * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    near = slope_structure(sea, omega_max, displacement)
    far = slope_structure(sea, omega_max, [(1e4, 3e3)])
    area = 2.0 * math.pi * distance**2 * math.log(high / low)  # 1 / density of the displacement
    normal = rng.standard_normal((n, draws, 2))
    excess = np.zeros(n)
    for sign, structure in ((1.0, near), (-1.0, np.broadcast_to(far, near.shape))):
        root = np.linalg.cholesky(structure + 1e-15 * np.eye(2))
        landing = displacement[:, None] + beta * np.einsum("nij,ndj->ndi", root, normal)
        ratio = np.linalg.norm(landing, axis=2) / aperture
        excess += sign * area * disk_correlation(ratio).mean(axis=1) / aperture**2
    index = fading.scintillation_of_spectrum(mt.Link(), sea, omega_max, tilts=False)
    stderr = math.hypot(excess.std(ddof=1) / math.sqrt(n), 0.005 * index)
    assert z_test(excess.mean(), stderr, index) > ALPHA


@pytest.mark.parametrize(
    ("link", "field"),
    [
        (mt.Link(receiver=mt.Receiver(position=(1.0, 0.0))), "receiver.position"),
        (mt.Link(receiver=mt.Receiver(tilt_deg=5.0)), "receiver.tilt_deg"),
        (mt.Link(receiver=(mt.Receiver(), mt.Receiver(height=6.0))), "receiver"),
        (mt.Link(transmitter=mt.Led(zenith_deg=5.0)), "transmitter.zenith_deg"),
        (mt.Link(receiver=mt.Receiver(fov_deg=5.0)), "receiver.fov_deg"),
        (mt.Link(transmitter=mt.Sun()), "transmitter"),
    ],
)
def test_links_off_the_axis_are_refused(link, field):
    with pytest.raises(Refused) as refused:
        fading.scintillation_of_spectrum(link, SEA)
    assert refused.value.field == field


def test_bad_arguments_are_refused():
    with pytest.raises(Refused, match="omega_max"):
        fading.scintillation_of_spectrum(mt.Link(), SEA, -1.0)
    with pytest.raises(Refused, match="sea"):
        fading.scintillation_of_spectrum(mt.Link(), FlatSea())
    with pytest.raises(Refused, match="lags"):
        fading.gain_autocovariance(mt.Link(), SEA, [0.0, math.nan])
