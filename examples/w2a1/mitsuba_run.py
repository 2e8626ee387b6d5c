"""Run the reference case W2A-1 in Mitsuba 3, from w2a1.json alone.

    pip install mitsuba numpy
    python mitsuba_run.py --photons 2e7 --seed 1 --cases jonswap5 flat/depth40 > mine.csv

Mitsuba casts the rays (`Scene.ray_intersect`), interpolates the normals, and has Fresnel's
equations, the law of refraction and the random numbers. This script has the rest: the surface as a
mesh, the lamp, free paths, the phase function, and the disks. No part of meshtrace is imported.

Choices
-------
- The surface is a mesh of triangles: spacing 0.03 m, half-width 6 m, vertices on the wave sum and
  normals of its exact slopes at the vertices; still water is two triangles. Light that is accepted
  crosses the surface within 1.1 + 5 tan(30 deg) = 4 m of the axis.
- Photons go forward from the lamp. Absorption and Fresnel's transmittance are factors of their
  weight, collisions are drawn by the scattering coefficient; roulette ends light photons.
- Directions are drawn from the lamp's cosine power and from lobes towards the disks, weighted to be
  those of the lamp: more photons reach small disks.
- One photon is scored at all disks of its depth, each by its own radius, place and field of view:
  numbers of one surface and depth are correlated, and an error is that of each number alone.
- Light that the surface reflects is lost. Light that crossed it and comes back to it is not
  followed: within 30 deg of the vertical no slope of these surfaces is in its way.

Mitsuba's vectorised variants need LLVM: 19 works, 14 and 15 do not. DRJIT_LIBLLVM_PATH names the
library, such as /usr/lib/x86_64-linux-gnu/libLLVM-19.so.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import sys
import time
import zlib
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_mono")

CASE = json.loads(Path(__file__).with_name("w2a1.json").read_text(encoding="utf-8"))
A, B = CASE["link"]["a"], CASE["link"]["b"]  # [1/m]
ETA = CASE["link"]["n_water"] / CASE["link"]["n_air"]
HALF_ANGLE, HEIGHT = math.radians(10.0), 5.0  # of the lamp [rad], of the receiver [m]
ORDER = -math.log(2.0) / math.log(math.cos(HALF_ANGLE))  # of the lamp: radiant intensity ~ cos^m

HALF_WIDTH, SPACING = 6.0, 0.03  # of the mesh [m]
LAMP, LOBES = 0.3, (300.0, 3000.0)  # share of directions drawn by the lamp, k of the lobes
FAINT, SURVIVAL = 0.02, 0.25  # roulette below this weight, which a photon survives so often
BATCHES = 64


def waves(name: str) -> np.ndarray:
    """Return the rows (amplitude, omega, kx, ky, phase) of a surface at t = 0."""
    if name == "sinusoid":
        return np.array([[0.05, 0.0, 2.0 * np.pi / 3.0, 0.0, 0.0]])
    if name == "jonswap5":
        return np.array(CASE["jonswap5_components"]["rows"])
    rows = jonswap_waves(13.0, np.linspace(0.9, 3.0, 22), np.linspace(-0.5, 0.5, 21) * np.pi)
    listed = CASE["jonswap13_check"]
    np.testing.assert_allclose(rows[[0, -1]], [listed["first"], listed["last"]], 1e-6, 1e-12)
    variance = 0.5 * float(np.square(rows[:, 0]).sum())
    np.testing.assert_allclose(variance, listed["sum_amplitude_squared_half"], rtol=1e-8)
    return rows


def jonswap_waves(wind: float, omega: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Return the waves of a wind sea by the rule of the file."""
    g, fetch, phases = 9.81, 30e3, np.random.default_rng(7).random((omega.size, theta.size))
    x = g * fetch / wind**2
    peak = 22.0 * g / wind * x**-0.33
    width = np.where(omega <= peak, 0.07, 0.09)
    enhancement = 3.3 ** np.exp(-((omega / peak - 1.0) ** 2) / (2.0 * width**2))
    density = 0.075 * x**-0.22 * g**2 * omega**-5 * np.exp(-1.25 * (peak / omega) ** 4)
    spread = np.cos(theta) ** 2 / np.sum(np.cos(theta) ** 2)
    step = omega[1] - omega[0]
    amplitude = np.sqrt(2.0 * step * np.outer(density * enhancement, spread))
    k = omega[:, None] ** 2 / g
    table = np.broadcast_arrays(
        amplitude, omega[:, None], k * np.cos(theta), k * np.sin(theta), 2.0 * np.pi * phases
    )
    return np.stack([column.ravel() for column in table], axis=1)


def mesh_of(name: str) -> mi.Mesh:
    """Return a surface as a mesh with normals at its vertices."""
    cells = 1 if name == "flat" else math.ceil(2.0 * HALF_WIDTH / SPACING)
    line = np.linspace(-HALF_WIDTH, HALF_WIDTH, cells + 1)
    x, y = (grid.ravel() for grid in np.meshgrid(line, line, indexing="ij"))
    z, slope_x, slope_y = np.zeros((3, x.size))
    for amplitude, _, kx, ky, phase in () if name == "flat" else waves(name):
        argument = phase - kx * x - ky * y
        z += amplitude * np.cos(argument)
        slope_x += amplitude * kx * np.sin(argument)
        slope_y += amplitude * ky * np.sin(argument)
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    right, far = corner + cells + 1, corner + 1
    triangles = np.concatenate(
        [np.stack([corner, right, right + 1], 1), np.stack([corner, right + 1, far], 1)]
    )
    mesh = mi.Mesh("sea", x.size, len(triangles), has_vertex_normals=True)
    values = mi.traverse(mesh)
    values["vertex_positions"] = np.stack([x, y, z], 1).astype(np.float32).ravel()
    values["faces"] = triangles.astype(np.uint32).ravel()
    values.update()  # replaces the normals by averages of the triangles'
    normals = np.stack([-slope_x, -slope_y, np.ones_like(z)], 1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    values["vertex_normals"] = normals.astype(np.float32).ravel()
    values.update()
    return mesh


def fournier_forand(n: float = 1.1, mu: float = 3.5835, size: int = 1 << 16) -> mi.Float:
    """Return the angles [rad] at which the distribution is 0, 1/size, ..., 1.

    Fournier and Jonasz 1999, Proc. SPIE 3761, doi:10.1117/12.366488: the distribution to the angle
    theta, without approximation, where nu = (3 - mu) / 2 and delta = 4 s / (3 (n - 1)^2),
    s = sin(theta / 2)^2.
    """
    nu, scale = 0.5 * (3.0 - mu), 4.0 / (3.0 * (n - 1.0) ** 2)
    theta = np.concatenate(
        [np.geomspace(1e-9, 1e-3, 40_000), np.linspace(1e-3, np.pi, 400_001)[1:]]
    )
    s = np.sin(0.5 * theta) ** 2
    delta = scale * s
    last = (1.0 - scale**nu) / (8.0 * (scale - 1.0) * scale**nu)
    first = (1.0 - delta ** (nu + 1.0) - (1.0 - delta**nu) * s) / ((1.0 - delta) * delta**nu)
    cdf = first + last * np.cos(theta) * np.sin(theta) ** 2
    fine = np.abs(delta - 1.0) > 1e-6  # 0 / 0 at delta = 1, where the neighbours are joined
    cdf, theta = np.concatenate([[0.0], cdf[fine]]), np.concatenate([[0.0], theta[fine]])
    assert np.all(np.diff(cdf) > -1e-12)
    assert abs(cdf[-1] - 1.0) < 1e-9
    return mi.Float(np.interp(np.arange(size + 1) / size, cdf, theta))


def turned(rng: mi.PCG32, direction: mi.Vector3f, table: mi.Float) -> mi.Vector3f:
    """Return directions after a collision."""
    place = rng.next_float32() * (dr.width(table) - 1)
    index = dr.minimum(mi.UInt32(place), dr.width(table) - 2)
    low, high = dr.gather(mi.Float, table, index), dr.gather(mi.Float, table, index + 1)
    theta = dr.lerp(low, high, place - mi.Float(index))
    sin, cos = dr.sincos(theta)
    sin_phi, cos_phi = dr.sincos(dr.two_pi * rng.next_float32())
    local = mi.Vector3f(sin * cos_phi, sin * sin_phi, cos)
    return dr.normalize(mi.Frame3f(direction).to_world(local))


def launched(rng: mi.PCG32, axes: list[mi.Vector3f]) -> tuple[mi.Vector3f, mi.Float]:
    """Return directions and their weights, which make them those of the lamp.

    They are drawn about the vertical by the lamp's density (m + 1) c^m, c the cosine, and about
    the axes of the lobes by k exp(-k (1 - c)). Both draw 1 - c by an exponential variate, which
    keeps its digits where c is close to 1; a power in single precision does not.
    """
    which, variate = rng.next_float32(), -dr.log(1.0 - rng.next_float32())
    half = 0.5 * variate / (ORDER + 1.0)
    missing, axis = 2.0 * dr.exp(-half) * dr.sinh(half), mi.Vector3f(0.0, 0.0, 1.0)
    share = (1.0 - LAMP) / len(axes)
    for i, (toward, k) in enumerate(axes):
        chosen = (which >= LAMP + i * share) & (which < LAMP + (i + 1) * share)
        missing, axis = dr.select(chosen, variate / k, missing), dr.select(chosen, toward, axis)
    sin_phi, cos_phi = dr.sincos(dr.two_pi * rng.next_float32())
    sin = dr.sqrt(dr.maximum(missing * (2.0 - missing), 0.0))
    local = mi.Vector3f(sin * cos_phi, sin * sin_phi, 1.0 - missing)
    direction = dr.normalize(mi.Frame3f(axis).to_world(local))
    lamp = (ORDER + 1.0) * dr.power(dr.maximum(direction.z, 0.0), ORDER)
    drawn = LAMP * lamp
    for toward, k in axes:
        drawn += share * k * dr.exp(-0.5 * k * dr.squared_norm(direction - toward))
    return direction, lamp / drawn


@dr.syntax
def followed(scene, table, rng, axes, depth, crest):
    """Return points, directions and weights of photons that entered the air, and if scattered."""
    direction, weight = launched(rng, axes)
    point = mi.Point3f(0.0, 0.0, -depth)
    scattered, in_water = mi.Bool(False), dr.full(mi.Bool, True, dr.width(weight))
    while in_water:
        hit = scene.ray_intersect(mi.Ray3f(point, direction), in_water)
        free = -dr.log(1.0 - rng.next_float32()) / B
        weight *= dr.exp(-A * dr.minimum(free, hit.t))
        if free < hit.t:
            point = mi.Point3f(point + free * direction)
            direction = turned(rng, direction, table)
            scattered = mi.Bool(True)
            if weight < FAINT:
                weight = dr.select(rng.next_float32() < SURVIVAL, weight / SURVIVAL, 0.0)
            # light can rise above the water beside the mesh: it has missed all disks
            in_water = (weight > 0.0) & (point.z < crest)
            weight = dr.select(in_water, weight, 0.0)
        else:
            normal = hit.sh_frame.n
            reflected, cos_t, _, eta_ti = mi.fresnel(-dr.dot(normal, direction), ETA)
            weight *= 1.0 - reflected
            point = mi.Point3f(hit.p)
            direction = mi.refract(-direction, normal, cos_t, eta_ti)
            in_water = mi.Bool(False)
    return point, direction, weight, scattered


def scores(photons: tuple, disks: list[dict]) -> list[mi.Float64]:
    """Return the sums of unscattered and of all weights on each disk."""
    point, direction, weight, scattered = photons
    rise = (HEIGHT - point.z) / direction.z
    x, y = point.x + rise * direction.x, point.y + rise * direction.y
    found = []
    for disk in disks:
        on = dr.square(x - disk["x"]) + dr.square(y) <= disk["radius"] ** 2
        on &= direction.z >= math.cos(math.radians(0.5 * disk["fov_deg"]))
        on &= weight > 0.0
        for counted in (on & ~scattered, on):
            found.append(dr.sum(mi.Float64(dr.select(counted, weight, 0.0))))
    return found


def run(surface: str, disks: list[dict], photons: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return gains and standard errors, of shape (disks, 2): unscattered, total."""
    mesh, table = mesh_of(surface), fournier_forand()
    scene = mi.load_dict({"type": "scene", "sea": mesh})
    crest, size = float(mesh.bbox().max.z) + 1e-3, math.ceil(photons / BATCHES)
    depth, gains = disks[0]["depth"], []
    own = mi.UInt32(zlib.crc32(f"{surface} {depth} {seed}".encode()))  # numbers of each run
    axes = [
        (dr.normalize(mi.Vector3f(x, 0.0, depth + HEIGHT * ETA)), k)
        for x in sorted({disk["x"] for disk in disks})
        for k in LOBES
    ]
    for batch in range(BATCHES):
        # consecutive seeds of PCG32 are correlated
        first = dr.opaque(mi.UInt32, batch * size)  # no constant, which would compile it anew
        state, sequence = mi.sample_tea_32(own, first + dr.arange(mi.UInt32, size))
        rng = mi.PCG32(size, mi.UInt64(state), mi.UInt64(sequence))
        sums = scores(followed(scene, table, rng, axes, depth, crest), disks)
        gains.append(np.array([value.numpy()[0] for value in sums]) / size)
    error = np.std(gains, axis=0, ddof=1) / math.sqrt(BATCHES)
    return np.mean(gains, axis=0).reshape(-1, 2), error.reshape(-1, 2)


def main() -> None:
    """Run the chosen cases and print their rows."""
    parser = argparse.ArgumentParser(description="Run the reference case W2A-1 in Mitsuba 3.")
    parser.add_argument("--photons", type=float, default=1e7, help="of each surface and depth")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cases", nargs="*", default=[""], help="beginnings of names of cases")
    given = parser.parse_args()
    runs: dict[tuple[str, float], list[str]] = {}
    for name in CASE["cases"]:
        if name.startswith(tuple(given.cases)):
            surface, variant = name.split("/")
            runs.setdefault((surface, CASE["variants"][variant]["depth"]), []).append(name)
    out = csv.writer(sys.stdout, lineterminator="\n")
    out.writerow(
        "case time unscattered total total_stderr unscattered_stderr photons cpu_s".split()
    )
    for (surface, _), names in runs.items():
        start = time.process_time()
        disks = [CASE["variants"][name.split("/")[1]] for name in names]
        gains, errors = run(surface, disks, int(given.photons), given.seed)
        spent = round(time.process_time() - start)
        for name, gain, error in zip(names, gains, errors, strict=True):
            cells = (f"{value:.6e}" for value in (*gain, *error[::-1]))
            out.writerow((name, "", *cells, int(given.photons), spent))
        sys.stdout.flush()


if __name__ == "__main__":
    main()
