"""Arguments of kernels, ready for a test: a mesh of waves, the default link over it, random numbers.

A test takes what it needs by name; `scene_of` makes the scene of another link or mesh.
"""

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.surfaces import SinusoidalSea


@pytest.fixture
def rng():
    """Return a generator of random numbers with a fixed seed."""
    return np.random.default_rng(1)


@pytest.fixture(scope="session")
def small_mesh():
    """Return a sinusoid of 0.1 m over |x|, |y| <= 6 m, in triangles of 0.5 m."""
    sea = SinusoidalSea(amplitude=0.1, wavelength=2.0, phase=0.4, direction_deg=30.0)
    return sea.mesh(extent=6.0, spacing=0.5)


@pytest.fixture(scope="session")
def medium():
    """Return the arrays of the default water without bubbles."""
    from meshtrace.transport.arrays import medium_arrays

    return medium_arrays(mt.Link())


@pytest.fixture(scope="session")
def scene_of():
    """Return a function of link, mesh and normals that makes a `Scene`, as forced detection does."""
    from meshtrace.transport.forced import ForcedDetection

    def make(link, mesh, normals="vertex"):
        forced = ForcedDetection(link, 32, 1, normals, scattered="chains")
        return forced.over(mesh).scene(forced.arrays.emitters[0], forced.arrays.targets[0])

    return make


@pytest.fixture(scope="session")
def scene(scene_of, small_mesh):
    """Return the scene of the default link over the small mesh."""
    return scene_of(mt.Link(), small_mesh)
