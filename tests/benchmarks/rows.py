"""The goals of speed as one table: cost of each work, its anchor and the goal.

    python tests/benchmarks/rows.py [ROUNDS [NAME...]]

Run it on a quiet machine; three rounds by default, of which each is printed. Each work runs in a separate
process; its CPU seconds count after a smaller work, which compiles and loads. `--list` prints
the names.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path
from typing import Any

from clocks import of_command, peak_mib, timed

ROOT = Path(__file__).parents[2]
PARAMETERS = (
    "water.a", "water.b", "water.n", "transmitter.depth", "transmitter.half_angle_deg",
    "transmitter.position.0", "receiver.height", "receiver.radius", "receiver.fov_deg",
    "receiver.position.0", "receiver.tilt_deg",
)  # fmt: skip


def cpu(work: Callable[[], Any], *earlier: Callable[[], Any]) -> float:
    """Return the CPU seconds of a work, after others."""
    for one in earlier:
        one()
    return timed(work)[1]


def in_child(file: str, *args: Any) -> Any:
    """Return the JSON that a script prints in a separate process."""
    command = [sys.executable, "-W", "ignore", file, *map(str, args)]
    return json.loads(subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout)


def _environment() -> dict[str, str]:
    """Return the environment, in which Python keeps the bytecode of modules, as users have it."""
    return {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}


def _run(**env: str) -> tuple[float, float]:
    return of_command("-m", "meshtrace", "run", env={**_environment(), **env})


def start() -> dict[str, Any]:
    """Return the cost of `meshtrace run` with compiled kernels, and of the imports of libraries."""
    _run()
    found, imports = {"CPU s": _run()[0]}, "numpy, numba"
    for name in ("Python, numpy, numba", "all libraries"):
        found[name] = of_command("-c", f"import {imports}", env=_environment())[0]
        imports += ", numpy.ma, pydantic, typer, rich.progress, yaml"
    return found


_LOADED = """
import sys
from meshtrace.__main__ import main
try:
    main()
except SystemExit:
    print(len(sys.modules), file=sys.stderr)
"""


def pictures() -> dict[str, Any]:
    """Return the CPU seconds of commands, and the number of modules that each loads."""
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        result, picture = f"{folder}/a.nc", f"{folder}/a.png"
        commands = {
            "run -o": ("run", "-o", result),
            "run": ("run",),
            "plot": ("plot", result, "-o", picture),
            "view": ("view", "--screenshot", picture),
        }
        for name, arguments in commands.items():
            command = [sys.executable, "-c", _LOADED, *arguments]
            done = subprocess.run(command, capture_output=True, text=True, env=_environment())
            found[f"modules of {name}"] = int(done.stderr.split()[-1])
            used = [of_command("-m", "meshtrace", *arguments, env=_environment()) for _ in "ab"]
            found[f"{name}, CPU s"] = min(used)[0]
    return found


def movie() -> dict[str, Any]:
    """Return the CPU seconds of a frame of a movie with paths of received light, after others."""
    import numpy as np

    import meshtrace as mt
    from meshtrace import viz
    from meshtrace.surfaces import JonswapSea

    sea, link = JonswapSea(wind_speed=5.0, seed=7), mt.Link()

    def work(n: int) -> float:
        times = np.arange(n) / 30.0
        gain = mt.time_series(link, sea, times, photons=512)
        with tempfile.TemporaryDirectory() as folder:
            path = f"{folder}/a.mp4"
            return cpu(lambda: viz.save_movie(link, sea, times, path, gain=gain, received=40))

    work(2)
    return {"CPU s": (work(8) - work(2)) / 6}


def compiled() -> dict[str, Any]:
    """Return the number of functions that numba compiles in the first run, and the CPU seconds."""
    code = """
import gc, time
start = time.process_time()
import meshtrace as mt
mt.Scenario.from_toml("").simulate()
used = time.process_time() - start
from numba.core.registry import CPUDispatcher
functions = [d for d in gc.get_objects() if isinstance(d, CPUDispatcher)]
print(sum(len(d.overloads) for d in functions), used)
"""
    with tempfile.TemporaryDirectory() as folder:
        env = {
            **_environment(),
            "MESHTRACE_CACHE_DIR": folder,
            "NUMBA_CACHE_DIR": f"{folder}/numba",
        }
        command = [sys.executable, "-W", "ignore", "-c", code]
        done = subprocess.run(command, capture_output=True, text=True, env=env, check=True)
    functions, used = done.stdout.split()[-2:]
    return {"functions": int(functions), "CPU s": float(used)}


def first() -> dict[str, Any]:
    """Return the cost of the first `meshtrace run` ever, from source."""
    with tempfile.TemporaryDirectory() as folder:
        used, wall = _run(MESHTRACE_CACHE_DIR=folder, NUMBA_CACHE_DIR=f"{folder}/numba")
    return {"wall s": wall, "CPU s": used}


def wheel() -> dict[str, Any]:
    """Return the cost of the first `meshtrace run` ever, from a platform wheel.

    The environment needs pip and wheel.
    """
    with tempfile.TemporaryDirectory() as folder:
        build = [ROOT / ".ci" / "wheel", sys.executable, folder]
        subprocess.run(build, check=True, stdout=subprocess.DEVNULL)
        (made,) = Path(folder).glob("*.whl")
        tree = f"{folder}/tree"
        subprocess.run([sys.executable, "-m", "zipfile", "-e", made, tree], check=True)
        used, wall = _run(MESHTRACE_CACHE_DIR=f"{folder}/cache", PYTHONPATH=tree)
    return {"wall s": wall, "CPU s": used}


def waves() -> dict[str, Any]:
    """Return the CPU seconds of sums of waves on grids."""
    from test_waves_benchmark import CASES, waves_of

    from meshtrace.surfaces.waves import WaveGrid, elevation_and_slopes

    found = {}
    for name, (n, longest, x, _) in CASES.items():
        sea = waves_of(n, longest)
        grid = WaveGrid(sea.kx, sea.ky, x, x)

        def work(grid: Any = grid, sea: Any = sea) -> None:
            grid.sum(elevation_and_slopes(sea, 1.0))

        found[name] = cpu(work, work)
    return found


def ensemble() -> dict[str, Any]:
    """Return the CPU seconds of a resolved sea in ensembles at 5 and 13 m/s, 512 chains."""
    import meshtrace as mt
    from meshtrace.surfaces import resolved_sea

    found = {}
    for wind in (5.0, 13.0):
        sea, options = resolved_sea(wind, fetch=30e3), {"photons": 512, "threads": 1}

        def work(n: int, sea: Any = sea, options: Any = options) -> Any:
            return mt.ensemble(mt.Link(), n, sea, **options)

        found[f"{wind:g} m/s"] = (
            cpu(lambda: work(48), lambda: work(16)) - cpu(lambda: work(16))
        ) / 32
    return found


def photon() -> dict[str, Any]:
    """Return the time of a photon over that of a plain loop, by b [1/m]."""
    from throughput import measure_against_loop

    return {f"b = {b:g}": measure_against_loop(b, n, 2)["ratio"] for b, n in
            ((0.037, 1_000_000), (0.1, 1_000_000), (1.0, 200_000))}  # fmt: skip


def rays() -> dict[str, Any]:
    """Return photons per raw ray of embreex over the same mesh.

    The limit is that of a plain loop below still water with one raw ray for each photon.
    """
    from throughput import SMOOTH, default_mesh, measure_against_loop
    from works import analog_rate

    import meshtrace as mt

    found = {"no tilts": SMOOTH, "tilts": mt.Link()}
    rates = {k: analog_rate(v, default_mesh(v), 1_000_000) for k, v in found.items()}
    loop = 1e-9 * measure_against_loop(0.037, 1_000_000, 2)["plain_ns"]
    limit = 1.0 / (1.0 + loop * rates["no tilts"]["rays_per_s"])
    return {**{k: rate["ratio"] for k, rate in rates.items()}, "limit": limit}


def receivers(n: int = 10_000) -> dict[str, Any]:
    """Return the cost of a list of receivers on a square of 10 m, 1,024 chains."""
    import numpy as np

    import meshtrace as mt
    from meshtrace.surfaces import JonswapSea

    sea, side = JonswapSea(wind_speed=5.0, seed=7), round(n**0.5)
    x = np.linspace(-5.0, 5.0, side).tolist()
    ends = tuple(mt.Receiver(position=(a, b)) for a in x for b in x)

    def work(ends: Any) -> None:
        mt.simulate(mt.Link(receiver=ends), sea, photons=1024, threads=1)

    work(ends[:2])
    before, seconds = peak_mib(), cpu(lambda: work(ends))
    each = 1e3 * seconds / len(ends), (peak_mib() - before) / len(ends)
    return {"receivers": len(ends), "CPU s": seconds, "ms each": each[0], "MiB each": each[1]}


def memory() -> dict[str, Any]:
    """Return the peaks of memory [MiB] of runs of forced detection by their chains."""
    from throughput import peak_memory

    return {
        f"{n:.0e}": peak_memory(n, "forced") / 2**20
        for n in (10_000, 100_000, 1_000_000, 4_000_000)
    }


def derivatives() -> dict[str, Any]:
    """Return the CPU time of 11 sensitivities over that of a plain run with the same chains."""
    import meshtrace as mt
    from meshtrace.studies import sensitivities
    from meshtrace.surfaces import FlatSea, JonswapSea

    found = {}
    for name, sea in (("flat", FlatSea()), ("5 m/s", JonswapSea(wind_speed=5.0, seed=7))):

        def plain(sea: Any = sea) -> Any:
            return mt.simulate(mt.Link(), sea, photons=8192, threads=1)

        def whole(sea: Any = sea) -> Any:
            return sensitivities(mt.Link(), sea, wrt=PARAMETERS, photons=8192, threads=1)

        found[name] = cpu(whole, whole) / min(cpu(plain) for _ in range(3))
    return found


def points() -> dict[str, Any]:
    """Return costs of a sweep of 64 points: CPU of one process over a loop, wall of one over two."""
    from test_batch_benchmark import LINK, PARAMETERS, seconds_of

    import meshtrace as mt
    from meshtrace.scenario import Scenario

    base = Scenario.from_config(LINK).to_toml()

    def loop() -> None:
        for depth in PARAMETERS["transmitter.depth"]:
            for wind in PARAMETERS["wind_speed"]:
                changes = {"transmitter.depth": depth, "wind_speed": wind}
                case = Scenario.from_toml(base, changes=changes)
                mt.simulate(case, photons=1024, rtol=0.01, threads=1)

    one = cpu(lambda: seconds_of(1, 0.01), lambda: seconds_of(1, 0.01))
    walls = [seconds_of(n, 0.0007) for n in (1, 2)]
    return {"one process over loop": one / cpu(loop), "wall of one over two": walls[0] / walls[1]}


def coverage() -> dict[str, Any]:
    """Return the CPU seconds of a map of 256 cells to 2 %, over those by photons alone."""
    import meshtrace as mt
    from meshtrace.scenario import Scenario
    from meshtrace.studies import coverage_map
    from meshtrace.surfaces import JonswapSea

    options: dict[str, Any] = {"extent": 5.0, "step": 0.625, "rtol": 0.02, "threads": 1}
    small = {**options, "extent": 1.25}
    analog = Scenario.from_config({"run": {"estimator": "analog"}, "sea": {"seed": 7}})
    link, sea = mt.Link(), JonswapSea(wind_speed=5.0, seed=7)
    auto = cpu(lambda: coverage_map(link, sea, **options), lambda: coverage_map(link, sea, **small))
    photons = cpu(lambda: coverage_map(analog, sea, **options))
    return {"CPU s": auto, "over photons alone": auto / photons}


def cells() -> dict[str, Any]:
    """Return the CPU seconds of maps at 13 m/s to a tolerance in every cell, and that reached."""
    from works import coverage_cost

    import meshtrace as mt
    from meshtrace.surfaces import JonswapSea

    link, sea, found = mt.Link(), JonswapSea(wind_speed=13.0, seed=7), {}
    for step, rtol in ((0.25, 0.02), (0.1, 0.01)):
        one = coverage_cost(link, sea, 5.0, step, rtol)
        found |= {f"{one['cells']} cells": one["cpu_seconds"], f"to {rtol:g}": one["rtol"]}
    return found


def fixed() -> dict[str, Any]:
    """Return the CPU seconds of a gain of few chains at 0, 5 and 13 m/s, on all cores."""
    import meshtrace as mt
    from meshtrace.surfaces import FlatSea, JonswapSea

    found = {}
    for wind in (0.0, 5.0, 13.0):
        sea = JonswapSea(wind_speed=wind, seed=7) if wind else FlatSea()

        def work(sea: Any = sea) -> Any:
            return mt.simulate(mt.Link(), sea, photons=512)

        found[f"{wind:g} m/s"] = min(cpu(work, work), *(cpu(work) for _ in range(6)))
    return found


def asked() -> dict[str, Any]:
    """Return the CPU time of a gain to 1 % over that of 32 chains, and the error, in per cent."""
    import meshtrace as mt
    from meshtrace.surfaces import FlatSea, JonswapSea

    found: dict[str, Any] = {}
    for wind in (0.0, 5.0, 13.0):
        sea = JonswapSea(wind_speed=wind, seed=7) if wind else FlatSea()

        def gain(sea: Any = sea, **options: Any) -> Any:
            return mt.simulate(mt.Link(), sea, threads=1, **options)

        result = gain(rtol=0.01)
        gain(photons=32)
        pairs = [(cpu(lambda: gain(rtol=0.01)), cpu(lambda: gain(photons=32))) for _ in range(8)]
        asked_for, fewest = map(min, zip(*pairs, strict=True))
        error = 100.0 * float(result.stderrs[0] / result.gains[0])
        found |= {f"{wind:g} m/s": asked_for / fewest, f"% at {wind:g} m/s": error}
    return found


def turbid() -> dict[str, Any]:
    """Return the CPU seconds to 1 % at b z = 10, by the phase function."""
    import meshtrace as mt
    from meshtrace.surfaces import FlatSea

    found = {}
    for name, phase in (("Fournier-Forand", None), ("g = 0.9", mt.optics.HenyeyGreenstein(g=0.9))):
        water = mt.Water(a=0.1, b=1.0) if phase is None else mt.Water(a=0.1, b=1.0, phase=phase)

        def work(water: Any = water) -> Any:
            return mt.simulate(mt.Link(water=water), FlatSea(), rtol=0.01, threads=1)

        found[name] = cpu(work, work)
    return found


def deep() -> dict[str, Any]:
    """Return the CPU seconds for 1 % where light is scattered 10 and 20 times on the way.

    From the cost of 2 % at three seeds, as the cost grows as the inverse square of the error.
    """
    import meshtrace as mt
    from meshtrace.surfaces import FlatSea, JonswapSea

    seas, found = {"": FlatSea(), ", 5 m/s": JonswapSea(wind_speed=5.0, seed=7)}, {}
    for b, (name, sea) in product((1.0, 2.0), seas.items()):
        link = mt.Link(water=mt.Water(a=0.1, b=b))

        def squares(seed: int, link: Any = link, sea: Any = sea) -> float:
            done: list[Any] = []
            used = cpu(lambda: done.append(mt.simulate(link, sea, rtol=0.02, seed=seed, threads=1)))
            return used * (100.0 * float(done[0].stderrs[0] / done[0].gains[0])) ** 2

        squares(1)
        found[f"b z = {10 * b:g}{name}"] = sum(map(squares, (1, 2, 3))) / 3.0
    return found


def colours() -> dict[str, Any]:
    """Return the CPU time of gains at 31 wavelengths over that at one, by the water."""
    from test_wavelengths_benchmark import CASES, COLOURS

    import meshtrace as mt

    found = {}
    for name in ("clear-wavy", "turbid-wavy", "chlorophyll-wavy"):
        link, sea, _ = CASES[name]
        options: dict[str, Any] = {"photons": 10_000, "threads": 1, "seed": 1}

        def gain(nm: Any, link: Any = link, sea: Any = sea, options: Any = options) -> None:
            mt.simulate(link, sea, wavelengths_nm=nm, **options)

        gain(COLOURS)
        pairs = [(cpu(lambda: gain(COLOURS)), cpu(lambda: gain([550.0]))) for _ in range(5)]
        every, single = map(min, zip(*pairs, strict=True))
        found[name] = every / single
    return found


def page() -> dict[str, Any]:
    """Return the CPU seconds and the peak memory of the page of a design, that of the guide."""
    import re

    import meshtrace as mt

    guide = (ROOT / "docs" / "guides" / "design.md").read_text()
    link = re.findall(r"```toml\n(.*?)```", guide, re.DOTALL)[0]
    used = cpu(lambda: mt.design(mt.Scenario.from_toml(link), threads=1))
    return {"CPU s": used, "MiB": peak_mib()}


def frames() -> dict[str, Any]:
    """Return the CPU seconds of a frame of a trace, the default link at 5 m/s over all waves."""
    from test_traces_benchmark import UP, per_frame

    return {"CPU s": per_frame(UP)}


ROWS: dict[str, tuple[Callable[[], dict[str, Any]], str, str]] = {
    "start": (start, "command to first output, warm", "0.6 CPU s"),
    "first": (first, "first run ever, from source", "10 s wall"),
    "wheel": (wheel, "first run ever, from a wheel", "5 s wall"),
    "waves": (waves, "sums of waves, CPU s", "finufft alone"),
    "ensemble": (ensemble, "resolved sea in an ensemble, CPU s", "0.015"),
    "photon": (photon, "photon over plain loop", "2"),
    "turbid": (turbid, "1 % at b z = 10, CPU s", "-"),
    "rays": (rays, "photons per raw ray", "0.8"),
    "receivers": (receivers, "10,000 receivers as a list", "40 CPU s, 0.1 MiB each"),
    "memory": (memory, "peak of forced detection by chains, MiB", "flat"),
    "derivatives": (derivatives, "11 sensitivities over a plain run", "6, differences 25"),
    "points": (points, "sweep of 64 points", "1.2, 1.9"),
    "coverage": (coverage, "coverage of 256 cells to 2 %", "never over 1"),
    "cells": (cells, "coverage at 13 m/s to 2 and 1 %, CPU s", "15, 40"),
    "fixed": (fixed, "fixed cost of a gain, CPU s", "0.03"),
    "asked": (asked, "1 % asked, over 32 chains", "1.2"),
    "pictures": (pictures, "commands, warm: CPU s and modules", ".7, 2, 5 CPU s"),
    "movie": (movie, "frame of a movie, CPU s", "0.8"),
    "compiled": (compiled, "functions that the first run compiles", "fewer"),
    "frames": (frames, "frame of a trace, CPU s", "0.010"),
    "deep": (deep, "1 % at b z = 10 and 20, CPU s", "20"),
    "colours": (colours, "31 wavelengths over one", "1.3"),
    "page": (page, "page of a design", "20 CPU s, 400 MiB"),
}


def main(rounds: int, names: Sequence[str]) -> None:
    """Print the table, a line for each row and round as it is measured."""
    load = os.getloadavg()[0]
    print(
        f"load {load:.1f} on {os.cpu_count()} cores before; CPU seconds of one thread", flush=True
    )
    for name in names:
        _, title, goal = ROWS[name]
        print(f"{title} (goal: {goal})", flush=True)
        for _ in range(rounds):
            try:
                found = in_child(__file__, "--row", name)
            except subprocess.CalledProcessError:
                print("    failed", flush=True)
                continue
            print("   ", ", ".join(f"{k}: {v:.3g}" for k, v in found.items()), flush=True)


if __name__ == "__main__":
    arguments = sys.argv[1:]
    if arguments[:1] == ["--row"]:
        warnings.simplefilter("ignore")
        print(json.dumps(ROWS[arguments[1]][0]()))
    elif arguments[:1] == ["--help"]:
        print(__doc__)
    elif arguments == ["--list"]:
        print(" ".join(ROWS))
    else:
        main(int(arguments[0]) if arguments else 3, arguments[1:] or list(ROWS))
