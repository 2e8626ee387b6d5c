"""Units, long name and symbol of each variable; parameters as docstrings describe them."""

from __future__ import annotations

import ast
import inspect
import re
import sys
import tomllib
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from meshtrace.errors import Refused, did_you_mean


class Field(NamedTuple):
    """Metadata of a variable: `units` for UDUNITS, `long_name`, and `symbol` in TeX without $."""

    units: str
    long_name: str
    symbol: str


_TABLE = tomllib.loads(Path(__file__).with_name("fields.toml").read_text(encoding="utf-8"))
FIELDS: Mapping[str, Field] = MappingProxyType({name: Field(*row) for name, row in _TABLE.items()})
"""Metadata by name of the variable, from `fields.toml`."""


# by the end of a variable's name: words for the long name, and a template for the symbol
_ERRORS = {
    "_stderr": ("standard error", r"\sigma({})"),
    "_low": ("lower confidence limit", "{{{}}}_-"),
    "_high": ("upper confidence limit", "{{{}}}_+"),
}


def field(name: str) -> Field:
    """Return the registered field of a variable.

    Parameters
    ----------
    name : str
        Name of the variable, as in results and datasets.

    Returns
    -------
    Field
        Units, long name and symbol.

    Raises
    ------
    Refused
        If the name is not registered; the message suggests similar names.

    Examples
    --------
    >>> field("wind_speed").units
    'm s-1'
    """
    is_text = isinstance(name, str)
    if is_text and name in FIELDS:
        return FIELDS[name]
    # standard errors and confidence limits are not in the table: they follow from the variable
    for ending, (words, template) in _ERRORS.items() if is_text else ():
        if name.endswith(ending) and name.removesuffix(ending) in FIELDS:
            units, long_name, symbol = FIELDS[name.removesuffix(ending)]
            return Field(units, f"{words} of the {long_name}", template.format(symbol))
    raise Refused("name", name, "the keys of meshtrace.fields.FIELDS", did_you_mean(name, FIELDS))


def attrs(name: str) -> dict[str, str]:
    """Return the attributes of a variable for xarray: units, long_name and symbol.

    Parameters
    ----------
    name : str
        Name of the variable, as in results and datasets.

    Returns
    -------
    dict
        A new dictionary in each call.

    Raises
    ------
    Refused
        If the name is not registered.

    Examples
    --------
    >>> attrs("hs")
    {'units': 'm', 'long_name': 'significant wave height', 'symbol': 'H_s'}
    """
    return field(name)._asdict()


# section of the parameters in a docstring of numpydoc, and an entry in it: names, type, text
_SECTION = re.compile(r"^Parameters\n-+\n(.*?)(?=^[^\n]+\n-+$|\Z)", re.M | re.S)
_ENTRY = re.compile(r"^(\w[\w, ]*?)(?: : (.*))?\n((?: .*\n|\n)+)", re.M)


def docstring(owner: Any) -> str:
    """Return the docstring of a function or class, "" if it has none.

    Where Python has removed the docstrings (-OO), it is read from the source.
    """
    text = owner.__doc__ or ""
    if sys.flags.optimize >= 2:  # without one, a dataclass gets its signature as docstring
        module = sys.modules.get(owner.__module__)
        text = _written(getattr(module, "__file__", None) or "").get(owner.__qualname__, "")
    return inspect.cleandoc(text)


@cache
def _written(file: str) -> dict[str, str]:
    """Return the docstrings of the functions and classes of a source file by qualified name."""

    def named(node: ast.AST, scope: str) -> Iterator[tuple[str, str]]:
        for part in ast.iter_child_nodes(node):
            if isinstance(part, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                name = f"{scope}{part.name}"
                yield name, ast.get_docstring(part) or ""
                separator = ".<locals>." if not isinstance(part, ast.ClassDef) else "."
                yield from named(part, f"{name}{separator}")

    try:
        return dict(named(ast.parse(Path(file).read_bytes()), ""))
    except (OSError, SyntaxError, ValueError):  # no source beside the byte code
        return {}


def entries(owner: Any) -> dict[str, tuple[str, str]]:
    """Return type and description of each parameter of a function, or of a class and its bases.

    A class replaces what its bases say, except by a text "See ..." or an entry without a type.
    """
    described: dict[str, tuple[str, str]] = {}
    for documented in reversed(getattr(owner, "__mro__", (owner,))):
        section = _SECTION.search(f"{docstring(documented)}\n")
        for names, kind, text in _ENTRY.findall(section[1] if section else ""):
            text = " ".join(text.split())
            # "See `Base`" and entries of names alone refer to the description by a base
            refers = not kind or text.startswith("See ")
            for name in names.split(", "):
                is_described = refers and name in described
                described[name] = kind, described[name][1] if is_described else text
    return described
