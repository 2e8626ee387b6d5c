"""Radiance on planes against Chandrasekhar's law of diffuse reflection, and its standard error."""

import math

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak, z_test
from scipy import stats

import meshtrace as mt
from meshtrace.results.tallies import Planes
from meshtrace.validation import closed_forms

pytestmark = pytest.mark.filterwarnings("ignore:.*left the meshed surface:meshtrace.DomainWarning")

ALBEDO, MU_SUN, N = 0.8, 0.5, 200_000


def h_function(mu, albedo):
    """Return Chandrasekhar's H by his integral equation for isotropic scattering.

    1 / H(mu) = sqrt(1 - albedo) + albedo / 2 int_0^1 x H(x) / (mu + x) dx
    """
    x, w = np.polynomial.legendre.leggauss(64)
    x, w = 0.5 * (x + 1.0), 0.5 * w
    h = np.ones_like(x)
    root = math.sqrt(1.0 - albedo)
    for _ in range(2000):
        h = 0.5 * (h + 1.0 / (root + 0.5 * albedo * (w * x * h / (x[:, None] + x)).sum(axis=1)))
    mu = np.asarray(mu, float)[..., None]
    return 1.0 / (root + 0.5 * albedo * (w * x * h / (mu + x)).sum(axis=-1))


def test_h_function_is_that_of_the_tables():
    """Chandrasekhar 1950, table XI: H(1) = 2.9078 without absorption, 1.6425 at albedo 0.8."""
    assert h_function(1.0, 1.0) == pytest.approx(2.9078, abs=2e-3)
    # the zeroth moment is exact: int H = 2 (1 - sqrt(1 - albedo)) / albedo
    x, w = np.polynomial.legendre.leggauss(200)
    mean = (0.5 * w * h_function(0.5 * (x + 1.0), ALBEDO)).sum()
    assert mean == pytest.approx(2.0 * (1.0 - math.sqrt(1.0 - ALBEDO)) / ALBEDO, rel=1e-6)


def deep_water(**planes):
    """Return half-space of isotropic scatterers under a sun at 60 degrees, without a surface."""
    return mt.Link(
        water=mt.Water(
            a=1.0 - ALBEDO,
            b=ALBEDO,
            n=1.33,
            phase=mt.HenyeyGreenstein(g=0.0),
            bottom_depth=30.0,
            bottom_albedo=0.0,
        ),
        n_air=1.33,
        transmitter=mt.Sun(zenith_deg=60.0, half_width=1.0),
        receiver=(),
        planes=mt.IrradiancePlanes(**planes),
    )


@pytest.fixture(scope="module")
def field():
    link = deep_water(depths=(1e-4, 1.0), n_cosines=20, n_azimuths=6)
    return mt.simulate(link, closed_forms.wide_mesh(), estimator="analog", photons=N, seed=5).planes


def expected_upward(edges):
    """Mean over each bin, weighted by mu, of albedo / (4 pi) H(mu) H(mu0) / (mu + mu0)."""
    x, w = np.polynomial.legendre.leggauss(16)
    low, high = edges[1:], edges[:-1]
    mu = low[:, None] + (high - low)[:, None] * 0.5 * (x + 1.0)
    both = h_function(mu, ALBEDO) * h_function(MU_SUN, ALBEDO)
    radiance = ALBEDO / (4.0 * math.pi) * both / (mu + MU_SUN)
    return (w * mu * radiance).sum(axis=1) / (w * mu).sum(axis=1)


def test_light_from_a_half_space_follows_the_law_of_diffuse_reflection(field):
    """In every bin of 20 x 6, within Student's t of 31 degrees of freedom; and all together."""
    expected = expected_upward(field.cosine_edges[:11])
    got, error = field.radiance[0, :10], field.radiance_stderr[0, :10]
    pulls = (got - expected[:, None]) / error
    assert 2.0 * stats.t.sf(np.abs(pulls).max(), 31) > sidak(ALPHA, pulls.size)
    # the mean square of t with 31 degrees of freedom is 31 / 29
    assert 0.65 < (pulls**2).mean() < 1.6
    ring, ring_error = got.mean(axis=1), np.sqrt((error**2).sum(axis=1)) / 6.0
    assert (ring_error < 0.03 * expected).all()
    for i in range(10):
        assert z_test(ring[i], ring_error[i], expected[i]) > sidak(ALPHA, 10)


def test_standard_error_is_that_of_independent_runs():
    """Within the water a photon crosses a bin several times: its scores belong together."""
    link = deep_water(depths=(0.5,), n_cosines=4, n_azimuths=1)
    runs = [
        mt.simulate(
            link,
            closed_forms.wide_mesh(),
            estimator="analog",
            photons=2048,
            first_photon=2048 * k,
            seed=6,
        ).planes
        for k in range(60)
    ]
    values = np.array([r.radiance[0, :, 0] for r in runs])
    claimed = np.mean([r.radiance_stderr[0, :, 0] ** 2 for r in runs], axis=0)
    ratio = values.var(axis=0, ddof=1) / claimed
    # chi-square of 59 over the mean of 60 estimates of 31 degrees of freedom each: an F
    low, high = stats.f.ppf([0.5 * ALPHA, 1.0 - 0.5 * ALPHA], 59, 60 * 31)
    assert (low < ratio).all()
    assert (ratio < high).all()


def test_radiance_adds_up_to_the_irradiances(field):
    """Int L |mu| dmu dphi over a hemisphere is its irradiance, int L its scalar irradiance."""
    step = np.diff(field.azimuth_edges)
    projected = np.abs(np.diff(0.5 * field.cosine_edges**2))
    flux = (field.radiance * projected[:, None] * step).sum(axis=2)
    np.testing.assert_allclose(flux[:, :10].sum(axis=1), field.e_u, rtol=1e-9)
    np.testing.assert_allclose(flux[:, 10:].sum(axis=1), field.e_d, rtol=1e-9)


def test_a_bin_of_both_directions_has_the_projected_solid_angle_of_both():
    flux = np.ones((1, 3, 2))
    found = Planes.radiance_of(flux, 0.1 * flux)
    middle = math.pi * (1.0 / 3.0) ** 2  # 2 int_0^(1/3) mu dmu times pi
    outer = math.pi * 0.5 * (1.0 - 1.0 / 9.0)
    np.testing.assert_allclose(found["radiance"][0, :, 0], 1.0 / np.array([outer, middle, outer]))
    np.testing.assert_allclose(found["radiance_stderr"], 0.1 * found["radiance"])


def test_coordinates_and_units_travel_with_the_radiance(tmp_path):
    link = deep_water(depths=(1.0,), n_cosines=4, n_azimuths=2)
    r = mt.simulate(link, closed_forms.wide_mesh(), estimator="analog", photons=4096, seed=5)
    data = r.to_dataset()
    assert data["radiance"].attrs["units"] == "sr-1"
    assert data["radiance_stderr"].dims == ("plane", "cosine", "azimuth")
    np.testing.assert_allclose(data["cosine"], [0.75, 0.25, -0.25, -0.75])
    np.testing.assert_allclose(data["azimuth"], [0.5 * math.pi, 1.5 * math.pi])
    r.save(tmp_path / "a.nc")
    back = mt.GainResult.load(tmp_path / "a.nc")
    np.testing.assert_array_equal(back.planes.radiance, r.planes.radiance)
    np.testing.assert_array_equal(back.planes.radiance_stderr, r.planes.radiance_stderr)


def test_few_photons_have_no_error_of_the_radiance():
    link = deep_water(depths=(1.0,), n_cosines=2, n_azimuths=1)
    r = mt.simulate(link, closed_forms.wide_mesh(), estimator="analog", photons=40, seed=5)
    assert np.isnan(r.planes.radiance_stderr).all()
