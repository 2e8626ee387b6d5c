"""Links of the API pages: from types and names to their pages, and to the pages that use a name."""

from __future__ import annotations

import ast
import pkgutil
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from places import DOCS
from sphinx.application import Sphinx

_PYTHON, _NUMPY = "https://docs.python.org/3/library/", "https://numpy.org/doc/stable/reference/"
ELSEWHERE = {
    "Path": f"{_PYTHON}pathlib.html#pathlib.Path",
    "Generator": f"{_NUMPY}random/generator.html",
    "ndarray": f"{_NUMPY}generated/numpy.ndarray.html",
    "DataArray": "https://docs.xarray.dev/en/stable/generated/xarray.DataArray.html",
    "Dataset": "https://docs.xarray.dev/en/stable/generated/xarray.Dataset.html",
    "Axes": "https://matplotlib.org/stable/api/axes_api.html",
    "Figure": "https://matplotlib.org/stable/api/figure_api.html",
    "PolyData": "https://docs.pyvista.org/api/core/_autosummary/pyvista.polydata",
    "ImageData": "https://docs.pyvista.org/api/core/_autosummary/pyvista.imagedata",
    "Plotter": "https://docs.pyvista.org/api/plotting/_autosummary/pyvista.plotter",
}
"""Types of other packages; a link asks for nothing until it is followed, an inventory would."""

_TYPE = re.compile(r"(?<=\()\*([^*]+)\*(?=\))|(?<=^:returns: )\*([^*\s][^*]*)\*")
_NAME = re.compile(r"(?<![`\w])`(?:mt\.)?(\w+)((?:\.\w+)*)`(?![`_])")
_CELL = re.compile(r"^```(?:\{code-cell\} )?python\n(?:---\n.*?^---\n)?(.*?)^```$", re.M | re.S)
_FOLDERS = ("tutorials", "gallery", "guides", "")  # in the order of the list on a page
_MOST = 6


@cache
def public() -> dict[str, str]:
    """Return the public names of the API pages: the last part of each, and the whole of it."""
    pages = sorted((DOCS / "api").glob("*.md"))
    text = "".join(page.read_text("utf-8") for page in pages)
    return {name.rpartition(".")[2]: name for name in re.findall(r"^   ~(\S+)$", text, re.M)}


def linked(
    app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]
) -> None:
    """Turn types and quoted names of a docstring into links, and list the pages that use it."""
    fields = set(re.findall(r"\*\*(\w+)\*\*", "\n".join(lines)))

    def quoted(found: re.Match[str]) -> str:
        target = public().get(found[1], name)
        if found[1] in fields or name.startswith(target):
            return found[0]
        return f":py:obj:`{found[1]}{found[2]} <{target}>`"

    code: int | None = None  # indentation of the example or directive that a line is in
    for i, line in enumerate(lines):
        indent = len(line) - len(line.lstrip())
        if code is not None and line.strip() and indent <= code:
            code = None
        if line.lstrip().startswith((">>>", ".. ")):
            code = indent - line.lstrip().startswith(">>>")
        elif code is None:
            lines[i] = _NAME.sub(quoted, _TYPE.sub(_linked_type, line))
    pages = users().get(name, []) if what in ("class", "function", "exception") else []
    if pages:
        lines += ["", ".. rubric:: Used in", ""]
        lines += [f"* :doc:`/{page}`" for page in pages[:_MOST]] + [""]


def _linked_type(found: re.Match[str]) -> str:
    """Return the words of a type in italics, with a link for each class."""
    text = found[1] or found[2]
    shown = re.sub(r"\b[A-Z]\w+\b|\bndarray\b", lambda word: _target(word[0]), text)
    parts = re.split(r"(\x00.*?\x00)", shown)
    return r"\ ".join(p.strip("\0") if p[0] == "\0" else _italic(p) for p in parts if p)


def _italic(words: str) -> str:
    """Return words in italics, which may neither begin nor end with a space."""
    inner = words.strip()
    return words.replace(inner, f"*{inner}*") if inner else words


def _target(word: str) -> str:
    """Return a link between two marks, or the word."""
    if word in ELSEWHERE:
        return f"\0`{word} <{ELSEWHERE[word]}>`__\0"
    return f"\0:py:obj:`{word} <{public()[word]}>`\0" if word in public() else word


@cache
def users() -> dict[str, list[str]]:
    """Return the pages whose code uses a public name, by the name."""
    names = {id(pkgutil.resolve_name(name)): name for name in public().values()}
    found: dict[str, list[str]] = {}
    for folder in _FOLDERS:
        pages = (DOCS / folder).glob("*.py" if folder == "gallery" else "*.md")
        for path in sorted(pages, key=_title):
            page = f"examples/{path.stem}" if folder == "gallery" else f"{folder}/{path.stem}"
            text = path.read_text("utf-8")
            code = text if folder == "gallery" else "\n".join(_CELL.findall(text))
            for name in sorted({names[id(o)] for o in _objects(ast.parse(code)) if id(o) in names}):
                found.setdefault(name, []).append(page.lstrip("/"))
    return found


def _title(path: Path) -> str:
    """Return the title of a page, or of a script of the gallery."""
    found = re.search(r'^(?:# |"""\n)(.+)', path.read_text("utf-8"), re.M)
    return found[1] if found else path.stem


def _objects(tree: ast.AST) -> Iterator[object]:
    """Yield the objects of meshtrace that code names."""
    names = {"mt": "meshtrace"}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("meshtrace"):
            names |= {a.asname or a.name: f"{node.module}.{a.name}" for a in node.names}
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute | ast.Name):
            first, dot, rest = ast.unparse(node).partition(".")
            if first in names:
                try:
                    yield pkgutil.resolve_name(names[first] + dot + rest)
                except (AttributeError, ImportError, ValueError):  # a call, an index
                    continue
