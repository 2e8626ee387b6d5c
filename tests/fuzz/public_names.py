"""All public functions, classes and methods: those on the pages of the API and in the stubs."""

import ast
import importlib
import inspect
import re
from functools import cache
from pathlib import Path

import meshtrace

ROOT = Path(__file__).parents[2]


def _names():
    """Yield the dotted names on docs/api and in every `__init__.pyi`."""
    for page in sorted((ROOT / "docs" / "api").glob("*.md")):
        yield from re.findall(r"~(meshtrace[\w.]+)", page.read_text(encoding="utf-8"))
    package = Path(meshtrace.__file__).parent
    beside = (Path(room.__file__).parent for room in (meshtrace.surfaces, meshtrace.viz))
    rooms = [package, *(path for path in package.iterdir() if path.is_dir()), *beside]
    for room in rooms:
        stub = room / "__init__.pyi"
        if stub.exists():
            name = "meshtrace" if room == package else f"meshtrace.{room.name}"
            for node in ast.parse(stub.read_text(encoding="utf-8")).body:
                if isinstance(node, ast.ImportFrom):
                    yield from (f"{name}.{alias.name}" for alias in node.names)


def _object(name):
    """Return the object of a dotted name."""
    words = name.split(".")
    for k in range(len(words), 0, -1):
        try:
            value = importlib.import_module(".".join(words[:k]))
        except ImportError:
            continue
        for word in words[k:]:
            value = getattr(value, word)
        return value
    raise LookupError(name)


@cache
def objects():
    """Return all public functions and classes of the package by their shortest name."""
    found = {}
    for name in sorted(set(_names()), key=lambda name: (name.count("."), name)):
        value = _object(name)
        if callable(value) and getattr(value, "__module__", "").startswith("meshtrace"):
            if not any(value is other for other in found.values()):
                found[name.removeprefix("meshtrace.")] = value
    return found


@cache
def callables():
    """Return (function, class or None) by name, methods of public classes included."""
    found = {}
    for name, value in objects().items():
        if not inspect.isclass(value):
            if not hasattr(value, "py_func"):  # kernels take what numba's types allow
                found[name] = (value, None)
            continue
        for method in sorted(vars(value)):
            member = vars(value)[method]
            function = getattr(member, "__func__", member)
            if method.startswith("_") or not inspect.isfunction(function):
                continue
            if function.__module__.startswith("meshtrace"):
                found[f"{name}.{method}"] = (function, value)
    return found
