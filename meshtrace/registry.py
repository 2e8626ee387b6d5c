"""Open families of models: subclasses register by `kind` and are found by import path, too."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Mapping
from typing import Any, ClassVar, Literal, Self

import pydantic
from pydantic.fields import FieldInfo

from meshtrace.errors import Refused, join_path


class Family(pydantic.BaseModel, frozen=True, extra="forbid"):
    """Base of a family of models that plain data tell apart by `kind`.

    A direct subclass is the base of a family. Every concrete class below it is registered: under
    the default of its field `kind`, or, if it declares none, under its import path
    "module:Class", which a fresh process finds again.

    Examples
    --------
    >>> class Shape(Family, frozen=True):
    ...     pass
    >>> class Disc(Shape, frozen=True):
    ...     kind: Literal["disc"] = "disc"
    ...     radius: float = 1.0
    >>> Shape.read({"kind": "disc", "radius": 2.0})
    Disc(kind='disc', radius=2.0)
    """

    registered: ClassVar[dict[str, type[Any]]] = {}

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        """Register a concrete class."""
        super().__pydantic_init_subclass__(**kwargs)
        if Family in cls.__bases__:
            cls.registered = {}
            return
        if inspect.isabstract(cls):
            return
        kind = cls.model_fields["kind"].default if "kind" in cls.model_fields else ""
        holder = cls.registered.get(kind)
        if not kind or (holder is not None and issubclass(cls, holder)):
            kind = f"{cls.__module__}:{cls.__qualname__}"
            literal: Any = Literal[kind]
            cls.model_fields["kind"] = FieldInfo.from_annotated_attribute(literal, kind)
            cls.model_rebuild(force=True)
        elif holder is not None and holder.__qualname__ != cls.__qualname__:
            raise Refused(f"{cls.__name__}.kind", kind, f"a kind other than {holder.__name__}'s")
        cls.registered[kind] = cls

    @classmethod
    def member(cls, kind: Any) -> type[Self]:
        """Return the class of a kind or of an import path "module:Class".

        Raises
        ------
        Refused
            If there is none, or it is not of this family.
        """
        if kind in cls.registered:
            return cls.registered[kind]
        allowed = f"{', '.join(cls.registered)}, or module:{cls.__name__} of your own"
        module, colon, name = str(kind).partition(":")
        try:
            found = getattr(importlib.import_module(module), name) if colon else None
        except (ImportError, AttributeError, ValueError) as error:
            raise Refused("kind", kind, f"{allowed} ({error})") from error
        if isinstance(found, type) and issubclass(found, cls):
            return found
        raise Refused("kind", kind, allowed)

    @classmethod
    def read(cls, value: Any) -> Any:
        """Return the member that a kind, or a table with `kind`, describes.

        Anything else is returned as it is, for a field's own validation.

        Raises
        ------
        Refused
            If the kind is unknown or a parameter is out of range.
        """
        if isinstance(value, str):
            value = {"kind": value}
        if not isinstance(value, Mapping):
            return value
        table = dict(value)
        model = cls.member(table.pop("kind", None))
        try:
            return model(**table)
        except pydantic.ValidationError as error:
            first = error.errors(include_url=False)[0]
            refusal = first.get("ctx", {}).get("error")
            if isinstance(refusal, Refused):
                raise refusal from error
            where = join_path("", *first["loc"]) or model.__name__
            raise Refused(where, first["input"], first["msg"]) from error
