"""Sizes that files state are checked before anything is read; attributes are read alike."""

import tracemalloc

import h5netcdf
import h5py
import numpy as np
import pytest
import xarray as xr
from scipy.io import netcdf_file

from meshtrace import netcdf, units
from meshtrace.errors import Refused
from meshtrace.optics.water_files import read_spectrum
from meshtrace.results import load
from meshtrace.stored import read_dataset
from meshtrace.surfaces import MeshSequence, from_wavespectra


def hollow(path, n, names=("efth", "z", "CHLA", "PRES", "gain"), chunk=10**6):
    """Write a netCDF file of 6 kB or so that states arrays of n numbers: no chunk is stored."""
    with h5netcdf.File(path, "w") as file:
        file.dimensions["n"] = n
        for name in names:
            file.create_variable(name, ("n",), "f8", chunks=(min(chunk, n),), compression="gzip")


READERS = {
    "result": load,
    "dataset": read_dataset,
    "spectrum": from_wavespectra,
    "wave model": lambda path: from_wavespectra(path, reader="ww3"),
    "meshes": lambda path: MeshSequence(path, times=(0.0,)).mesh(),
    "water": read_spectrum,
}


@pytest.mark.parametrize("n", [2 * 10**7, 3 * 10**8, 10**9, 10**14])
@pytest.mark.parametrize("reader", READERS)
def test_arrays_that_a_file_cannot_hold(reader, n, tmp_path):
    """Once 4.8 GB and 15 s for 3e8 numbers; a process of 1e9 was killed by the system."""
    path = tmp_path / "hollow.nc"
    hollow(path, n)
    assert path.stat().st_size < 20_000
    pytest.importorskip("wavespectra")  # whose import takes 40 MB
    tracemalloc.start()
    try:
        with pytest.raises(
            Refused, match=r"hollow.nc: arrays of .* [kMGTP]B( in .* kB)?, allowed: "
        ):
            READERS[reader](path)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < 2**24


def test_one_number_of_a_giant_chunk(tmp_path):
    path = tmp_path / "chunk.nc"
    with h5py.File(path, "w") as file:
        file.create_dataset("a", (2 * 10**8,), "f8", chunks=(2 * 10**8,), compression="gzip")
    with pytest.raises(Refused, match=r"chunk.nc: arrays of 1.6 GB in"), netcdf.opened(path, None):
        pass


def test_variables_of_a_classic_file_that_share_bytes(tmp_path):
    """The header of each variable says where it begins: all at one place, again and again."""
    path = tmp_path / "shared.nc"
    n = 600
    with netcdf_file(path, "w") as file:
        file.createDimension("n", 10**6)
        for i in range(n):
            file.createVariable(f"v{i:03}", "f4", ("n",)) if i < 2 else None
    content = bytearray(path.read_bytes())
    first = content.index(b"v000") - 4
    second = content.index(b"v001") - 4
    entry = bytes(content[first:second])
    listed = int.from_bytes(content[first - 4 : first], "big")
    assert listed == 2
    entries = b"".join(entry.replace(b"v000", f"v{i:03}".encode()) for i in range(n))
    path.write_bytes(
        bytes(content[: first - 4]) + n.to_bytes(4, "big") + entries + bytes(content[second:])
    )
    with pytest.raises(Refused, match=r"shared.nc: arrays of 4.8 GB, allowed: at most 2.15 GB"):
        read_dataset(path)


def test_a_dimension_alone_is_never_read(tmp_path):
    path = tmp_path / "dimension.nc"
    with h5netcdf.File(path, "w") as file:
        file.dimensions = {"n": 10**12, "m": 3}
        file.create_variable("a", ("m",), "f8", data=np.arange(3.0))
    assert read_dataset(path)["a"].sum() == 3.0


def test_files_that_refer_to_others(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["a"] = np.arange(9.0)
    layout = h5py.VirtualLayout((9,), "f8")
    layout[:] = h5py.VirtualSource(tmp_path / "a.h5", "a", (9,))
    with h5py.File(tmp_path / "virtual.h5", "w") as file:
        file.create_virtual_dataset("a", layout)
    (tmp_path / "secret").write_bytes(bytes(72))
    with h5py.File(tmp_path / "raw.h5", "w") as file:
        file.create_dataset("a", (9,), "f8", external=[(str(tmp_path / "secret"), 0, 72)])
    with h5py.File(tmp_path / "link.h5", "w") as file:
        file["group/a"] = h5py.ExternalLink("a.h5", "a")
    for name in ("virtual", "raw", "link"):
        with pytest.raises(Refused, match=rf"{name}.h5: array .*, allowed: arrays of its own"):
            read_dataset(tmp_path / f"{name}.h5")
    with h5py.File(tmp_path / "soft.h5", "w") as file:
        file["a"] = np.arange(9.0)
        file["b"] = h5py.SoftLink("/a")
    assert read_dataset(tmp_path / "soft.h5")["b"].size == 9


@pytest.mark.thorough
def test_compressed_arrays_are_read(tmp_path):
    """Deflate saves a factor of 1000 at most: zeros of 80 MB are read."""
    path = tmp_path / "zeros.nc"
    with h5netcdf.File(path, "w") as file:
        file.dimensions["n"] = 10**7
        zeros = file.create_variable("a", ("n",), "f8", chunks=(10**6,), compression="gzip")
        zeros[:] = np.zeros(10**7)
    assert read_dataset(path)["a"].size == 10**7


@pytest.mark.parametrize(
    ("stated", "stored", "most", "match"),
    [(2**32, 2**32, 2**31, "arrays of 4.29 GB, allowed: at most 2.15 GB"),
     (10**9, 10**5, None, "arrays of 1 GB in 100 kB, allowed: arrays that the file holds"),
     (10**18, 1, None, "arrays of 1e.03 PB in 1 B")],
)  # fmt: skip
def test_bounds(stated, stored, most, match):
    with pytest.raises(Refused, match=f"file: {match}"):
        netcdf.require_size(stated, stored, "file", most)


@pytest.mark.parametrize(("stated", "stored"), [(2**26, 1), (10**12, 10**9), (0, 0)])
def test_sizes_that_pass(stated, stored):
    netcdf.require_size(stated, stored, "file", None)


@pytest.mark.parametrize(
    ("attributes", "unit"),
    [({"units": " m "}, "m"), ({"units": b"m"}, "m"), ({"unit": "m"}, "m"), ({"units": "unknown"}, ""),
     ({}, ""), ({"units": 5}, "5"), ({"units": np.str_("m")}, "m")],
)  # fmt: skip
def test_units(attributes, unit):
    assert units.unit_of(xr.DataArray([1.0], attrs=attributes)) == unit


def test_valid_ranges():
    for attributes in ({"valid_min": 0, "valid_max": 2}, {"valid_range": np.array([0, 2])}):
        found = netcdf.valid_values(xr.DataArray([-1, 0, 2, 3], attrs=attributes))
        np.testing.assert_array_equal(found, [np.nan, 0.0, 2.0, np.nan])


@pytest.mark.parametrize(
    ("text", "convention"),
    [("", ""), ("degrees clockwise from true north", ""), ("Direction (from), clockwise from north", "from"),
     ("waves come from", "from"), ("toward", "to"), ("heading of waves", "to"), ("wave direction", ""),
     ("mean direction from which waves arrive relative to north", "from"), ("to_direction", "to"),
     ("cartesian: coming from, anticlockwise from the x axis", "cartesian from")],
)  # fmt: skip
def test_conventions(text, convention):
    assert netcdf.convention_of(xr.DataArray([0.0], attrs={"long_name": text}), {}) == convention


def zarr_spectrum(path, zarr_format=3, codec=None):
    """Write a store of a spectrum, and open it."""
    zarr = pytest.importorskip("zarr")
    group = zarr.open_group(path, mode="w", zarr_format=zarr_format)
    axes = {"freq": np.linspace(0.1, 0.4, 8), "dir": np.arange(0.0, 360.0, 30.0)}
    for name, values in {**axes, "efth": np.ones((8, 12))}.items():
        dims = [name] if name in axes else list(axes)
        options = {"dimension_names": dims} if zarr_format == 3 else {}
        if codec is not None and name == "efth":
            options["compressors"] = codec
        array = group.create_array(
            name, shape=values.shape, chunks=values.shape, dtype="f8", fill_value=np.nan, **options
        )
        array[:] = values
        array.attrs["_ARRAY_DIMENSIONS"] = dims
    return xr.open_zarr(path, chunks=None, consolidated=False)


@pytest.mark.filterwarnings("ignore")
def test_a_chunk_of_zarr_that_no_memory_holds(tmp_path):
    """One number of a chunk is read by expanding all of it: here 3.2 GB."""
    pytest.importorskip("wavespectra")
    data = zarr_spectrum(tmp_path / "a.zarr")
    assert from_wavespectra(data) is not None
    data["efth"].encoding["chunks"] = (20_000, 20_000)
    with pytest.raises(Refused, match=r"a chunk of efth: arrays of 3.2 GB, allowed: at most 2.15"):
        from_wavespectra(data)


def bombs():
    """Yield codecs by name, and the bytes of a chunk that states or holds 2^30 bytes."""
    codecs = pytest.importorskip("numcodecs")
    blosc = bytearray(codecs.Blosc().encode(np.ones(96)))
    blosc[4:8] = (2**30).to_bytes(4, "little")
    zstd = b"\x28\xb5\x2f\xfd\xa0" + (2**30).to_bytes(4, "little") + bytes(40)
    wide = b"\x28\xb5\x2f\xfd\xe0" + (2**60).to_bytes(8, "little") + bytes(40)
    yield codecs.Blosc(), bytes(blosc)
    yield codecs.Zstd(), zstd
    yield codecs.Zstd(), wide
    yield codecs.LZ4(), (2**30).to_bytes(4, "little") + bytes(40)
    for codec in (codecs.GZip(), codecs.Zlib(), codecs.BZ2(), codecs.LZMA()):
        yield codec, codec.encode(np.ones(2**20))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("number", range(8))
@pytest.mark.slow_but(*"01234")
def test_a_chunk_of_zarr_that_states_more_than_its_store(number, tmp_path):
    codec, content = list(bombs())[number]
    data = zarr_spectrum(tmp_path / "a.zarr", 2, codec)
    assert from_wavespectra(data) is not None
    (tmp_path / "a.zarr" / "efth" / "0.0").write_bytes(content)
    tracemalloc.start()
    try:
        with pytest.raises(Refused, match=r"efth/0.0: arrays of .*B, allowed: at most 768 B"):
            from_wavespectra(xr.open_zarr(tmp_path / "a.zarr", chunks=None, consolidated=False))
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < 2**24
