"""The cache of compiled kernels: kept while no kernel changes, verified, and never required."""

import os
import pickle
import signal
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
    assert warned.count("UserWarning") == 1
    assert "compiled kernels are not kept; MESHTRACE_CACHE_DIR" in warned


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


HOLD = """
import sys
import own
import meshtrace.kernels.jit as jit
def compile(self, sig):
    with self._cache.turn(sig, self.targetctx):
        print("held", flush=True)
        sys.stdin.read()
jit._Entry.compile = compile
jit.entry(own.double)(1.0)
"""


@pytest.fixture
def holder(monkeypatch, tmp_path):
    """Stop a process that holds the lock of a kernel, in a folder that this process uses."""
    (tmp_path / "own.py").write_text("def double(x):\n    return 2.0 * x\n")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.syspath_prepend(tmp_path)
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD],
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    with process:
        assert process.stdout.readline() == "held\n"
        process.send_signal(signal.SIGSTOP)
        yield process
        process.kill()
    sys.modules.pop("own", None)


@pytest.mark.process
@pytest.mark.thorough
@pytest.mark.posix
def test_a_stopped_process_that_compiles_delays_others_for_a_bounded_time(
    holder, monkeypatch, capfd
):
    """Once every other process slept for ever, at no CPU time and without a word."""
    import own

    monkeypatch.setattr(jit, "_SILENT_WAIT", 0.2)
    monkeypatch.setattr(jit, "_LONGEST_WAIT", 0.5)
    assert jit.entry(own.double)(1.5) == 3.0
    (line,) = capfd.readouterr().err.splitlines()
    assert line.startswith("waiting for 0 s at most for another process that compiles own.double")
    assert ".lock" in line
    assert sum(jit.entry(own.double).stats.cache_hits.values()) == 0
    again = jit.entry(own.double)
    assert again(1.5) == 3.0
    assert sum(again.stats.cache_hits.values()) == 1  # saved all the same
    assert capfd.readouterr().err == ""


@pytest.mark.process
@pytest.mark.thorough
@pytest.mark.posix
def test_the_lock_of_a_killed_process_is_free(holder, monkeypatch, capfd):
    import own

    holder.kill()
    holder.wait()
    (lock,) = jit.folder().glob("*.lock")  # stays behind, and holds nobody
    assert jit.entry(own.double)(1.5) == 3.0
    assert capfd.readouterr().err == ""
    assert not lock.exists()


@pytest.mark.parametrize("error", [OSError(37, "No locks available"), NotImplementedError()])
def test_a_file_system_without_locks_is_no_obstacle(folder, monkeypatch, error):
    def refuse(self, timeout):
        raise error

    monkeypatch.setattr("filelock.FileLock.acquire", refuse)
    assert hits_of_a_call() == 0
    assert hits_of_a_call() == 1


def test_bounds_of_the_wait():
    """A word after some seconds; the compile time of the slowest kernel is a quarter of a minute."""
    assert 1.0 <= jit._SILENT_WAIT <= 5.0
    assert 10.0 <= jit._LONGEST_WAIT <= 60.0


# ---- kernels of strangers ----------------------------------------------------------------------


@pytest.mark.posix
def test_folders_and_kernels_are_those_of_their_owner_alone(folder):
    before = os.umask(0o002)
    try:
        hits_of_a_call()
    finally:
        os.umask(before)
    (path,) = jit.folder().iterdir()
    for place in (path.parent, path.parent.parent, folder):
        assert place.stat().st_mode & 0o777 == 0o700
    assert path.stat().st_mode & 0o777 == 0o600


class Trap:
    """Pickle that runs code."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


def hostile(path, ran):
    """Replace a kernel by a pickle that creates a folder, under a right checksum."""
    payload = pickle.dumps(Trap(ran))
    mode = path.stat().st_mode
    path.write_bytes(jit.hashlib.sha256(payload).digest() + payload)
    path.chmod(mode)


def chown(path):
    os.chown(path, 12345, -1)


FOREIGN = {
    "folder of another user": lambda path: chown(path.parent),
    "kernel of another user": chown,
    "folder open to the group": lambda path: path.parent.chmod(0o770),
    "folder open to all": lambda path: path.parent.chmod(0o777),
    "kernel open to the group": lambda path: path.chmod(0o660),
    "kernel open to all": lambda path: path.chmod(0o606),
}


@pytest.mark.posix
@pytest.mark.parametrize("place", FOREIGN)
def test_kernels_that_others_may_have_written_are_not_read(place, kernel, tmp_path):
    if "another" in place and os.geteuid() != 0:
        pytest.skip("gives a file away")
    hostile(kernel, tmp_path / "ran")
    FOREIGN[place](kernel)
    jit._warn_once.cache_clear()
    with pytest.warns(UserWarning, match=r"compiled kernels are not read; MESHTRACE_CACHE") as told:
        assert hits_of_a_call() == 0
    assert hits_of_a_call() == ("kernel" in place)  # a file is replaced by one of this user
    assert len(told) == 1
    assert not (tmp_path / "ran").exists()


def test_the_folder_inside_the_package_is_trusted(kernel, monkeypatch):
    """Its owner may be whoever installed the package."""
    kernel.parent.chmod(0o777)
    jit._warn_once.cache_clear()
    with pytest.warns(UserWarning, match="writable by other users"):
        assert not jit._is_trusted(kernel)
    monkeypatch.setattr(jit, "shipped", lambda: kernel.parent)
    assert jit._is_trusted(kernel)


# ---- the environment of numba ------------------------------------------------------------------

IMPORT = "import meshtrace.kernels.jit as jit; print(jit.config.NUMBA_NUM_THREADS, jit.folder())"


@pytest.mark.process
@pytest.mark.parametrize("threads", ["0", "-1", "abc", "1.5", "", "1e3"])
def test_a_wrong_number_of_threads_for_numba_is_one_line(threads):
    """It once ended in a traceback of numba, or printed that of its parser."""
    done = subprocess.run(
        [sys.executable, "-m", "meshtrace", "run", "--photons", "64"],
        env={**os.environ, "NUMBA_NUM_THREADS": threads},
        capture_output=True,
        text=True,
        timeout=60,
    )
    allowed = "allowed: a whole number >= 1, or unset"
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == f"error: NUMBA_NUM_THREADS: {threads!r}, {allowed}\n"


@pytest.mark.process
@pytest.mark.parametrize("name", ["NUMBA_OPT", "NUMBA_DEBUG_CACHE", "NUMBA_DISABLE_JIT"])
def test_another_wrong_setting_of_numba_is_one_warning(name):
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            f"import warnings; warnings.showwarning = lambda w, *_: print(w);{IMPORT}",
        ],
        env={**os.environ, name: "abc"},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    first, _ = done.stdout.splitlines()
    assert first.startswith(f"Environment variable '{name}' is defined but its associated value")
    assert done.stderr == ""


@pytest.mark.process
def test_settings_of_numba_in_the_working_directory_are_left_aside(tmp_path):
    """A folder of a stranger could name a cache folder with the stranger's kernels."""
    (tmp_path / ".numba_config.yaml").write_text("cache_dir: stranger\nopt: 0\n")
    code = f"{IMPORT}; jit.config.reload_config(); print(jit.config.OPT, jit.folder())"
    done = subprocess.run(
        [sys.executable, "-P", "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert "stranger" not in done.stdout
    assert "OptLevel(3)" in done.stdout
