"""Hostile files of other programs: meshes, spectra, records, grids in time, profiles."""

from __future__ import annotations

import warnings
from functools import cache

import numpy as np
from hostile_parts import NUMBERS, VALUES, damage, short

ATTRIBUTES = ["units", "standard_name", "long_name", "calendar", "_FillValue", "missing_value", "valid_range",
              "scale_factor", "add_offset", "valid_min", "valid_max", "positive", "coordinates"]  # fmt: skip
TEXTS = ["", "m", "mm", "deg", "rad/s", "m2 s rad-1", "cm2 s degree-1", "hours since 2024-01-01", "days since", "Hz", "s",
         "noleap", "sea_surface_wave_to_direction", "from magnetic north", "down", "none", "9" * 300, "\x1b[2J", "m**9**9**9"]  # fmt: skip


def twist(random, data):
    """Return a dataset with one to three faults in its attributes, values and dimensions."""
    done = []
    warnings.simplefilter("ignore")  # of xarray, which makes such datasets
    for _ in range(random.choice([1, 1, 2, 3])):
        name = random.choice(list(data.variables))
        how = random.choice(["attribute"] * 4 + ["value"] * 2 + [
            "all", "drop", "type", "order", "few", "length", "rename", "copy", "dimension"])  # fmt: skip
        what = None
        try:
            if how == "attribute":
                key = random.choice(ATTRIBUTES)
                what = random.choice([*TEXTS, *NUMBERS[:-4], 7, np.arange(3.0), b"m"])
                data = data.assign({name: data[name].assign_attrs({key: what})})
                what = f"{key} {what!r:.40}"
            elif how in ("value", "all"):
                what = float(random.choice(NUMBERS[:-1]))
                values = np.array(data[name].values, dtype=np.float64)
                values.ravel()[slice(None) if how == "all" else random.randrange(values.size)] = (
                    what
                )
                data = data.assign({name: (data[name].dims, values, data[name].attrs)})
            elif how == "drop":
                data = data.drop_vars(name)
            elif how == "type":
                what = random.choice(["i2", "U8", "S4", "c16", "?", "f4", "O"])
                data = data.assign({name: data[name].astype(what)})
            elif how == "order":
                data = data.transpose(*random.sample(list(data.dims), len(data.dims)))
            elif how == "few":
                dim, what = random.choice(list(data.dims)), random.choice([0, 1, 2])
                data = data.isel({dim: slice(what)})
            elif how == "length":
                values = np.ravel(data[name].values)
                data = data.drop_vars(name).assign({name: ("other", values)})
            elif how == "rename":
                what = random.choice([*data.variables, "x", "freq", "time", "t", "site"])
                data = data.rename({name: what})
            elif how == "copy":
                what = random.choice(list(data.variables))
                data = data.assign({name: data[what]})
            else:
                what = random.choice([1, 2])
                data = data.assign({name: data[name].expand_dims(new=what)})
        except (ValueError, TypeError, IndexError, KeyError, OverflowError):
            continue  # no such dataset
        done.append(f"{how} {name} {what}")
    return data, "; ".join(done)


def _written(random, data, folder):
    """Return a file of a dataset, sometimes damaged, or the dataset if it cannot be written."""
    path = folder / "data.nc"
    engine = random.choice(["h5netcdf", "h5netcdf", "scipy"])
    if random.random() < 0.4:
        return data
    try:
        data.to_netcdf(path, engine=engine)
    except Exception:  # names and types that no file holds
        return data
    if random.random() < 0.3:
        path.write_bytes(damage(random, path.read_bytes())[0])
    return path


def _mesh():
    from meshtrace.surfaces import JonswapSea

    return JonswapSea(wind_speed=5.0, seed=7, waves="paper").mesh(extent=15.0, spacing=1.5)


def meshes(random, folder):
    """Meshes with hostile arrays, or in damaged files."""
    import meshtrace as mt
    from meshtrace.scenario import Scenario
    from meshtrace.surfaces import from_trimesh

    mesh = _mesh()
    if random.random() < 0.5:
        suffix = random.choice(["stl", "ply", "obj"])
        path = folder / f"sea.{suffix}"
        mesh.to_trimesh().export(path)
        content, how = damage(random, path.read_bytes(), text=suffix == "obj")
        path.write_bytes(content)
        config = {"sea": {"mesh": str(path)}, "run": {"estimator": "analog"}}
        return f"{suffix}: {how}", lambda: short(Scenario.from_config(config))
    vertices, faces = mesh.vertices.copy(), mesh.faces.astype(np.int64)
    how = random.choice(["value", "scale", "shift", "face", "order", "shape", "height"])
    with np.errstate(all="ignore"):
        if how == "value":
            x = float(random.choice([v for v in NUMBERS if abs(v) < 1e301 or v != v]))
            vertices[random.randrange(len(vertices)), random.randrange(3)] = x
        elif how in ("scale", "shift", "height"):
            x = random.choice([0.0, -1.0, 1e-30, 1e-6, 1e-3, 1e3, 1e6, 1e12, 1e30, 1e300])
            if how == "scale":
                vertices *= x
            elif how == "shift":
                vertices += x
            else:
                vertices[:, 2] *= x
        elif how == "face":
            x = random.choice([-1, len(vertices), 2**31, -(2**31), 0])
            faces[random.randrange(len(faces)), random.randrange(3)] = x
        elif how == "order":
            x = None
            faces = faces[:, ::-1]
        else:
            x = random.randrange(4)
            faces = [faces[:0], faces[:, :2], faces.ravel(), faces[:1]][x]

    def call():
        estimator = random.choice(["forced", "analog"])
        made = random.choice([from_trimesh, lambda pair: mt.TriangleMesh(*pair)])((vertices, faces))
        result = mt.simulate(mt.Link(), made, estimator=estimator, photons=64, threads=1)
        return result.gain, result.gain_stderr

    return f"arrays: {how} {x!r}", call


@cache
def _spectrum():
    import xarray as xr

    freq, direction = np.linspace(0.05, 0.5, 8), np.arange(0.0, 360.0, 30.0)
    efth = np.outer(np.exp(-(((freq - 0.2) / 0.05) ** 2)), np.ones(12)) * 1e-3
    return xr.Dataset({"efth": (("freq", "dir"), efth)}, {"freq": freq, "dir": direction})


def spectra(random, folder):
    """Files of directional spectra with damaged bytes or hostile numbers."""
    from meshtrace.surfaces import from_wavespectra

    data = _spectrum().copy(deep=True)
    path = folder / "spectrum.nc"
    if random.random() < 0.5:
        name = random.choice(["efth", "freq", "dir"])
        values = data[name].values.copy()
        x = float(random.choice(NUMBERS[:-1]))
        values.ravel()[random.randrange(values.size)] = x
        how = f"{name} = {x!r}"
        data = data.assign({name: (data[name].dims, values)})
        data.to_netcdf(path, engine="h5netcdf")
    else:
        data.to_netcdf(path, engine="h5netcdf")
        content, how = damage(random, path.read_bytes())
        path.write_bytes(content)
    return how, lambda: from_wavespectra(path).elevation(np.zeros(3), np.arange(3.0))


@cache
def _records():
    """Return spectra at two times and stations, and in the forms of models and buoys."""
    import xarray as xr

    one = _spectrum()
    coords = {"time": ("time", [0.0, 1.0], {"units": "hours since 2024-05-01"}), "site": [1, 2]}
    place = {"lon": ("site", [0.0, 9.0]), "lat": ("site", [50.0, 60.0])}
    ones = xr.DataArray(np.ones((2, 2)), coords, ("time", "site"))
    plain = (one.efth * ones).to_dataset(name="efth").assign_coords(place)
    ww3 = plain.rename(
        freq="frequency", dir="direction", site="station", lon="longitude", lat="latitude"
    )
    swan = plain.rename(freq="frequency", dir="direction", site="points", efth="density")
    rows = {"spectral_wave_density": 1.0, "mean_wave_dir": 200.0, "principal_wave_dir": 205.0,
            "wave_spectrum_r1": 0.8, "wave_spectrum_r2": 0.6}  # fmt: skip
    ndbc = xr.Dataset(
        {name: (("time", "frequency"), np.full((2, 8), value)) for name, value in rows.items()},
        {"time": coords["time"], "frequency": one.freq.values},
    )
    return {None: plain, "ww3": ww3, "ncswan": swan, "ndbc": ndbc, "netcdf": plain}


def records(random, folder):
    """Spectra with hostile attributes, dimensions and selections, as files and as datasets."""
    from meshtrace.surfaces import from_wavespectra

    reader = random.choice(list(_records()))
    data, how = twist(random, _records()[reader])
    options = {
        "reader": reader,
        "time": random.choice(VALUES) if random.random() < 0.1 else "2024-05-01T01",
        "site": None if reader == "ndbc" else random.choice([1, 2, (0.0, 50.0)]),
    }
    if random.random() < 0.1:
        options["site"] = random.choice(VALUES)
    if random.random() < 0.1:
        options["reader"] = random.choice(
            ["swan", "era5", "wwm", "json", "spotter", "octopus", "funwave"]
        )
    source = _written(random, data, folder)
    text = f"{how}; {options!r:.200}; {'file' if source is not data else 'dataset'}"
    return text, lambda: from_wavespectra(source, **options).elevation(np.zeros(3), np.arange(3.0))


@cache
def _grids():
    import xarray as xr

    axis = np.linspace(-3.0, 3.0, 7)
    z = 0.1 * np.cos(axis[:, None] + axis + np.arange(3.0)[:, None, None])
    metres = {"units": "m"}
    coords = {
        "time": ("time", np.arange(3.0), {"units": "s"}),
        "x": ("x", axis, metres),
        "y": ("y", axis, metres),
    }
    return xr.Dataset({"z": (("time", "x", "y"), z, metres)}, coords)


def sequences(random, folder):
    """Meshes in time in hostile grids, collections and damaged files."""
    from meshtrace.surfaces import MeshSequence, from_trimesh

    suffix = random.choice(["nc"] * 6 + ["ply", "pvd", "xdmf", "vtp"])
    options = {"blend": random.choice(["nearest", "linear"])}
    if random.random() < 0.3:
        key = random.choice(["times", "scale", "up", "frame_rate", "normals"])
        options[key] = random.choice([*VALUES, (0.0, 1.0, 2.0), "y", 0.5])
    if suffix == "nc":
        data, how = twist(random, _grids())
        path = _written(random, data, folder)
        path = folder / "none.nc" if path is data else path
    else:
        how, path = suffix, folder / f"a_0.{suffix}"
        mesh = from_trimesh((np.arange(7.0), np.arange(7.0), 0.1 * np.eye(7)))
        for i in range(3):
            mesh.to_trimesh().export(folder / f"a_{i}.ply")
        text = "".join(f'<DataSet timestep="{i}" file="a_{i}.ply"/>' for i in range(3))
        if suffix != "ply":
            path.write_text(f"<VTKFile><Collection>{text}</Collection></VTKFile>")
        path.write_bytes(damage(random, path.read_bytes())[0])
        path = str(folder / "a_*.ply") if suffix == "ply" else path
    time = random.choice(VALUES) if random.random() < 0.1 else random.choice([0.0, 0.5, 1.5])

    def call():
        return (MeshSequence(path, **options).mesh(time=time).vertices,)

    return f"{how}; {options!r:.100}; {time!r:.60}", call


@cache
def _profile():
    import xarray as xr

    dims = ("N_PROF", "N_LEVELS")
    rows = {"PRES": [3.0, 10.0, 30.0], "CHLA": [0.4, 0.6, 0.2], "BBP700": [1.2e-3, 1.0e-3, 5e-4],
            "TEMP": [20.0, 19.0, 15.0], "PSAL": [36.5, 36.5, 36.0]}  # fmt: skip
    units = {
        "PRES": "decibar",
        "CHLA": "mg/m3",
        "BBP700": "m-1",
        "TEMP": "degree_Celsius",
        "PSAL": "psu",
    }
    data = {
        name: (dims, np.array([values]), {"units": units[name]}) for name, values in rows.items()
    }
    flags = {f"{name}_QC": (dims, np.array([list("111")], "S1")) for name in rows}
    return xr.Dataset({**data, **flags})


def profiles(random, folder):
    """BGC-Argo profiles with hostile attributes, values and dimensions."""
    import xarray as xr

    from meshtrace.optics import Water

    data, how = twist(random, _profile())
    path = _written(random, data, folder)
    if isinstance(path, xr.Dataset):
        path = folder / "none.nc"

    def call():
        water = Water.from_file(path, 532.0)
        return water.a, water.b

    return how, call
