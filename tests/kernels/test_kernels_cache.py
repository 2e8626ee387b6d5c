"""The cache of compiled kernels: kept while no kernel changes, verified, and never required."""

import os
import subprocess
import sys
from functools import partial

import pytest
from numba import config, njit
from numba.core.caching import FunctionCache

from meshtrace.kernels import jit


def double(x):
    return 2.0 * x


def hits_of_a_call():
    compiled = jit.entry(double)
    assert compiled(1.5) == 3.0
    return sum(compiled.stats.cache_hits.values())


@pytest.fixture
def folder(monkeypatch, tmp_path):
    """Keep kernels in a folder of the test."""
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def kernel(folder):
    """Return the file of the only kernel."""
    hits_of_a_call()
    (path,) = jit.folder().iterdir()
    return path


def test_a_change_in_any_kernel_is_noticed(monkeypatch, folder):
    with monkeypatch.context() as changed:
        changed.setattr(jit, "sources", lambda: b"first")
        assert hits_of_a_call() == 0
        assert hits_of_a_call() == 1
        changed.setattr(jit, "sources", lambda: b"second")
        assert hits_of_a_call() == 0
        assert hits_of_a_call() == 1
    assert len(list((folder / "kernels").iterdir())) == 2


def test_old_folders_are_removed(monkeypatch, folder):
    for i in range(jit._KEPT_DIGESTS + 3):
        monkeypatch.setattr(jit, "sources", lambda i=i: bytes([i]))
        hits_of_a_call()
    assert len(list((folder / "kernels").iterdir())) == jit._KEPT_DIGESTS
    assert hits_of_a_call() == 1


def test_is_compiled_in_memory_or_on_disk(folder):
    compiled = jit.entry(double)
    assert not jit.is_compiled(compiled)
    compiled(1.5)
    assert jit.is_compiled(compiled)
    assert jit.is_compiled(jit.entry(double))
    compiled._cache.flush()
    assert jit.is_compiled(compiled)
    assert not jit.is_compiled(jit.entry(double))


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: b"",
        lambda content: content[:20],
        lambda content: content[:-1],
        lambda content: content + b"\0",
        lambda content: bytes([content[0] ^ 1]) + content[1:],
        lambda content: content[:5000] + bytes([content[5000] ^ 16]) + content[5001:],
    ],
    ids=["empty", "cut checksum", "cut", "longer", "bit of the checksum", "bit of the code"],
)
def test_a_damaged_kernel_is_replaced(kernel, damage):
    intact = kernel.read_bytes()
    kernel.write_bytes(damage(intact))
    with pytest.warns(UserWarning, match="damaged, compiled again"):
        assert hits_of_a_call() == 0
    assert len(kernel.read_bytes()) == pytest.approx(len(intact), rel=0.01)
    assert hits_of_a_call() == 1


def test_an_intact_kernel_of_another_signature_is_not_used(kernel):
    jit.entry(double)(2)
    (other,) = set(jit.folder().iterdir()) - {kernel}
    kernel.write_bytes(other.read_bytes())
    with pytest.warns(UserWarning, match="damaged"):
        assert hits_of_a_call() == 0


def test_kernels_run_without_a_folder_to_write_to(monkeypatch, tmp_path):
    (tmp_path / "file").touch()
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path / "file"))
    with pytest.warns(UserWarning, match="Not a directory, compiled kernels are not kept"):
        hits_of_a_call()
    assert hits_of_a_call() == 0


def test_nothing_is_left_of_a_write_that_fails(monkeypatch, kernel):
    def full(*names):
        raise OSError(28, "No space left on device")

    jit.entry(double)._cache.flush()
    monkeypatch.setattr("os.replace", full)
    with pytest.warns(UserWarning, match="No space left on device"):
        hits_of_a_call()
    assert list(jit.folder().iterdir()) == []


def python(code, **changes):
    """Return what a fresh interpreter prints, without its warnings."""
    environment = {**os.environ, **changes}
    environment = {key: value for key, value in environment.items() if value is not None}
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip(), done.stderr


def test_kernels_run_as_plain_python_for_debuggers():
    code = (
        "import meshtrace.engine.crossing; from meshtrace.kernels import jit;"
        "f = jit.entry(lambda x: 2.0 * x);"
        "print(f(1.0), jit.is_compiled(f))"
    )
    assert python(code, NUMBA_DISABLE_JIT="1")[0] == "2.0 True"


@pytest.mark.process
@pytest.mark.thorough
def test_a_home_that_cannot_be_written_is_no_obstacle():
    """Nor may numba's own cache look for a folder, which is fatal where it finds none."""
    code = (
        "import meshtrace.surfaces, meshtrace.engine.photons.flight\n"
        "from meshtrace.engine.bvh import BruteForceIntersector\n"
        "from meshtrace.mesh import TriangleMesh\n"
        "mesh = TriangleMesh([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])\n"
        "print(*BruteForceIntersector(mesh).intersect([(0.2, 0.2, 1)], [(0, 0, -1)]).facet)\n"
    )
    unset = dict.fromkeys(["NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "MESHTRACE_CACHE_DIR"])
    locators = "numba.core.caching.ZipCacheLocator"  # finds no folder
    shown, warned = python(code, **unset, HOME="/dev/null", NUMBA_CACHE_LOCATOR_CLASSES=locators)
    assert shown == "0"
    assert warned.count("compiled kernels are not kept") == 1
    assert "MESHTRACE_CACHE_DIR" in warned


def test_kernels_of_other_packages_use_this_cache(monkeypatch, folder, tmp_path):
    (tmp_path / "foreign.py").write_text(
        "from numba import njit\n\n@njit('f8(f8)', cache=True)\ndef half(x):\n    return 0.5 * x\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    with jit.foreign_kernels():
        import foreign
    assert foreign.half(3.0) == 1.5
    assert [path.suffix for path in jit.folder().iterdir()] == [jit._SUFFIX]
    assert type(njit(cache=True)(double)._cache) is FunctionCache


@pytest.mark.process
@pytest.mark.thorough
def test_processes_share_a_folder(tmp_path):
    """Of two processes that need a kernel at once one compiles it, the other waits for the file."""
    code = "import own, meshtrace.kernels.jit as jit; f = jit.entry(own.double); f(1.0)"
    code += "; print(sum(f.stats.cache_hits.values()))"
    (tmp_path / "own.py").write_text("def double(x):\n    return 2.0 * x\n")
    changes = {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(tmp_path)}
    start = partial(subprocess.Popen, stdout=subprocess.PIPE, env={**os.environ, **changes})
    started = [start([sys.executable, "-c", code]) for _ in range(2)]
    assert sorted(process.communicate(timeout=300)[0] for process in started) == [b"0\n", b"1\n"]
    assert [process.returncode for process in started] == [0, 0]
    files = list((tmp_path / "cache").rglob("*.*"))
    assert [path.suffix for path in files] == [jit._SUFFIX]
