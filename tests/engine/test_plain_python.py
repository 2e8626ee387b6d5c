"""Runs without the compiler, for debuggers: the digits of compiled kernels."""

import json
import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.process

RUN = """
import json, sys
import meshtrace as mt
from meshtrace.surfaces import FlatSea, SinusoidalSea
few = {"photons": 32, "seed": 3, "threads": 1}
wave = SinusoidalSea(amplitude=0.05, wavelength=4.0)
cases = {
    "still": lambda: mt.simulate(mt.Link(), FlatSea(), **few),
    "wave": lambda: mt.simulate(mt.Link(), wave, mesh=mt.Meshing(extent=3.0, spacing=1.0), **few),
    "down": lambda: mt.simulate(mt.Link().mirrored(), FlatSea(), **few),
    "analog": lambda: mt.simulate(
        mt.Link().replace("receiver.radius", 3.0), FlatSea(), estimator="analog", **few
    ),
}
found = cases[sys.argv[1]]()
print(json.dumps([found.gain, found.gain_stderr]))
"""


@pytest.mark.parametrize(
    "case",
    [
        pytest.param("still", marks=pytest.mark.thorough),
        *(pytest.param(n, marks=pytest.mark.slow) for n in ("wave", "down", "analog")),
    ],
)
def test_plain_python_gives_the_digits_of_compiled_kernels(case):
    """Records of numpy once had no attributes there, and every run ended in a traceback."""
    (plain, compiled) = (
        subprocess.run(
            [sys.executable, "-W", "ignore", "-c", RUN, case],
            env={**os.environ, "NUMBA_DISABLE_JIT": disabled},
            capture_output=True,
            text=True,
            timeout=600,
        )
        for disabled in "10"
    )
    assert plain.returncode == 0, plain.stderr
    assert json.loads(plain.stdout) == pytest.approx(
        json.loads(compiled.stdout), rel=1e-12, abs=0.0
    )
    assert json.loads(compiled.stdout)[0] > 0.0
