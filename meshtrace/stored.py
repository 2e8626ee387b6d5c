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
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import cache, reduce
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from meshtrace.checks import check_call, check_methods
from meshtrace.errors import LARGEST, MISSING, Described, Refused, one_line, require_writable, show
from meshtrace.fields import attrs
from meshtrace.files import atomic
from meshtrace.netcdf import opened, reading

if TYPE_CHECKING:
    import xarray as xr

FORMAT_VERSION = 2
"""Version of the files; others are refused."""

SHIFTS = 32
"""Number of independent groups of samples, whose scatter gives the standard errors.

Chains are grouped by the random shift of their points, photons by their number modulo `SHIFTS`.
"""

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
    "depth-sweep": "meshtrace.studies.depths",
    "convergence": "meshtrace.studies.convergence",
    "design": "meshtrace.apps.designs.page",
    "inference": "meshtrace.apps.inference",
    "lidar": "meshtrace.apps.lidar",
    "optimum": "meshtrace.apps.optimisation",
    "pixels": "meshtrace.studies.pixels",
    "availability": "meshtrace.studies.availability_result",
    "sensitivity": "meshtrace.studies.derivatives",
    "measured": "meshtrace.apps.measured",
    "fading-convergence": "meshtrace.studies.fading_convergence",
}
"""Module that defines the result of each kind, imported when a file holds one."""

_hints: Callable[..., dict[str, Any]] = cache(get_type_hints)  # a call takes milliseconds

_MARK = b"meshtrace-sha256"
_TRAILER = len(_MARK) + hashlib.sha256().digest_size  # [B]

Variables = dict[str, tuple[Any, ...]]
"""Arrays by their names in files: (dimensions, values) or (dimensions, values, attributes).

Without attributes, those of the name in `fields.toml` apply.
"""


class Elsewhere:
    """Field not stored, or stored by its class."""

    def write(self, value: Any) -> Variables:
        """Return no variables."""
        return {}

    def read(self, data: xr.Dataset, hint: Any) -> Any:
        """Return MISSING, with which the field keeps its default."""
        return MISSING


class Variable:
    """Array or number with its dimensions and its name in files (default: the field's).

    Units and long name are those of the name in `fields.toml`. A value with fewer dimensions than
    `dims` has the first of them.
    """

    def __init__(self, *dims: str, name: str = "") -> None:
        self.dims, self.name = dims, name

    def write(self, value: Any) -> Variables:
        """Return the variable of a value."""
        # the gain of a single receiver is a number, and in files an array of one
        array = np.atleast_1d(value) if self.dims else np.asarray(value)
        return {self.name: (self.dims[: array.ndim], array)}

    def read(self, data: xr.Dataset, hint: Any) -> Any:
        """Return the array, number or tuple that a dataset has for a field, or MISSING."""
        if self.name not in data.variables:
            return MISSING
        values = self.checked(data.variables[self.name], hint).to_numpy()
        if not values.ndim:
            return values.item()
        return tuple(values.tolist()) if get_origin(hint) is tuple else values

    def checked(self, array: xr.Variable, hint: Any) -> xr.Variable:
        """Check that an array has the dimensions and the type of values that a result writes."""
        dims, lacking = self.dims[: array.ndim], self.dims[array.ndim :]
        # values of one receiver lack that dimension; a number has none
        fits = array.dims == dims and (array.ndim or not lacking) and {*lacking} <= {"receiver"}
        # a link may have no receivers, and its water may not scatter: no order of scattering
        is_empty = any(n == 0 for dim, n in array.sizes.items() if dim not in ("receiver", "order"))
        if not fits or is_empty:
            shape = ", ".join(f"{dim} {size}" for dim, size in array.sizes.items())
            raise ValueError(f"{self.name} of dimensions ({shape}), not ({', '.join(self.dims)})")
        # text of fixed length, as Python objects or of variable length; or else numbers
        if array.dtype.kind not in ("UOT" if _is_text(hint) else "biuf"):
            raise TypeError(f"{self.name} of {array.dtype}")
        _check_range(self.name, array.to_numpy())
        return array


class Columns:
    """Sequence of named tuples or dataclasses, stored as one variable for each of their fields.

    A prefix goes before the names of the variables. An `Estimate` in the field `ber` is stored as
    ber, ber_low and ber_high. A field with the name of a dimension, or the field `name` for the
    first dimension, is its coordinate. Without dimensions there is a single item.
    """

    def __init__(self, kind: type, prefix: str = "", *dims: str) -> None:
        self.kind, self.prefix, self.dims = kind, prefix, dims

    def write(self, value: Any) -> Variables:
        """Return the variables of items in row-major order."""
        items = value if self.dims else [value]
        columns = {
            variable.name: (variable, [reduce(getattr, path, row) for row in items])
            for variable, path, _ in self._columns()
        }
        # a dimension is as long as its coordinate has values; the last follows from the items
        shape = (*(len({*columns[dim][1]}) for dim in self.dims[:-1]), -1)[: len(self.dims)]
        variables = Variables()
        for variable, column in columns.values() if items else ():
            # netCDF has no truth values
            array = np.array(column, np.int8 if isinstance(column[0], bool | np.bool) else None)
            # a coordinate is the same along all other dimensions
            first = tuple(0 if dim not in variable.dims else slice(None) for dim in self.dims)
            variables |= variable.write(array.reshape(shape)[first])
        return variables

    def read(self, data: xr.Dataset, hint: Any) -> Any:
        """Return the items that a dataset has for a field, or MISSING."""
        columns = {variable.name: (variable, kind) for variable, _, kind in self._columns()}
        present = [name for name in columns if name in data.variables and name not in self.dims]
        if not present:
            return MISSING
        if lacking := [name for name in columns if name not in data.variables]:
            raise ValueError(f"no variable {lacking[0]} beside {present[0]}")
        sizes = {dim: data.sizes[dim] for dim in self.dims}
        flat = []
        for name, (variable, kind) in columns.items():
            array = data.variables[name].transpose(*variable.dims, missing_dims="ignore")
            flat.append(variable.checked(array, kind).set_dims(sizes).to_numpy().ravel().tolist())
        items = _rows(self.kind, iter(flat))
        return (get_origin(hint) or hint)(items) if self.dims else items[0]

    def _columns(self) -> Iterator[tuple[Variable, tuple[str, ...], Any]]:
        """Yield the variable of each column, its path within an item, and its type."""
        for path, hint in _paths(self.kind):
            # the value of an `Estimate` has the name of the estimate
            words = (word for word in (self.prefix, *path) if word not in ("", "value"))
            name = self.dims[0] if path == ("name",) else "_".join(words)
            yield Variable(*([name] if name in self.dims else self.dims), name=name), path, hint


def _paths(kind: Any) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield the path of field names to each number or text in nested tuples, and its type."""
    for name, hint in _hints(kind).items():
        inner = _paths(hint) if hasattr(hint, "_fields") else [((), hint)]
        yield from (((name, *path), last) for path, last in inner)


def _rows(kind: Any, columns: Iterator[list[Any]]) -> list[Any]:
    """Return items of a class, made of the next columns in the order of `_paths`."""
    values: list[Any] = []
    for hint in _hints(kind).values():
        column = _rows(hint, columns) if hasattr(hint, "_fields") else next(columns)
        values.append(map(bool, column) if hint is bool else column)  # stored as int8
    return [kind(*row) for row in zip(*values, strict=True)]


class Part:
    """Tally or named tuple of arrays, stored as the variables of its fields."""

    def __init__(self, kind: type) -> None:
        self.kind = kind

    def write(self, value: Any) -> Variables:
        """Return the variables of a part."""
        return variables_of(value)

    def read(self, data: xr.Dataset, hint: Any) -> Any:
        """Return the part that a dataset has for a field, or MISSING."""
        fields = fields_of(self.kind, data)
        return self.kind(**fields) if fields else MISSING


class Attribute(Elsewhere):
    """Attribute of a dataset with its name in files: a number or a text, or else JSON."""

    def __init__(self, name: str) -> None:
        self.name = name

    def plain(self, value: Any) -> Any:
        """Return a value as an attribute of a file."""
        is_plain = np.isscalar(value) or isinstance(value, np.ndarray)
        return value if is_plain else json.dumps(value, default=vars)

    def read(self, data: xr.Dataset, hint: Any) -> Any:
        """Return the attribute of a dataset as a value of a type, or MISSING."""
        from pydantic import TypeAdapter

        if self.name not in data.attrs:
            return MISSING
        value = data.attrs[self.name]
        _check_range("an attribute", np.asarray(value))
        if hint is Any:
            return value
        if isinstance(value, str) and hint is not str:
            with suppress(ValueError):  # no JSON: a word, or damaged; the validation decides
                value = json.loads(value)
        # netCDF returns numbers as numpy's types
        value = value.tolist() if isinstance(value, np.ndarray | np.generic) else value
        return TypeAdapter(hint).validate_python(value)


def _is_text(hint: Any) -> bool:
    """Return whether a type is `str`, a tuple of `str`, or a `Literal` of words."""
    return hint is str or isinstance(hint, str) or any(map(_is_text, get_args(hint)))


def _check_range(name: str, values: NDArray[Any]) -> None:
    """Refuse numbers whose squares overflow in statistics."""
    if values.dtype.kind == "f" and (np.isfinite(values) & (np.abs(values) > LARGEST)).any():
        raise ValueError(f"{name} beyond {LARGEST:g}")


def described(kind: Any) -> dict[str, tuple[Any, Any]]:
    """Return the type and the storage of each field, by default an `Attribute`."""
    fields = {}
    for name, hint in _hints(kind, include_extras=True).items():
        if get_origin(hint) is not ClassVar and name != "provenance":
            description = getattr(hint, "__metadata__", [Attribute(name)])[0]  # of `Annotated`
            if isinstance(description, Variable) and not description.name:
                description = Variable(*description.dims, name=name)
            fields[name] = _hints(kind)[name], description
    return fields


def variables_of(item: Any) -> Variables:
    """Return the variables of a result or part: its fields and its `_derived` ones."""
    variables = Variables()
    for name, (_, description) in described(type(item)).items():
        value = getattr(item, name)
        variables |= {} if value is None else description.write(value)
    return variables | getattr(item, "_derived", dict)()


def fields_of(kind: type, data: xr.Dataset) -> dict[str, Any]:
    """Return the fields of a result or part that a dataset holds."""
    fields = {name: entry.read(data, hint) for name, (hint, entry) in described(kind).items()}
    return {name: value for name, value in fields.items() if value is not MISSING}


@check_methods
class Stored(ABC):
    """Result with a text, a notebook table, a Dataset and a file.

    Subclasses are frozen dataclasses (`repr=False`) with a `kind` and a `title`. A field of type
    ``Annotated[array, Variable(*dims)]`` is a variable of the dataset; those with `Columns` and
    `Part` are several. All others but the provenance are attributes, under their own name or that
    of an `Attribute`. A result over a parameter that the user chooses calls the dimension and its
    coordinate "step"; files name them by the value of the field `_step_name`.
    """

    kind: ClassVar[str] = ""
    title: ClassVar[str] = ""
    provenance: Any

    _step_name: ClassVar[str] = ""
    _classes: ClassVar[dict[str, type[Stored]]] = {}

    def __init_subclass__(cls, kind: str = "", title: str = "") -> None:
        """Register the kind of a class that has one."""
        super().__init_subclass__()
        check_methods(cls)
        if kind:
            cls.kind, cls.title = kind, title
            Stored._classes[kind] = cls

    def summary(self) -> str:
        """Return the numbers with their standard errors and units as text for a terminal."""
        lines, variables = [self._headline()], variables_of(self)
        for name, (dims, value) in variables.items():
            if not dims and not name.endswith("_stderr"):
                error = variables.get(f"{name}_stderr")
                text = f"{value:.6g}" + (f" +- {error[1]:.1g}" if error else "")
                text = f"{text} {attrs(name)['units']}".removesuffix(" 1")
                lines.append(f"  {name.replace('_', ' '):<20} {text}")
        return "\n".join(lines + self._origin_lines())

    @abstractmethod
    def _headline(self) -> str:
        """Return the most important numbers as one line."""

    def _content(self) -> xr.Dataset:
        """Return the Dataset without kind, version and provenance."""
        import xarray as xr

        attributes = {
            description.name: description.plain(getattr(self, name))
            for name, (_, description) in described(type(self)).items()
            if isinstance(description, Attribute)
        }
        data = xr.Dataset(variables_of(self), attrs=attributes)
        # rename first: units are looked up by the name in files
        if self._step_name:
            data = data.rename(step=attributes[self._step_name])
        for name, variable in data.variables.items():
            variable.attrs = variable.attrs or attrs(str(name))
        return data

    @classmethod
    def _restored(
        cls, data: xr.Dataset, provenance: Any, derived: dict[str, Any] | None = None
    ) -> Self:
        """Return the result of a dataset of this kind; missing attributes take their defaults.

        `derived` are fields that are neither in its variables nor in its attributes.
        """
        if cls._step_name:
            data = data.rename({data.attrs[cls._step_name]: "step"})
        return cls(**fields_of(cls, data) | (derived or {}) | {"provenance": provenance})

    def _check(self) -> None:  # noqa: B027
        """Raise an error for values that no study writes; anybody can compute a valid digest."""

    def _origin_lines(self) -> list[str]:
        """Return the lines of the summary that come from the provenance."""
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
            problem = f"a {kind} of format_version {version}" if kind else "no result"
            allowed = f"{cls.kind} of format_version {FORMAT_VERSION}"
            raise Refused(name, Described(problem), allowed)
        # a digest shows that a file is undamaged, not that meshtrace wrote it
        try:
            for label in dataset.dims:
                if label in dataset.variables and bool(dataset[label].isnull().any()):
                    raise ValueError(f"{label} without a number")
            result = cls._restored(dataset, json.loads(dataset.attrs["provenance"]))
            result._check()
            result._origin_lines()  # fails if the provenance lacks a key
            result._content()  # fails if the sizes of arrays do not agree
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

    Subclasses are dataclasses of the labels along the dimension and the results. `_along` holds
    the names of the dimension and of the labels in files.
    """

    _along: ClassVar[tuple[str, str]] = ("", "")

    @abstractmethod
    def _stack(self) -> tuple[Any, tuple[Any, ...]]:
        """Return the labels and the results."""

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
        # variables are concatenated; attributes cannot be, and are written as JSON for each result
        datasets = [result._content() for result in results]
        each = [json.dumps(part.attrs, default=lambda number: number.tolist()) for part in datasets]
        data = xr.concat(
            [part.drop_vars(name, errors="ignore") for part in _alike(datasets)],
            dim, data_vars="all", coords="minimal", compat="override", join="outer",
            combine_attrs="override",
        )  # fmt: skip
        data.attrs = {"of": results[0].kind, "each": each}
        return data.assign_coords({name: (dim, np.asarray(labels), attrs(name))})

    @classmethod
    def _restored(
        cls, data: xr.Dataset, provenance: Any, derived: dict[str, Any] | None = None
    ) -> Self:
        (dim, name), kind = cls._along, kind_of(data.attrs["of"])
        each = zip(np.atleast_1d(data.attrs["each"]), provenance, strict=True)
        results = [
            kind._restored(data.isel({dim: i}).assign_attrs(json.loads(attributes)), origin)
            for i, (attributes, origin) in enumerate(each)
        ]
        return cls._of_stack(data[name].to_numpy(), tuple(results))


def _alike(datasets: Sequence[xr.Dataset]) -> list[xr.Dataset]:
    """Return datasets padded with 0 to equal sizes along dimensions without coordinates."""
    sizes: dict[Any, int] = {}
    for part in datasets:
        for name, size in part.sizes.items():
            sizes[name] = max(sizes.get(name, 0), size)
    padded = []
    # such as the orders of scattering, fewer at some wavelengths: orders not sampled have no gain
    for part in datasets:
        free = {name: size for name, size in part.sizes.items() if name not in part.coords}
        pad = {name: (0, sizes[name] - size) for name, size in free.items() if size < sizes[name]}
        padded.append(part.pad(pad, constant_values=0.0) if pad else part)
    return padded


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
        If the file is damaged or holds no result.
    """
    data = read_dataset(path)
    return kind_of(data.attrs.get("kind"), str(path)).from_dataset(data, str(path))


def kind_of(kind: Any, name: str = "kind") -> type[Stored]:
    """Return the class of a kind of result; `name` is the dataset or file in messages.

    Raises
    ------
    Refused
        If there is no such kind.
    """
    if not isinstance(kind, str) or kind not in _HOMES:
        problem = Described("no result" if kind is None else f"kind {show(kind)}")
        raise Refused(name, problem, f"results of kind {', '.join(_HOMES)}")
    # only now: applications import much that a gain does not need
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
        If the path is a folder, is not in an existing folder, or may not be written.
    OSError
        If the disk is full; an older file is unchanged.
    """
    require_writable(path, field="path")
    import h5netcdf
    from xarray.backends import H5NetCDFStore

    data = data.compute()
    for variable in data.variables.values():
        # filters, such as the checksum, need chunks: no scalars and no empty arrays
        numbers = variable.size > 0 and variable.ndim > 0 and variable.dtype.kind in "biufc"
        variable.encoding = {"_FillValue": None} | ({"fletcher32": True} if numbers else {})
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
def read_dataset(path: str | PathLike[str], decode_times: bool = True) -> xr.Dataset:
    """Read a netCDF file into memory.

    Parameters
    ----------
    path : path
        Regular file, netCDF-4 or classic netCDF.
    decode_times : bool
        Whether numbers in units such as "days since 1970-01-01" are read as dates.

    Raises
    ------
    Refused
        If there is no such file, or it is damaged or not a netCDF file.
    """
    with reading(path):
        if _is_damaged(path):
            raise OSError("damaged: its checksum differs")
        with opened(path, decode_times=decode_times) as data:
            return data.load()


def _is_damaged(path: str | PathLike[str]) -> bool:
    """Return whether the digest at the end of a file differs from the digest of its bytes.

    The superblock of HDF5 states where its data end (end-of-file address; HDF5 File Format
    Specification, section II.A): what follows is an intact or a damaged digest. A file without
    the mark that ends there, or is no HDF5, has no digest and counts as undamaged.
    """
    size = Path(path).stat().st_size - _TRAILER  # [B] without the digest
    with open(path, "rb") as file:
        end, head = None, file.read(52)
        if len(head) == 52 and head.startswith(b"\x89HDF\r\n\x1a\n"):
            # byte 8 is the version of the superblock: 0, 1, or 2 and 3 alike
            place = {0: 40, 1: 44}.get(head[8], 28)
            end = int.from_bytes(head[place : place + 8], "little")
        file.seek(0)
        digest = hashlib.sha256()
        for start in range(0, max(size, 0), 2**20):
            digest.update(file.read(min(2**20, size - start)))
        trailer = file.read()
    is_signed = trailer.startswith(_MARK) or (end is not None and end < size + _TRAILER)
    return is_signed and trailer != _MARK + digest.digest()
