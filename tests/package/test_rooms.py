"""Tests take names from the package or room that offers them, so that files within a room may move."""

import ast
from importlib import import_module
from pathlib import Path

TESTS = Path(__file__).parents[1]


def inner_imports(text):
    """Return (place, name) of names that a text imports from a file below a place that offers them."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").count(".") > 1:
            package, room, *_ = node.module.split(".")
            if package == "meshtrace":
                inner = import_module(node.module)
                yield from (
                    (place, alias.name)
                    for alias in node.names
                    for place in (package, f"{package}.{room}")
                    if getattr(import_module(place), alias.name, inner)
                    is getattr(inner, alias.name, None)
                )


def test_public_names_come_from_their_room():
    found = {path.name: list(inner_imports(path.read_text())) for path in TESTS.rglob("*.py")}
    assert {name: names for name, names in found.items() if names} == {}
    assert list(inner_imports("from meshtrace.comms.ook import OokLink")) == [
        ("meshtrace", "OokLink"),
        ("meshtrace.comms", "OokLink"),
    ]
