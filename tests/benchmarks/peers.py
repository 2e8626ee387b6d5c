"""meshtrace beside other tracers on one link: gains, and figures of merit per CPU second.

`python tests/benchmarks/peers.py` prints the table. The link is one that all can follow: a Lambertian
lamp (m = 1), a Henyey-Greenstein phase function and the facets of the mesh as they are. Open3D and
Mitsuba 3 take part where they are installed (`pip install open3d mitsuba`), Mitsuba in a process
of its own: it ends the process where its LLVM is too old (DRJIT_LIBLLVM_PATH names another).
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from time import process_time
from typing import NamedTuple

import numpy as np
from naive import HAS_OPEN3D, caster, naive_gain
from works import RayRecorder

import meshtrace as mt
from meshtrace.engine import bvh
from meshtrace.engine.photons import analog
from meshtrace.results import tallies
from meshtrace.surfaces import JonswapSea
from meshtrace.tables import text_table

LINK = mt.Link(
    physics=mt.Physics(unresolved="none"),
    transmitter=mt.Led(depth=5.0, half_angle_deg=60.0),
    water=mt.Water(a=0.1, b=0.2, phase=mt.HenyeyGreenstein(g=0.9)),
    receiver=mt.Receiver(height=3.0, radius=1.0, fov_deg=180.0),
)


class Row(NamedTuple):
    """Gain and cost of a tracer; rays alone have no gain."""

    name: str
    samples: int
    gain: float
    stderr: float
    cpu_s: float

    @property
    def merit(self) -> float:
        """Figure of merit: 1 / (relative variance x CPU seconds) [s-1]."""
        return (self.gain / self.stderr) ** 2 / self.cpu_s


def default_mesh() -> mt.TriangleMesh:
    """Return a sea of 5 m/s."""
    return JonswapSea(wind_speed=5.0, seed=3).mesh(extent=60.0, spacing=0.5)


def measure(scale: float = 1.0, rounds: int = 3) -> list[Row]:
    """Return a row for each tracer; all take turns, and the fastest round of each counts."""
    mesh = default_mesh()
    photons, few = int(2_000_000 * scale), int(200_000 * scale)
    jobs: dict[str, tuple[int, Callable[[int], tuple[float, float]]]] = {
        "analog": (photons, _analog(mesh, photons)),
        "raw Embree rays": _raw(mesh, min(photons, 2**18)),
        "naive, embreex": (few, _naive(mesh, few, False)),
    }
    if HAS_OPEN3D:
        jobs["naive, Open3D"] = (few, _naive(mesh, few, True))
    for _, job in jobs.values():
        job(0)  # compiles
    cpu, found = dict.fromkeys(jobs, math.inf), {}
    for _ in range(rounds):
        for name, (_, job) in jobs.items():
            start = process_time()
            found[name] = job(1)
            cpu[name] = min(cpu[name], process_time() - start)
    rows = [Row(name, n, *found[name], cpu[name]) for name, (n, _) in jobs.items()]
    return [_forced(mesh, 10_000), *rows, *mitsuba_rows(int(1_600_000 * scale))]


def _analog(mesh: mt.TriangleMesh, photons: int) -> Callable[[int], tuple[float, float]]:
    intersector = mt.EmbreeIntersector(mesh, 1)

    def job(seed: int) -> tuple[float, float]:
        sums = analog.run_analog(LINK, intersector, photons=photons, seed=seed, normals="facet")
        error = tallies.standard_error(sums.score, sums.score_squared, photons)
        return float(sums.score[0]) / photons, float(error[0])

    return job


def _raw(mesh: mt.TriangleMesh, photons: int) -> tuple[int, Callable[[int], tuple[float, float]]]:
    """Return the number of rays of analog photons, and a job that casts them by embreex.

    The lamp is 10 m deep: the engine scales shorter links, and the rays with them.
    """
    recorder = RayRecorder(mesh, 1)
    deeper = LINK.replace(transmitter=LINK.transmitter.replace(depth=10.0))
    analog.run_analog(deeper, recorder, photons=photons, seed=1, normals="facet")
    scene = bvh.CopiedScene(mesh.vertices, mesh.faces)

    def job(seed: int) -> tuple[float, float]:
        for chunk in recorder.rays:
            scene.run(*chunk)
        return np.nan, np.nan

    return sum(len(origins) for origins, _ in recorder.rays), job


def _naive(mesh: mt.TriangleMesh, n: int, open3d: bool) -> Callable[[int], tuple[float, float]]:
    cast = caster(mesh, open3d)
    return lambda seed: tuple(map(float, naive_gain(cast, LINK, mesh, n, seed)))  # type: ignore


def _forced(mesh: mt.TriangleMesh, chains: int) -> Row:
    """Return the row of forced detection, making of the chains included."""
    options = {"normals": "facet", "photons": chains, "threads": 1}
    mt.simulate(LINK, mesh, seed=0, **options)
    start = process_time()
    result = mt.simulate(LINK, mesh, seed=1, **options)
    cpu = process_time() - start
    return Row("forced", chains, result.gain, result.gain_stderr, cpu)


def mitsuba_rows(samples: int) -> list[Row]:
    """Return the row of Mitsuba 3, none where it is not installed or cannot run."""
    if find_spec("mitsuba") is None:
        return []
    command = [sys.executable, str(Path(__file__).with_name("mitsuba_peer.py")), str(samples)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        print("Mitsuba 3 ended:", (done.stderr.strip() or "killed").splitlines()[0])
        return []
    found = json.loads(done.stdout.splitlines()[-1])
    return [Row("Mitsuba 3, volpath", samples, found["gain"], found["stderr"], found["cpu_s"])]


def table(rows: list[Row]) -> str:
    """Return the rows as text, figures of merit relative to the naive tracer on embreex."""
    naive = next(row.merit for row in rows if row.name == "naive, embreex")
    return text_table((row.name, _text(row, naive)) for row in rows)


def _text(row: Row, naive: float) -> str:
    """Return a row as text."""
    rate = f"{row.samples / row.cpu_s:9.3g} samples per CPU s"
    if np.isnan(row.gain):
        return f"{'':22s}  {rate}"
    return f"{row.gain:.4e} +- {row.stderr:.1e}, {rate}, merit {row.merit / naive:8.3g}"


if __name__ == "__main__":
    print(table(measure(float(sys.argv[1]) if len(sys.argv) > 1 else 1.0)))
