"""Plane-parallel slabs against published tables, through mesh, Embree and the same kernels.

The slab is the water between a flat mesh and a black floor; light comes from the sun in the
zenith, that is at normal incidence.
"""

import math

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak, z_test

import meshtrace as mt
from meshtrace.surfaces import FlatSea

# 0.002 of the light of a slab of 2 m wanders off by 100 m and more
pytestmark = pytest.mark.filterwarnings("ignore:.*left the meshed surface:meshtrace.DomainWarning")

MESH = FlatSea().mesh(extent=3000.0, spacing=1000.0)
VAN_DE_HULST = {"R": 0.09739, "T": 0.66096}
TABLE_ERROR = 5e-6  # the digits printed


def slab_link(thickness, albedo, phase, n_water, n_air, absorption="continuous"):
    """Return a slab of c = 1 m-1; the plane that scores T lies a hair above the floor."""
    water = mt.Water(
        a=1.0 - albedo, b=albedo, n=n_water, phase=phase, bottom_depth=thickness, bottom_albedo=0.0
    )
    return mt.Link(
        water=water,
        n_air=n_air,
        transmitter=mt.Sun(zenith_deg=0.0, half_width=1.0),
        receiver=mt.Receiver(height=1.0, radius=1e7, fov_deg=180.0),
        planes=mt.IrradiancePlanes(depths=(thickness * (1.0 - 1e-9),)),
        physics=mt.Physics(absorption=absorption),
    )


def reflectance_and_transmittance(link, photons, seed):
    """Return R and T with their standard errors; R and T of the ledger must be the same."""
    r = mt.simulate(
        link, MESH, estimator="analog", photons=photons, seed=seed, max_surface_events=10_000
    )
    transmitted, error = r.data["e_d"][1][0], r.data["e_d_stderr"][1][0]
    assert r.fates["received"].weight == pytest.approx(r.gain, rel=1e-9)
    assert r.fates["bottom"].weight == pytest.approx(transmitted, rel=1e-7)
    assert r.fates["event_limit"].weight == 0.0
    assert r.fates["left_domain"].weight < 1e-5
    return (r.gain, r.gain_stderr), (transmitted, error)


@pytest.mark.parametrize(
    ("absorption", "photons", "precision"),
    [("continuous", 7_000_000, 1e-3), ("implicit", 1_000_000, 3e-3), ("analog", 1_500_000, 4e-3)],
)
def test_van_de_hulst_slab(absorption, photons, precision):
    """Tau 2, albedo 0.9, Henyey-Greenstein 0.75, index-matched: van de Hulst 1980, table 35."""
    phase = mt.HenyeyGreenstein(g=0.75)
    link = slab_link(2.0, 0.9, phase, n_water=1.33, n_air=1.33, absorption=absorption)
    got = reflectance_and_transmittance(link, photons, seed=31)
    for (value, stderr), expected in zip(got, VAN_DE_HULST.values(), strict=True):
        assert stderr / expected < precision
        assert abs(value - expected) < 3.0 * math.hypot(stderr, TABLE_ERROR)


def test_index_matched_slab_does_not_know_the_index():
    """Index 1.33 on both sides and 1.5 on both sides are one slab."""
    phase = mt.HenyeyGreenstein(g=0.75)
    (a, _), (b, _) = (
        reflectance_and_transmittance(slab_link(2.0, 0.9, phase, n, n), 100_000, seed=32)
        for n in (1.33, 1.5)
    )
    assert a == b


def test_nothing_scattered_is_beer_lambert():
    link = slab_link(2.0, 0.0, mt.HenyeyGreenstein(g=0.0), 1.33, 1.33)
    (reflected, _), (transmitted, stderr) = reflectance_and_transmittance(link, 4096, seed=33)
    assert reflected == 0.0
    # a ray starts 10 um off the facet that it leaves, and does not fly these
    assert transmitted == pytest.approx(math.exp(-2.0), rel=1.1e-5)
    assert stderr < 1e-10


def test_nothing_absorbed_is_all_reflected_or_transmitted():
    """Conservative slab of isotropic scatterers: R + T = 1, and the asymptotic T of a thick one.

    T = (H(1) / sqrt 3) / (tau + 2 q) with Chandrasekhar's H(1) = 2.9078 and q = 0.7104.
    """
    link = slab_link(10.0, 1.0, mt.HenyeyGreenstein(g=0.0), 1.33, 1.33)
    r = mt.simulate(link, MESH, estimator="analog", photons=150_000, seed=34, roulette=0.0)
    reflected, transmitted = r.gain, r.data["e_d"][1][0]
    assert reflected + transmitted == pytest.approx(1.0, abs=2e-4)
    expected = 2.9078 / math.sqrt(3.0) / (10.0 + 2.0 * 0.7104)
    assert z_test(transmitted, r.data["e_d_stderr"][1][0], expected, 1e-3 * expected) > ALPHA


@pytest.mark.parametrize("absorption", ["continuous", "implicit"])
def test_giovanelli(absorption):
    """Semi-infinite, albedo 0.9, isotropic, n = 1.5, light at normal incidence: R = 0.2600.

    Total hemispherical reflectance, the specular 0.04 included, for a beam in the zenith: the case
    of Giovanelli 1955 (Opt. Acta 2, 153) that Prahl et al. 1989 and Wang et al. 1995 (MCML) repeat.
    A floor at tau = 60 takes the place of infinity: nothing comes back from there.
    """
    phase = mt.HenyeyGreenstein(g=0.0)
    link = slab_link(60.0, 0.9, phase, n_water=1.5, n_air=1.0, absorption=absorption)
    (reflected, stderr), (transmitted, _) = reflectance_and_transmittance(link, 700_000, seed=35)
    assert transmitted < 1e-6
    assert stderr / reflected < 2e-3
    # four digits are printed
    assert z_test(reflected, stderr, 0.2600, 3e-5) > sidak(ALPHA, 2)


def test_light_wanders_without_bias_sideways():
    """Mean x and y of what leaves a slab under the zenith sun are those of the sun's square."""
    phase = mt.HenyeyGreenstein(g=0.75)
    link = slab_link(2.0, 0.9, phase, n_water=1.33, n_air=1.33)
    grid = mt.MapGrid(height=1.0, extent=8.0, step=0.5)
    r = mt.simulate(link, MESH, estimator="analog", photons=300_000, seed=36, grid=grid)
    light = r.data["map_irradiance"][1]
    x = r.data["map_x"][1]
    total = light.sum()
    spread = math.sqrt((light.sum(axis=1) * x**2).sum() / total)
    noise = 4.5 * spread / math.sqrt(0.05 * r.photons)
    assert abs((light.sum(axis=1) * x).sum() / total) < noise
    assert abs((light.sum(axis=0) * x).sum() / total) < noise
    asymmetry = np.abs(light - light.T).sum() / total
    assert asymmetry < 0.2
