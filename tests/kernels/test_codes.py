"""Codes of kernels as numba before 0.68 takes them."""

import ast
import sys
from pathlib import Path

import pytest

import meshtrace
from meshtrace.kernels import jit

KERNELS = [path for path in jit.kernel_files() if path.stem != "bvh"]
"""Those of the intersectors know the mesh."""
BESIDE = [path for path in KERNELS if path.parent.name != "kernels"]


def parts(tree):
    """Yield the indices and the returned values of a module."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Subscript):
            yield node.slice
        elif isinstance(node, ast.Return) and node.value is not None:
            yield node.value


def members(node, codes):
    """Return the members of enumerations in an expression that stand for no `.value`."""
    plain = isinstance(node, ast.Compare | ast.BinOp)
    if plain or (isinstance(node, ast.Attribute) and node.attr == "value"):
        return []
    if isinstance(node, ast.Attribute) and getattr(node.value, "id", "") in codes:
        return [ast.unparse(node)]
    return [found for child in ast.iter_child_nodes(node) for found in members(child, codes)]


@pytest.fixture(scope="module")
def codes():
    trees = (ast.parse(path.read_text(encoding="utf-8")) for path in KERNELS)
    classes = (node for tree in trees for node in tree.body if isinstance(node, ast.ClassDef))
    return {node.name for node in classes if "IntEnum" in map(ast.unparse, node.bases)}


@pytest.mark.parametrize("path", KERNELS, ids=lambda path: path.stem)
def test_codes_index_arrays_and_return_as_numbers(path, codes):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    assert [member for part in parts(tree) for member in members(part, codes)] == []


@pytest.mark.parametrize("path", BESIDE, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_kernels_beside_their_drivers_know_numba_numpy_and_kernels(path):
    root = Path(meshtrace.__file__).parents[1]
    kernels = {".".join(p.relative_to(root).with_suffix("").parts) for p in KERNELS}
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            whole = {f"{node.module}.{alias.name}" for alias in node.names}
            names |= whole if whole <= kernels else {node.module}
    assert names <= kernels | {"numba", "numpy", "numpy.typing"} | set(sys.stdlib_module_names)
