"""Safe reading of netCDF, HDF5 and Zarr files, with sizes checked before any array is read.

A file of a few kilobytes can state arrays of any size: HDF5 does not store chunks that were never
written, and deflate packs a thousand bytes into one.
"""

from __future__ import annotations

import bz2
import gzip
import lzma
import math
import mmap
import os
import re
import struct
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import lru_cache
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from meshtrace.errors import Described, Refused, refusing, show

if TYPE_CHECKING:
    import xarray as xr

MOST_BYTES = 2**31
"""Largest size of all arrays together, of a file that is read as a whole [B]."""

_HARMLESS = 2**26  # [B] (tuned: small enough for any computer) that even a tiny file may state
_DENSEST = 1100  # deflate expands a byte to at most 1032
_TEXT = 1024  # [B] assumed for a text of variable length, which HDF5 counts as a pointer
ALLOWED = "an undamaged netCDF file"
# HDF5 File Format Specification: start of a global heap (III.E), and the header of an object in
# it, of its index and its size [B]; start of a file (II.A)
_HEAP, _HEAP_OBJECT = b"GCOL\x01\0\0\0", struct.Struct("<H6xQ")
_HDF5 = b"\x89HDF\r\n\x1a\n"
# netCDF-C writes this text as attribute NAME of a dimension without coordinates
_PLACEHOLDER = "This is a netCDF dimension but not a netCDF variable"


def require_size(stated: int, stored: int, name: str, most: int | None = MOST_BYTES) -> None:
    """Refuse arrays larger than memory or than the stored bytes can hold.

    Parameters
    ----------
    stated : int
        Size of the arrays [B], uncompressed.
    stored : int
        Size of the file or the store [B].
    name : str
        File or variable, for the message.
    most : int, optional
        Bound on `stated` [B]; None where arrays are read in parts.
    """
    if most is not None and stated > most:
        raise Refused(name, Described(f"arrays of {_bytes(stated)}"), f"at most {_bytes(most)}")
    if stated > max(_HARMLESS, _DENSEST * stored):
        problem = Described(f"arrays of {_bytes(stated)} in {_bytes(stored)}")
        raise Refused(
            name, problem, "arrays that the file holds: compression saves a factor of 1000"
        )


def _bytes(n: int) -> str:
    """Return a size in bytes as text with a decimal unit."""
    size, units = float(n), ["B", "kB", "MB", "GB", "TB", "PB"]
    while size >= 1000.0 and len(units) > 1:
        size, units = size / 1000.0, units[1:]
    return f"{size:.3g} {units[0]}"


@contextmanager
def reading(path: str | PathLike[str], allowed: str = ALLOWED) -> Iterator[None]:
    """Require a file, and turn errors of a block into refusals of the file."""
    name = str(path) if isinstance(path, str | PathLike) else show(path)
    is_file = is_folder = False
    with suppress(TypeError, ValueError, OSError):
        is_file, is_folder = Path(path).is_file(), Path(path).is_dir()
    if is_folder:
        raise Refused(name, Described("a folder"), "a file; a Zarr store as xarray.open_zarr(path)")
    if not is_file:
        raise Refused(name, Described("no such file"), allowed)
    with refusing(name, allowed):
        yield


@contextmanager
def opened(
    path: str | PathLike[str], most: int | None = MOST_BYTES, decode_times: bool = True
) -> Iterator[xr.Dataset]:
    """Open a netCDF or HDF5 file lazily, after a check of its sizes.

    Parameters
    ----------
    path : path
        Regular file: netCDF-4, HDF5 or classic netCDF.
    most : int, optional
        Bound on the size of all arrays [B]; None where they are read in parts.
    decode_times : bool
        Whether numbers in units such as "days since 1970-01-01" are read as dates.

    Raises
    ------
    Refused
        If there is no such file, it is damaged or not a netCDF file, states arrays that it cannot
        hold, or refers to other files.
    """
    import xarray as xr

    with reading(path):
        check_file(path, most)
        with open(path, "rb") as file:
            is_classic = file.read(3) == b"CDF"
        # HDF5 files that were not written as netCDF do not name their dimensions
        engine, phony = ("scipy", None) if is_classic else ("h5netcdf", {"phony_dims": "sort"})
        # a wave period in s remains a number
        with xr.open_dataset(
            path, engine=engine, decode_times=decode_times, decode_timedelta=False,
            backend_kwargs=phony,
        ) as data:  # fmt: skip
            yield data


def check_file(path: str | PathLike[str], most: int | None = MOST_BYTES) -> None:
    """Refuse a netCDF or HDF5 file that states arrays which it cannot hold; ignore other files."""
    status = os.stat(path)
    if status.st_size == 0:
        raise OSError("the file is empty")
    _check(str(path), most, status.st_size, (status.st_ino, status.st_mtime_ns))


@lru_cache(maxsize=64)  # a file of many frames is opened again for each of them
def _check(path: str, most: int | None, stored: int, version: tuple[int, int]) -> None:
    """Check a file of `stored` bytes, once for each `version` (inode and time) of it."""
    with open(path, "rb") as file:
        head = file.read(8)
    if head.startswith(b"CDF"):
        require_size(_classic_size(path), stored, path, most)
    elif head == _HDF5:
        _check_heaps(path)
        total, largest_chunk = _hdf5_size(path)
        require_size(total, stored, path, most)
        # to read one value of a chunk, HDF5 expands all of it
        require_size(largest_chunk, stored, path)


def _classic_size(path: str | PathLike[str]) -> int:
    """Return the size of all variables of a classic netCDF file [B].

    Variables of a forged file may overlap, so that their sum may exceed the size of the file.
    """
    from scipy.io import netcdf_file

    file = netcdf_file(path, mmap=True)
    # numbers become float64 when they are decoded
    sizes = [v.data.size * max(v.data.itemsize, 8) for v in file.variables.values()]
    file.variables.clear()  # else closing warns of arrays in use
    file.close()
    return sum(sizes)


def _hdf5_size(path: str | PathLike[str]) -> tuple[int, int]:
    """Return the size of all arrays, as numbers of 8 bytes, and of the largest chunk [B].

    Files that refer to others are refused: they would let their author read the user's files.
    """
    import h5py

    def add_link(name: str, link: Any) -> None:
        if isinstance(link, h5py.ExternalLink):
            elsewhere.append(f"{name} in {link.filename}")

    def add(name: str, item: Any) -> None:
        if not isinstance(item, h5py.Dataset):
            return
        if item.is_virtual or item.external:
            elsewhere.append(f"{name} in other files")
        label = item.attrs.get("NAME", "")
        label = label.decode("latin-1") if isinstance(label, bytes) else str(label)
        if label.startswith(_PLACEHOLDER):
            return  # the length of a dimension, never read
        width = _TEXT if item.dtype.hasobject else max(item.dtype.itemsize, 8)
        sizes.append(int(item.size or 0) * width)
        if item.chunks is not None:
            # as Python integers: the product of a forged shape overflows int64
            chunks.append(int(np.prod(item.chunks, dtype=object)) * width)

    elsewhere: list[str] = []
    sizes, chunks = [0], [0]
    with h5py.File(path, "r") as file:
        # h5netcdf reads this, too, and leaves a traceback where it fails: it shall fail here
        file.attrs.get("_nc3_strict")
        file.visititems_links(add_link)
        file.visititems(add)
    if elsewhere:
        raise Refused(str(path), Described(f"array {elsewhere[0]}"), "arrays of its own")
    return sum(sizes), max(chunks)


def _check_heaps(path: str | PathLike[str]) -> None:
    """Refuse an HDF5 file with an object of size 0 in a global heap.

    HDF5 loops over it forever (H5HG__cache_heap_deserialize). In a file without a digest, a single
    wrong bit is enough.
    """
    with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        start = content.find(_HEAP)
        while start >= 0:
            end = start + int.from_bytes(content[start + 8 : start + 16], "little")
            place = start + 16
            while place + 16 <= end <= len(content):
                index, size = _HEAP_OBJECT.unpack_from(content, place)
                if index == 0 and size < 16:
                    raise OSError("damaged: an object of a global heap has no size")
                # index 0 is free space, whose size includes this header; the data of other objects
                # follow their header and are padded to 8 bytes
                place += 16 + -(-size // 8) * 8 if index else size
            start = content.find(_HEAP, start + 1)


def check_zarr(dataset: xr.Dataset) -> None:
    """Refuse a dataset of a Zarr store with chunks too large for memory; ignore other datasets.

    Reading one value expands a whole chunk. Codecs allocate the size that is stated in the file of
    the chunk: in a local store it may not exceed the size by the metadata.

    Raises
    ------
    Refused
        With the name of the variable, or the file of the chunk.
    """
    store = Path(str(dataset.encoding.get("source", "")))
    for name, variable in dataset.variables.items():
        # the shapes of a chunk and of a shard, a file of several chunks
        grids = [variable.encoding.get(key) for key in ("chunks", "shards")]
        itemsize = np.dtype(variable.encoding.get("dtype", variable.dtype)).itemsize
        sizes = [math.prod(grid) * itemsize for grid in grids if grid is not None]
        if not sizes:
            continue
        require_size(max(sizes), max(sizes), f"a chunk of {name}")
        for folder in store.glob(f"**/{name}") if store.is_dir() else ():
            for file in folder.rglob("[!.]*"):
                if file.is_file() and file.name != "zarr.json":
                    codec = " ".join(map(str, variable.encoding.get("compressors", ())))
                    stated = _stated_by_chunk(file, codec.lower(), max(sizes))
                    require_size(stated, stated, str(file), max(sizes))


_STREAMS: Mapping[bytes, Any] = {b"\x1f\x8b": gzip.open, b"BZh": bz2.open, b"\xfd7zXZ": lzma.open}
_ZSTD = b"\x28\xb5\x2f\xfd"


def _stated_by_chunk(path: Path, codec: str, most: int) -> int:
    """Return the expanded size of a chunk [B], or any number above `most` if it is larger.

    The size is 0 for unknown codecs, and for zstd if none is stated.
    """
    with path.open("rb") as file:
        head = file.read(18)
    # the header of Blosc states it in bytes 4 to 7
    if "blosc" in codec:
        return int.from_bytes(head[4:8], "little")
    # numcodecs writes it before the LZ4 block
    if "lz4" in codec:
        return int.from_bytes(head[:4], "little")
    if head.startswith(_ZSTD) and len(head) > 4:  # RFC 8878, 3.1.1.1
        flags = head[4]
        # Single_Segment_flag, and number of bytes of Frame_Content_Size
        single, width = flags >> 5 & 1, (0, 2, 4, 8)[flags >> 6]
        width = width or single
        start = 6 - single + (0, 1, 2, 4)[flags & 3]
        # two bytes hold the size less 256
        return int.from_bytes(head[start : start + width], "little") + 256 * (width == 2)
    # other formats do not state it: expand until it exceeds what is allowed
    if "zlib" in codec:
        return len(zlib.decompressobj().decompress(path.read_bytes(), most + 1))
    expand = next((opener for magic, opener in _STREAMS.items() if head.startswith(magic)), None)
    total = 0
    if expand is not None:
        with expand(path) as stream:
            while total <= most and (block := stream.read(2**20)):
                total += len(block)
    return total


def valid_values(variable: xr.DataArray) -> NDArray[np.float64]:
    """Return the values of a variable, nan outside its `valid_range`."""
    values = np.asarray(variable.values, np.float64)
    low, high = variable.attrs.get("valid_min"), variable.attrs.get("valid_max")
    low, high = variable.attrs.get("valid_range", (low, high))
    with np.errstate(invalid="ignore"):
        if low is not None:
            values = np.where(values < float(low), np.nan, values)
        if high is not None:
            values = np.where(values > float(high), np.nan, values)
    return values


# phrases about directions, in lower case: those that say how angles count, and so hide words of
# the next two; waves come from there; waves go there; angles count counter-clockwise from east
_TURNS = re.compile(
    r"(relative|with respect|respect|referred|reference) to|(counter-?|anti-?)?clockwise( from)?"
    r"|from (the )?(true |geographic |grid )?(north|east|x)|magnetic declination"
)
_FROM = re.compile(r"from[_ ]direction|from[_ ]which|(coming|come|comes|arriving|blow\w*)[_ -]from"
                   r"|direction[_ (]+from|\(from\)|nautical|meteorological")  # fmt: skip
_TO = re.compile(r"to[_ ]direction|to[_ ]which|(going|coming|moving)[_ -]to|direction[_ (]+to\b"
                 r"|\(to\)|towards?|propagat|travell?ing|heading|ocean(ograph)?ic")  # fmt: skip
_CARTESIAN = re.compile(
    r"cartesian|mathematic|trigonometric|(counter|anti)-?clockwise|from (the )?(east|x)"
)


def convention_of(direction: xr.DataArray, attributes: Mapping[Any, Any]) -> str:
    """Return the convention of directions that attributes state, or "" if they state none.

    Parameters
    ----------
    direction : xarray.DataArray
        Directions of waves, with their attributes.
    attributes : mapping
        Attributes of the dataset; only those whose names contain "convention" and "dir" count.

    Returns
    -------
    str
        "from" or "to", where waves come from or go to, clockwise from north; "cartesian" for where
        they go to, also if not stated, and "cartesian from", counter-clockwise from east.

    Raises
    ------
    Refused
        If attributes contradict each other, or directions count from magnetic north.
    """
    statements = [
        str(v)
        for k, v in attributes.items()
        if "convention" in str(k).lower() and "dir" in str(k).lower()
    ]
    statements += [str(v) for k, v in direction.attrs.items() if k not in ("units", "unit")]
    texts = [text.lower() for text in statements]
    if any("magnetic north" in text or "degrees_magnetic" in text for text in texts):
        raise Refused("dir", Described("relative to magnetic north"), "relative to true north")
    senses = set()
    for text in texts:
        # "clockwise from north" says how angles count, not where waves come from
        remaining = _TURNS.sub(" ", text)
        if _FROM.search(remaining):
            senses.add("from")
        elif _TO.search(remaining):
            senses.add("to")
    is_cartesian = any(_CARTESIAN.search(text) for text in texts)
    if len(senses) > 1:
        allowed = "attributes that agree whether waves come from there or go to"
        raise Refused("dir", Described("; ".join(statements)), allowed)
    sense = next(iter(senses), "to" if is_cartesian else "")
    if not is_cartesian:
        return sense
    return "cartesian" if sense == "to" else "cartesian from"
