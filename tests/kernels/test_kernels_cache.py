"""What is compiled is kept on disk as long as no kernel has changed."""

import os
import subprocess
import sys

from meshtrace.kernels import jit


def double(x):
    return 2.0 * x


def hits_of_a_call():
    compiled = jit.entry(double)
    assert compiled(1.5) == 3.0
    return sum(compiled.stats.cache_hits.values())


def test_a_change_in_any_kernel_is_noticed(monkeypatch):
    with monkeypatch.context() as changed:
        changed.setattr(jit, "sources", lambda: b"first")
        hits_of_a_call()
        assert hits_of_a_call() == 1
        changed.setattr(jit, "sources", lambda: b"second")
        assert hits_of_a_call() == 0
        assert hits_of_a_call() == 1


def test_kernels_run_as_plain_python_for_debuggers():
    code = "from meshtrace.kernels import aiming, jit; print(jit.entry(lambda x: 2.0 * x)(1.0))"
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True)
    assert (done.returncode, done.stdout.strip()) == (0, b"2.0"), done.stderr
