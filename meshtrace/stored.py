"""Base of all results: text, notebook table, xarray Dataset and netCDF file.

A file is netCDF-4 with a Fletcher-32 checksum in each variable, followed by the SHA-256 digest of
all its bytes, which other readers ignore. It is encoded in memory and replaced atomically.
"""

from __future__ import annotations

import hashlib
import html
import io
import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields
from functools import cache, reduce
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Any,
    ClassVar,
    NamedTuple,
    Self,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np
from numpy.typing import NDArray

from meshtrace.checks import check_call, check_methods
from meshtrace.errors import (
    LARGEST,
    Described,
    Refused,
    one_line,
    require_writable,
    show,
)
from meshtrace.fields import attrs
from meshtrace.files import atomic
from meshtrace.netcdf import opened, reading

if TYPE_CHECKING:
    import xarray as xr

FORMAT_VERSION = 2
"""Version of the files; others are refused."""

SHIFTS = 32
"""Independent groups from which standard errors come: shifts of chains, photon ids modulo 32."""

_HOMES = {
    "gain": "meshtrace.results.gain",
    "wavelengths": "meshtrace.results.series",
    "impulse-response": "meshtrace.results.impulse",
    "series": "meshtrace.results.series",
    "trace": "meshtrace.apps.traces",
    "duplex": "meshtrace.studies.comparison",
    "coverage": "meshtrace.results.series",
    "comparison": "meshtrace.studies.comparison",
    "background": "meshtrace.results.daylight",
    "background-series": "meshtrace.results.daylight",
    "irradiance-series": "meshtrace.results.daylight",
    "fading": "meshtrace.fading.statistics",
    "markov-channel": "meshtrace.apps.channels",
    "transformed-gaussian": "meshtrace.apps.channels",
    "performance": "meshtrace.studies.performance",
    "depth-sweep": "meshtrace.studies.performance",
    "convergence": "meshtrace.studies.convergence",
    "design": "meshtrace.apps.designs.page",
    "inference": "meshtrace.apps.inference",
    "optimum": "meshtrace.apps.optimisation",
    "sensitivity": "meshtrace.studies.sensitivity",
    "measured": "meshtrace.apps.measured",
    "fading-convergence": "meshtrace.studies.convergence",
}
"""Modules of the results by kind, imported when a file asks for them."""

_hints: Callable[..., dict[str, Any]] = cache(get_type_hints)  # which takes milliseconds

Variables = dict[str, tuple[tuple[str, ...], NDArray[Any], dict[str, str]]]

_MARK = b"meshtrace-sha256"
_TRAILER = len(_MARK) + hashlib.sha256().digest_size


class Variable(NamedTuple):
    """Dimensions of an array, its rule for merging and its name in files.

    A dimension or a name in braces is the value of that field; values with fewer dimensions have
    the first ones. A mean merges together with its standard error, which has no separate rule.
    """

    dims: str
    rule: Callable[..., Any] | None = None
    name: str = ""


class Rows(NamedTuple):
    """Kind and dimensions of rows with named fields, or of one of them: columns are variables.

    The name of a variable is that of its column behind the prefix: `ber_low` is `low` of `ber`, but
    `ber` its `value`. A column with the name of a dimension, or `name`, is its coordinate.
    """

    kind: type
    dims: str = ""
    prefix: str = ""

    def variables(self, rows: Sequence[Any], sizes: Mapping[str, int]) -> Variables:
        """Return the columns of rows; `sizes` are the sizes of all dimensions but the last."""
        dims = tuple(self.dims.split())
        shape = (*(sizes[name] for name in dims[:-1]), -1)[: len(dims)]
        found: Variables = {}
        for path, name in self._names():
            column = [reduce(getattr, path, row) for row in rows]
            kind = np.int8 if isinstance(column[0], bool | np.bool) else None
            array = np.reshape(np.array(column, kind), shape)
            if name in dims:  # varies along that alone
                array = array[tuple(slice(None) if one == name else 0 for one in dims)]
            found[name] = ((name,) if name in dims else dims, array, attrs(name))
        return found

    def read(self, data: xr.Dataset) -> list[Any]:
        """Return the rows of a dataset, none if it lacks them."""
        import xarray as xr

        names = [name for _, name in self._names()]
        if names[-1] not in data.variables:
            own = [name for name in names if name not in self.dims.split()]
            if any(name in data.variables for name in own):
                raise ValueError(f"no variable {names[-1]} beside {own[0]}")
            return []
        columns = xr.broadcast(*(data[name] for name in names))
        flat = (one.transpose(*self.dims.split()).values.ravel().tolist() for one in columns)
        return [_row(self.kind, iter(values)) for values in zip(*flat, strict=True)]

    def _names(self) -> Iterator[tuple[tuple[str, ...], str]]:
        """Yield the path of each column within a row, and its name in files."""
        dims = self.dims.split()
        for path in _paths(self.kind):
            column = "_".join(path).removesuffix("_value")
            name = dims[0] if column == "name" else f"{self.prefix}{column}".removesuffix("_value")
            yield path, column if column in dims else name


def _paths(kind: Any) -> Iterator[tuple[str, ...]]:
    """Yield the names that lead to each number or text of a row."""
    for name, hint in _hints(kind).items():
        inner = _paths(hint) if hasattr(hint, "_fields") else [()]
        yield from ((name, *path) for path in inner)


def _row(kind: Any, values: Iterator[Any]) -> Any:
    """Return a row of the next values, in the order of `_paths`."""
    found = []
    for hint in _hints(kind).values():
        value = _row(hint, values) if hasattr(hint, "_fields") else next(values)
        if hint in (int, float, str) and not isinstance(value, str if hint is str else int | float):
            raise TypeError(f"{value!r:.40} for a {hint.__name__}")
        found.append(bool(value) if hint is bool else value)
    return kind(*found)


def _check_array(array: xr.DataArray, dims: list[str], hint: Any) -> None:
    """Refuse an array of other dimensions than a result writes, or of text for numbers."""
    # values of one receiver lack that dimension; a number has none
    few = (array.ndim or not dims) and set(dims[array.ndim :]) <= {"receiver"}
    # a link may have no receivers, and light no scatterings
    is_empty = any(n == 0 for name, n in array.sizes.items() if name not in ("receiver", "order"))
    if not few or list(array.dims) != dims[: array.ndim] or is_empty:
        shape = ", ".join(f"{name} {size}" for name, size in array.sizes.items())
        raise ValueError(f"{array.name} of dimensions ({shape}), not ({', '.join(dims)})")
    if array.dtype.kind not in ("UOST" if _is_text(hint) else "biuf"):
        raise TypeError(f"{array.name} of {array.dtype}")
    if array.dtype.kind == "f":
        _check_range(str(array.name), array.to_numpy())


def _is_text(hint: Any) -> bool:
    """Return whether a type is that of texts, or of a tuple of texts or of certain words."""
    return hint is str or isinstance(hint, str) or any(map(_is_text, get_args(hint)))


def _check_range(name: str, values: NDArray[Any]) -> None:
    """Refuse numbers whose squares overflow in statistics."""
    if (np.isfinite(values) & (np.abs(values) > LARGEST)).any():
        raise ValueError(f"{name} beyond {LARGEST:g}")


class Attribute(NamedTuple):
    """Name in files of a field that is an attribute; none if the field is not, or elsewhere."""

    name: str = ""


class WithArrays:
    """Base of the dataclasses with fields of type ``Annotated[array, Variable(...)]``.

    Fields of type ``Annotated[rows, Rows(...)]`` have a variable for each column. Fields whose type
    is another such class, or None, have their arrays in the same dataset.
    """

    @classmethod
    def _described(cls, kind: Any = Variable) -> Iterator[tuple[str, Any, Any]]:
        """Yield attribute, type and description of each array, or of another kind."""
        hints = _hints(cls)
        for attribute, hint in _hints(cls, include_extras=True).items():
            for about in getattr(hint, "__metadata__", ()):
                if isinstance(about, kind):
                    yield attribute, hints[attribute], about

    @classmethod
    def _parts(cls) -> Iterator[tuple[str, Any]]:
        """Yield attribute and class of each field that holds further arrays."""
        for attribute, hint in _hints(cls).items():
            for kind in get_args(hint):
                if isinstance(kind, type) and issubclass(kind, WithArrays):
                    yield attribute, kind

    def to_variables(self) -> Variables:
        """Return the arrays by their names in files, with dimensions and attributes."""
        found: Variables = {}
        for attribute, _, variable in self._described():
            value, dims = getattr(self, attribute), variable.dims.format(**vars(self)).split()
            name = (variable.name or attribute).format(**vars(self))
            if value is not None:
                array = np.atleast_1d(value) if dims else np.asarray(value)
                found[name] = (tuple(dims[: array.ndim]), array, attrs(name))
        sizes = {name: len(array) for name, (dims, array, _) in found.items() if dims == (name,)}
        for attribute, _, rows in self._described(Rows):
            given = getattr(self, attribute)
            if given:
                found |= rows.variables(given if rows.dims else [given], sizes)
        for attribute, _ in self._parts():
            part = getattr(self, attribute)
            found |= {} if part is None else part.to_variables()
        return found

    @classmethod
    def arrays(cls, data: xr.Dataset) -> dict[str, Any]:
        """Return the fields that a dataset holds: numbers, arrays, tuples of texts."""
        found: dict[str, Any] = {}
        for attribute, hint, variable in cls._described():
            name = variable.name or attribute
            name = name.format(**data.attrs) if "{" in name else name
            if name in data.variables:
                _check_array(data[name], variable.dims.format(**data.attrs).split(), hint)
                value = data[name].to_numpy()
                found[attribute] = tuple(value.tolist()) if get_origin(hint) is tuple else value
                if not value.ndim:
                    found[attribute] = value.item()
        for attribute, hint, table in cls._described(Rows):
            several, rows = get_origin(hint) or hint, table.read(data)
            found[attribute] = several(rows) if table.dims else rows[0] if rows else None
        for attribute, kind in cls._parts():
            fields = kind.arrays(data)
            found[attribute] = kind(**fields) if fields else None
        return found


@check_methods
class Stored(WithArrays, ABC):
    """Result with a text, a notebook table, a Dataset and a file.

    Subclasses are frozen dataclasses (`repr=False`) with a `kind` and a `title`. Fields described
    by a `Variable` or `Rows` become variables of the dataset, all others but the provenance its
    attributes, of the same name or that of an `Attribute`.
    """

    kind: ClassVar[str] = ""
    title: ClassVar[str] = ""
    provenance: Any

    _classes: ClassVar[dict[str, type[Stored]]] = {}

    def __init_subclass__(cls) -> None:
        """Register the kind of a class that has one."""
        super().__init_subclass__()
        check_methods(cls)
        if cls.kind:
            Stored._classes[cls.kind] = cls

    def summary(self) -> str:
        """Return the numbers with their standard errors and units as text for a terminal."""
        lines, found = [self._headline()], self.to_variables()
        for name, (dims, value, about) in found.items():
            if not dims and not name.endswith("_stderr"):
                error = f" +- {found[f'{name}_stderr'][1]:.1g}" if f"{name}_stderr" in found else ""
                text = f"{value:.6g}{error} {about['units']}".removesuffix(" 1")
                lines.append(f"  {name.replace('_', ' '):<20} {text}")
        return "\n".join(lines + self._origin_lines())

    @abstractmethod
    def _headline(self) -> str:
        """Return the most important numbers as one line."""

    def _content(self) -> xr.Dataset:
        """Return the Dataset without kind, version and provenance."""
        import xarray as xr

        about = {name: _plain(self, field) for field, name in self._named()}
        return xr.Dataset(self.to_variables(), attrs=about)

    @classmethod
    def _named(cls) -> list[tuple[str, str]]:
        """Return fields and names of the attributes of the dataset."""
        arrays = {one[0] for one in (*cls._described((Variable, Rows)), *cls._parts())}
        own: Any = cls  # a dataclass
        names = {field.name: field.name for field in fields(own) if field.name not in arrays}
        names.pop("provenance", None)
        names |= {name: about.name for name, _, about in cls._described(Attribute)}
        return [(field, name) for field, name in names.items() if name]

    @classmethod
    def _restored(cls, data: xr.Dataset, provenance: Any, **more: Any) -> Self:
        """Return the result of a dataset of this kind; attributes that it lacks have defaults.

        `more` are the fields that are neither in its variables nor in its attributes.
        """
        found, hints = cls.arrays(data), _hints(cls)
        for field, name in cls._named():
            if name in data.attrs:
                found[field] = _typed(data.attrs[name], hints[field])
        return cls(**{**found, **more, "provenance": provenance})

    def _check(self) -> None:
        """Raise for values of a file that no study writes: its digest may be that of a forger."""

    def _origin_lines(self) -> list[str]:
        """Return the texts that come from the provenance; a file is refused without them."""
        return []

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self._headline()}>"

    def __str__(self) -> str:
        return self.summary()

    def _repr_html_(self) -> str:
        data = self.to_dataset()
        del data.attrs["provenance"]  # thousands of characters
        return f"<pre>{html.escape(self._headline())}</pre>{data._repr_html_()}"

    def to_dataset(self) -> xr.Dataset:
        """Return the result as an xarray Dataset with units and provenance."""
        return self._content().assign_attrs(
            title=self.title,
            kind=self.kind,
            format_version=FORMAT_VERSION,
            provenance=json.dumps(self.provenance, default=np.generic.item),
        )

    @classmethod
    def from_dataset(cls, dataset: xr.Dataset, name: str = "dataset") -> Self:
        """Return the result that `to_dataset` wrote.

        Parameters
        ----------
        dataset : xarray.Dataset
            Of the same kind.
        name : str
            Name of the dataset or file, for messages.

        Raises
        ------
        Refused
            If the dataset is of another kind or format, or incomplete.
        """
        kind, version = dataset.attrs.get("kind"), dataset.attrs.get("format_version", 0)
        is_version = np.ndim(version) == 0 and version == FORMAT_VERSION
        if not isinstance(kind, str) or kind != cls.kind or not is_version:
            found = f"a {kind} of format_version {version}" if kind else "no result"
            allowed = f"{cls.kind} of format_version {FORMAT_VERSION}"
            raise Refused(name, Described(found), allowed)
        try:
            for label in dataset.dims:
                if label in dataset.variables and bool(dataset[label].isnull().any()):
                    raise ValueError(f"{label} without a number")
            result = cls._restored(dataset, json.loads(dataset.attrs["provenance"]))
            result._check()
            result._origin_lines()
            result._content()  # fits together: sizes of all arrays
            return result
        except (LookupError, ValueError, TypeError, AttributeError, ArithmeticError) as error:
            reason = f"{type(error).__name__}: {one_line(error)}"
            raise Refused(
                name, Described(reason), f"a complete result of kind {cls.kind}"
            ) from error

    def save(self, path: str | Path) -> None:
        """Write the result as netCDF, atomically."""
        write_dataset(self.to_dataset(), path)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read the result from netCDF.

        Raises
        ------
        Refused
            If the file is damaged, or of another kind or format.
        """
        return cls.from_dataset(read_dataset(path), str(path))


class Stacked(Stored):
    """Results of one kind along a dimension, each with its provenance.

    Subclasses are dataclasses of two fields: labels along the dimension and the results. `_along`
    is the dimension and the name of the labels.
    """

    _along: ClassVar[tuple[str, str]] = ("", "")

    def _stack(self) -> tuple[Any, tuple[Any, ...]]:
        """Return the labels and the results."""
        labels, results = vars(self).values()
        return labels, results

    @classmethod
    def _of_stack(cls, labels: Any, results: tuple[Any, ...]) -> Self:
        """Return the stack of labels and results."""
        return cls(labels, results)  # type: ignore[call-arg]

    @property
    def provenance(self) -> list[Any]:
        """Provenance of each result."""
        return [result.provenance for result in self._stack()[1]]

    def _content(self) -> xr.Dataset:
        import xarray as xr

        (dim, name), (labels, results) = self._along, self._stack()
        parts = [result._content() for result in results]
        each = [json.dumps(part.attrs, default=lambda number: number.tolist()) for part in parts]
        parts = [
            part.drop_attrs(deep=False).drop_vars(name, errors="ignore") for part in _alike(parts)
        ]
        data = xr.concat(
            parts, dim, data_vars="all", coords="minimal", compat="override",
            join="outer", combine_attrs="override",
        )  # fmt: skip
        return data.assign_coords({name: (dim, np.asarray(labels), attrs(name))}).assign_attrs(
            of=results[0].kind, each=each
        )

    @classmethod
    def _restored(cls, data: xr.Dataset, provenance: Any, **more: Any) -> Self:
        (dim, name), kind = cls._along, kind_of(data.attrs["of"])
        results = []
        abouts = np.atleast_1d(data.attrs["each"])
        for i, (about, origin) in enumerate(zip(abouts, provenance, strict=True)):
            one = data.isel({dim: i}).assign_attrs(**json.loads(about))
            results.append(kind._restored(one, origin))
        return cls._of_stack(data[name].to_numpy(), tuple(results))


def _alike(parts: Sequence[xr.Dataset]) -> list[xr.Dataset]:
    """Return datasets padded to common sizes along dimensions without coordinates."""
    sizes: dict[Any, int] = {}
    for part in parts:
        for name, size in part.sizes.items():
            sizes[name] = max(sizes.get(name, 0), size)
    found = []
    for part in parts:
        free = {n: k for n, k in part.sizes.items() if n not in part.coords}
        lack = {n: (0, sizes[n] - k) for n, k in free.items() if k < sizes[n]}
        found.append(part.pad(lack, constant_values=0.0) if lack else part)
    return found


def _plain(result: Stored, name: str) -> Any:
    """Return a field as an attribute of a file: numbers and texts as they are, others as JSON."""
    value = getattr(result, name)
    if isinstance(value, np.ndarray):
        return value
    if value and isinstance(value, tuple) and all(isinstance(v, int | float) for v in value):
        return list(value)
    return value if np.isscalar(value) else json.dumps(value, default=vars)


def _typed(value: Any, hint: Any) -> Any:
    """Return an attribute of a file as a value of a type."""
    from pydantic import TypeAdapter

    if np.asarray(value).dtype.kind == "f":
        _check_range("an attribute", np.asarray(value))
    if hint is Any:
        return value
    if isinstance(value, str) and hint is not str:
        with suppress(ValueError):  # a word, or damaged: the type decides
            value = json.loads(value)
    return TypeAdapter(hint).validate_python(
        np.asarray(value).tolist() if hasattr(value, "dtype") else value
    )


@check_call
def load(path: str | Path) -> Stored:
    """Read a result of any kind from netCDF.

    Parameters
    ----------
    path : path
        File that `save` of a result wrote.

    Returns
    -------
    Stored
        An object of the class that wrote the file.

    Raises
    ------
    Refused
        If the file is damaged or no such result.
    """
    data = read_dataset(path)
    return kind_of(data.attrs.get("kind"), str(path)).from_dataset(data, str(path))


def kind_of(kind: Any, name: str = "kind") -> type[Stored]:
    """Return the class of results of a kind; `name` is the dataset or file in messages.

    Raises
    ------
    Refused
        If there is no such kind.
    """
    if not isinstance(kind, str) or kind not in _HOMES:
        found = Described("no result" if kind is None else f"kind {show(kind)}")
        raise Refused(name, found, f"results of kind {', '.join(_HOMES)}")
    import_module(_HOMES[kind])
    return Stored._classes[kind]


@check_call
def write_dataset(data: xr.Dataset, path: str | Path) -> None:
    """Write a Dataset as netCDF with checksums, atomically.

    Parameters
    ----------
    data : xarray.Dataset
        Dataset.
    path : path
        Target.

    Raises
    ------
    Refused
        If the path is a folder or in none, or may not be written.
    OSError
        If the disk is full; an older file is unchanged.
    """
    require_writable(path, field="path")
    import h5netcdf
    from xarray.backends import H5NetCDFStore

    data = data.compute()
    for variable in data.variables.values():
        numbers = variable.size > 0 and variable.ndim > 0 and variable.dtype.kind in "biufc"
        variable.encoding = {"_FillValue": None, **({"fletcher32": True} if numbers else {})}
    # in memory: HDF5 may crash where it cannot write to the disk
    buffer = io.BytesIO()
    store = H5NetCDFStore(h5netcdf.File(buffer, "w"))
    data.dump_to_store(store)
    store.close()
    content = buffer.getbuffer()
    with atomic(path) as temporary, temporary.open("wb") as file:
        file.write(content)
        file.write(_MARK + hashlib.sha256(content).digest())


@check_call
def read_dataset(path: str | PathLike[str], **options: Any) -> xr.Dataset:
    """Read a netCDF file into memory.

    Parameters
    ----------
    path : path
        Regular file, netCDF-4 or classic netCDF.
    **options
        Options of `xarray.open_dataset`.

    Raises
    ------
    Refused
        If there is no such file, or it is damaged or no netCDF file.
    """
    with reading(path):
        if _is_damaged(path):
            raise OSError("damaged: its checksum differs")
        with opened(path, **options) as data:
            return data.load()


def _is_damaged(path: str | PathLike[str]) -> bool:
    """Return whether the digest at the end of a file differs from the digest of its bytes.

    HDF5 notes the end of its bytes in its superblock: the rest behind it is an intact or a damaged
    digest. Other files have none.
    """
    size = Path(path).stat().st_size - _TRAILER
    with open(path, "rb") as file:
        end, head = None, file.read(52)
        if len(head) == 52 and head.startswith(b"\x89HDF\r\n\x1a\n"):
            place = {0: 40, 1: 44}.get(head[8], 28)  # by the version of the superblock
            end = int.from_bytes(head[place : place + 8], "little")
        file.seek(0)
        digest = hashlib.sha256()
        for start in range(0, max(size, 0), 2**20):
            digest.update(file.read(min(2**20, size - start)))
        trailer = file.read()
    expected = trailer.startswith(_MARK) or (end is not None and end < size + _TRAILER)
    return expected and trailer != _MARK + digest.digest()
