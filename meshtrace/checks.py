"""Arguments of public functions, checked by their annotations.

`check_call` decorates a function: pydantic validates each argument by its annotation before the
call. Numbers are checked more strictly than by pydantic: it would accept booleans, text and nan.
"""

from __future__ import annotations

import builtins
import inspect
import itertools
import math
import operator
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, partial, wraps
from pathlib import Path
from types import MappingProxyType, NoneType, UnionType
from typing import (
    Annotated,
    Any,
    Literal,
    NamedTuple,
    ParamSpec,
    TypeVar,
    Union,
    Unpack,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np
import pydantic
from numpy.typing import ArrayLike, NDArray
from pydantic import AfterValidator, BeforeValidator, Field, PlainValidator

from meshtrace.errors import (
    LARGEST,
    SMALLEST,
    Described,
    Refused,
    did_you_mean,
    require_array,
    require_keys,
    require_real,
)
from meshtrace.pydantic_errors import allowed_alone, is_alternative, range_text, refuse, words_of

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Probability = Annotated[float, Field(gt=0.0, lt=1.0)]
ErrorRate = Annotated[float, Field(gt=0.0, lt=0.5)]  # of bits: guessing is wrong in half of them
Index = Annotated[float, Field(ge=0.1, le=10.0)]  # of refraction, well beyond that of any material
Seed = Annotated[int, Field(ge=0, lt=2**64)]

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")

# comparisons of a number with a bound, by the names of pydantic's constraints
_COMPARISONS = {"gt": operator.gt, "ge": operator.ge, "lt": operator.lt, "le": operator.le}
# what to pass for a protocol, whose name users have not met
_SAID_OF_CLASS = {
    "HasCase": "a Scenario",
    "MeshSource": "a sea (SurfaceModel)",
    "SurfaceModel": "a sea (SurfaceModel)",
    "Surface": "a sea (Surface)",
}
_WITH_SHORT_TEXT = (str, bool, int, float, complex, NoneType, list, tuple, dict)


class Infinite:
    """Marker of numbers that may be infinite."""


class InfiniteOrNan(Infinite):
    """Marker of numbers that may be infinite, or nan where there is no value."""


class Shape:
    """Marker of an array's shape, as in "n", "n 3" and "... 3".

    Letters stand for any size, each independently; "..." in front for any number of dimensions.
    """

    def __init__(self, sizes: str) -> None:
        self._sizes = sizes.split()

    def __str__(self) -> str:
        return f"({', '.join(self._sizes)}{',' if len(self._sizes) == 1 else ''})"

    def holds(self, shape: tuple[int, ...]) -> bool:
        """Return whether the shape of an array matches."""
        sizes = self._sizes
        if sizes[0] == "...":
            sizes = sizes[1:]
            shape = shape[-len(sizes) :] if len(shape) >= len(sizes) else ()
        pairs = zip(sizes, shape, strict=False)
        return len(sizes) == len(shape) and all(not s.isdecimal() or int(s) == n for s, n in pairs)


class Unit:
    """Marker of vectors of length 1 to within 1e-3, which admits directions read from files."""


class Inside:
    """Marker of a parameter that the function checks itself: its range depends on others."""


Ranged = Annotated[float, Inside()]
"""A number that the function checks."""

RangedArray = Annotated[ArrayLike, Inside()]
"""Numbers that the function checks."""

Number = Annotated[float, InfiniteOrNan()]
"""A number, also infinite or nan, whose range the function checks."""

Directions = Annotated[NDArray[np.float64], Shape("... 3"), Unit()]
"""Unit vectors."""


# ---- functions -------------------------------------------------------------------------------


def check_call(function: Callable[P, R], all_named: bool = False) -> Callable[P, R]:
    """Decorate a function to refuse arguments that do not match its annotations.

    Arrays arrive as float64, numbers as float or int, lists and pairs as list and tuple. Bounds
    stand in the annotation, `Annotated[float, Field(gt=0.0)]`; arguments of type `Any` and
    relations between arguments are up to the function. `all_named` also refuses keywords that
    neither the signature nor its ``**options: Unpack[...]`` names.

    Raises
    ------
    Refused
        By the decorated function: with the name of the first wrong argument.

    Examples
    --------
    >>> @check_call
    ... def fade(rate: Positive, name: str | None = None) -> float:
    ...     return rate
    >>> fade(-1)
    Traceback (most recent call last):
    meshtrace.errors.Refused: rate: -1, allowed: > 0
    """
    checks: _Checks | None = None

    @wraps(function)
    def call(*args: P.args, **options: P.kwargs) -> R:
        nonlocal checks
        if checks is None:  # not at import: most functions are not called in a run
            checks = _checks_of(function, all_named)
        by_place, rest, by_name, only_known = checks
        if only_known:
            require_keys(options, by_name)
        # all arguments that *args collects share one check
        in_order = zip(itertools.chain(by_place, itertools.repeat(rest)), args, strict=False)
        places: list[Any] = [check(value) if check else value for check, value in in_order]
        names: dict[str, Any] = {
            key: check(value) if (check := by_name.get(key)) else value
            for key, value in options.items()
        }
        return function(*places, **names)

    call.__checked__ = True  # type: ignore[attr-defined]
    return call


def check_methods(cls: type[T]) -> type[T]:
    """Decorate the public methods of a class of the package by `check_call`."""
    # subclasses that users define check their arguments themselves
    if not cls.__module__.startswith("meshtrace."):
        return cls
    for name, member in list(vars(cls).items()):
        # before any look at a private member: pydantic would build a schema that may not be needed.
        # `model_validate` accepts any object, and the model refuses it
        if name.startswith("_") or name == "model_validate":
            continue
        function = getattr(member, "__func__", member)
        if not inspect.isfunction(function):
            continue
        # a single annotation is that of the returned value: there is nothing to check
        if not hasattr(function, "__checked__") and len(function.__annotations__) > 1:
            checked = check_call(function)
            bound = isinstance(member, classmethod | staticmethod)
            setattr(cls, name, type(member)(checked) if bound else checked)
    return cls


def _checked(name: str, adapter: pydantic.TypeAdapter[Any], value: Any) -> Any:
    """Return the value of a parameter converted to its annotated type, or refuse it."""
    try:
        return adapter.validate_python(value)
    except pydantic.ValidationError as error:
        errors = error.errors(include_url=False)
    # pydantic has an error for each alternative of a union, and names the alternative in the path;
    # ours lead to a value only, and the outermost of them is shown with all that it might be
    paths = [[key for key in row["loc"] if not is_alternative(key)] for row in errors]
    place = min(paths, key=len)
    tried = [e for e, path in zip(errors, paths, strict=True) if path[: len(place)] == place]
    if len(tried) == 1:
        refuse(tried[0], name, place)
    for key in place:
        value = value[key]
    allowed = " or ".join(dict.fromkeys(map(allowed_alone, tried)))
    raise Refused("", _shown(value), allowed).inside(name, *words_of(place))


_Check = Callable[[Any], Any] | None
"""Returns a value as its annotated type, or refuses it; None accepts any value."""
_Checks = tuple[list[_Check], _Check, dict[str, _Check], bool]
"""Checks of positional arguments, of `*args` and of keywords; whether no other keyword is known."""


def _checks_of(function: Callable[..., Any], all_named: bool) -> _Checks:
    """Return the checks of the parameters of a function; see `check_call`."""
    plain = inspect.unwrap(function)
    places: list[_Check] = []
    by_name: dict[str, _Check] = {}
    rest: _Check = None
    only_known = True
    for name, parameter in inspect.signature(plain).parameters.items():
        hint = plain.__annotations__.get(name, Any)
        if isinstance(hint, str):  # by `from __future__ import annotations`
            hint = eval(hint, plain.__globals__, _Names(plain.__globals__))
        if parameter.kind is parameter.VAR_KEYWORD:
            if get_origin(hint) is Unpack:
                table = get_type_hints(get_args(hint)[0], include_extras=True)
                by_name.update({key: _parameter(key, kind) for key, kind in table.items()})
            only_known = all_named
        elif parameter.kind is parameter.VAR_POSITIONAL:
            rest = _parameter(name, hint)
        else:
            check = _parameter(name, hint)
            if parameter.kind is not parameter.KEYWORD_ONLY:
                places.append(check)
            if parameter.kind is not parameter.POSITIONAL_ONLY:
                by_name[name] = check
    return places, rest, by_name, only_known


class _Names(dict[str, Any]):
    """Names of a module, with a `_Later` for each import under TYPE_CHECKING."""

    def __missing__(self, name: str) -> Any:
        if hasattr(builtins, name):
            raise KeyError(name)  # `eval` goes on to look in the builtins
        return _Later(name)


class _Later(type):
    """Stand-in for a class (or module) that is not imported: compared with instances by name.

    Importing it only to check arguments would load a module that the call may not need.
    """

    def __new__(cls, name: str) -> Any:
        return super().__new__(cls, name, (), {})

    def __init__(cls, name: str) -> None:
        super().__init__(name, (), {})

    def __getattr__(cls, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return _Later(name)

    def __instancecheck__(cls, value: object) -> bool:
        return cls.__name__ in (kind.__name__ for kind in type(value).__mro__)


def _parameter(name: str, hint: Any) -> _Check:
    """Return the check of a parameter."""
    kind = _typed(hint, _Limits(name))
    if kind is Any:
        return None
    # made when it is first needed, as most never are: it takes longer than the check of a value
    adapter = cache(partial(pydantic.TypeAdapter, kind))
    parts = get_args(kind) if get_origin(kind) is Union else (kind,)
    # a type that one plain function validates needs the adapter only where that fails
    metadata = [get_args(part)[1:] for part in parts if part is not NoneType]
    if [list(map(type, several)) for several in metadata] != [[PlainValidator]]:
        return lambda value: _checked(name, adapter(), value)
    convert = metadata[0][0].func

    def check(value: Any) -> Any:
        if value is None and NoneType in parts:
            return None
        try:
            return convert(value)
        except (ValueError, AssertionError):  # what pydantic turns into its errors
            return _checked(name, adapter(), value)

    return check


# ---- types -----------------------------------------------------------------------------------


class _Limits(NamedTuple):
    """Requirements of an annotation on the numbers of a parameter."""

    name: str  # of the parameter
    bounds: Mapping[str, Any] = MappingProxyType({})  # by the names of pydantic's constraints
    infinite: Infinite | None = None
    shape: Shape | None = None
    unit: bool = False
    range: str = ""  # of the bounds, as text
    words: str = ""  # in place of the range

    def allowed(self, words: str) -> str:
        """Describe the allowed values by the limits' own words, their range, or `words`."""
        return self.words or self.range or words

    def refused(self, value: Any, words: str) -> Refused:
        """Return the error for a number outside the bounds; `words` describe the allowed values."""
        number = float(value)
        # inside the bounds of the annotation, but too large or too small to compute with
        if math.isfinite(number) and abs(number) > LARGEST:
            words = f"at most {LARGEST:g} in magnitude"
        elif self.bounds == {"gt": 0.0} and 0.0 < number < SMALLEST:
            words = f"at least {SMALLEST:g}"
        return Refused("", value, words)

    def hold(self, numbers: Any) -> Any:
        """Return whether a number, or each number of an array, lies within the bounds."""
        most = math.inf if self.infinite else LARGEST
        good = abs(numbers) <= most  # False for nan
        if isinstance(self.infinite, InfiniteOrNan):
            good = good | (numbers != numbers)  # nan
        # where the only bound is > 0, numbers are divided by, see `SMALLEST`
        if self.bounds == {"gt": 0.0}:
            good = good & (numbers >= SMALLEST)
        for key, bound in self.bounds.items():
            good = good & _COMPARISONS[key](numbers, bound)
        return good


def _typed(hint: Any, limits: _Limits) -> Any:
    """Return the type with which pydantic validates an annotation; `Any` accepts all values."""
    kind, parts = get_origin(hint), get_args(hint)
    if hint is Any:
        return Any
    if kind is Annotated:
        # a `Field` holds its bounds in its metadata; the other markers stand for themselves
        markers = [m for part in parts[1:] for m in getattr(part, "metadata", None) or [part]]
        bounds = {key: getattr(part, key) for part in markers for key in _COMPARISONS
                  if getattr(part, key, None) is not None}  # fmt: skip
        by_kind = {type(part): part for part in markers}
        if Inside in by_kind:
            return Any
        if validators := [part for part in parts[1:] if isinstance(part, AfterValidator)]:
            rest = tuple(part for part in parts if part not in validators)
            bare = Annotated[rest] if len(rest) > 1 else rest[0]
            return Annotated[(_typed(bare, limits), *validators)]
        infinite = by_kind.get(InfiniteOrNan) or by_kind.get(Infinite)
        # the text is made once: arguments are checked a hundred thousand times in a study
        shown = range_text(bounds, limits.name)
        inner = _Limits(limits.name, bounds, infinite, by_kind.get(Shape), Unit in by_kind, shown)
        return _typed(parts[0], inner)
    if kind in (Union, UnionType):
        return _union(parts, limits)
    if kind is Literal:
        return _plain(_word, parts)
    if kind in (Mapping, dict):
        item = _typed(parts[1], limits)
        return Annotated[dict[str, item], BeforeValidator(_mapping)]  # type: ignore[valid-type]
    if kind in (Sequence, list, tuple, Iterable):
        return _several(kind, parts, limits)
    if kind is np.ndarray:
        dtype = next(iter(get_args(parts[1])), Any)  # of ndarray[shape, np.dtype[...]]
        if dtype is np.bool_:
            return _plain(_flags, limits)
        return _plain(_array, limits, dtype) if dtype in (np.float64, np.float32) else Any
    if kind is Callable:
        return _plain(_callable)
    if hint in _SCALARS:
        return _plain(_SCALARS[hint], limits)
    if inspect.isclass(kind or hint):
        return _plain(_instance, kind or hint, limits)
    return Any


def _plain(convert: Callable[..., Any], *more: Any) -> Any:
    return Annotated[Any, PlainValidator(lambda value: convert(value, *more))]


def _union(parts: tuple[Any, ...], limits: _Limits) -> Any:
    arrays = set(get_args(ArrayLike))
    kinds: list[Any] = []
    # in `str | Path` a text is a path, too: as a mere text it would pass unchecked
    if any(map(_is_path, parts)):
        kinds.append(_plain(_path, limits))
        parts = tuple(part for part in parts if part is not str and not _is_path(part))
    # Python flattens unions: of `ArrayLike | None` only the parts of ArrayLike are left
    if arrays - {str} <= set(parts):
        kinds.append(_plain(_array, limits))
        parts = tuple(part for part in parts if part not in arrays)
    kinds += [NoneType if part is NoneType else _typed(part, limits) for part in parts]
    return Any if Any in kinds else Union[tuple(kinds)]  # noqa: UP007


def _is_path(hint: Any) -> bool:
    return (get_origin(hint) or hint) in (os.PathLike, Path)


def _several(kind: Any, parts: tuple[Any, ...], limits: _Limits) -> Any:
    """Return the type that validates a list or a tuple; arrays are accepted as lists."""
    made = tuple if kind is tuple else list
    fixed = kind is tuple and ... not in parts
    numbers = [part for part in parts if part is not ...]
    if all(part is float for part in numbers):  # one array is quicker to check than many numbers
        return _plain(_numbers, limits, made, len(parts) if fixed else None)
    kinds = tuple(_typed(part, limits) for part in numbers)
    several: Any = list[kinds[0]]  # type: ignore[valid-type]
    if made is tuple:
        several = tuple[kinds if fixed else (kinds[0], ...)]  # type: ignore[misc]
    return Annotated[several, BeforeValidator(_iterated if kind is Iterable else _listed)]


def _float(value: Any, limits: _Limits) -> float:
    allowed = limits.allowed("a number" if limits.infinite else "a finite number")
    number = value if type(value) is float else require_real(value, "", allowed)
    if not limits.hold(number):
        raise limits.refused(value, allowed)
    return number


def _int(value: Any, limits: _Limits) -> int:
    allowed = f"an integer {limits.range}".rstrip()
    try:
        number = None if isinstance(value, bool) else operator.index(value)
    except TypeError:
        number = None
    if number is None or not all(_COMPARISONS[k](number, v) for k, v in limits.bounds.items()):
        raise Refused("", value, allowed)
    # larger ones overflow in numpy's int64 or uint64
    if not -(2**63) <= number < 2**64:
        raise Refused("", value, "integers of 64 bits")
    return number


def _bool(value: Any, limits: _Limits) -> bool:
    if not isinstance(value, bool | np.bool_):
        raise Refused("", _shown(value), "true or false")
    return bool(value)


def _str(value: Any, limits: _Limits) -> str:
    if not isinstance(value, str):
        raise Refused("", _shown(value), limits.allowed("a text"))
    return value


def _complex(value: Any, limits: _Limits) -> complex:
    allowed = "a finite complex number"
    number = value if isinstance(value, complex) else require_real(value, "", allowed)
    if not np.isfinite(number):
        raise Refused("", value, allowed)
    return complex(number)


def _array(value: Any, limits: _Limits, dtype: Any = np.float64) -> NDArray[Any]:
    shape = f" {limits.shape}" if limits.shape else ""
    allowed = limits.allowed("numbers" if limits.infinite else f"finite numbers{shape}")
    array = require_array(value, "", allowed)
    if limits.shape and not limits.shape.holds(array.shape):
        raise Refused("", Described(f"shape {array.shape}"), allowed)
    good = np.asarray(limits.hold(array))
    if not good.all():
        at = np.argwhere(~good)[0]
        wrong = array[tuple(at)]
        raise limits.refused(wrong, allowed).inside(*(at.tolist() if array.size > 1 else ()))
    # rounding to single precision changes the length by 1e-7, to few digits in a file by some 1e-4
    if limits.unit and np.any(np.abs(np.linalg.norm(array, axis=-1) - 1.0) > 1e-3):
        raise Refused("", array, "unit vectors (..., 3)")
    return array.astype(dtype, copy=False)


def _flags(value: Any, limits: _Limits) -> NDArray[np.bool_]:
    # no other type: np.asarray takes any object, and a single True as an array
    array = np.asarray(value) if isinstance(value, list | tuple | np.ndarray) else None
    if array is None or array.dtype.kind != "b":
        raise Refused("", _shown(value), limits.allowed("true or false, one or more"))
    return array


def _numbers(value: Any, limits: _Limits, made: type, n: int | None) -> Any:
    several = "a list of finite numbers" if n is None else f"{n} finite numbers"
    allowed = limits.allowed(several)
    array = _array(value, limits._replace(words=allowed))
    if array.ndim != 1 or (n is not None and len(array) != n):
        raise Refused("", _shown(value), allowed)
    return made(array.tolist())


def _path(value: Any, limits: _Limits) -> Any:
    text = os.fspath(value) if isinstance(value, str | os.PathLike) else None
    try:
        if not isinstance(text, str) or not text or "\0" in text:
            raise ValueError
        os.stat(text)
    except FileNotFoundError:
        pass  # the file may yet be written
    # the reason of the operating system: too long a name, a file taken for a folder, ...
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", "")
        allowed = limits.allowed("the path of a file")
        raise Refused("", _shown(value), f"{allowed} ({reason})" if reason else allowed) from error
    return value


def _word(value: Any, words: Sequence[Any]) -> Any:
    if not isinstance(value, str) or value not in words:
        hint = did_you_mean(value, words) if isinstance(value, str) else ""
        raise Refused("", _shown(value), ", ".join(map(str, words)), hint)
    return value


def _callable(value: Any) -> Any:
    if not callable(value):
        raise Refused("", _shown(value), "a callable")
    return value


def _instance(value: Any, kind: type, limits: _Limits) -> Any:
    if not isinstance(value, kind):
        article = "an" if kind.__name__[0] in "AEIO" else "a"
        said = _SAID_OF_CLASS.get(kind.__name__, f"{article} {kind.__name__}")
        raise Refused("", _shown(value), limits.allowed(said))
    return value


def _mapping(value: Any) -> Any:
    if not isinstance(value, Mapping):
        raise Refused("", _shown(value), "a table")
    for key in value:
        if not isinstance(key, str):
            raise Refused("", key, "a text as key")
    return dict(value)


def _listed(value: Any) -> Any:
    if isinstance(value, np.ndarray) and value.ndim:
        return value.tolist()
    if isinstance(value, str | bytes | bytearray | memoryview) or not isinstance(value, Sequence):
        raise Refused("", _shown(value), "a list")
    return list(value)


def _iterated(value: Any) -> Any:
    try:
        if isinstance(value, str | bytes | Mapping) or not isinstance(value, Iterable):
            raise TypeError
        return list(value)
    except TypeError as error:  # arrays without dimensions, too
        raise Refused("", _shown(value), "a list") from error


def _shown(value: Any) -> Any:
    """Return a value, or the name of its class if its text says little."""
    # the text of other objects may be long, or hold their address in memory
    plain = type(value) in _WITH_SHORT_TEXT or isinstance(value, np.generic | np.ndarray)
    return value if plain else Described(type(value).__name__)


_SCALARS: dict[Any, Callable[[Any, _Limits], Any]] = {
    float: _float,
    int: _int,
    bool: _bool,
    str: _str,
    complex: _complex,
    ArrayLike: _array,
    Path: _path,
}
