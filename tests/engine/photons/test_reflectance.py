"""Flat sea under diffuse light: the hemispheric reflectances of both sides, by photons."""

import math

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak, z_test
from scipy import stats

import meshtrace as mt
from meshtrace.optics import fresnel_reflectance
from meshtrace.surfaces import FlatSea

pytestmark = pytest.mark.filterwarnings("ignore:.*left the meshed surface:meshtrace.DomainWarning")

FLAT = FlatSea().mesh(extent=4000.0, spacing=1000.0)
WATER_SIDE, AIR_SIDE = 0.47195, 0.06593
DIGITS = 5e-6  # of the tabulated values
ABSORBING = mt.Water(a=1e-9, b=0.0)
N = 400_000


def run(**link):
    return mt.simulate(mt.Link(**link), FLAT, estimator="analog", photons=N, seed=12)


def everything(height=1.0):
    """Return an aperture that takes all light that leaves a flat sea, with a standard error."""
    return mt.Receiver(height=height, radius=1e6, fov_deg=180.0)


def test_from_below():
    """Lambertian light (half-power at 60 degrees) has uniform radiance: T = 1 - 0.47195."""
    r = run(
        water=ABSORBING,
        transmitter=mt.Led(depth=0.01, half_angle_deg=60.0),
        receiver=everything(),
        physics=mt.Physics(reflected="kill"),
    )
    assert r.gain_stderr < 1e-3
    assert z_test(r.gain, r.gain_stderr, 1.0 - WATER_SIDE, DIGITS) > sidak(ALPHA, 4)
    assert r.fates["reflected"].weight == pytest.approx(1.0 - r.gain, abs=1e-5)


@pytest.mark.parametrize("fresnel", ["weight", "roulette"])
def test_from_above(fresnel):
    r = run(
        water=ABSORBING,
        transmitter=mt.UniformSky(half_width=5.0),
        receiver=everything(),
        physics=mt.Physics(fresnel=fresnel),
    )
    assert z_test(r.gain, r.gain_stderr, AIR_SIDE, DIGITS) > sidak(ALPHA, 4)


def test_both_sides_are_tied_by_reciprocity():
    assert 1.0 - WATER_SIDE == pytest.approx((1.0 - AIR_SIDE) / 1.33**2, abs=1e-5)


def test_overcast_sky():
    """Cardioidal sky by quadrature; the literature's 5.2 per cent for n = 1.34."""
    x, w = np.polynomial.legendre.leggauss(100)
    mu = 0.5 * (x + 1.0)
    flux = mu * (1.0 + 2.0 * mu) * 0.5 * w
    expected = (flux * fresnel_reflectance(mu, 1.0, 1.33)).sum() / flux.sum()
    r = run(water=ABSORBING, transmitter=mt.CardioidalSky(half_width=5.0), receiver=everything())
    assert z_test(r.gain, r.gain_stderr, expected) > sidak(ALPHA, 4)


@pytest.mark.parametrize("zenith_deg", [0.0, 30.0, 60.0, 80.0, 88.0])
def test_sun_is_split_without_noise(zenith_deg):
    """Weights carry the Fresnel law: reflected light and E_d just below are exact."""
    r = run(
        water=mt.Water(a=1e-9, b=0.0, bottom_depth=10.0),
        transmitter=mt.Sun(zenith_deg=zenith_deg),
        receiver=everything(height=0.01),
        planes=mt.IrradiancePlanes(depths=(0.01,)),
    )
    cos_i = math.cos(math.radians(zenith_deg))
    rho = float(fresnel_reflectance(cos_i, 1.0, 1.33))
    cos_t = math.sqrt(1.0 - (1.0 - cos_i**2) / 1.33**2)
    assert r.gain == pytest.approx(rho, rel=1e-9)
    assert r.planes.e_d[0] == pytest.approx(1.0 - rho, rel=1e-9)
    assert r.planes.e_od[0] == pytest.approx((1.0 - rho) / cos_t, rel=1e-9)


def test_uniform_sky_fills_the_snell_cone_evenly():
    """n^2 law: below the surface the radiance is uniform but for Fresnel, dark past 48.75 deg."""
    r = run(
        water=mt.Water(a=1e-9, b=0.0, bottom_depth=10.0),
        transmitter=mt.UniformSky(half_width=5.0),
        planes=mt.IrradiancePlanes(depths=(1.0,), n_cosines=200, n_azimuths=4),
    )
    planes = r.planes
    centre = 0.5 * (planes.cosine_edges[1:] + planes.cosine_edges[:-1])
    critical = math.cos(math.asin(1.0 / 1.33))
    assert planes.radiance[0, centre > -critical + 0.006].max() == 0.0
    inside = centre < -critical - 0.05
    cos_i = np.sqrt(1.0 - 1.33**2 * (1.0 - centre[inside] ** 2))
    # n^2 L (1 - rho), L = 1 / pi for unit irradiance from above
    expected = 1.33**2 * (1.0 - fresnel_reflectance(cos_i, 1.0, 1.33)) / math.pi
    got, error = planes.radiance[0, inside], planes.radiance_stderr[0, inside]
    pulls = (got - expected[:, None]) / error
    # errors of 32 groups: Student's t of 31 degrees of freedom
    assert 2.0 * stats.t.sf(np.abs(pulls).max(), 31) > sidak(ALPHA, pulls.size)
    np.testing.assert_allclose(got.mean(axis=1), expected, rtol=4.5 * 0.01)
    assert 0.7 < (pulls**2).mean() < 1.4
