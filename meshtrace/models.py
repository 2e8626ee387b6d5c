"""Descriptions as data: validated, frozen models that raise `Refused`, and families of them.

Plain data (tables, lists, numbers and texts, as in a link file) identify a member of a family by
its `kind`, by its import path "module:Class", or by an entry point of the group "meshtrace.parts".
Modules that are not imported yet are imported only inside `trusting`: the data may come from
anybody, and an import runs code.
"""

from __future__ import annotations

import html
import importlib
import inspect
import os
import re
import sys
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from importlib.machinery import PathFinder
from importlib.metadata import entry_points
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    Generic,
    Literal,
    NoReturn,
    Self,
    TypeVar,
    dataclass_transform,
    get_args,
    overload,
)

import numpy as np
import pydantic
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, PrivateAttr, SerializeAsAny

from meshtrace.checks import Finite as Finite
from meshtrace.checks import NonNegative as NonNegative
from meshtrace.checks import Positive as Positive
from meshtrace.checks import check_methods
from meshtrace.errors import (
    LARGEST,
    MISSING,
    Described,
    Refused,
    did_you_mean,
    hinting_at,
    require_array,
    require_keys,
    require_number,
    require_plain,
    warn_of_input,
    within,
)
from meshtrace.fields import entries
from meshtrace.pydantic_errors import refuse
from meshtrace.units import convert, is_same, is_unit, unit_of, without_unit

if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass as _ModelMetaclass
else:
    _ModelMetaclass = type(pydantic.BaseModel)

Stored = TypeVar("Stored")  # what a field holds
Accepted = TypeVar("Accepted")  # what its constructor takes
Member = TypeVar("Member")  # class of a family

if TYPE_CHECKING:

    class Converted(Generic[Stored, Accepted]):
        """Field that accepts further types in the constructor, for type checkers only.

        By the rules of `dataclass_transform`, a constructor takes what the `__set__` of a
        descriptor takes. At run time such a field is an `Annotated` type with a pydantic validator.
        """

        @overload
        def __get__(self, instance: None, owner: Any) -> Self: ...
        @overload
        def __get__(self, instance: object, owner: Any) -> Stored: ...
        def __get__(self, instance: Any, owner: Any) -> Any: ...
        def __set__(self, instance: Any, value: Accepted) -> None: ...

    FamilyField = Converted[Member, Member | str | Mapping[str, Any]]
    # mypy gives an overridden field the type of `__set__`: Any there lets it be read as a member
    InheritedFamilyField = Converted[Member, Member | Any]
    FamilyFields = Converted[
        Member | tuple[Member, ...],
        Member | str | Mapping[str, Any] | Sequence[Member | str | Mapping[str, Any]],
    ]
    FamilyTuple = Converted[tuple[Member, ...], Sequence[Member | str | Mapping[str, Any]]]
    Numbers = Converted[tuple[float, ...], Sequence[float] | NDArray[Any]]
    NumberRows = Converted[tuple[tuple[float, ...], ...], Sequence[Sequence[float]] | NDArray[Any]]
else:

    class FamilyField:
        """Field that holds a member of a family: `FamilyField[Lens]`, `FamilyField[Lens | None]`.

        Its values are members, plain data with their `kind`, or a bare kind.
        """

        def __class_getitem__(cls, union: Any) -> Any:
            family, *optional = get_args(union) or (union,)
            field = Annotated[SerializeAsAny[family], BeforeValidator(family.read)]
            return field | None if optional else field

    InheritedFamilyField = FamilyField

    class FamilyFields:
        """Field that holds one member of a family or a tuple of them, as `FamilyField`."""

        def __class_getitem__(cls, family: Any) -> Any:
            member = SerializeAsAny[family]
            return Annotated[member | tuple[member, ...], BeforeValidator(family.read_several)]

    class FamilyTuple:
        """Field that holds a tuple of members of a family, as `FamilyField`."""

        def __class_getitem__(cls, family: Any) -> Any:
            return tuple[FamilyField[family], ...]

    Numbers = Annotated[
        tuple[pydantic.FiniteFloat, ...],
        BeforeValidator(lambda value: value.tolist() if isinstance(value, np.ndarray) else value),
    ]
    NumberRows = tuple[tuple[pydantic.FiniteFloat, ...], ...]


def converted(*, default: Any) -> Any:
    """Return a pydantic field with a default that type checkers accept for `Converted` types."""
    return Field(default=default)


Position = tuple[Finite, Finite]
Floats = NDArray[np.float64]


_BUILDING = threading.RLock()


# pydantic decorates its own metaclass alike, but type checkers do not inherit that
@dataclass_transform(
    kw_only_default=True, frozen_default=True, field_specifiers=(Field, PrivateAttr, converted)
)
class _Documented(_ModelMetaclass):
    """Metaclass that keeps the internals of pydantic out of `help` and completion."""

    def __dir__(cls) -> list[str]:  # noqa: N805
        hidden = dir(pydantic.BaseModel)
        return [n for n in super().__dir__() if n not in hidden and not n.startswith("_")]

    @property
    def __signature__(cls) -> inspect.Signature:  # noqa: N805
        """Signature that `help` shows, without types: the docstring has them."""
        cls.model_rebuild()  # type: ignore[attr-defined]
        typed: Any = cls._typed_signature
        parameters = typed.parameters.values()
        return inspect.Signature([p.replace(annotation=p.empty) for p in parameters])

    @__signature__.setter
    def __signature__(cls, typed: Any) -> None:  # noqa: N805
        # pydantic sets it when it has the schema of the class, which is at the first use
        cls._typed_signature = typed


@check_methods
class Model(
    pydantic.BaseModel, frozen=True, extra="forbid", defer_build=True, metaclass=_Documented
):
    """Validated, frozen, comparable description; loads back from its own `model_dump`.

    Raises
    ------
    Refused
        If a field is unknown or a value is out of range.
    """

    if not TYPE_CHECKING:  # editors and type checkers see the fields as keywords

        def __init__(self, /, **data: Any) -> None:
            with _refusals(type(self)):
                super().__init__(**data)

        # as in pydantic's own: the data of a part are validated without a call of `__init__`
        __init__.__pydantic_base_init__ = True

    @classmethod
    def __pydantic_init_subclass__(cls, **options: Any) -> None:
        """Check the arguments of the methods of each subclass."""
        super().__pydantic_init_subclass__(**options)
        check_methods(cls)

    def __repr_args__(self) -> Iterator[tuple[str | None, Any]]:
        """Yield the fields that differ from their defaults."""
        for name, value in super().__repr_args__():
            field = type(self).model_fields.get(name or "")
            if field is None or not _equal(value, field.get_default(call_default_factory=True)):
                yield name, value

    __str__ = pydantic.BaseModel.__repr__

    def _repr_html_(self) -> str:
        notes = self.notes()
        lines = (
            f"<tr><td>{name}</td><td>{html.escape(_shown(getattr(self, name)))}</td>"
            f"<td style='text-align:left'>{html.escape(notes.get(name, ''))}</td></tr>"
            for name in type(self).model_fields
        )
        return f"<b>{type(self).__name__}</b><table>{''.join(lines)}</table>"

    @classmethod
    def notes(cls) -> dict[str, str]:
        """Return a short description of each field, from the docstring of the class.

        Examples
        --------
        >>> from meshtrace.link import Receiver
        >>> Receiver.notes()["radius"]
        'Radius of the aperture [m], > 0'
        """
        sentences = {  # up to the first ":", ";" or "." that ends a word, but not up to "..."
            name: re.split(r"(?<!\.)[:;.](?:\s|$)", text)[0]
            for name, (_, text) in entries(cls).items()
            if not text.startswith("See ")
        }
        # docstrings may describe a field under its alias
        keys = {n: n if n in sentences else field.alias for n, field in cls.model_fields.items()}
        return {name: sentences[key] for name, key in keys.items() if key in sentences}

    @classmethod
    def model_validate(cls, obj: Any, **options: Any) -> Self:
        """Return the model described by plain data or by an instance."""
        with _refusals(cls):
            return super().model_validate(obj, **options)

    @classmethod
    def model_validate_json(cls, json_data: str | bytes | bytearray, **options: Any) -> Self:
        """Return the model described by a JSON text."""
        with _refusals(cls):
            return super().model_validate_json(json_data, **options)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return a copy, with updated fields validated."""
        return self.replace(**update) if update else super().model_copy(deep=deep)

    def replace(self, path: str | None = None, value: Any = None, /, **updates: Any) -> Self:
        """Return a copy with new values, all validated together.

        Parameters
        ----------
        path : str, optional
            Dotted path of a field, with the numbers of list items counted from 0:
            "receiver.height", "transmitter.1.depth".
        value : object
            Its new value.
        **updates
            New values by field.

        Raises
        ------
        Refused
            If there is no such field, or a value is not allowed.

        Examples
        --------
        >>> from meshtrace.link import Link
        >>> Link().replace("receiver.height", 10.0).receiver.height
        10.0
        >>> Link().replace("receiver.hieght", 10.0)  # doctest: +ELLIPSIS
        Traceback (most recent call last):
        meshtrace.errors.Refused: receiver.hieght: 10.0, no such key, did you mean height? ...
        """
        # only what was set: fields left at their defaults remain unset in the copy
        fields = {name: getattr(self, name) for name in self.model_fields_set}
        for key, new in (updates if path is None else {path: value} | updates).items():
            head, *rest = key.split(".")
            if rest:
                require_keys({head: new}, type(self).model_fields)
                new = _replaced(fields.get(head, getattr(self, head)), head, rest, new)
            fields[head] = new
        return type(self).model_validate(fields)

    @pydantic.model_validator(mode="wrap")
    @classmethod
    def _plain_numbers(cls, data: Any, validate: pydantic.ModelWrapValidatorHandler[Self]) -> Self:
        """Convert values with units; refuse values that pydantic would misread as numbers.

        This is the outermost validator: the inner ones no longer have the unit of a number or know
        that it was a text.
        """
        if isinstance(data, Mapping):
            # for speed: most values are floats, which need no call of `_is_plain`
            unusual = {
                key: value
                for key, value in data.items()
                if not (type(value) is float and abs(value) <= LARGEST) and not _is_plain(value)
            }
            if unusual:
                data = dict(data) | cls._converted(unusual)
        try:
            return validate(data)
        except pydantic.ValidationError as error:
            # an error of the model as a whole has no path: the field that holds it will name it
            if error.errors(include_url=False)[0]["loc"]:
                _refuse_first(error, cls)
            raise

    @classmethod
    def _converted(cls, values: dict[str, Any]) -> dict[str, Any]:
        """Convert values to the units of their fields; refuse values misread as numbers."""
        # plain data may name a field by its alias
        names = {field.alias or name: name for name, field in cls.model_fields.items()}
        for key, value in values.items():
            name = names.get(key, key)
            if (field := cls.model_fields.get(name)) is None:
                continue
            if _has_unit(value):
                values[key] = value = _in_unit(value, key, cls._units(name))
            # a part checks its own values
            if field.annotation not in (bool, str) and not isinstance(field.default, Model):
                _require_numbers(value, key)
        return values

    @classmethod
    def _units(cls, name: str) -> list[str]:
        """Return the units of a field, from "[m]" in the docstring or else from its suffix."""
        texts = {key: text for key, (_, text) in entries(cls).items()}
        text = texts.get(name, "")
        units = re.findall(r"\[([^\]]*)\]", text)
        sharing = [key for key, other in texts.items() if text and other == text]
        # fields described together with a unit each, in order: "hs, tp : ... [m] and ... [s]"
        if len(units) == len(sharing) > 1:
            units = [units[sharing.index(name)]]
        by_name = {"deg": "deg", "nm": "nm"}.get(name.rpartition("_")[2], "1")
        return list(dict.fromkeys(units or [by_name]))


def _equal(a: Any, b: Any) -> bool:
    """Return whether two values are equal, arrays included."""
    try:
        return bool(np.all(a == b))
    except (TypeError, ValueError):
        return False


def _shown(value: Any) -> str:
    """Return a value as a text of limited length."""
    text = f"{value:g}" if isinstance(value, float) else str(value)
    return text if len(text) <= 120 else f"{text[:117]}..."


def _is_plain(value: Any) -> bool:
    """Check by exact type that a value needs no test of unit or magnitude.

    This takes a tenth of the time of the search for units. False only asks for that search.
    """
    kind = type(value)
    if kind is float:
        return bool(-LARGEST <= value <= LARGEST)
    if kind is int:
        return bool(-(2**64) < value < 2**64)
    if kind is list or kind is tuple:
        return all(map(_is_plain, value))
    # a table becomes a model, which checks the values in it
    return value is None or kind is dict or isinstance(value, pydantic.BaseModel)


def _has_unit(value: Any) -> bool:
    """Return whether a value, or any in a nested list, has a unit."""
    if isinstance(value, list | tuple):
        return any(map(_has_unit, value))
    return bool(unit_of(value))


def _in_unit(value: Any, name: str, units: list[str]) -> Any:
    """Return a value as plain numbers in the unit of its field; warn if they were converted.

    Arrays are refused where the field has columns in several `units`: it is unclear which apply.
    """
    if isinstance(value, list | tuple):
        return [_in_unit(item, f"{name}[{i}]", units) for i, item in enumerate(value)]
    unit, wanted = unit_of(value), units[0]
    if not unit:
        return value
    numbers = require_array(without_unit(value), name, f"numbers [{wanted}]")
    # an array in one unit cannot fill a field such as "depth [m], a, b [m-1]"
    if not is_unit(wanted) or (numbers.ndim and len(units) > 1):
        allowed = f"plain numbers [{', '.join(units)}]"
        raise Refused(name, Described(f"an array in {unit}"), allowed)
    if not is_same(unit, wanted):
        numbers = convert(numbers, unit, wanted, name)
        warn_of_input(f"{name} in {unit} converted to {wanted}")
    return numbers.tolist()


def _require_numbers(value: Any, path: str) -> None:
    if isinstance(value, list | tuple):
        for i, item in enumerate(value):
            if not _is_plain(item):
                _require_numbers(item, f"{path}[{i}]")
    else:
        require_number(value, path)
        # data frames go on to the fields that read them by column; other fields refuse them
        if not hasattr(value, "columns"):
            require_plain(value, path, "numbers")


def _replaced(part: Any, name: str, path: list[str], value: Any) -> Any:
    """Return a part of a model, or a tuple of parts, with the value at a path replaced."""
    head, *rest = path
    with within(name):
        if isinstance(part, Model):
            return part.replace(".".join(path), value)
        if isinstance(part, tuple) and head.isdecimal() and int(head) < len(part):
            i = int(head)
            new = _replaced(part[i], head, rest, value) if rest else value
            return (*part[:i], new, *part[i + 1 :])
        raise Refused(head, value, "fields of a part, or numbers of list items")


@contextmanager
def _refusals(cls: type[Model]) -> Iterator[None]:
    """Turn errors of pydantic into `Refused`."""
    if not cls.__pydantic_complete__:
        # threads: before pydantic 2.12 two of them could build the schema of a class at once
        with _BUILDING:
            cls.model_rebuild()
    try:
        yield
    except pydantic.ValidationError as error:
        _refuse_first(error, cls)
    except RecursionError as error:
        raise Refused(cls.__name__, Described("lists nested too deeply"), "few levels") from error
    except ArithmeticError as error:
        raise Refused(cls.__name__, f"{error}", "numbers that do not overflow") from error


def _refuse_first(error: pydantic.ValidationError, cls: type[Model]) -> NoReturn:
    """Refuse an unknown key, or else the first wrong value."""
    errors = error.errors(include_url=False)
    # pydantic reports unknown keys last, but a misspelt key is the cause of a missing one
    first = next((e for e in errors if e["type"] == "extra_forbidden"), errors[0])
    if first["type"] == "extra_forbidden":
        aliases = (field.alias for field in cls.model_fields.values() if field.alias)
        inner = [
            f"{name}.{key}"
            for name, field in cls.model_fields.items()
            if isinstance(part := field.get_default(call_default_factory=True), Model)
            for key in type(part).model_fields
        ]
        unknown = {str(first["loc"][0]): first["input"]}
        with hinting_at(lambda: inner):
            require_keys(unknown, [*cls.model_fields, *aliases])
    refuse(first, cls.__name__, list(first["loc"]), cls)


GROUP = "meshtrace.parts"
"""Group of entry points, through which packages add classes (the objects) by kind (the names)."""

_TRUSTED: ContextVar[bool] = ContextVar("trusted", default=False)  # inside `trusting`


class Family(Model, frozen=True):
    """Base of model families; data select a class by its `kind`.

    A direct subclass is the base of a family. It may set the class keywords `default`, the kind of
    a table that names none, and `closed`, the reason why users cannot add classes. A user's class
    that declares no kind has its import path as kind.

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
    synonyms: ClassVar[Mapping[str, str]] = {}  # kind to suggest in an error, by another word
    _default: ClassVar[str] = ""
    _closed: ClassVar[str] = ""

    def __init_subclass__(cls, default: str = "", closed: str = "", **options: Any) -> None:
        super().__init_subclass__(**options)
        if Family in cls.__bases__:
            cls.registered, cls._default, cls._closed = {}, default, closed
        annotations = inspect.get_annotations(cls)
        if Family not in cls.__bases__ and "kind" not in annotations and not _is_ours(cls):
            kind = f"{cls.__module__}:{cls.__qualname__}"
            cls.__annotations__ = annotations | {"kind": Literal[kind]}
            cls.kind = kind  # type: ignore[method-assign, assignment]

    @classmethod
    def __pydantic_init_subclass__(
        cls, default: str = "", closed: str = "", **options: Any
    ) -> None:
        super().__pydantic_init_subclass__(**options)
        if Family in cls.__bases__ or "kind" not in cls.model_fields or inspect.isabstract(cls):
            return
        kind = cls.model_fields["kind"].default
        other = cls.registered.get(kind)
        # compiled kernels have a branch for each class of a closed family, and no others
        if cls._closed and not _is_ours(cls):
            raise Refused(f"{cls.__qualname__}.kind", kind, cls._closed)
        if other is not None and other.__qualname__ != cls.__qualname__:
            raise Refused(f"{cls.__qualname__}.kind", kind, f"a kind other than {other.__name__}'s")
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
        target: Any = cls.registered.get(kind) if isinstance(kind, str) else None
        allowed = ", ".join(cls.registered)
        allowed += f" ({cls._closed})" if cls._closed else f" or module:{cls.__name__}"
        if target is None and isinstance(kind, str) and not cls._closed:
            if source := _untrusted(kind):
                hint = f"would run {source}: a link file may, with --trust or trust=True;"
                raise Refused(key, kind, allowed, hint)
            try:
                target = _imported(kind)
            except Exception as error:  # any failure of a module's import
                raise Refused(key, kind, f"{allowed} ({error})") from error
        if inspect.isclass(target) and issubclass(target, cls):
            return target
        synonym = cls.synonyms.get(kind.lower()) if isinstance(kind, str) else None
        hint = f"did you mean {synonym}?" if synonym else did_you_mean(kind, cls.registered)
        raise Refused(key, kind, allowed, hint)

    @classmethod
    def read(cls, value: Any) -> Self:
        """Return the model described by plain data: a table with its `kind`, or a bare kind.

        Parameters
        ----------
        value : model, mapping or str
            A model of the family is returned unchanged. The key `model` stands for `kind`, too.

        Raises
        ------
        Refused
            If the kind is unknown or a value is not allowed.
        """
        # models are frozen: they are as valid as when they were made
        if isinstance(value, cls):
            return value
        table = {"kind": value} if isinstance(value, str) else value
        if not isinstance(table, Mapping):
            raise Refused("", value, f"a table, or one of {', '.join(cls.registered)}")
        key = "model" if "model" in table and "kind" not in table else "kind"
        model = cls.member(table.get(key, cls._default or MISSING), key)
        return model.model_validate({name: v for name, v in table.items() if name != key})

    @classmethod
    def read_several(cls, value: Any) -> Self | tuple[Self, ...]:
        """Return the model described by plain data, or a tuple of models for a list."""
        if not isinstance(value, list | tuple):
            return cls.read(value)
        members = []
        for i, item in enumerate(value):
            with within(i):
                members.append(cls.read(item))
        return tuple(members)


def _is_ours(cls: type) -> bool:
    return cls.__module__.startswith("meshtrace.")


@contextmanager
def trusting(trust: bool = True) -> Iterator[None]:
    """Allow import paths "module:Class" in plain data to import modules within a block.

    With ``trust=False`` nothing changes: a block inside a trusted one is trusted as well.
    """
    token = _TRUSTED.set(trust or _TRUSTED.get())
    try:
        yield
    finally:
        _TRUSTED.reset(token)


def modules_of(text: str) -> list[str]:
    """Return the modules of user-defined classes whose kinds occur in a text.

    Another process must import them, by `import_modules`, before it can read the text.
    """
    members = (m for family in Family.__subclasses__() for m in family.registered.items())
    modules = {c.__module__ for kind, c in members if not _is_ours(c) and kind in text}
    return sorted(modules - {"__main__"})


def import_modules(names: Iterable[str]) -> None:
    """Import modules, also from the working directory as `python -m` does."""
    folder = os.getcwd()
    # last in the search: a file of the working directory must not hide a package
    sys.path.append(folder)
    try:
        for name in names:
            importlib.import_module(name)
    finally:
        sys.path.remove(folder)


def _module_of(kind: str) -> str:
    """Return the module of an import path "module:Class", "" for other kinds."""
    module, colon, name = kind.partition(":")
    words = (*module.split("."), *name.split("."))
    return module if colon and all(word.isidentifier() for word in words) else ""


def _untrusted(kind: str) -> str:
    """Return the file that importing a kind would run although it is not trusted, or ""."""
    module = _module_of(kind)
    if not module or module in sys.modules or _TRUSTED.get():
        return ""
    package = module.partition(".")[0]
    # only the top package is looked up: Python would run it to find a module inside
    spec = PathFinder.find_spec(package, [*sys.path, os.getcwd()])
    return (spec and spec.origin) or f"the module {package}"


def _imported(kind: str) -> Any:
    """Return the object at an entry point or an import path "module:Class", None if absent."""
    module = _module_of(kind)
    if not module:
        return next((e.load() for e in entry_points(group=GROUP) if e.name == kind), None)
    if module not in sys.modules:
        import_modules([module])
    target: Any = sys.modules[module]
    for attribute in kind.partition(":")[2].split("."):
        # not `getattr`, which may run a `__getattr__` or a property of the module's
        target = getattr(target, "__dict__", {}).get(attribute)
    return target
