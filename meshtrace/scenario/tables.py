"""One table of a link file to its model, and back to plain data."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

from meshtrace.errors import Refused, require_keys
from meshtrace.models import Model

M = TypeVar("M", bound=Model)
Table = dict[str, Any]


def as_table(value: Any, path: str, word: str = "") -> Table:
    """Return a copy of a table; a bare word stands for a table with the key `word`."""
    if word and isinstance(value, str):
        return {word: value}
    if not isinstance(value, Mapping):
        raise Refused(path, value, "a table")
    return dict(value)


def validated(model: type[M], value: Any, path: str, keys: Iterable[str] = ()) -> M:
    """Return the model that a table describes; `keys` are further keys to name in errors."""
    table = as_table(value, path)
    require_keys(table, list(dict.fromkeys([*keys, *model.model_fields])), path)
    try:
        return model.model_validate(table)
    except Refused as error:
        raise error.inside(*path.split(".")) from None


def plain(part: Any) -> Any:
    """Return a model, or a tuple of them, as plain data."""
    if isinstance(part, tuple):
        return [plain(item) for item in part]
    return part.model_dump(mode="json", exclude_none=True)


def without_shared_wind(table: Table, wind_speed: float) -> Table:
    """Return the table without a wind speed that is that of the scenario."""
    same = table.get("wind_speed") == wind_speed
    return {k: v for k, v in table.items() if not (same and k == "wind_speed")}
