"""Chi-square of the directions and places where light starts."""

import math

import numpy as np
import pytest
from mc_statistics import ALPHA, chi2_test, sidak

import meshtrace as mt
from meshtrace.engine.setup import arrays
from meshtrace.kernels import jit, vectors
from meshtrace.kernels.random import uniforms
from meshtrace.kernels.sources import cardioidal_cosine, lambert_reflection, launch

TOP = 1.5
SAMPLES = 400_000
POLAR_BINS, AZIMUTH_BINS = 40, 24


@jit.allocating_entry
def _launched(sources, n, seed):
    out = np.empty((n, 8))
    for i in range(n):
        p, d, source, out[i, 7] = launch(sources, seed, i)
        out[i, 6] = sources.in_water[source]
        vectors.write(out[i, :3], p)
        vectors.write(out[i, 3:6], d)
    return out


@jit.allocating_entry
def _reflected(n, seed):
    out = np.empty((n, 3))
    for i in range(n):
        u0, u1, _, _ = uniforms(seed, i, 0, 5)
        vectors.write(out[i], lambert_reflection(u0, u1))
    return out


@jit.allocating_entry
def _cardioidal(u):
    out = np.empty(len(u))
    for i in range(len(u)):
        out[i] = cardioidal_cosine(u[i])
    return out


def launched(*sources, n=SAMPLES, seed=1):
    """Return positions, directions, media and spare uniforms of n photons."""
    out = _launched(arrays.source_arrays(mt.Link(transmitter=sources), TOP), n, seed)
    return out[:, :3], out[:, 3:6], out[:, 6] == 1.0, out[:, 7]


def frame(axis):
    """Return two unit vectors across an axis."""
    other = np.eye(3)[np.argmin(np.abs(axis))]
    e1 = np.cross(axis, other)
    e1 /= np.linalg.norm(e1)
    return e1, np.cross(axis, e1)


def assert_distribution(directions, axis, cdf, edges, family):
    """Polar angle by its CDF, azimuth uniform, both independent of each other."""
    axis = np.asarray(axis)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, atol=1e-14)
    e1, e2 = frame(axis)
    along = directions @ axis
    across = np.hypot(directions @ e1, directions @ e2)
    theta = np.arctan2(across, along)
    phi = np.arctan2(directions @ e2, directions @ e1) % (2 * math.pi)
    assert theta.min() >= edges[0]
    assert theta.max() <= edges[-1] + 1e-9
    counts = np.histogram2d(theta, phi, (edges, np.linspace(0.0, 2 * math.pi, AZIMUTH_BINS + 1)))[0]
    p = np.repeat(np.diff(cdf(edges)), AZIMUTH_BINS) / AZIMUTH_BINS
    assert chi2_test(counts.ravel(), p) > sidak(ALPHA, family)
    assert chi2_test(counts.sum(axis=1), np.diff(cdf(edges))) > sidak(ALPHA, family)


def edges_by_share(cdf, end):
    """Return polar angles between which a distribution has equal shares."""
    theta = np.linspace(0.0, end, 200_001)
    inner = np.interp(np.linspace(0, 1, POLAR_BINS + 1)[1:-1], cdf(theta), theta)
    return np.concatenate([[0.0], inner, [end]])


POINTING = [(0.0, 0.0), (180.0, 0.0), (35.0, 120.0), (90.0, -45.0), (1e-5, 10.0)]


@pytest.mark.parametrize(("zenith_deg", "azimuth_deg"), POINTING)
@pytest.mark.parametrize("half_angle_deg", [1.0, 10.0, 60.0, 85.0])
@pytest.mark.slow_but(
    "1.0-0.0-0.0",
    "1.0-35.0-120.0",
    "10.0-180.0-0.0",
    "10.0-1e-05-10.0",
    "60.0-90.0--45.0",
    "60.0-35.0-120.0",
    "85.0-180.0-0.0",
    "85.0-90.0--45.0",
)
def test_lambertian_lamp(half_angle_deg, zenith_deg, azimuth_deg):
    """I ~ cos^m: the CDF of theta is 1 - cos^(m+1)."""
    led = mt.Led(half_angle_deg=half_angle_deg, zenith_deg=zenith_deg, azimuth_deg=azimuth_deg)
    m = -math.log(2.0) / math.log(math.cos(math.radians(half_angle_deg)))

    def cdf(theta):
        return 1.0 - np.maximum(np.cos(theta), 0.0) ** (m + 1.0)

    position, d, in_water, _ = launched(led)
    assert (position == (0.0, 0.0, -10.0)).all()
    assert in_water.all()
    assert_distribution(d, led.axis, cdf, edges_by_share(cdf, math.pi / 2), 40)


@pytest.mark.parametrize("divergence_deg", [0.1, 10.0, 50.0])
def test_gaussian_beam(divergence_deg):
    """1/e^2 of the on-axis value at the divergence: the CDF is 1 - exp(-2 (theta/w)^2)."""
    beam = mt.GaussianBeam(divergence_deg=divergence_deg, zenith_deg=20.0)
    w = math.radians(divergence_deg)

    def cdf(theta):
        return np.where(theta >= math.pi, 1.0, -np.expm1(-2.0 * (theta / w) ** 2))

    _, d, _, _ = launched(beam)
    assert_distribution(d, beam.axis, cdf, edges_by_share(cdf, math.pi), 6)


@pytest.mark.parametrize("divergence_deg", [0.5, 30.0, 90.0])
def test_top_hat_beam(divergence_deg):
    beam = mt.TopHatBeam(divergence_deg=divergence_deg, zenith_deg=160.0, azimuth_deg=70.0)
    end = math.radians(divergence_deg)

    def cdf(theta):
        return (np.sin(theta / 2) / math.sin(end / 2)) ** 2

    _, d, _, _ = launched(beam)
    assert_distribution(d, beam.axis, cdf, edges_by_share(cdf, end), 6)


def test_isotropic_source():
    def cdf(theta):
        return np.sin(theta / 2) ** 2

    _, d, _, _ = launched(mt.IsotropicSource(zenith_deg=77.0))
    assert_distribution(d, (0.0, 0.0, 1.0), cdf, edges_by_share(cdf, math.pi), 2)


def test_uniform_sky():
    """Equal radiance onto a horizontal plane: flux ~ cos sin."""

    def cdf(theta):
        return np.sin(theta) ** 2

    _, d, in_water, _ = launched(mt.UniformSky())
    assert not in_water.any()
    assert_distribution(d, (0.0, 0.0, -1.0), cdf, edges_by_share(cdf, math.pi / 2), 2)


def test_cardioidal_sky():
    """Flux ~ (1 + 2 cos) cos sin; its CDF is 1 - (3 c^2 + 4 c^3) / 7."""

    def cdf(theta):
        c = np.maximum(np.cos(theta), 0.0)
        return 1.0 - (3.0 * c**2 + 4.0 * c**3) / 7.0

    _, d, _, _ = launched(mt.CardioidalSky())
    assert_distribution(d, (0.0, 0.0, -1.0), cdf, edges_by_share(cdf, math.pi / 2), 2)


def test_cardioidal_inversion_is_exact():
    u = np.concatenate([np.geomspace(1e-10, 0.5, 50), 1.0 - np.geomspace(1e-10, 0.5, 50)])
    m = _cardioidal(u)
    np.testing.assert_allclose((3 * m**2 + 4 * m**3) / 7, u, rtol=1e-13)
    assert ((m > 0.0) & (m <= 1.0)).all()


def test_divergence_zero_is_one_direction():
    for beam in (mt.TopHatBeam(divergence_deg=0.0), mt.GaussianBeam(divergence_deg=0.0)):
        _, d, _, _ = launched(beam, n=1000)
        assert (d == (0.0, 0.0, 1.0)).all()


@pytest.mark.parametrize(("zenith_deg", "azimuth_deg"), [(0.0, 0.0), (50.0, 200.0)])
@pytest.mark.parametrize("kind", ["gaussian", "top-hat"])
def test_wide_beams_spread_across_their_axis(kind, zenith_deg, azimuth_deg):
    pointing = {"zenith_deg": zenith_deg, "azimuth_deg": azimuth_deg, "position": (1.0, -2.0)}
    if kind == "gaussian":
        beam = mt.GaussianBeam(waist=0.3, divergence_deg=1.0, **pointing)

        def cdf(r):
            return -np.expm1(-2.0 * (r / 0.3) ** 2)

        edges = np.concatenate([np.linspace(0.0, 0.5, 26), [9.0]])
    else:
        beam = mt.TopHatBeam(radius=0.3, divergence_deg=1.0, **pointing)

        def cdf(r):
            return (r / 0.3) ** 2

        edges = np.linspace(0.0, 0.3, 26)
    position, d, _, _ = launched(beam)
    off = position - (1.0, -2.0, -10.0)
    axis = np.array(beam.axis)
    np.testing.assert_allclose(off @ axis, 0.0, atol=1e-13)
    e1, e2 = frame(axis)
    r, phi = np.hypot(off @ e1, off @ e2), np.arctan2(off @ e2, off @ e1)
    counts = np.histogram2d(r, phi, (edges, np.linspace(-math.pi, math.pi, 17)))[0]
    p = np.repeat(np.diff(cdf(edges)), 16) / 16
    assert chi2_test(counts.ravel(), p) > sidak(ALPHA, 8)
    # where a photon starts tells nothing of where it goes
    side = np.histogram2d(off @ e1 > 0.0, d @ e1 > 0.0, 2)[0]
    assert chi2_test(side.ravel(), np.full(4, 0.25)) > sidak(ALPHA, 8)


@pytest.mark.parametrize("zenith_deg", [0.0, 60.0, 88.0])
def test_sun_lights_its_square_at_still_water(zenith_deg):
    sun = mt.Sun(zenith_deg=zenith_deg, azimuth_deg=30.0, half_width=2.0, position=(1.0, 3.0))
    position, d, in_water, _ = launched(sun)
    assert not in_water.any()
    assert np.ptp(d, axis=0).max() == 0.0
    zenith, azimuth = np.radians([zenith_deg, 30.0])
    expected = np.array(
        [
            math.sin(zenith) * math.cos(azimuth),
            math.sin(zenith) * math.sin(azimuth),
            -math.cos(zenith),
        ]
    )
    np.testing.assert_allclose(d[0], expected, atol=1e-15)
    assert (position[:, 2] == TOP).all()
    still = position - position[:, 2:] / d[:, 2:] * d
    edges = [np.linspace(c - 2.0 - 1e-9, c + 2.0 + 1e-9, 21) for c in (1.0, 3.0)]
    counts = np.histogram2d(*still[:, :2].T, edges)[0]
    assert counts.sum() == SAMPLES
    assert chi2_test(counts.ravel(), np.full(400, 1 / 400)) > sidak(ALPHA, 3)


@pytest.mark.parametrize("sky", [mt.UniformSky, mt.CardioidalSky])
def test_sky_light_starts_above_the_waves_evenly_over_its_square(sky):
    position, d, _, _ = launched(sky(half_width=1.5, position=(-1.0, 0.5)))
    assert (position[:, 2] == TOP).all()
    edges = [np.linspace(c - 1.5, c + 1.5, 13) for c in (-1.0, 0.5)]
    off = position[:, :2]
    counts = np.histogram2d(off[:, 0], off[:, 1], edges)[0]
    assert counts.sum() == SAMPLES, "the square moved with the starting height"
    assert chi2_test(counts.ravel(), np.full(144, 1 / 144)) > sidak(ALPHA, 2)
    half = np.histogram2d(off[:, 0] > -1.0, d[:, 0] > 0.0, 2)[0]
    assert chi2_test(half.ravel(), np.full(4, 0.25)) > sidak(ALPHA, 2)


def test_sources_share_the_photons_by_power():
    power = np.array([10.0, 0.5, 70.0, 19.5])
    sources = [
        mt.Led(power_mw=power[0], position=(0.0, 0.0)),
        mt.IsotropicSource(power_mw=power[1], position=(1.0, 0.0)),
        mt.TopHatBeam(power_mw=power[2], position=(2.0, 0.0)),
        mt.Sun(power_mw=power[3], position=(30.0, 0.0)),
    ]
    position, d, in_water, _ = launched(*sources)
    which = np.where(in_water, np.round(position[:, 0]).astype(int), 3)
    counts = np.bincount(which, minlength=4)
    assert chi2_test(counts, power / power.sum()) > ALPHA
    assert d[which == 2, 2].min() > math.cos(math.radians(1.0)) - 1e-9
    # the choice of the source must not tilt its directions
    up = np.array([(d[which == 1, 2] > 0.0).sum(), (d[which == 1, 2] <= 0.0).sum()])
    assert chi2_test(up, [0.5, 0.5]) > ALPHA


def test_first_free_path_is_independent_of_the_direction():
    _, d, _, u = launched(mt.IsotropicSource())
    phi = np.arctan2(d[:, 1], d[:, 0]) / (2 * math.pi) + 0.5
    theta = np.clip(0.5 - 0.5 * d[:, 2], 0.0, 1.0)
    cells = (np.clip(theta * 8, 0, 7).astype(int) * 8 + np.clip(phi * 8, 0, 7).astype(int)) * 8
    counts = np.bincount(cells + (u * 8).astype(int), minlength=512)
    assert chi2_test(counts, np.full(512, 1 / 512)) > ALPHA


def test_lambertian_bottom():
    def cdf(theta):
        return np.sin(theta) ** 2

    d = _reflected(SAMPLES, 9)
    assert (d[:, 2] > 0.0).all()
    assert_distribution(d, (0.0, 0.0, 1.0), cdf, edges_by_share(cdf, math.pi / 2), 2)
