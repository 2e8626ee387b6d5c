"""Chi-square of scattering directions: polar angle by its CDF, azimuth even, at any axis."""

import math

import numpy as np
import pytest
from mc_statistics import ALPHA, chi2_test, sidak

from meshtrace.kernels import jit, medium, vectors
from meshtrace.kernels.random import uniforms
from meshtrace.optics import FournierForand, HenyeyGreenstein

SAMPLES = 400_000


@jit.allocating_entry
def _turned(tables, dx, dy, dz, n, seed):
    out = np.empty((n, 3))
    for i in range(n):
        _, u_theta, u_phi, _ = uniforms(seed, i, 1, 2)
        vectors.write(
            out[i], vectors.turn(vectors.Vec3(dx, dy, dz), medium.sample_s(tables, u_theta), u_phi)
        )
    return out


@jit.allocating_entry
def _after(tables, n, scatterings, seed):
    """Return the height of the direction after several scatterings of light that goes up."""
    out = np.empty(n)
    for i in range(n):
        d = vectors.UP
        for k in range(scatterings):
            _, u_theta, u_phi, _ = uniforms(seed, i, k + 1, 2)
            d = vectors.turn(d, medium.sample_s(tables, u_theta), u_phi)
        out[i] = d.z
    return out


def slanted(dz, azimuth=2.2):
    across = math.sqrt((1.0 - abs(dz)) * (1.0 + abs(dz)))
    return across * math.cos(azimuth), across * math.sin(azimuth), dz


AXES = {
    "up": (0.0, 0.0, 1.0),
    "down": (0.0, 0.0, -1.0),
    "almost up": slanted(1.0 - 1e-12),
    "almost down": slanted(-1.0 + 1e-12),
    "near up": slanted(1.0 - 1e-6),
    "level": slanted(0.0),
    "slanted": slanted(0.4),
    "slanted down": slanted(-0.8),
}


@pytest.mark.parametrize("axis", AXES.values(), ids=AXES.keys())
@pytest.mark.parametrize("phase", [HenyeyGreenstein(g=0.0), FournierForand()], ids=["hg", "ff"])
def test_polar_angle_and_azimuth(phase, axis):
    d = _turned(phase.tables(), *axis, SAMPLES, 4)
    axis = np.array(axis)
    e1 = np.cross(axis, (1.0, 0.0, 0.0) if abs(axis[0]) < 0.7 else (0.0, 1.0, 0.0))
    e1 /= np.linalg.norm(e1)
    e2 = np.cross(axis, e1)
    np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1.0, atol=1e-15)
    theta = np.arctan2(np.linalg.norm(np.cross(axis, d), axis=1), d @ axis)
    phi = np.arctan2(d @ e2, d @ e1)
    grid = np.concatenate([[0.0], np.geomspace(1e-7, math.pi, 100_000)])
    inner = np.interp(np.linspace(0, 1, 31)[1:-1], phase.cdf(grid), grid)
    edges = np.concatenate([[0.0], inner, [math.pi + 1e-9]])
    counts = np.histogram2d(theta, phi, (edges, np.linspace(-math.pi, math.pi, 17)))[0]
    edges[-1] = math.pi
    p = np.repeat(np.diff(phase.cdf(edges)), 16) / 16.0
    assert chi2_test(counts.ravel(), p) > sidak(ALPHA, 2 * len(AXES))


@pytest.mark.parametrize("scatterings", [1, 2, 5])
@pytest.mark.parametrize("phase", [HenyeyGreenstein(g=0.8), FournierForand()], ids=["hg", "ff"])
def test_mean_cosine_falls_as_g_to_the_power_of_scatterings(phase, scatterings):
    """<cos> after k scatterings is g^k: fails if azimuths or frames of the turns are correlated."""
    z = _after(phase.tables(), SAMPLES, scatterings, 5)
    stderr = z.std() / math.sqrt(SAMPLES)
    assert abs(z.mean() - phase.mean_cosine**scatterings) < 4.5 * stderr


def test_second_legendre_moment_of_henyey_greenstein():
    """<P2> after k scatterings is g^(2k)."""
    z = _after(HenyeyGreenstein(g=0.8).tables(), SAMPLES, 3, 6)
    p2 = 1.5 * z**2 - 0.5
    assert abs(p2.mean() - 0.8**6) < 4.5 * p2.std() / math.sqrt(SAMPLES)
