"""Registry of variables: CF units, long name and symbol; parameters as docstrings describe them."""

from __future__ import annotations

import inspect
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from meshtrace.errors import Refused, did_you_mean


class Field(NamedTuple):
    """Metadata of a variable: UDUNITS `units`, `long_name`, and `symbol` as TeX without dollars."""

    units: str
    long_name: str
    symbol: str


_TABLE = tomllib.loads(Path(__file__).with_name("fields.toml").read_text(encoding="utf-8"))
FIELDS: Mapping[str, Field] = MappingProxyType({name: Field(*row) for name, row in _TABLE.items()})
"""Metadata by name of the variable, from `fields.toml`."""


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
        If the name is not registered; the message offers similar names.

    Examples
    --------
    >>> field("wind_speed").units
    'm s-1'
    """
    plain = isinstance(name, str)
    if plain and name in FIELDS:
        return FIELDS[name]
    for ending, (what, wrap) in _ERRORS.items() if plain else ():
        if name.endswith(ending) and name.removesuffix(ending) in FIELDS:
            units, long_name, symbol = FIELDS[name.removesuffix(ending)]
            return Field(units, f"{what} of the {long_name}", wrap.format(symbol))
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
        A new dictionary at each call.

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


_SECTION = re.compile(r"^Parameters\n-+\n(.*?)(?=^[^\n]+\n-+$|\Z)", re.M | re.S)
_ENTRY = re.compile(r"^(\w[\w, ]*?)(?: : (.*))?\n((?: .*\n|\n)+)", re.M)


def entries(owner: Any) -> dict[str, tuple[str, str]]:
    """Return type and text of each parameter of a function, or of a class and its bases.

    A text "See ..." does not replace that of a base, nor does one without a type.
    """
    found: dict[str, tuple[str, str]] = {}
    for one in reversed(getattr(owner, "__mro__", (owner,))):
        section = _SECTION.search(f"{inspect.cleandoc(one.__doc__ or '')}\n")
        for names, kind, text in _ENTRY.findall(section[1] if section else ""):
            text = " ".join(text.split())
            refers = not kind or text.startswith("See ")
            for name in names.split(", "):
                found[name] = kind, found[name][1] if refers and name in found else text
    return found
