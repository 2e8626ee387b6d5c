"""Plane-parallel slabs against published tables, through mesh, Embree and the same kernels.

`meshtrace validate` has those with a closed form: Beer-Lambert, and the thick white slab.
"""

import math

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak, z_test

import meshtrace as mt
from meshtrace.validation import closed_forms

# 0.002 of the light of a slab of 2 m wanders off by 100 m and more
pytestmark = pytest.mark.filterwarnings("ignore:.*left the meshed surface:meshtrace.DomainWarning")

TABLE_ERROR = 5e-6  # the digits printed


def light_of(thickness, albedo, g, n_water, n_air, photons, seed, absorption="continuous"):
    """Return reflectance and transmittance of a slab, each with its error, as in the ledger."""
    link = closed_forms.slab_link(thickness, albedo, g, n_water, n_air, absorption)
    options = {"photons": photons, "seed": seed, "max_surface_events": 10_000}
    r = mt.simulate(link, closed_forms.wide_mesh(), estimator="analog", **options)
    transmitted, error = float(r.planes.e_d[0]), float(r.planes.e_d_stderr[0])
    assert r.fates["received"].weight == pytest.approx(r.gain, rel=1e-9)
    assert r.fates["bottom"].weight == pytest.approx(transmitted, rel=1e-7)
    assert r.fates["event_limit"].weight == 0.0
    assert r.fates["left_domain"].weight < 1e-5
    return (r.gain, r.gain_stderr), (transmitted, error)


@pytest.mark.external
@pytest.mark.parametrize(
    ("absorption", "photons", "precision"),
    [("continuous", 7_000_000, 1e-3), ("implicit", 1_000_000, 3e-3), ("analog", 1_500_000, 4e-3)],
)
def test_van_de_hulst_slab(absorption, photons, precision):
    """Tau 2, albedo 0.9, Henyey-Greenstein 0.75, index-matched: van de Hulst 1980, table 35."""
    light = light_of(2.0, 0.9, 0.75, 1.33, 1.33, photons, 31, absorption)
    for (value, stderr), expected in zip(light, (0.09739, 0.66096), strict=True):
        assert stderr / expected < precision
        assert z_test(value, stderr, expected, TABLE_ERROR) > sidak(ALPHA, 6)


def test_index_matched_slab_does_not_know_the_index():
    """Index 1.33 on both sides and 1.5 on both sides are one slab."""
    a, b = (light_of(2.0, 0.9, 0.75, n, n, 100_000, 32) for n in (1.33, 1.5))
    assert a[0] == b[0]


def test_nothing_scattered_is_beer_lambert():
    (reflected, _), (transmitted, error) = light_of(2.0, 0.0, 0.0, 1.33, 1.33, 4096, 33)
    assert reflected == 0.0
    # a ray starts 10 um off the facet that it leaves, and does not fly these
    assert transmitted == pytest.approx(math.exp(-2.0), rel=1.1e-5)
    assert error < 1e-10


def test_nothing_absorbed_is_all_reflected_or_transmitted():
    """Conservative slab of isotropic scatterers: R + T = 1."""
    link = closed_forms.slab_link(10.0, 1.0, 0.0, 1.33, 1.33)
    r = mt.simulate(
        link, closed_forms.wide_mesh(), estimator="analog", photons=30_000, seed=34, roulette=0.0
    )
    assert r.gain + r.planes.e_d[0] == pytest.approx(1.0, abs=2e-4)


@pytest.mark.external
@pytest.mark.parametrize("absorption", ["continuous", "implicit"])
def test_giovanelli(absorption):
    """Semi-infinite, albedo 0.9, isotropic, n = 1.5, light at normal incidence: R = 0.2600.

    Total hemispherical reflectance, the specular 0.04 included, for a beam in the zenith: the case
    of Giovanelli 1955 (Opt. Acta 2, 153) that Prahl et al. 1989 and Wang et al. 1995 (MCML) repeat.
    A floor at tau = 60 takes the place of infinity: nothing comes back from there.
    """
    (reflected, stderr), (transmitted, _) = light_of(
        60.0, 0.9, 0.0, 1.5, 1.0, 700_000, 35, absorption
    )
    assert transmitted < 1e-6
    assert stderr / reflected < 2e-3
    # four digits are printed
    assert z_test(reflected, stderr, 0.2600, 3e-5) > sidak(ALPHA, 2)


def test_light_wanders_without_bias_sideways():
    """Mean x and y of what leaves a slab under the zenith sun are those of the sun's square."""
    link = closed_forms.slab_link(2.0, 0.9, 0.75, 1.33, 1.33)
    grid = mt.IrradianceMap(height=1.0, extent=8.0, step=0.5)
    r = mt.simulate(
        link, closed_forms.wide_mesh(), estimator="analog", photons=300_000, seed=36, record=[grid]
    )
    light = r.map.irradiance
    x = r.map.x
    total = light.sum()
    spread = math.sqrt((light.sum(axis=1) * x**2).sum() / total)
    noise = 4.5 * spread / math.sqrt(0.05 * r.photons)
    assert abs((light.sum(axis=1) * x).sum() / total) < noise
    assert abs((light.sum(axis=0) * x).sum() / total) < noise
    asymmetry = np.abs(light - light.T).sum() / total
    assert asymmetry < 0.2
