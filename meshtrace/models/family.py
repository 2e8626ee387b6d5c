"""Families of models, identified by `kind` in plain data; most are open to a user's own classes.

A direct subclass of `Family` is the base of a family, and every concrete class below it joins by
being defined. Plain data name a class by its `kind`, by its import path "module:Class", or by an
entry point of the group "meshtrace.parts". Import paths of modules that are not imported yet are
followed inside `trusting` alone: plain data may come from a stranger's file.
"""

from __future__ import annotations

import importlib
import inspect
import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from importlib.machinery import PathFinder
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

from meshtrace.errors import MISSING, Refused, did_you_mean
from meshtrace.models.model import Model

GROUP = "meshtrace.parts"
"""Group of entry points whose names are kinds and whose objects are classes."""

_TRUSTED: ContextVar[bool] = ContextVar("trusted", default=False)


class Family(Model, frozen=True):
    """Base of the families; a subclass without a `kind` of its own gets its import path.

    Class keywords of a family's base: `default`, the kind of a table that names none; `closed`,
    the reason why no other kinds can join.

    Examples
    --------
    >>> class Lens(Family, default="ball"):
    ...     pass
    >>> class Ball(Lens):
    ...     kind: Literal["ball"] = "ball"
    ...     radius: float = 1.0
    >>> Lens.read({"kind": "ball", "radius": 2.0}), Lens.read("ball").radius
    (Ball(radius=2.0), 1.0)
    """

    if TYPE_CHECKING:

        @property
        def kind(self) -> str:
            """Name of the class in plain data."""

    registered: ClassVar[dict[str, type[Any]]] = {}
    _default: ClassVar[str] = ""
    _closed: ClassVar[str] = ""

    def __init_subclass__(cls, default: str = "", closed: str = "", **options: Any) -> None:
        super().__init_subclass__(**options)
        if Family in cls.__bases__:
            cls.registered, cls._default, cls._closed = {}, default, closed
        own = inspect.get_annotations(cls)
        if Family not in cls.__bases__ and "kind" not in own and not _is_ours(cls):
            kind = f"{cls.__module__}:{cls.__qualname__}"
            cls.__annotations__ = {**own, "kind": Literal[kind]}
            cls.kind = kind  # type: ignore[method-assign, assignment]

    @classmethod
    def __pydantic_init_subclass__(
        cls, default: str = "", closed: str = "", **options: Any
    ) -> None:
        super().__pydantic_init_subclass__(**options)
        if Family in cls.__bases__ or "kind" not in cls.model_fields or inspect.isabstract(cls):
            return
        kind = cls.model_fields["kind"].default
        known = cls.registered.get(kind)
        if cls._closed and not _is_ours(cls):
            raise Refused(f"{cls.__qualname__}.kind", kind, cls._closed)
        if known is not None and known.__qualname__ != cls.__qualname__:
            raise Refused(f"{cls.__qualname__}.kind", kind, f"a kind other than {known.__name__}'s")
        cls.registered[kind] = cls

    @classmethod
    def member(cls, kind: Any, key: str = "kind") -> type[Self]:
        """Return the class of a kind, of an import path "module:Class" or of an entry point.

        Raises
        ------
        Refused
            If there is none, it is not of this family, or its module is not imported yet and
            import paths are not trusted.
        """
        found: Any = cls.registered.get(kind) if isinstance(kind, str) else None
        allowed = ", ".join(cls.registered)
        allowed += f" ({cls._closed})" if cls._closed else f" or module:{cls.__name__}"
        if found is None and isinstance(kind, str) and not cls._closed:
            if source := _untrusted(kind):
                hint = f"would run {source}: a link file may, with --trust or trust=True;"
                raise Refused(key, kind, allowed, hint)
            try:
                found = _found(kind)
            except Exception as error:  # any failure of a module's import
                raise Refused(key, kind, f"{allowed} ({error})") from error
        if inspect.isclass(found) and issubclass(found, cls):
            return found
        raise Refused(key, kind, allowed, did_you_mean(kind, cls.registered))

    @classmethod
    def read(cls, value: Any) -> Self:
        """Return the model that plain data describe: a table with its `kind`, or a bare kind.

        Parameters
        ----------
        value : model, mapping or str
            A model of the family is returned unchanged. The key `model` stands for `kind`, too.

        Raises
        ------
        Refused
            If the kind is unknown or a value is not allowed.
        """
        if isinstance(value, cls):
            return value
        table = {"kind": value} if isinstance(value, str) else value
        if not isinstance(table, Mapping):
            raise Refused("", value, f"a table, or one of {', '.join(cls.registered)}")
        key = "model" if "model" in table and "kind" not in table else "kind"
        model = cls.member(table.get(key, cls._default or MISSING), key)
        return model.model_validate({name: v for name, v in table.items() if name != key})


def _is_ours(cls: type) -> bool:
    return cls.__module__.startswith("meshtrace.")


@contextmanager
def trusting(trust: bool = True) -> Iterator[None]:
    """Let import paths "module:Class" in plain data run the modules that they name.

    Without `trust` the block is as trusted as what surrounds it.
    """
    token = _TRUSTED.set(trust or _TRUSTED.get())
    try:
        yield
    finally:
        _TRUSTED.reset(token)


def modules_of(text: str) -> list[str]:
    """Return the modules of the user's classes that a text names by kind.

    Another process that reads the text imports them first, by `import_modules`.
    """
    members = (m for family in Family.__subclasses__() for m in family.registered.items())
    named = {c.__module__ for kind, c in members if not _is_ours(c) and kind in text}
    return sorted(named - {"__main__"})


def import_modules(names: Iterable[str]) -> None:
    """Import modules, also from the working directory, so that their classes join families."""
    for name in names:
        _module(name)


def _module_of(kind: str) -> str:
    """Return the module of an import path "module:Class", "" for other kinds."""
    module, colon, name = kind.partition(":")
    words = (*module.split("."), *name.split("."))
    return module if colon and all(word.isidentifier() for word in words) else ""


def _untrusted(kind: str) -> str:
    """Return the file that a kind would run without trust, found without running any, or ""."""
    module = _module_of(kind)
    if not module or module in sys.modules or _TRUSTED.get():
        return ""
    package = module.partition(".")[0]
    spec = PathFinder.find_spec(package, [*sys.path, os.getcwd()])
    return (spec and spec.origin) or f"the module {package}"


def _found(kind: str) -> Any:
    """Return the object of an entry point or of an import path "module:Class", None if none."""
    module = _module_of(kind)
    if not module:
        return next((e.load() for e in entry_points(group=GROUP) if e.name == kind), None)
    found = sys.modules.get(module) or _module(module)
    for word in kind.partition(":")[2].split("."):
        found = getattr(found, "__dict__", {}).get(word)  # runs nothing
    return found


def _module(name: str) -> Any:
    """Import a module, also from the working directory as `python -m` does."""
    folder = os.getcwd()
    sys.path.append(folder)
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(folder)
