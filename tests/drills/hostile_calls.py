"""Hostile inputs of the program: link files, calls from Python, command lines, environments."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from functools import cache

from hostile_parts import ARRAYS, LINKS, VALUES, damage, invoke, judged, replace, short


def links(random, folder):
    """Link files with values replaced, or letters."""
    import tomli_w

    from meshtrace.scenario import Scenario

    base = random.choice(LINKS)
    if random.random() < 0.3:
        text, how = damage(random, base.encode(), text=True)
        text = text.decode(errors="replace")
    else:
        config = Scenario.from_toml(base).to_config()
        how = replace(random, config, [v for v in VALUES if v is not None])
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
