"""Tests take public names from the room that offers them, so that files within a room may move."""

import ast
from importlib import import_module
from pathlib import Path

TESTS = Path(__file__).parents[1]


def inner_imports(text):
    """Return (room, name) of public names that a text imports from a file within their room."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").count(".") > 1:
            package, room, *_ = node.module.split(".")
            if package == "meshtrace":
                inner, public = import_module(node.module), import_module(f"{package}.{room}")
                yield from (
                    (room, alias.name)
                    for alias in node.names
                    if getattr(public, alias.name, inner) is getattr(inner, alias.name, None)
                )


def test_public_names_come_from_their_room():
    found = {path.name: list(inner_imports(path.read_text())) for path in TESTS.rglob("*.py")}
    assert {name: names for name, names in found.items() if names} == {}
    assert list(inner_imports("from meshtrace.comms.ook import OokLink")) == [("comms", "OokLink")]
