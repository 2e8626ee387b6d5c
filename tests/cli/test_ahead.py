"""A second process compiles the kernels that a first run needs, and ends with the block."""

from __future__ import annotations

import subprocess
import sys

import pytest

from meshtrace.cli import console
from meshtrace.scenario import Scenario

pytestmark = pytest.mark.process

SAME = """
import sys
from meshtrace.cli.console import compile_ahead
from meshtrace.engine.chains import microfacets
from meshtrace.engine.chains import gain as chain_gain
from meshtrace.engine.chains import unscattered
from meshtrace.kernels import scene
from meshtrace.scenario import Scenario

compile_ahead(sys.argv[1])
kernels = (microfacets.blurred_gain, chain_gain.blurred_contributions, chain_gain.contributions,
           unscattered.image_gain, scene.facet_summary, scene.count_bins, scene.fill_bins)
ahead = [kernel.signatures for kernel in kernels]
Scenario.from_toml(sys.argv[1]).simulate()
for kernel, before in zip(kernels, ahead, strict=True):
    print(kernel.__name__, len(before), kernel.signatures == before)
"""
SEAS = {
    "tilted": ("", {"blurred_gain", "blurred_contributions"}),
    "flat": ('[sea]\nspectrum = "flat"\n', {"image_gain", "contributions"}),
    "facets": ('[run]\nnormals = "facet"\n', {"blurred_gain", "blurred_contributions"}),
}


@pytest.mark.parametrize("sea", SEAS)
@pytest.mark.thorough
def test_kernels_are_those_of_a_run(sea):
    """A run compiles no other signature of the kernels that were compiled ahead."""
    toml, wanted = SEAS[sea]
    command = [sys.executable, "-c", SAME, Scenario.from_toml(toml).to_toml()]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    rows = dict(line.split(maxsplit=1) for line in done.stdout.splitlines())
    wanted = wanted | {"facet_summary", "count_bins", "fill_bins"}
    assert {name for name, row in rows.items() if row == "1 True"} == wanted
    assert {name for name, row in rows.items() if row == "0 True"} == set(rows) - wanted


def test_process_ends_with_the_block(monkeypatch):
    started = []
    popen = subprocess.Popen
    monkeypatch.setattr(
        console.subprocess, "Popen", lambda *a, **k: started.append(popen(*a, **k)) or started[-1]
    )
    with console.compiling_ahead(Scenario.from_toml("")):
        assert started[0].poll() is None
    assert started[0].returncode != 0


def test_block_runs_without_a_process(monkeypatch):
    def refuse(*_, **__):
        raise OSError("no more processes")

    monkeypatch.setattr(console.subprocess, "Popen", refuse)
    with console.compiling_ahead(Scenario.from_toml("")):
        pass


def test_analog_run_and_single_core_start_no_process(monkeypatch):
    monkeypatch.setattr(console.subprocess, "Popen", lambda *_, **__: pytest.fail("started"))
    with console.compiling_ahead(Scenario.from_toml('[run]\nestimator = "analog"\n')):
        pass
    monkeypatch.setattr("meshtrace.parallel.default_threads", lambda: 1)
    with console.compiling_ahead(Scenario.from_toml("")):
        pass
