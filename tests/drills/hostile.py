"""Hostile inputs of fifteen kinds, drawn by a fixed seed.

Each kind is a function of a random generator and a folder of its own; it returns a description,
which reproduces the input, and a function without arguments that puts the input in. That function
returns numbers, or raises: `drill` tells refusals from failures.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import shlex
import subprocess
import sys
import warnings
from functools import cache

import numpy as np

NUMBERS = [math.nan, math.inf, -math.inf, -1, 0, -0.0, 1, 2.5, 90.0, 180.0, 1e-300, 1e-30, 1e-9,
           1e6, 1e30, 1e77, 1e300, 2**31, 2**63, -(2**63) - 1, 10**400]  # fmt: skip
WORDS = ["", "nan", "none", "flat", "paper", "forced", "\x00", "\x1b[2J", "é", "../..", "a" * 5000]
VALUES = [*NUMBERS, *NUMBERS, *WORDS, True, None, [], {}, [[]], [1, 2, 3, 4], {"kind": "x"}]
ARRAYS = [np.array([]), np.full(3, np.nan), np.float32(3.0), np.array("x")]

LINKS = [
    "wind_speed = 5.0\n[sea]\nspacing = 0.5",
    "wind_speed = 13.0\nphysics = 'paper'\n[sea]\nomega_max = 6.0\nspacing = 0.5",
    "whitecaps = { wind_speed = 3.0 }\n[sea]\nspectrum = 'tma'\ndepth = 9.0\nspacing = 0.5\n"
    "[[receiver]]\n[[receiver]]\nkind = 'water-aperture'\n[run]\nestimator = 'analog'",
    "[sea]\nspectrum = 'flat'\nspacing = 0.5\n[water]\nlayers = [[0.0, 0.1, 0.2], [9.0, 0.2, 0.1]]\n"
    "[water.phase]\nmodel = 'mixture'\ncomponents = ['petzold', 'rayleigh']\nweights = [1.0, 2.0]",
    "[sea]\nspectrum = 'sinusoid'\namplitude = 0.1\nwavelength = 2.0\nspacing = 0.5\n"
    "[transmitter]\nkind = 'sun'\n[run]\nestimator = 'analog'",
    "[sea]\nspacing = 0.5\n[transmitter]\nkind = 'air-led'\n[receiver]\nkind = 'water-receiver'\n"
    "[daylight]\nmodel = 'clear'\nsun_zenith_deg = 40.0",
]


def places(table, path=()):
    """Yield the path of every value, tables and lists included."""
    items = table.items() if isinstance(table, dict) else enumerate(table)
    for key, value in items:
        yield (*path, key)
        if isinstance(value, dict | list):
            yield from places(value, (*path, key))


def _replace(random, config, values):
    """Replace one or two values of nested plain data, and return what was done."""
    done = []
    for _ in range(random.choice([1, 1, 2])):
        *parents, last = random.choice(list(places(config)))
        table = config
        for key in parents:
            table = table[key]
        new = random.choice(values)
        old = table[last]
        if isinstance(old, float) and random.random() < 0.6:
            new = old * random.choice([-1.0, 1e-9, 1e-3, 0.3, 3.0, 1e3, 1e9])
        table[last] = new
        done.append(f"{'.'.join(map(str, (*parents, last)))} = {new!r:.80}")
    return done


def _damage(random, content, text=False):
    """Return bytes that are cut, emptied, overwritten or flipped, and what was done."""
    how = random.choice(["flip", "flip", "flip", "cut", "empty", "zeros", "twice", "noise"])
    start = random.randrange(max(1, len(content)))
    length = random.choice([1, 4, 64, 4096])
    if how == "flip":
        bit = 1 << random.randrange(7 if text else 8)
        spoilt = content[:start] + bytes([content[start] ^ bit]) + content[start + 1 :]
    elif how == "cut":
        spoilt = content[:start]
    elif how == "empty":
        spoilt = b""
    elif how == "twice":
        spoilt = content[: start + length] + content[start:]
    else:
        patch = bytes(length) if how == "zeros" else random.randbytes(length)
        spoilt = content[:start] + patch + content[start + length :]
    return spoilt, f"{how} at {start} ({length})"


def short(scenario):
    """Simulate with few photons on one thread; a Mie table of its own would take minutes."""
    from meshtrace.optics import HallNovarini
    from meshtrace.scenario import Run

    few: dict = {"photons": 32}
    if scenario.run.estimator.kind == "analog":
        few = {"photons": 64, "max_events": 1000}
    run = Run(**{**scenario.run.to_config(), "rtol": None, "threads": 1, **few})
    bubbles, plain = scenario.link.bubbles, HallNovarini(wind_speed=5.0)
    table = ("n_water", "wavelength_nm", "r_min", "r_max")
    if bubbles and any(getattr(bubbles, key) != getattr(plain, key) for key in table):
        bubbles = None
    link = scenario.link.model_copy(update={"bubbles": bubbles})
    result = scenario.model_copy(update={"link": link, "run": run}).simulate()
    return result.gain, result.gain_stderr


def links(random, folder):
    """Link files with values replaced, or letters."""
    import tomli_w

    from meshtrace.scenario import Scenario

    base = random.choice(LINKS)
    if random.random() < 0.3:
        text, how = _damage(random, base.encode(), text=True)
        text = text.decode(errors="replace")
    else:
        config = Scenario.from_toml(base).to_config()
        how = _replace(random, config, [v for v in VALUES if v is not None])
        # integers of TOML end at 64 bits
        text = tomli_w.dumps(config)
    path = folder / "link.toml"
    path.write_text(text, encoding="utf-8", newline="")
    return f"{base!r}: {how}", lambda: short(Scenario.load(path))


@cache
def _calls():
    """Return functions, with sound arguments for each."""
    import meshtrace as mt
    from meshtrace import surfaces

    link, sea = mt.Link(), surfaces.JonswapSea(wind_speed=5.0, seed=7, waves="paper")
    grid = {"mesh": mt.Meshing(spacing=0.5), "threads": 1}
    run = {"link": link, "surface": sea, "photons": 32, "seed": 1, "time": 0.0, **grid}
    many = {"link": link, "surface": sea, "photons": 32, "seed": 1, **grid}
    down = mt.Link(transmitter=mt.AirLed(), receiver=mt.WaterReceiver())
    day = mt.Daylight(direct=1.4, diffuse=0.3)
    rows = [{"transmitter.depth": d, "gain": 1e-5, "stderr": 1e-6} for d in (5.0, 10.0)]
    flat = {**run, "surface": surfaces.FlatSea()}
    corners = [(-50.0, -50.0, 0.0), (50.0, -50.0, 0.0), (50.0, 50.0, 0.0), (-50.0, 50.0, 0.0)]
    return [
        (mt.Water, {"a": 0.1, "b": 0.03}),
        (mt.Led, {"depth": 10.0, "half_angle_deg": 10.0, "position": (0.0, 0.0)}),
        (mt.GaussianBeam, {"depth": 10.0, "waist": 0.001}),
        (mt.Receiver, {"height": 5.0, "radius": 0.05, "fov_deg": 60.0, "tilt_deg": 0.0}),
        (mt.HallNovarini, {"wind_speed": 5.0, "n_water": 1.33}),
        (mt.HenyeyGreenstein, {"g": 0.9}),
        (mt.FournierForand, {"n": 1.1, "mu": 3.5}),
        (mt.IrradianceMap, {"height": 5.0, "extent": 5.0, "step": 0.5}),
        (mt.Uav, {"mass": 8.0}),
        (mt.Dryden, {"wind_speed": 13.0}),
        (mt.OokLink, {"bit_rate": 5e6}),
        (mt.TriangleMesh, {"vertices": corners, "faces": [(0, 1, 2), (0, 2, 3)]}),
        (surfaces.JonswapSea, {"wind_speed": 5.0, "fetch": 30e3, "seed": 7, "omega_max": 6.0}),
        (surfaces.TiltedPlane, {"slope_x": 0.1, "slope_y": 0.0}),
        (surfaces.from_trimesh, {"source": (corners, [(0, 1, 2), (0, 2, 3)])}),
        (mt.Daylight, day.model_dump()),
        (mt.Daylight.clear_sky, {"sun_zenith_deg": 30.0, "aerosol": 0.1, "day_of_year": 80}),
        (mt.AirLed, {"height": 5.0, "half_angle_deg": 10.0, "position": (0.0, 0.0)}),
        (mt.WaterReceiver, {"depth": 10.0, "radius": 0.05, "fov_deg": 60.0, "tilt_deg": 0.0}),
        (mt.Route, {"times": (0.0, 1.0), "positions": ((0.0, 0.0), (1.0, 0.0)), "heights": None}),
        (mt.time_series, {**many, "times": [0.0], "route": mt.Route(
            times=(0.0, 1.0), positions=((0.0, 0.0), (1.0, 0.0)))}),
        (mt.simulate, {**run, "link": down}),
        *[(mt.background, {**run, "daylight": day, "water": "none"})] * 2,
        (mt.background_series, {**many, "daylight": day, "times": [0.0, 1.0]}),
        (mt.compare, {**many, "links": {"a": link, "b": link}, "realizations": 2}),
        (mt.duplex, {**many, "up": link, "down": down, "times": [0.0], "realizations": None}),
        (mt.light_pattern, {**flat, "extent": 1.0, "step": 0.1}),
        *[(mt.sensitivities, {**flat, "wrt": ["water.a"], "quantity": "gain", "realizations": 1,
                              "step": None, "limit": 1e-3, "bit_rate": 1e6, "ook": "paper"})] * 2,
        *[(mt.infer, {**flat, "measurements": rows, "unknown": ["water.a"],
                      "prior": {"water.a": (0.1, 0.05)}})] * 2,
        *[(mt.optimize, {**flat, "bounds": {"receiver.fov_deg": (10.0, 60.0)}, "objective": "gain",
                         "constraints": (), "hover_std": (0.0, 0.0), "method": "auto",
                         "realizations": 1, "bit_rate": 1e6, "limit": 1e-3})] * 2,
        *[(mt.simulate, run)] * 6,
        *[(mt.simulate, {**run, "estimator": "analog", "rtol": 0.5, "max_events": 1000})] * 3,
        *[(mt.time_series, {**many, "times": [0.0, 0.5]})] * 3,
        *[(mt.ensemble, {**many, "realizations": 2})] * 2,
        (mt.trace_paths, {"link": link, "surface": sea, "n": 4, "seed": 1}),
        (mt.link_performance, {**many, "bit_rate": 5e6, "realizations": 2}),
        (mt.coverage_map, {**many, "step": 5.0, "extent": 5.0}),
    ]  # fmt: skip


def arguments(random, folder):
    """Python calls with one or two arguments replaced."""
    import inspect

    from meshtrace.engine.setup.options import StudyOptions

    function, sound = random.choice(_calls())
    if not inspect.isclass(function):
        known = [*inspect.signature(function).parameters]
        known += StudyOptions.__annotations__ if "run" in known else ()
        sound = {k: v for k, v in sound.items() if k in known}
    given = dict(sound)
    names = sorted(sound)
    for name in random.sample(names, min(len(names), random.choice([1, 1, 2]))):
        given[name] = random.choice([*VALUES, *ARRAYS])
    photons = given.get("photons")
    if isinstance(photons, int | float) and photons in (1e6, 2**31):
        given["photons"] = -photons  # so many photons are allowed, and take minutes
    shown = {name: given[name] for name in given if given[name] is not sound[name]}

    def call():
        result = function(**given)
        if hasattr(result, "photons") and getattr(result, "gain", None) is not None:
            return result.gain, result.gain_stderr
        return None

    return f"{function.__name__}({shown!r:.200})", call


OPTIONS = {
    "run": ["--photons", "--rtol", "--seed", "--estimator", "--threads", "--set", "-o"],
    "series": ["--times", "--photons", "--seed", "--set", "-o"],
    "ensemble": ["-n", "--photons", "--seed", "--set", "-o"],
    "ber": ["--wind", "--bit-rates", "--depths", "--limit", "--uav", "--preset", "-n", "--set"],
    "converge": ["--spacings", "--time-steps", "--omega-max", "--tolerance", "--set"],
    "view": ["--html", "--spacing", "--extent", "--time", "--color", "--paths", "--set"],
    "compare": ["-n", "--photons", "--seed", "--plot", "--set", "-o"],
    "sensitivity": ["--wrt", "--quantity", "-n", "--limit", "--step", "--photons", "--set", "-o"],
    "optimize": ["--bounds", "--objective", "--hover", "-n", "--quantile", "--method", "--set"],
    "coverage": ["--extent", "--step", "--photons", "--seed", "--set", "-o"],
    "sweep": ["--store", "--workers", "-o"],
}
FEW = {
    "run": ["--photons", "64"],
    "series": ["--photons", "32", "--times", "0,1"],
    "ensemble": ["--photons", "32", "-n", "2"],
    "ber": ["--photons", "32", "-n", "2"],
    "converge": ["--photons", "32", "--placements", "1", "--spacings", "4,3,2,1"],
    "view": ["--html", "a.html", "--paths", "0"],
    "compare": ["a.toml", "b.toml", "--photons", "32"],
    "sensitivity": ["a.toml", "--photons", "32", "--wrt", "water.a"],
    "optimize": ["a.toml", "--photons", "32", "-n", "2", "--bounds", "receiver.fov_deg=10,60"],
    "coverage": ["a.toml", "--photons", "64", "--extent", "1", "--step", "0.5"],
    "sweep": ["none.toml"],
}
SETTINGS = ["wind_speed", "water.a", "water.b", "transmitter.depth", "receiver.height",
            "receiver.radius", "receiver.fov_deg", "sea.spacing", "sea.time", "run.estimator",
            "sea.spectrum", "n_air", "bubbles", "no.such.key", ""]  # fmt: skip


def commands(random, folder):
    """Command lines with hostile words."""
    name = random.choice(list(OPTIONS))
    words = [str(value) for value in VALUES]
    words += 4 * ["1", "2", "0.5", "1,2", "5e6", "flat", "4,3,2,1", "a.nc", "a.html", "0:2:1"]
    words += ["0:1:0", "1:2:nan", "0:1e9:1", "1,2,", "9:1:1", "/dev/null", ".", "/", "-", "--"]
    line = [name, *FEW[name]]
    for option in random.sample(OPTIONS[name], min(len(OPTIONS[name]), random.choice([1, 1, 2]))):
        word = random.choice(words)
        if option == "--photons" and word == str(2**31):
            word = "64"  # so many are allowed, and take minutes
        if option == "--set":
            word = f"{random.choice(SETTINGS)}={word}"
        line += [option, word]
    for link in ("a.toml", "b.toml"):
        (folder / link).write_text(LINKS[0])
    line = [word.replace("\x00", "\ufffd") for word in line]  # no argument can hold it
    if random.random() < 0.1:
        line.insert(random.randrange(len(line)), random.choice(words).replace("\x00", ""))

    def call():
        return invoke(line, folder)

    return shlex.join(line)[:300], call


def invoke(line, folder):
    """Run a command line in this process; return its numbers or raise what it printed."""
    from typer.testing import CliRunner

    from meshtrace import cli

    with contextlib.chdir(folder):
        done = CliRunner().invoke(cli.app, line)
    return judged(done.exit_code, done.stdout, done.stderr, done.exception)


class Wrong(Exception):
    """A failure of a command that is no refusal."""


class Line(ValueError):
    """The only line of a refused command."""


def judged(code, stdout, stderr, error=None):
    """Return nothing for a command that succeeded; raise its refusal, or what is wrong with it."""
    if error is not None and not isinstance(error, SystemExit):
        raise error
    if code < 0 or code not in (0, 2) or "Traceback" in stderr:
        raise Wrong(f"exit code {code}: {stderr[-300:]}")
    lines = [line for line in stderr.splitlines() if not line.startswith(("warning", "compiling"))]
    if code == 2:
        if len(lines) != 1 or stdout or not lines[0].startswith("error: "):
            raise Wrong(f"not one line: {stdout[:100]!r} {stderr[-300:]!r}")
        raise Line(f"{lines[0][:900]} (allowed: )")
    shown = stdout.partition("\nwritten to ")[0]  # a file may be called nan
    if any(word.strip("[],()") in ("nan", "+-nan") for word in shown.split()):
        raise Wrong(f"nan in {stdout[:300]!r}")


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
        content, how = _damage(random, path.read_bytes(), text=suffix == "obj")
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
        content, how = _damage(random, path.read_bytes())
        path.write_bytes(content)
    return how, lambda: from_wavespectra(path).elevation(np.zeros(3), np.arange(3.0))


ATTRIBUTES = ["units", "standard_name", "long_name", "calendar", "_FillValue", "missing_value", "valid_range",
              "scale_factor", "add_offset", "valid_min", "valid_max", "positive", "coordinates"]  # fmt: skip
TEXTS = ["", "m", "mm", "deg", "rad/s", "m2 s rad-1", "cm2 s degree-1", "hours since 2024-01-01", "days since", "Hz", "s",
         "noleap", "sea_surface_wave_to_direction", "from magnetic north", "down", "none", "9" * 300, "\x1b[2J", "m**9**9**9"]  # fmt: skip


def _twist(random, data):
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
    data, how = _twist(random, _records()[reader])
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
        path.write_bytes(_damage(random, path.read_bytes())[0])
    return path


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
        data, how = _twist(random, _grids())
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
        path.write_bytes(_damage(random, path.read_bytes())[0])
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

    data, how = _twist(random, _profile())
    path = _written(random, data, folder)
    if isinstance(path, xr.Dataset):
        path = folder / "none.nc"

    def call():
        water = Water.from_file(path, 532.0)
        return water.a, water.b

    return how, call


def forged(random, folder):
    """Results with other values and dimensions, written with their digests: read and shown."""
    from meshtrace.stored import load, write_dataset

    data = random.choice(_datasets()).copy()
    if random.random() < 0.5:
        data, how = _twist(random, data)
    else:
        key = random.choice(list(data.attrs))
        value = random.choice([*VALUES, "{}", "[1, 2]", np.arange(3.0), np.array(["a", "b"])])
        data, how = data.assign_attrs({key: value}), f"{key} = {value!r:.60}"
    path = folder / "result.nc"
    try:
        write_dataset(data, path)
    except Exception:  # values that no file holds
        path = folder / "none.nc"

    def call():
        found = load(path)
        found.summary()
        found._repr_html_()
        found.save(folder / "again.nc")

    return f"{data.attrs.get('kind')!r:.30}: {how}", call


def forged_stores(random, folder):
    """Lines of right digests and other values in stores of sweeps."""
    from meshtrace.studies.store import _line

    store, changes = folder / "kept.store", []
    lines = []
    for line in _store(folder.parent / "kept.store").splitlines():
        content = json.loads(line.partition(b" ")[2])
        if random.random() < 0.3:
            if random.random() < 0.2:
                key = random.choice(list(content))
                changes.append(f"without {key}")
                del content[key]
            elif random.random() < 0.1:
                content = {"list": [content]}
            else:
                changes += _replace(
                    random, content, [*VALUES, [1, 4], [2, 2], "AAAA", "AAAAAAAAAAA="]
                )
        try:
            lines.append(_line(content))
        except (ValueError, TypeError, RecursionError):  # no JSON holds it
            lines.append(line + b"\n")
    store.write_bytes(b"".join(lines))
    return str(changes), lambda: np.asarray(_sweep(store, 3e-5)["gain"]).ravel() * 0.0


@cache
def _results(folder):
    import meshtrace as mt
    from meshtrace.surfaces import FlatSea, JonswapSea

    folder.mkdir(exist_ok=True)
    link, sea = mt.Link(), JonswapSea(wind_speed=5.0, seed=7, waves="paper")
    one = mt.simulate(link, FlatSea(), photons=32, threads=1)
    series = mt.time_series(link, sea, [0.0, 1.0], photons=32, threads=1)
    made = {}
    for kind, result in ((mt.GainResult, one), (mt.GainSeries, series)):
        path = folder / f"{kind.__name__}.nc"
        result.save(path)
        made[kind] = path.read_bytes(), np.asarray(result.gain)
    return made


def results(random, folder):
    """Damaged result files; one that loads must hold the gains that were saved."""
    made = _results(folder.parent / "results")
    kind = random.choice(list(made))
    content, gain = made[kind]
    content, how = _damage(random, content)
    path = folder / "result.nc"
    path.write_bytes(content)

    def call():
        loaded = np.asarray(kind.load(path).gain)
        if not np.array_equal(loaded, gain):
            raise Wrong(f"silently changed: {loaded} for {gain}")

    return f"{kind.__name__}: {how}", call


@cache
def _datasets():
    """Return results of several kinds as datasets."""
    import warnings

    import meshtrace as mt
    from meshtrace.scenario import Scenario

    warnings.simplefilter("ignore")  # few samples
    link, day = Scenario.from_toml(LINKS[0]), mt.Daylight(direct=1.4, diffuse=0.3)
    series = mt.ensemble(link, 3, photons=64, threads=1)
    made = [
        mt.simulate(link, photons=64, threads=1),
        series,
        series.fading(),
        mt.coverage_map(link, extent=1.0, step=0.5, photons=64, threads=1),
        mt.compare({"a": link, "b": link}, realizations=2, photons=64),
        mt.link_performance(link, bit_rate=5e6, realizations=2, photons=64),
        mt.background(link, daylight=day, photons=64),
    ]
    return [result.to_dataset() for result in made]


def origins(random, folder):
    """Results whose provenance has values of other types or amounts, read and viewed."""
    from meshtrace.stored import load, write_dataset

    data = random.choice(_datasets()).copy()
    provenance = json.loads(data.attrs["provenance"])
    how = _replace(random, provenance, VALUES)
    data.attrs["provenance"] = json.dumps(provenance)
    write_dataset(data, folder / "result.nc")

    def call():
        invoke(["view", "result.nc", "--html", "a.html", "--paths", "0", "--spacing", "2"], folder)
        found = load(folder / "result.nc")
        found.summary()
        found._repr_html_()

    return f"{data.attrs['kind']}: {how}", call


SWEEP = {"parameters": {"transmitter.depth": [5.0, 10.0], "wind_speed": [5.0, 9.0]}}


def _sweep(path, gain):
    """Open a store, filled with a gain where it waits for one, and return its gains."""
    from meshtrace.studies import sweeps as module

    original = module.Cluster.map

    def fill(self, setup, tasks):
        for i in range(len(tasks)):
            yield i, (np.full((1, 4), gain), '[""]')

    module.Cluster.map = fill
    try:
        link = {"bubbles": "none"}
        return module.sweep(link, **SWEEP, store=path, photons=32, rtol=None)
    finally:
        module.Cluster.map = original


@cache
def _store(path):
    _sweep(path, 3e-5)
    return path.read_bytes()


def stores(random, folder):
    """Damaged stores of sweeps; gains that are read must be those that were written."""
    content, how = _damage(random, _store(folder.parent / "kept.store"))
    store = folder / "kept.store"
    store.write_bytes(content)

    def call():
        gain = np.asarray(_sweep(store, 3e-5)["gain"])
        if not np.array_equal(gain, np.full((2, 2, 1), 3e-5)):
            raise Wrong(f"silently changed: {gain.ravel()}")

    return how, call


def studies(random, folder):
    """Study files with values replaced, or letters."""
    import tomli_w

    from meshtrace.studies import sweeps as module

    table = {"realizations": 2, "photons": 32, "seed": 1, "rtol": 0.1, **SWEEP}
    config = {"wind_speed": 5.0, "transmitter": {"depth": 5.0}, "sweep": table}
    config = json.loads(json.dumps(config))
    if random.random() < 0.5:
        how = _replace(random, config, [v for v in VALUES if v is not None])
        text = tomli_w.dumps(config)
    else:
        content, how = _damage(random, tomli_w.dumps(config).encode(), text=True)
        text = content.decode(errors="replace")
    path = folder / "study.toml"
    path.write_text(text, encoding="utf-8", newline="")

    def call():
        original, module.Cluster.map = module.Cluster.map, lambda *rest: (one for one in ())
        try:
            module.read_study(path)[0].run(None)
        finally:
            module.Cluster.map = original

    return str(how), call


NAMES = ["HOME", "XDG_CACHE_HOME", "MESHTRACE_CACHE_DIR", "NUMBA_CACHE_DIR", "TMPDIR", "COLUMNS",
         "TERM", "LANG", "LC_ALL", "PYTHONIOENCODING", "PYTHONOPTIMIZE", "PYTHONHASHSEED", "TZ",
         "NO_COLOR", "USER", "PATH", "OMP_NUM_THREADS", "XDG_CONFIG_HOME"]  # fmt: skip
SETTING = ["", "/dev/null", "/proc", "~", "relative", "0", "1", "-1", "xx", "utf-8", "ascii", "C"]


def environment(random, folder):
    """Real processes in hostile environments."""
    changes = {name: random.choice([*SETTING, None]) for name in random.sample(NAMES, 2)}
    if changes.get("PYTHONHASHSEED") not in (None, "0", "1"):
        changes["PYTHONHASHSEED"] = "0"  # Python itself refuses the rest
    if changes.get("PYTHONIOENCODING") not in (None, "ascii", "utf-8"):
        changes["PYTHONIOENCODING"] = "ascii"
    closed = random.choice(["nothing", "nothing", "nothing", "stdin", "output to /dev/full"])
    given = {**os.environ, **changes}
    given = {name: value for name, value in given.items() if value is not None}

    def call():
        command = [sys.executable, "-P", "-m", "meshtrace", "run", "--photons", "32"]
        with open("/dev/full", "w") as full:
            done = subprocess.run(
                command,
                cwd=folder,
                env=given,
                stdin=None if closed == "stdin" else subprocess.DEVNULL,
                stdout=full if closed == "output to /dev/full" else subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                errors="replace",
                timeout=500,
            )
        return judged(done.returncode, done.stdout or "", done.stderr)

    return f"{changes}, {closed}", call


KINDS = {
    function.__name__: function
    for function in (
        links, arguments, commands, meshes, spectra, results, origins, stores, studies,
        environment, records, sequences, profiles, forged, forged_stores,
    )
}  # fmt: skip
