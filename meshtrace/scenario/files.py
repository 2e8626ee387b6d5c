"""Text and tables of link files: parsing, notes on keys, and settings by dotted key."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

from meshtrace.checks import check_call
from meshtrace.errors import Described, Refused, require_keys, within
from meshtrace.models import Model

M = TypeVar("M", bound=Model)
Table = dict[str, Any]

KEYS = tuple(
    "wind_speed physics whitecaps n_air sea water bubbles transmitter receiver planes objects "
    "detector uav daylight run".split()
)
"""Keys at the top of a link file."""

LARGEST_FILE = 16 * 2**20
"""Largest size of a link file [bytes]; larger ones are refused."""

_MOST_DOTS = 64  # in a key, tuned: the time to parse it grows with their square


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
        return file.read_text(encoding="utf-8-sig")  # some editors write a byte order mark
    except OSError as error:
        raise Refused(str(path), Described(error.strerror), "a TOML file") from error
    except ValueError as error:
        if isinstance(error, Refused):
            raise
        raise Refused(str(path), Described(str(error)), "a TOML file in UTF-8") from error


def parse_toml(text: str) -> dict[str, Any]:
    """Return the tables that the text of a link file describes."""
    for line in text.splitlines():
        key = line.partition("=")[0]
        # each dot nests one more table: a malicious key would exhaust time or stack. "," and "#"
        # tell lines that are no keys: items of an array, comments
        if key.count(".") > _MOST_DOTS and not {",", "#"} & set(key):
            raise Refused("", key, f"keys of at most {_MOST_DOTS} dots")
    try:
        return tomllib.loads(text)
    except ValueError as error:  # TOMLDecodeError, or an integer of more digits than int() reads
        raise Refused("", Described(str(error)), "TOML") from error
    except RecursionError as error:
        raise Refused("", Described("nested too deeply"), "tables of a link file") from error


@check_call
def parse_setting(setting: str) -> tuple[str, Any]:
    """Split "key=value" into the dotted key and its value, parsed as TOML or else taken as a word.

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
        # not TOML, such as a word whose quotes the shell has removed
        return key.strip(), value.strip()


def with_notes(text: str, parts: Mapping[str, Iterable[Any]]) -> str:
    """Return the text of a link file with the notes of its models as comments.

    Parameters
    ----------
    text : str
        Text of a link file.
    parts : mapping of str to models
        Models whose fields are the keys of each table; those of inner tables are fields of them.
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
        # several models may share a table: the first that has such a field
        note = next((n[key] for n in notes if key in n), "")
        lines.append(f"{line}  # {note}" if note and not line.startswith((" ", "[")) else line)
    return "\n".join(lines) + "\n"


def unset_keys() -> dict[str, list[str]]:
    """Return lines "key = example  # note" by table, for keys that no default link file has."""
    text = (resources.files("meshtrace") / "link_keys.toml").read_text(encoding="utf-8")
    tables: dict[str, list[str]] = {}
    for line in text.splitlines():
        if line.startswith("["):
            lines = tables.setdefault(line.strip("[]"), [])
        elif line and not line.startswith("#"):
            lines.append(line)
    return tables


def dotted(tables: Mapping[str, Any], path: str = "") -> Iterator[str]:
    """Yield the dotted keys of nested tables."""
    for key, value in tables.items():
        name = f"{path}{key}"
        yield name
        if isinstance(value, Mapping):
            yield from dotted(value, f"{name}.")


def with_unset_keys(text: str, more: str) -> str:
    """Add missing keys and tables to the text of a link file as comments.

    Parameters
    ----------
    text : str
        Text of a link file.
    more : str
        Text of tables that it lacks.
    """
    unset = unset_keys()

    def filled(part: str) -> list[str]:
        """Return the lines of a text, with the unset keys below the head of each table."""
        lines = []
        for line in part.splitlines():
            keys = unset.pop(line.strip("[]"), []) if line.startswith("[") else []
            lines += [line, *(f"# {key}" for key in keys)]
        return lines

    lines = filled(text)
    further = filled(more)
    # `filled` has popped the tables of both texts: those in neither are left
    for name, keys in unset.items():
        further += ["", f"[{name}]", *keys]
    # as comments: tables that the link lacks would change it
    lines += [line if line.startswith("# ") else f"# {line}".rstrip() for line in ["", *further]]
    return "\n".join(lines) + "\n"


_WORDS = {"sea": "", "water": "", "run": "", "bubbles": "model", "whitecaps": "model",
          "daylight": "model", "detector": "preset", "uav": "preset"}  # fmt: skip
"""Tables that may be missing, each with the key that a bare word stands for ("": no word)."""


def located(config: Mapping[str, Any], folder: str | Path) -> Table:
    """Return a copy of nested tables with a folder prepended to the paths of files.

    These are the keys `file`, and those of bodies.
    """
    copies = [tables := dict(config)]
    for table in copies:  # the list grows by the tables inside each
        for key, value in table.items():
            if isinstance(value, Mapping):
                table[key] = dict(value)
                copies.append(table[key])
            elif isinstance(value, list):
                table[key] = [dict(v) if isinstance(v, Mapping) else v for v in value]
                copies += [v for v in table[key] if isinstance(v, dict)]
            elif key == "file" and isinstance(value, str):
                table[key] = str(Path(folder) / value)
    objects = tables.get("objects")
    # one body may be a table [objects], several are tables [[objects]]
    bodies = objects if isinstance(objects, list) else [objects]
    places = [(body, key) for body in bodies for key in ("mesh", "albedo")]
    for owner, key in [*places, (tables.get("water"), "bottom")]:
        if isinstance(owner, dict) and isinstance(owner.get(key), str):
            owner[key] = str(Path(folder) / owner[key])
    return tables


def expand_words(tables: Table) -> None:
    """Replace bare words in place by the tables that they stand for, and add missing tables."""
    for name, word in _WORDS.items():
        # missing [detector] and [uav] stay missing, and a missing [daylight] is "none": then the
        # scenario has no such part, whereas an empty table stands for the defaults
        if name in tables or name not in ("detector", "uav"):
            missing = "none" if name == "daylight" else {}
            tables[name] = as_table(tables.get(name, missing), name, word)


def set_value(config: dict[str, Any], key: str, value: Any) -> None:
    """Set the value at a dotted key of nested tables, in place; missing tables are added."""
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
    """Split a table into its entries at `keys`, in the order of these, and all others."""
    part = {key: table[key] for key in keys if key in table}
    return part, {key: value for key, value in table.items() if key not in part}


def validated(model: type[M], table: Table, path: str, keys: Sequence[str] = ()) -> M:
    """Return the model that a table describes; `keys` are further keys to name in errors."""
    if keys:  # without these the model itself refuses unknown keys, and names its own
        require_keys(table, list(dict.fromkeys([*keys, *model.model_fields])), path)
    with within(*filter(None, [path])):
        return model.model_validate(table)


def plain(part: Any) -> Any:
    """Convert a model, or a tuple of models, to plain data; pass None through."""
    if isinstance(part, tuple):
        return [plain(item) for item in part]
    return part and part.model_dump(mode="json", exclude_none=True)


def unshared(table: Table, shared: Table) -> Table:
    """Drop the entries of a table that `shared` contains."""
    return {k: v for k, v in table.items() if k not in shared or v != shared[k]}
