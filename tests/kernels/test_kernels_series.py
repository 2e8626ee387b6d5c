"""Random slopes with skewness and peakedness, drawn by rejection, against their density."""

import math

import numpy as np
import pytest
from mc_statistics import ALPHA, chi2_test, sidak, z_test

from meshtrace.kernels import interface, jit, vectors
from meshtrace.surfaces import GramCharlier

LAWS = {
    "5 m/s": GramCharlier.cox_munk(5.0),
    "14 m/s": GramCharlier.cox_munk(14.0),
    "breon-henriot": GramCharlier.breon_henriot(10.0),
    "strong": GramCharlier(c21=-0.3, c03=-0.6, c40=1.2, c22=0.4, c04=0.8),
}
N = 400_000
WIND = 0.7


@jit.allocating_entry
def tilts(u, roughness):
    """Return slopes along x and y, and two uniform numbers each."""
    out = np.empty((len(u), 2))
    for i in range(len(u)):
        tilt = interface.drawn_tilt(roughness, u[i, 0], u[i, 1])
        out[i, 0], out[i, 1] = tilt.x, tilt.y
    return out


@jit.allocating_entry
def met_tilts(d, u, roughness):
    """Return slopes that light along d meets on a level mesh."""
    out, up = np.empty((len(u), 2)), vectors.Vec3(0.0, 0.0, 1.0)
    for i in range(len(u)):
        n = interface.roughened(
            vectors.Vec3(d[0], d[1], d[2]), up, u[i, 0], u[i, 1], u[i, 2], roughness
        )
        out[i, 0], out[i, 1] = -n.x / n.z, -n.y / n.z
    return out


@jit.allocating_entry
def turned(along, across, roughness):
    """Return the slopes along x and y of slopes in standard deviations."""
    out = np.empty((len(along), 2))
    for i in range(len(along)):
        tilt = interface.slope_tilt(roughness, along[i], across[i])
        out[i, 0], out[i, 1] = tilt.x, tilt.y
    return out


def rough(law):
    return interface.Roughness(0.2, 0.1, math.cos(WIND), math.sin(WIND), law.series)


def whitened(tilt, roughness):
    c, s = roughness.cos, roughness.sin
    return (c * tilt[:, 0] + s * tilt[:, 1]) / 0.2, (c * tilt[:, 1] - s * tilt[:, 0]) / 0.1


def uniforms(seed, columns):
    return (np.random.default_rng(seed).integers(0, 2**32, (N, columns)) + 0.5) / 2.0**32


EDGES = np.array([-np.inf, *np.linspace(-3.6, 3.6, 19), np.inf])


def probabilities(roughness, seen=None):
    """Return the probabilities of squares of the plane by sums over points 0.02 apart."""
    line = np.arange(-9.0, 9.0, 0.02) + 0.01
    a, c = (v.ravel() for v in np.meshgrid(line, line, indexing="ij"))
    mass = np.exp(-0.5 * (a * a + c * c)) / (2.0 * math.pi) * 0.02**2
    mass *= interface.over_gaussian.py_func(roughness.series, a, c)
    if seen is not None:
        mass *= seen(turned(a, c, roughness))
    return np.histogram2d(a, c, [EDGES, EDGES], weights=mass)[0].ravel()


@pytest.mark.thorough
@pytest.mark.parametrize("name", LAWS)
def test_drawn_slopes_have_the_density(name):
    """Pearson's test of 400 squares of the plane, and the five moments."""
    law, roughness = LAWS[name], rough(LAWS[name])
    a, c = whitened(tilts(uniforms(1, 2), roughness), roughness)
    counts = np.histogram2d(a, c, [EDGES, EDGES])[0].ravel()
    expected = probabilities(roughness)
    assert expected.sum() == pytest.approx(1.0, abs=1e-5)
    tests = len(LAWS) * 8
    assert chi2_test(counts, expected / expected.sum()) > sidak(ALPHA, tests)
    eta = -a
    moments = {
        "mean": (eta, 0.0),
        "mss": (0.5 * (eta**2 + c**2), 1.0),
        "c03": (-(eta**3), law.c03),
        "c21": (-(c**2) * eta, law.c21),
        "c04": (eta**4 - 3.0, law.c04),
        "c22": (c**2 * eta**2 - 1.0, law.c22),
        "c40": (c**4 - 3.0, law.c40),
    }
    for values, wanted in moments.values():
        assert z_test(values.mean(), values.std() / math.sqrt(N), wanted) > sidak(ALPHA, tests)


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["14 m/s", "strong"])
@pytest.mark.parametrize("d", [(0.6, 0.3, 0.74), (-0.5, 0.2, -0.84)], ids=["up", "down"])
def test_light_meets_slopes_by_density_and_exposure(name, d):
    roughness, d = rough(LAWS[name]), np.array(d) / np.linalg.norm(d)
    a, c = whitened(met_tilts(d, uniforms(2, 3), roughness), roughness)
    counts = np.histogram2d(a, c, [EDGES, EDGES])[0].ravel()
    expected = probabilities(roughness, lambda t: np.clip(1.0 - t @ d[:2] / d[2], 0.0, 2.0))
    # the mean slope is 0: the exposures of all slopes add up to 1 but for those that show their back
    assert expected.sum() == pytest.approx(1.0, abs=1e-4)
    assert chi2_test(counts, expected / expected.sum()) > sidak(ALPHA, 4)
    met = probabilities(rough(LAWS[name]))
    assert chi2_test(counts, met / met.sum()) < 1e-12
