"""Examples in docstrings run, and print the digits that they state."""

import doctest
import importlib
import inspect
from pathlib import Path

import pytest

import meshtrace
import paper

ROOMS = (meshtrace, meshtrace.surfaces, meshtrace.viz, paper)
MODULES = sorted(
    {
        ".".join([room.__name__, *file.relative_to(folder).with_suffix("").parts])
        for room in ROOMS
        for folder in [Path(room.__file__).parent]
        for file in folder.rglob("*.py")
        if not file.name.startswith("__")
    }
)
SLOW = {
    "meshtrace.apps.explorer.page",
    "meshtrace.optics.mie",
    "meshtrace.studies.convergence",
    "meshtrace.studies.comparison",
    "meshtrace.studies.sensitivity",
}
LONG = {"meshtrace.apps.designs.study"}  # a design, as in the tests of its room


def marks_of(name):
    return [pytest.mark.slow] * (name in LONG) + [pytest.mark.thorough] * (name in SLOW)


class Finder(doctest.DocTestFinder):
    """Finder that sees behind decorators, whose functions belong to another module."""

    def _from_module(self, module, object):
        return super()._from_module(module, inspect.unwrap(object))


@pytest.mark.parametrize("name", [pytest.param(n, marks=marks_of(n)) for n in MODULES])
def test_examples_of_a_module(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    runner = doctest.DocTestRunner()
    for test in Finder().find(importlib.import_module(name)):
        runner.run(test)
    assert runner.failures == 0


def test_examples_of_decorated_functions_are_found():
    found = Finder().find(importlib.import_module("meshtrace.optics.fresnel"))
    assert any(test.name.endswith("hemispheric_reflectance") and test.examples for test in found)
