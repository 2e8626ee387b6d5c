"""`meshtrace warm` compiles what users meet first; a default run compiles few kernels."""

import json
import os
import subprocess
import sys
from contextlib import nullcontext
from functools import partial
from importlib import import_module

import pytest
from command_line import meshtrace

from meshtrace.cli import console, tools

SIGNATURES = """
import json, sys
from meshtrace.cli import app
app({arguments!r}, standalone_mode=False)
{then}
from meshtrace.kernels.jit import _Entry
modules = [m for name, m in list(sys.modules.items()) if name.startswith("meshtrace.")]
entries = {{e for m in modules for e in vars(m).values() if isinstance(e, _Entry)}}
print(json.dumps({{e.py_func.__name__: len(e.signatures) for e in entries}}))
"""


def signatures_after(*arguments, then=""):
    """Return the number of compiled signatures of each kernel after a command and further code."""
    code = SIGNATURES.format(arguments=arguments, then=then)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.process
@pytest.mark.thorough
def test_a_default_run_compiles_few_kernels():
    n = signatures_after("run")
    # each takes some seconds to compile
    assert sum(n.values()) <= 11
    assert n["follow"] == n["follow_joined"] == n["tint_chains"] == 0


COMPILED = """
import gc
import meshtrace as mt
mt.Scenario.from_toml("").simulate()
from numba.core.registry import CPUDispatcher
functions = [d for d in gc.get_objects() if isinstance(d, CPUDispatcher)]
print(sum(len(d.overloads) for d in functions))
"""


@pytest.mark.process
@pytest.mark.slow
def test_the_first_run_compiles_no_more_functions_than_it_did(tmp_path):
    """Each takes some 0.15 s; 187 when this was written, those of Mie theory included."""
    folders = {"MESHTRACE_CACHE_DIR": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path / "numba")}
    command, env = [sys.executable, "-W", "ignore", "-c", COMPILED], os.environ | folders
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=env)
    assert 100 < int(done.stdout.split()[-1]) <= 190


@pytest.mark.process
@pytest.mark.thorough
def test_warm_compiles_colours_turbid_water_background_and_irradiance():
    n = signatures_after("warm")
    # of one and of several wavelengths, and at one wavelength beside bodies
    assert n["follow"] == 3
    # of one and of several wavelengths: up, under water, and both beside bodies; with facets alone
    assert n["follow_joined"] == 9
    assert n["facet_hits"] == 1  # one for both
    names = ("tint_chains", "tint_straight", "land_sunlight", "add_upwelling", "split_rays")
    assert all(n[name] for name in names)
    assert n["best_thresholds"] == 1  # of error rates


@pytest.mark.parametrize("compiled", [True, False])
def test_a_second_process_compiles_the_kernels_of_the_last_run_first(monkeypatch, compiled):
    """Where all are there, it would repeat all runs for nothing."""
    done, started = [], []
    monkeypatch.setattr(
        tools, "_runs_of_all_kernels", lambda: [partial(done.append, i) for i in range(3)]
    )
    monkeypatch.setattr(console, "kernels_are_compiled", lambda estimator: compiled)
    monkeypatch.setattr(
        console, "compiling_beside", lambda *name: started.append(name) or nullcontext()
    )
    assert meshtrace("warm").exit_code == 0
    assert done == [0, 1, 2]
    assert len(started) == (not compiled)
    for (name,) in started:
        module, _, function = name.partition(":")
        getattr(import_module(module), function)()
        assert done[3:] == [2, 1, 0]


UNDER_AND_BESIDE = """
import warnings
import meshtrace as mt
from meshtrace.link import Body
warnings.simplefilter("ignore")
plate = mt.TriangleMesh([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [(0, 1, 2), (0, 2, 3)])
bodies = tuple(Body(mesh=plate, position=(0.5, 0.0, z), albedo=0.0) for z in (-3.0, 2.0))
ends = {"under": mt.WaterReceiver(depth=5.0), "up": mt.Receiver(height=4.0)}
for end, objects in ((e, o) for e in ends.values() for o in ((), bodies)):
    for spectrum in (None, [480.0, 520.0]):
        water = mt.Water() if spectrum is None else mt.Water.from_type("jerlov-II")
        link = mt.Link(water=water, receiver=end, objects=objects)
        mt.simulate(link, mt.surfaces.FlatSea(), photons=32, wavelengths_nm=spectrum)
        mt.simulate(link, mt.JonswapSea(), photons=32, wavelengths_nm=spectrum)
    mt.simulate(link, mt.surfaces.FlatSea(), "analog", photons=32)
"""


@pytest.mark.process
@pytest.mark.slow
def test_links_under_water_and_beside_bodies_compile_nothing_after_warm():
    assert signatures_after("warm", then=UNDER_AND_BESIDE) == signatures_after("warm")
