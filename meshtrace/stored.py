"""Base of all results: text, notebook table, xarray Dataset and netCDF file.

A file is netCDF-4 with a Fletcher-32 checksum in each variable, followed by the SHA-256 digest of
all its bytes, which other readers ignore. It is encoded in memory and replaced atomically.
"""

from __future__ import annotations

import abc
import hashlib
import html
import io
import json
import mmap
import struct
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

from meshtrace.errors import Described, Refused, one_line, reason_of, show
from meshtrace.files import atomic

if TYPE_CHECKING:
    import xarray as xr

FORMAT_VERSION = 2
"""Version of the files; those of version 1 (meshtrace 0.1) are read, too."""

SHIFTS = 32
"""Independent groups from which standard errors come: shifts of chains, photon ids modulo 32."""

_HOMES = {
    "gain": "meshtrace.results.gain",
    "impulse-response": "meshtrace.results.impulse",
    "series": "meshtrace.results.series",
    "duplex": "meshtrace.studies.comparison",
    "coverage": "meshtrace.results.coverage",
    "comparison": "meshtrace.studies.comparison",
    "background": "meshtrace.results.background",
    "background-series": "meshtrace.results.background",
    "fading": "meshtrace.fading.summary",
    "performance": "meshtrace.studies.performance.tables",
    "depth-sweep": "meshtrace.studies.performance.tables",
    "convergence": "meshtrace.studies.convergence.study",
    "inference": "meshtrace.studies.inference.study",
    "optimum": "meshtrace.studies.optimisation.study",
    "sensitivity": "meshtrace.studies.sensitivity.result",
    "fading-convergence": "meshtrace.studies.convergence.fading",
}
"""Modules of the results by kind, imported when a file asks for them."""

_MARK = b"meshtrace-sha256"
_TRAILER = len(_MARK) + hashlib.sha256().digest_size
_HEAP, _HEAP_OBJECT = b"GCOL\x01\0\0\0", struct.Struct("<H6xQ")
_ALLOWED = "an undamaged netCDF file"


class Stored(abc.ABC):
    """Result with a text, a notebook table, a Dataset and a file.

    Subclasses are frozen dataclasses (`repr=False`) with a `kind`, a `title` and the abstract
    methods below.
    """

    kind: ClassVar[str] = ""
    title: ClassVar[str] = ""
    provenance: Any

    _classes: ClassVar[dict[str, type[Stored]]] = {}

    def __init_subclass__(cls) -> None:
        """Register the kind of a class that has one."""
        if cls.kind:
            Stored._classes[cls.kind] = cls

    @abc.abstractmethod
    def summary(self) -> str:
        """Return the result as text for a terminal."""

    @abc.abstractmethod
    def _headline(self) -> str:
        """Return the most important numbers as one line."""

    @abc.abstractmethod
    def _content(self) -> xr.Dataset:
        """Return the Dataset without kind, version and provenance."""

    @classmethod
    @abc.abstractmethod
    def _restored(cls, data: xr.Dataset, provenance: Any) -> Self:
        """Return the result of a dataset of this kind."""

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
        import numpy as np

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
        kind, version = dataset.attrs.get("kind"), dataset.attrs.get("format_version")
        if kind != cls.kind or version != FORMAT_VERSION:
            found = f"a {kind} of format_version {version}" if kind else "no result"
            allowed = f"{cls.kind} of format_version {FORMAT_VERSION}"
            raise Refused(name, Described(found), allowed)
        try:
            result = cls._restored(dataset, json.loads(dataset.attrs["provenance"]))
            result._origin_lines()
            return result
        except (LookupError, ValueError, TypeError, AttributeError) as error:
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
    kind = data.attrs.get("kind")
    if kind not in _HOMES:
        found = Described(f"kind {kind}" if kind else "no result")
        raise Refused(str(path), found, f"results of kind {', '.join(_HOMES)}")
    import_module(_HOMES[kind])
    return Stored._classes[kind].from_dataset(data, str(path))


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
    OSError
        If the file cannot be written; an older one is unchanged.
    """
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
    import h5py
    import xarray as xr

    if not _is_file(path):
        name = str(path) if isinstance(path, str | PathLike) else show(path)
        raise Refused(name, Described("no such file"), _ALLOWED)
    try:
        if _is_damaged(path):
            raise OSError("damaged: its checksum differs")
        with open(path, "rb") as file:
            engine = "scipy" if file.read(3) == b"CDF" else "h5netcdf"
        if engine == "h5netcdf":
            _check_heaps(path)
            with h5py.File(path, "r") as found:  # h5netcdf leaves a traceback where this fails
                found.attrs.get("_nc3_strict")
        with xr.open_dataset(path, engine=engine, decode_timedelta=False, **options) as opened:
            return opened.load()
    except Exception as error:  # the readers raise any exception
        raise Refused(str(path), Described(reason_of(error)), _ALLOWED) from error


def _is_file(path: Any) -> bool:
    """Return whether a value is the path of a regular file."""
    try:
        return Path(path).is_file()
    except (TypeError, ValueError, OSError):
        return False


def _is_damaged(path: str | PathLike[str]) -> bool:
    """Return whether a file has a digest at its end that differs from that of its bytes.

    HDF5 notes the end of its bytes: the rest behind it is an intact or a damaged digest.
    """
    size = Path(path).stat().st_size - _TRAILER
    with open(path, "rb") as file:
        end = _hdf5_end(file.read(52))
        file.seek(0)
        digest = hashlib.sha256()
        for start in range(0, max(size, 0), 2**20):
            digest.update(file.read(min(2**20, size - start)))
        trailer = file.read()
    expected = trailer.startswith(_MARK) or (end is not None and end < size + _TRAILER)
    return expected and trailer != _MARK + digest.digest()


def _check_heaps(path: str | PathLike[str]) -> None:
    """Refuse an HDF5 file with an object of no size in a global heap.

    HDF5 loops for ever over it (H5HG__cache_heap_deserialize); one wrong bit in a file without a
    digest is enough.
    """
    if Path(path).stat().st_size == 0:
        raise OSError("the file is empty")
    with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        start = content.find(_HEAP)
        while start >= 0:
            end = start + int.from_bytes(content[start + 8 : start + 16], "little")
            at = start + 16
            while at + 16 <= end <= len(content):
                index, size = _HEAP_OBJECT.unpack_from(content, at)
                if index == 0 and size < 16:
                    raise OSError("damaged: an object of a global heap has no size")
                at += 16 + -(-size // 8) * 8 if index else size
            start = content.find(_HEAP, start + 1)


def _hdf5_end(head: bytes) -> int | None:
    """Return the length that the superblock of an HDF5 file gives, None for other files."""
    if len(head) < 52 or not head.startswith(b"\x89HDF\r\n\x1a\n"):
        return None
    place = {0: 40, 1: 44}.get(head[8], 28)  # by the version of the superblock
    return int.from_bytes(head[place : place + 8], "little")
