"""Conversion of pydantic errors to `Refused` with field, value and allowed values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NoReturn

import pydantic

from meshtrace.errors import MISSING, Refused, did_you_mean

# the sign in a range, which is written from low to high ("0 < x"), by the names of pydantic's
# constraints
_SIGNS = {"gt": "<", "ge": "<=", "lt": "<", "le": "<="}
# the allowed values in words, by the type of pydantic's error or the part of it before the first
# "_": "float" stands for "float_parsing" and "float_type"
_ALLOWED_OF_TYPE = {
    "missing": "a value",
    "finite_number": "finite numbers",
    "tuple_type": "a list",
    "list_type": "a list",
    "mapping_type": "a table",
    "dict_type": "a table",
    "model_type": "a table",
    "model_attributes_type": "a table",
    "string_type": "a text",
    "bool": "true or false",
    "float": "a number",
    "int": "an integer",
}


def refuse(
    first: Any, name: str, path: list[Any], cls: type[pydantic.BaseModel] | None = None
) -> NoReturn:
    """Raise `Refused` for one of pydantic's errors (`first`).

    The field is `name` followed by the `path` of the error inside it; for a model (`cls`) it is
    the path alone, or `name` if that is empty.
    """
    kind, cause = first["type"], first.get("ctx", {}).get("error")
    path = path if cls else [name, *words_of(path)]
    if isinstance(cause, Refused):
        if path and cause.field == path[-1]:  # validators of a field name it themselves
            path.pop()
        raise cause.inside(*path) from None
    value = MISSING if kind == "missing" else first["input"]
    allowed, hint = str(cause) if cause else allowed_by(first, cls), ""
    # pydantic lists the words with "or" before the last
    if kind == "literal_error":
        hint = did_you_mean(value, allowed.replace(" or ", ", ").split(", "))
    raise Refused("", value, allowed, hint).inside(*(path or [name])) from None


def words_of(path: list[Any]) -> list[Any]:
    """Return the keys of a path, dotted ones such as "water.a" split as in link files."""
    dotted = (key.split(".") if isinstance(key, str) else [key] for key in path)
    return [word for words in dotted for word in words]


def is_alternative(key: Any) -> bool:
    """Return whether a key in a path of pydantic names an alternative, such as "list[int]"."""
    return isinstance(key, str) and (key.startswith("function-") or key.endswith(("]", ")")))


def allowed_alone(error: Any) -> str:
    """Return the allowed values of one alternative of a union."""
    cause = error.get("ctx", {}).get("error")
    return cause.allowed if isinstance(cause, Refused) else allowed_by(error)


def allowed_by(error: Mapping[str, Any], cls: type[pydantic.BaseModel] | None = None) -> str:
    """Describe the values that a pydantic error allows, for a model field or a single value."""
    kind, context = error["type"], error.get("ctx", {})
    if kind == "literal_error":
        return str(context["expected"].replace("'", ""))
    if kind in ("greater_than", "greater_than_equal", "less_than", "less_than_equal"):
        return _range(cls, list(error["loc"]), context)
    if kind == "too_short":
        return f"at least {context['min_length']} of them"
    if kind == "too_long":
        return f"at most {context['max_length']} of them"
    words = _ALLOWED_OF_TYPE.get(kind) or _ALLOWED_OF_TYPE.get(kind.partition("_")[0])
    return words or str(error["msg"].removeprefix("Input should be "))


def _range(
    cls: type[pydantic.BaseModel] | None, path: list[int | str], context: dict[str, Any]
) -> str:
    """Return the range of a field, as in "> 0" and "0 < fov_deg <= 180"."""
    field = cls.model_fields.get(str(path[0])) if cls and path else None
    if field is None:
        return range_text(context)
    bounds = {key: getattr(part, key) for part in field.metadata for key in _SIGNS
              if getattr(part, key, None) is not None}  # fmt: skip
    # pydantic reports only the bound that was exceeded; the field has the other, too
    return range_text(bounds if context.items() <= bounds.items() else context, str(path[0]))


def range_text(bounds: Mapping[str, Any], name: str = "") -> str:
    """Return a range as text, as in "> 0" and "0 < fov_deg <= 180", "" without bounds."""
    shown = {key: _bound(bounds[key]) for key in _SIGNS if key in bounds}
    low = next((f"{v} {_SIGNS[k]}" for k, v in shown.items() if k in ("gt", "ge")), "")
    high = next((f"{_SIGNS[k]} {v}" for k, v in shown.items() if k in ("lt", "le")), "")
    if low and high:
        return f"{low} {name} {high}"
    # a lower bound alone turns around: "0 <" is written "> 0"
    return high or (low and f"{low.split()[1].replace('<', '>')} {low.split()[0]}")


def _bound(value: Any) -> str:
    """Return a bound as text, large powers of two as such."""
    # 2^53 is easier to read than its sixteen digits
    power = isinstance(value, int) and value > 2**20 and value & (value - 1) == 0
    if power:
        return f"2^{value.bit_length() - 1}"
    return str(value) if isinstance(value, int) else f"{value:g}"
