"""Closed forms of the fading over a Gaussian sea, against published numbers and a twin."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from mc_statistics import ALPHA, z_test
from scipy.special import jv

import meshtrace as mt
from meshtrace import fading
from meshtrace.errors import Refused
from meshtrace.fading import spectral
from meshtrace.surfaces import Elfouhaily, FlatSea, JonswapSea, SpectralSea, resolved_sea

SEA = SpectralSea(
    spectrum=Elfouhaily(wind_speed=5.0, fetch=30e3), spreading="elfouhaily", mss="elfouhaily"
)


REFERENCE = json.loads(
    (Path(__file__).parents[1] / "data" / "real_seas_reference.json").read_text()
)
"""Numbers of an independent program: paraxial integrals and explicit meshes."""


def rows(name):
    """Return the rows (omega_max, tilts, row) of a table; all but three are slow."""
    found = [
        (row["omega_max"], tilts, row)
        for row in REFERENCE[name]["rows"]
        for tilts in ((True, False) if row["omega_max"] else (True,))
    ]
    quick = [(8, True), (16, False), (None, True)] if "fetch" in name else [(24, True)]
    return [pytest.param(*row, marks=() if row[:2] in quick else pytest.mark.slow) for row in found]


def closed_form(sea, omega_max, tilts, row):
    found = fading.scintillation_of_spectrum(mt.Link(), sea, omega_max, tilts)
    assert found == pytest.approx(row["si_tilt" if tilts else "si"], rel=0.01)


@pytest.mark.parametrize(
    ("omega_max", "tilts", "row"), rows("si_elfouhaily_U5_fetch30km_spreading_elfouhaily")
)
def test_scintillation_over_the_band(omega_max, tilts, row):
    closed_form(SEA, omega_max, tilts, row)


@pytest.mark.parametrize(("omega_max", "tilts", "row"), rows("si_elfouhaily_U5_developed"))
def test_scintillation_of_the_developed_sea(omega_max, tilts, row):
    closed_form(
        SpectralSea(
            spectrum=Elfouhaily(wind_speed=5.0), spreading="elfouhaily", mss="elfouhaily"
        ),
        omega_max, tilts, row,
    )  # fmt: skip


def test_lever_and_slopes_of_the_bands():
    """The geometry, and k_max, slope variance and curvature up to each frequency."""
    lever, expected = spectral.paraxial_lever(mt.Link()), REFERENCE["geometry"]
    assert lever.beta == pytest.approx(expected["beta_m"], rel=1e-5)
    assert lever.aperture == pytest.approx(expected["aperture_in_surface_m"], rel=1e-4)
    assert 0.05 / lever.aperture == pytest.approx(expected["magnification"], rel=1e-6)
    tables = ("si_elfouhaily_U5_fetch30km_spreading_elfouhaily", "si_elfouhaily_U5_developed")
    for fetch, name in zip((30e3, None), tables, strict=True):
        sea = SpectralSea(spectrum=Elfouhaily(wind_speed=5.0, fetch=fetch))
        slopes = sea.slope_spectrum()
        for row in REFERENCE[name]["rows"]:
            inside = slopes.k <= row["k_max"]
            if row["omega_max"]:
                edge = slopes.k[slopes.omega <= row["omega_max"]].max()
                assert edge == pytest.approx(row["k_max"], rel=0.01)
            assert slopes.variance[inside].sum() == pytest.approx(row["mss"], rel=0.01)
            curved = (slopes.variance * slopes.k**2)[inside].sum()
            assert lever.beta * math.sqrt(curved) == pytest.approx(row["beta_curv"], rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("wind", ["2", "3", "5", "13"])
def test_scintillation_of_all_waves_over_wind(wind):
    sea = SpectralSea(
        spectrum=Elfouhaily(wind_speed=float(wind), fetch=30e3), spreading="elfouhaily"
    )
    expected = REFERENCE["si_by_wind_fetch30km_full_spectrum"][wind]
    assert fading.scintillation_of_spectrum(mt.Link(), sea) == pytest.approx(expected, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("omega_max", ["4", "8", "16"])
def test_scintillation_of_jonswap(omega_max):
    index = fading.scintillation_of_spectrum(
        mt.Link(), JonswapSea(wind_speed=5.0), float(omega_max), tilts=False
    )
    expected = REFERENCE["si_jonswap_U5_fetch30km_ittc_nothing_beyond"][omega_max]
    assert index == pytest.approx(expected, rel=0.015)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("field", "name"),
    [
        ("receiver.radius", "si_by_radius_U5_full"),
        ("receiver.height", "si_by_height_U5_full"),
        ("transmitter.depth", "si_by_depth_U5_full"),
    ],
)
def test_scintillation_over_the_geometry(field, name):
    for value, expected in REFERENCE[name].items():
        if value != "rtol":
            link = mt.Link().replace(field, float(value))
            found = fading.scintillation_of_spectrum(link, SEA)
            assert found == pytest.approx(expected, rel=0.01)


def test_correlation_over_time():
    table = REFERENCE["temporal_U5_omega24_tilts"]
    sea = SEA.model_copy(update={"omega_max": 24.0})
    lags = np.array([float(lag) for lag in table["rho"]] + [0.11, 0.12]).reshape(3, 3)
    covariance = fading.gain_autocovariance(mt.Link(), sea, lags)
    assert covariance.shape == (3, 3)
    rho = covariance.ravel() / covariance[0, 0]
    np.testing.assert_allclose(rho[:7], list(table["rho"].values()), rtol=0.02)
    time = np.interp(-math.exp(-1.0), -rho[7:], [0.11, 0.12])
    assert time == pytest.approx(table["coherence_time_1_over_e_s"], rel=0.02)


def test_heights_of_crests_over_time():
    """Over long waves the covariance is int (beta k^2 + q)^2 S cos(omega tau) d(omega)."""
    link, sea = mt.Link(), JonswapSea(wind_speed=3.0, fetch=3e3, omega_max=3.5, mss="band")
    lags = np.array([0.0, 0.5, 1.2])
    lever, slopes = spectral.paraxial_lever(link), sea.slope_spectrum(3.5)
    for heights, q in ((False, 0.0), (True, lever.q)):
        share = (lever.beta * slopes.k + q / slopes.k) ** 2 * slopes.variance
        wanted = (share * np.cos(slopes.omega * lags[:, None])).sum(axis=1)
        found = fading.gain_autocovariance(link, sea, lags, heights=heights)
        np.testing.assert_allclose(found, wanted, rtol=0.0, atol=0.005 * wanted[0])


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


def test_all_waves_are_those_of_an_infinite_frequency():
    wide = fading.gain_autocovariance(mt.Link(), SEA, [0.0, 0.1], omega_max=math.inf)
    # beyond 1000 rad/s no wave is left: shorter than 1.3 mm
    np.testing.assert_allclose(
        wide, fading.gain_autocovariance(mt.Link(), SEA, [0.0, 0.1], omega_max=1e3), rtol=1e-2
    )
    for wrong in (math.nan, 0.0, -1.0):
        with pytest.raises(Refused, match=r"^omega_max: "):
            fading.gain_autocovariance(mt.Link(), SEA, [0.0], omega_max=wrong)


def test_bad_arguments_are_refused():
    with pytest.raises(Refused, match="omega_max"):
        fading.scintillation_of_spectrum(mt.Link(), SEA, -1.0)
    with pytest.raises(Refused, match=r"^surface"):
        fading.scintillation_of_spectrum(mt.Link(), FlatSea())
    with pytest.raises(Refused, match="lags"):
        fading.gain_autocovariance(mt.Link(), SEA, [0.0, math.nan])


def test_covariance_of_slopes_over_distances():
    """Windows of one row of Bessel functions, against scipy at every product."""
    slopes = SEA.slope_spectrum(8.0)
    distance = slopes.distances(1e-3, 30.0, 12)
    assert distance[0] == 1e-3
    assert 30.0 <= distance[-1] <= 60.0
    np.testing.assert_allclose(np.diff(np.log(distance), n=2), 0.0, atol=1e-12)
    azimuth, lags = np.array([0.0, 0.4, 1.3]), np.array([0.0, 0.2, 1.5])
    found = slopes.covariance(distance, azimuth, lags)
    z, turn = np.outer(distance, slopes.k), np.outer(lags, slopes.omega)
    expected = np.zeros((2, *found.shape[1:]))
    for n in range(13):
        phase = (np.sin(turn) if n % 2 else np.cos(turn)) * (-1.0) ** (n // 2)
        lower, upper = slopes.harmonics[abs(n - 2)], slopes.harmonics[n + 2]
        for i, share in enumerate((slopes.harmonics[n], 0.5 * (lower + upper))):
            weight = (2.0 if n else 1.0) * slopes.variance * share * phase
            expected[i] += (weight @ jv(n, z).T)[:, :, None] * np.cos(n * azimuth)
    scale = slopes.variance.sum()
    np.testing.assert_allclose(found[0] + found[1], expected[0], atol=1e-6 * scale)
    np.testing.assert_allclose(found[0] - found[1], expected[1], atol=1e-6 * scale)


def test_all_waves_that_make_light_fade_by_default():
    """The waves of a study of fading, where a sea leaves them open; its own, where it does not."""
    lags = [0.0, 0.07]
    open_sea = resolved_sea(5.0, fetch=30e3)
    resolved = fading.resolve_band(mt.Link(), open_sea)
    wanted = fading.gain_autocovariance(mt.Link(), open_sea, lags, resolved.omega_max)
    assert wanted[0] == pytest.approx(
        fading.scintillation_of_spectrum(mt.Link(), open_sea), rel=0.03
    )
    for sea in (open_sea, resolved, JonswapSea(wind_speed=5.0)):
        np.testing.assert_array_equal(fading.gain_autocovariance(mt.Link(), sea, lags), wanted)
    narrow = open_sea.model_copy(update={"omega_max": 8.0})
    found = fading.gain_autocovariance(mt.Link(), narrow, lags)
    np.testing.assert_array_equal(
        found, fading.gain_autocovariance(mt.Link(), open_sea, lags, omega_max=8.0)
    )
