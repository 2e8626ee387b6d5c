"""The text of a link file and its tables: reading, keys, single settings by dotted key."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

from meshtrace.checks import check_call
from meshtrace.errors import Described, Refused, require_keys, within
from meshtrace.models import Model

M = TypeVar("M", bound=Model)
Table = dict[str, Any]

KEYS = tuple(
    "wind_speed physics whitecaps n_air sea water bubbles transmitter receiver planes detector uav "
    "daylight run".split()
)
"""Keys at the top of a link file."""

LARGEST_FILE = 16 * 2**20
"""Bytes of a link file beyond which it is refused."""

_MOST_DOTS = 64  # of a key: the time that TOML takes grows with their square


def read_text(path: str | Path) -> str:
    """Return the text of a link file.

    Raises
    ------
    Refused
        If it is no regular file of at most 16 MB in UTF-8.
    """
    file = Path(path)
    try:
        if file.exists() and not file.is_file():
            raise Refused(str(path), Described("no regular file"), "a TOML file")
        if file.exists() and file.stat().st_size > LARGEST_FILE:
            size = Described(f"{file.stat().st_size / 2**20:.0f} MB")
            raise Refused(str(path), size, f"at most {LARGEST_FILE / 2**20:.0f} MB")
        return file.read_text(encoding="utf-8-sig")  # some editors write a mark
    except OSError as error:
        raise Refused(str(path), Described(error.strerror), "a TOML file") from error
    except ValueError as error:
        if isinstance(error, Refused):
            raise
        raise Refused(str(path), Described(str(error)), "a TOML file in UTF-8") from error


def parse_toml(text: str) -> dict[str, Any]:
    """Return the tables of a text."""
    for line in text.splitlines():
        key = line.partition("=")[0]
        # tables nest by dots: a long key of a stranger's file would nest too deep
        if key.count(".") > _MOST_DOTS and not {",", "#"} & set(key):
            raise Refused("", key, f"keys of at most {_MOST_DOTS} dots")
    try:
        return tomllib.loads(text)
    except ValueError as error:  # also integers of more digits than Python reads
        raise Refused("", Described(str(error)), "TOML") from error
    except RecursionError as error:
        raise Refused("", Described("nested too deeply"), "tables of a link file") from error


@check_call
def parse_setting(setting: str) -> tuple[str, Any]:
    """Split "key=value" into the dotted key and its value, read as TOML or else as a word.

    Raises
    ------
    Refused
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
        raise Refused("", setting, "key=value, as in transmitter.depth=20.0")
    try:
        return key.strip(), parse_toml(f"value = {value}")["value"]
    except Refused:
        # a shell removes the quotes of a word
        return key.strip(), value.strip()


def with_notes(text: str, parts: Mapping[str, Iterable[Any]]) -> str:
    """Return the text of a link file with the notes of its models as comments.

    Parameters
    ----------
    text : str
        Text of a link file.
    parts : mapping of str to models
        Models behind each table; those of inner tables are fields of them.
    """
    lines, models = [], list(parts.get("", ()))
    for line in text.splitlines():
        if line.startswith("["):
            head, *inner = line.strip("[]").split(".")
            models = list(parts.get(head, ()))
            for name in inner:
                models = [getattr(m, name) for m in models if hasattr(m, name)]
        key = line.partition(" = ")[0]
        notes = [type(m).notes() for m in models if isinstance(m, Model)]
        # the first model with such a field: tables may describe several
        note = next((n[key] for n in notes if key in n), "")
        lines.append(f"{line}  # {note}" if note and not line.startswith((" ", "[")) else line)
    return "\n".join(lines) + "\n"


def unset_keys() -> dict[str, list[str]]:
    """Return lines "key = example  # note" of the keys that no default file holds, by table."""
    text = (resources.files("meshtrace") / "link_keys.toml").read_text(encoding="utf-8")
    tables: dict[str, list[str]] = {}
    for line in text.splitlines():
        if line.startswith("["):
            lines = tables.setdefault(line.strip("[]"), [])
        elif line and not line.startswith("#"):
            lines.append(line)
    return tables


def with_unset_keys(text: str, more: str) -> str:
    """Return the text of a link file with keys and tables that it does not hold as comments.

    Parameters
    ----------
    text : str
        Text of a link file.
    more : str
        Text of further tables.
    """
    unset = unset_keys()

    def filled(part: str) -> list[str]:
        lines = []
        for line in part.splitlines():
            keys = unset.pop(line.strip("[]"), []) if line.startswith("[") else []
            lines += [line, *(f"# {key}" for key in keys)]
        return lines

    lines = filled(text)
    further = filled(more)
    for name, keys in unset.items():
        further += ["", f"[{name}]", *keys]
    # tables that the link has not would change it, unless they are comments
    lines += [line if line.startswith("# ") else f"# {line}".rstrip() for line in ["", *further]]
    return "\n".join(lines) + "\n"


_WORDS = {"sea": "", "water": "", "run": "", "bubbles": "model", "whitecaps": "model",
          "daylight": "model", "detector": "preset", "uav": "preset"}  # fmt: skip
"""Tables whose keys are read one by one, with the key that a bare word stands for."""


def located(config: Mapping[str, Any], folder: str | Path) -> Table:
    """Return a copy of nested tables with their paths `file` relative to a folder."""
    copies = [tables := dict(config)]
    for table in copies:  # grows by the tables inside
        for key, value in table.items():
            if isinstance(value, Mapping):
                table[key] = dict(value)
                copies.append(table[key])
            elif isinstance(value, list):
                table[key] = [dict(v) if isinstance(v, Mapping) else v for v in value]
                copies += [v for v in table[key] if isinstance(v, dict)]
            elif key == "file" and isinstance(value, str):
                table[key] = str(Path(folder) / value)
    return tables


def expand_words(tables: Table) -> None:
    """Replace bare words by the tables that they stand for, and missing tables by empty ones."""
    for name, word in _WORDS.items():
        # without [detector], [uav] and [daylight] a scenario has none
        if name in tables or name not in ("detector", "uav"):
            missing = "none" if name == "daylight" else {}
            tables[name] = as_table(tables.get(name, missing), name, word)


def set_value(config: dict[str, Any], key: str, value: Any) -> None:
    """Set the value at a dotted key of nested tables."""
    *parents, last = key.split(".")
    table: Any = config
    for name in parents:
        table = table.setdefault(name, {})
        if not isinstance(table, dict):
            raise Refused(key, value, "a key in a table")
    table[last] = value


def as_table(value: Any, path: str, word: str = "") -> Table:
    """Return a copy of a table; a bare word becomes a table with the key `word`."""
    if word and isinstance(value, str):
        return {word: value}
    if not isinstance(value, Mapping):
        raise Refused(path, value, "a table")
    return dict(value)


def split(table: Table, keys: Iterable[str]) -> tuple[Table, Table]:
    """Return the part of a table that has certain keys, in their order, and the rest."""
    part = {key: table[key] for key in keys if key in table}
    return part, {key: value for key, value in table.items() if key not in part}


def validated(model: type[M], table: Table, path: str, keys: Sequence[str] = ()) -> M:
    """Return the model that a table describes; `keys` are further keys to name in errors."""
    if keys:  # else the model names its own
        require_keys(table, list(dict.fromkeys([*keys, *model.model_fields])), path)
    with within(*filter(None, [path])):
        return model.model_validate(table)


def plain(part: Any) -> Any:
    """Return a model, or a tuple of them, as plain data, and None as it is."""
    if isinstance(part, tuple):
        return [plain(item) for item in part]
    return part and part.model_dump(mode="json", exclude_none=True)


def unshared(table: Table, shared: Table) -> Table:
    """Return the table without the values that it shares with other tables."""
    return {k: v for k, v in table.items() if k not in shared or v != shared[k]}
