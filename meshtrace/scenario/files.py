"""The text of a link file: reading it, its keys at the top, and single settings by dotted key."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from meshtrace.errors import ScenarioError, one_line, show

KEYS = (
    "wind_speed",
    "physics",
    "whitecaps",
    "n_air",
    "sea",
    "water",
    "bubbles",
    "transmitter",
    "receiver",
    "planes",
    "detector",
    "uav",
    "run",
)
"""Keys at the top of a link file."""


def read_text(path: str | Path) -> str:
    """Return the text of a link file."""
    try:
        return Path(path).read_text(encoding="utf-8")
    except OSError as error:
        raise ScenarioError(f"{path}: {error.strerror}, allowed: a TOML file") from error
    except UnicodeDecodeError as error:
        raise ScenarioError(f"{path}: {error}, allowed: a TOML file in UTF-8") from error


def parse_toml(text: str) -> dict[str, Any]:
    """Return the tables of a text."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ScenarioError(f"{one_line(str(error))}, allowed: TOML") from error
    except RecursionError as error:
        raise ScenarioError("nested too deeply, allowed: tables of a link file") from error


def parse_setting(setting: str) -> tuple[str, Any]:
    """Split "key=value" into the dotted key and its value, read as TOML or else as a word.

    Raises
    ------
    ScenarioError
        If there is no "=" or no key.

    Examples
    --------
    >>> parse_setting("transmitter.depth=20.0")
    ('transmitter.depth', 20.0)
    >>> parse_setting("sea.spectrum=flat")
    ('sea.spectrum', 'flat')
    """
    key, equals, value = setting.partition("=")
    if not equals or not key.strip():
        raise ScenarioError(f"{setting!r}, allowed: key=value, as in transmitter.depth=20.0")
    try:
        return key.strip(), tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return key.strip(), value.strip()


def set_value(config: dict[str, Any], key: str, value: Any) -> None:
    """Set the value at a dotted key of nested tables."""
    *parents, last = key.split(".")
    table: Any = config
    for name in parents:
        table = table.setdefault(name, {})
        if not isinstance(table, dict):
            raise ScenarioError(f"{key}: {show(value)}, allowed: a key in a table")
    table[last] = value
