"""The C interface of Embree against embreex: same hits, and embreex wherever it fails."""

import gc
from pathlib import Path

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.engine import bvh
from meshtrace.surfaces import JonswapSea

SEA = JonswapSea(wind_speed=13.0, seed=7, waves="paper")


@pytest.fixture(scope="module")
def mesh():
    return SEA.mesh(extent=12.0, spacing=0.5)


@pytest.fixture
def fresh():
    """Load the library again before and after the test."""
    bvh.library.cache_clear()
    yield
    bvh.library.cache_clear()


def rays(n=20_000):
    rng = np.random.default_rng(4)
    origins = np.column_stack([rng.uniform(-13.0, 13.0, (n, 2)), rng.uniform(-3.0, 3.0, n)])
    return origins.astype(np.float32), rng.normal(size=(n, 3)).astype(np.float32)


def shared(mesh):
    found = bvh.library()
    if found is None:
        pytest.skip("the wheel of embreex has no library that can be called here")
    return bvh.SharedScene(found, mesh.vertices, mesh.faces)


def test_hits_are_those_of_embreex(mesh):
    copied = bvh.CopiedScene(mesh.vertices, mesh.faces).run(*rays())
    assert 0.3 < (copied >= 0).mean() < 0.9
    assert len(np.unique(copied)) > 2000
    assert np.array_equal(shared(mesh).run(*rays()), copied)
    for n in (0, 1, 63, 64, 65):  # around the block of rays
        origins, directions = rays(n)
        assert np.array_equal(
            shared(mesh).run(origins, directions),
            copied[:0] if n == 0 else bvh.CopiedScene(mesh.vertices, mesh.faces).run(*rays(n)),
        )


def test_arrays_live_as_long_as_their_scene(mesh):
    expected = bvh.CopiedScene(mesh.vertices, mesh.faces).run(*rays())
    scene = bvh.SharedScene(
        bvh.library() or pytest.skip("no library"),
        mesh.vertices.copy(),
        mesh.faces.astype(np.int64),
    )
    gc.collect()
    waste = [np.full(len(mesh.vertices) * 3, np.nan, np.float32) for _ in range(50)]
    assert np.array_equal(scene.run(*rays()), expected)
    release = scene._release
    assert release.alive
    assert len(waste) == 50
    del scene
    gc.collect()
    assert not release.alive


class Elsewhere:
    """A file of the wheel that is not there."""

    name, suffix = "libembree4.so.4", ".4"

    def locate(self):
        return Path("/nowhere/libembree4.so.4")


@pytest.mark.parametrize("lack", ["distribution", "file", "library", "function", "jit"])
def test_embreex_takes_over(lack, mesh, fresh, monkeypatch):
    expected = bvh.CopiedScene(mesh.vertices, mesh.faces).run(*rays())
    if lack == "distribution":

        def missing(name):
            raise bvh.metadata.PackageNotFoundError(name)

        monkeypatch.setattr(bvh.metadata, "files", missing)
    elif lack == "file":
        monkeypatch.setattr(bvh.metadata, "files", lambda name: None)
    elif lack == "library":
        monkeypatch.setattr(bvh.metadata, "files", lambda name: [Elsewhere()])
    elif lack == "function":
        monkeypatch.setitem(bvh._FUNCTIONS, "rtcNoSuchFunction", (None,))
    else:
        monkeypatch.setattr(bvh.config, "DISABLE_JIT", True)
    assert bvh.library() is None
    scene = mt.EmbreeIntersector(mesh)._scene
    assert isinstance(scene, bvh.CopiedScene)
    assert np.array_equal(scene.run(*rays()), expected)


class Failing:
    """Functions of the library, of which one reports an error."""

    def __init__(self, functions, **answers):
        self._functions, self._answers = functions, answers

    def __getattr__(self, name):
        if name in self._answers:
            return lambda *_: self._answers[name]
        return getattr(self._functions, name)


@pytest.mark.parametrize("answers", [{"rtcNewScene": None}, {"rtcGetDeviceError": 4}])
def test_errors_of_embree_are_warnings(answers, mesh, monkeypatch):
    found = bvh.library()
    if found is None:
        pytest.skip("the wheel of embreex has no library that can be called here")
    failing = Failing(found, **answers)
    monkeypatch.setattr(bvh, "library", lambda: failing)
    with pytest.warns(UserWarning, match="embreex is used, which is slower"):
        scene = bvh.new_scene(mesh.vertices, mesh.faces)
    assert isinstance(scene, bvh.CopiedScene)
