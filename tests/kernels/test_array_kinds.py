"""Kernels meet one kind of array: for another memory order or a read-only one numba recompiles."""

import numpy as np
import pytest
from numba import typeof

import meshtrace as mt
from meshtrace.engine import bvh
from meshtrace.engine.backward.walk import _last_scattering
from meshtrace.engine.setup.arrays import surface_arrays
from meshtrace.kernels import scene
from meshtrace.mesh import TriangleMesh, vertex_normals

SEA = mt.JonswapSea(wind_speed=5.0, seed=1).mesh(extent=2.0, spacing=0.5)


def read_only(array):
    array = array.copy()
    array.flags.writeable = False
    return array


@pytest.fixture
def types_of(monkeypatch):
    """Return a function that replaces a kernel and returns the set of types it is called with."""

    def watch(module, name):
        kernel, types = getattr(module, name), set()

        def watched(*arguments):
            types.add(tuple(map(typeof, arguments)))
            return kernel(*arguments)

        monkeypatch.setattr(module, name, watched)
        return types

    return watch


def test_a_mesh_of_read_only_arrays_is_as_any_other():
    arrays = read_only(SEA.vertices), SEA.faces.astype(np.int64), read_only(SEA.vertex_normals)
    assert typeof(surface_arrays(TriangleMesh(*arrays), "vertex")) == typeof(
        surface_arrays(SEA, "vertex")
    )
    assert not arrays[0].flags.writeable


def test_normals_of_facets_are_compiled_once(types_of):
    types = types_of(scene, "facet_normals")
    faces = SEA.faces.astype(np.int64)
    TriangleMesh(SEA.vertices, faces)
    vertex_normals(np.asfortranarray(SEA.vertices), faces)
    vertex_normals(read_only(SEA.vertices), faces)
    assert len(types) == 1


def test_read_only_rays_are_as_any_other(types_of):
    types = types_of(bvh, "facet_hits")
    origins, up = np.array([[0.1, 0.1, -3.0]]), np.array([[0.0, 0.0, 1.0]])
    intersector = mt.EmbreeIntersector(SEA)
    intersector.intersect(origins, up)
    intersector.intersect(read_only(origins), np.broadcast_to(up[0], (1, 3)))
    assert len(types) == 1


def test_factors_of_one_wavelength_are_as_those_of_several():
    link = mt.Link()
    one, two = (_last_scattering(link, [link] * n, 0.8, True, False) for n in (1, 2))
    assert typeof(one) == typeof(two)
