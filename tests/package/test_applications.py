"""Applications use names that the documentation lists, and nothing of the engine."""

import ast
import inspect
import re
from importlib import import_module
from pathlib import Path

import pytest

import meshtrace
import meshtrace.viz.live
import meshtrace.viz.marks
import meshtrace.viz.parts
import meshtrace.viz.scenes

PACKAGE = Path(meshtrace.__file__).parent
PAGE = Path(__file__).parents[2] / "docs" / "api" / "writers.md"
FILES = sorted((PACKAGE / "apps").rglob("*.py"))


def offered():
    """Return (module, name) of the page for writers of applications, with the object."""
    rows = {}
    for line in PAGE.read_text("utf-8").splitlines():
        if line.startswith("| `meshtrace"):
            modules, words = line.strip("| ").split(" | ", 1)
            for name in set(re.findall(r"`(\w+)`", words)):
                homes = [import_module(module) for module in re.findall(r"`([\w.]+)`", modules)]
                homes_of_name = [home for home in homes if hasattr(home, name)]
                assert homes_of_name, f"{modules} have no {name}"
                rows |= {(home.__name__, name): getattr(home, name) for home in homes_of_name}
    return rows


def stub_names(room):
    """Return the names that a package offers by its stub."""
    places = getattr(import_module(room), "__path__", ["."])
    stub = Path(places[0], "__init__.pyi")
    if not stub.exists():
        return set()
    imports = [n for n in ast.parse(stub.read_text("utf-8")).body if isinstance(n, ast.ImportFrom)]
    return {alias.asname for node in imports for alias in node.names}


def hidden_imports(text, pairs):
    """Yield (module, name) of imports that neither a stub nor the page offers."""
    for node in ast.walk(ast.parse(text)):
        module = node.module or "" if isinstance(node, ast.ImportFrom) else ""
        if module.split(".")[0] != "meshtrace" or node.level or module.startswith("meshtrace.apps"):
            continue
        names = {alias.name for alias in node.names} - stub_names(module)
        yield from ((module, name) for name in names if (module, name) not in pairs)


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_applications_import_public_names(path):
    allowed = {*offered(), ("meshtrace.lazy", "attach")}  # the room's own stub
    assert list(hidden_imports(path.read_text("utf-8"), allowed)) == []


def private_attributes(text):
    """Yield attributes with a leading underscore of objects other than `self` and `cls`."""
    public = {"_replace", "_asdict", "_fields"}  # of a NamedTuple
    for node in ast.walk(ast.parse(text)):
        name = ""
        if isinstance(node, ast.Attribute) and ast.unparse(node.value) not in ("self", "cls"):
            name = node.attr
        elif isinstance(node, ast.Call) and ast.unparse(node.func) in ("getattr", "hasattr"):
            name = getattr(node.args[1], "value", "")
        if name.startswith("_") and not name.startswith("__") and name not in public:
            yield name


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_applications_read_public_attributes(path):
    assert list(private_attributes(path.read_text("utf-8"))) == []


def test_private_attributes_are_found():
    text = "x = getattr(sea, '_slopes', 0.0) + sea._wind + self._own + pair._replace(a=1)[0]"
    assert sorted(private_attributes(text)) == ["_slopes", "_wind"]


def test_hidden_names_are_found():
    text = "from meshtrace.engine.forced import ForcedDetection\nfrom meshtrace import simulate\n"
    assert list(hidden_imports(text, offered())) == [("meshtrace.engine.forced", "ForcedDetection")]


def test_offered_functions_and_classes_have_docstrings():
    bare = [
        name for (_, name), value in offered().items()
        if (inspect.isfunction(value) or inspect.isclass(value)) and not value.__doc__
    ]  # fmt: skip
    assert bare == []
