"""Ctrl-C at any moment of a command: one line, exit code 130, no file."""

import os
import signal
import subprocess
import sys
import time
from random import Random

import pytest

pytestmark = [pytest.mark.process]

STARTED = "import os; from meshtrace.__main__ import main; os.write(2, b'started\\n'); main()"
"""A command that says when Python has its first function; before, nothing handles the signal."""

SLOW = ["run", "--photons", "2000000", "--threads", "1", "-o", "gain.nc"]


def heed():
    """Heed Ctrl-C: a shell's background jobs ignore it, and so would their children."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def interrupt(delay, folder, code=STARTED, line=SLOW):
    """Return exit code, stdout and stderr of a command that gets SIGINT after a delay [s]."""
    process = subprocess.Popen(
        [sys.executable, "-c", code, *line],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
        preexec_fn=heed,
    )
    assert process.stderr.readline() == "started\n"
    time.sleep(delay)
    process.send_signal(signal.SIGINT)
    stdout, stderr = process.communicate(timeout=300)
    return process.returncode, stdout, stderr


def check(tries, longest, folder):
    random = Random(5)
    for _ in range(tries):
        delay = random.uniform(0.02, longest)
        code, stdout, stderr = interrupt(delay, folder)
        lines = [x for x in stderr.splitlines() if not x.startswith(("compiling", "warning"))]
        assert (code, stdout, lines) == (130, "", ["interrupted"]), delay
        assert os.listdir(folder) == []


@pytest.mark.posix
@pytest.mark.slow
def test_ctrl_c_at_random_times(tmp_path):
    check(6, 1.0, tmp_path)


@pytest.mark.posix
@pytest.mark.thorough
def test_ctrl_c_while_kernels_compile(tmp_path, monkeypatch):
    """The process ends, too, and leaves whole kernels or none; a lock left behind holds nobody."""
    cache = tmp_path / "cache"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(cache))
    code, stdout, stderr = interrupt(3.0, tmp_path, line=["run"])
    assert (code, stdout) == (130, "")
    assert stderr.splitlines()[-1] == "interrupted"
    assert "Traceback" not in stderr
    named = {path.suffix for path in cache.rglob("[!.]*.*") if path.is_file()}
    assert named <= {".kernel", ".lock"}


@pytest.mark.slow
@pytest.mark.drill
@pytest.mark.posix
def test_ctrl_c_at_many_times(tmp_path):
    check(60, 3.0, tmp_path)


CALLBACK = """
import os, signal, sys
class Late:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)
        sum(range(1000))
class Half:
    def __init__(self):
        signal.raise_signal(signal.SIGINT)
        self.whole = True
    def __del__(self):
        del self.whole
class Llvm:
    def __init__(self):
        code = "signal.raise_signal(signal.SIGINT); os.write(2, b'complete\\\\n')"
        exec(compile(code, os.path.join(os.sep, "llvmlite", "ffi.py"), "exec"))
from meshtrace import cli
import meshtrace.__main__ as start
def body(prog_name):
    CASE()
    import time
    time.sleep(60)
cli.app = body
os.write(2, b"started\\n")
start.main()
"""


@pytest.mark.posix
@pytest.mark.parametrize("case", ["Late", "Half", "Llvm"])
def test_ctrl_c_in_a_callback_is_not_lost(case, tmp_path):
    """Exceptions of `__del__` go nowhere; once the command went on, or printed them."""
    done = subprocess.run(
        [sys.executable, "-c", CALLBACK.replace("CASE", case)],
        capture_output=True,
        text=True,
        timeout=50,
        preexec_fn=heed,
    )
    complete = "complete\n" if case == "Llvm" else ""
    assert (done.returncode, done.stderr) == (130, f"started\n{complete}interrupted\n")
