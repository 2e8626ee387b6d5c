"""The link as a scene of Mitsuba 3: volume path tracing from the receiver, as far as it goes.

A small Lambertian disk stands for the lamp of order m = 1, the water is a homogeneous medium with a
Henyey-Greenstein phase function, its surface a dielectric with the facets of the mesh, closed by
walls and a bed far away.
"""

from __future__ import annotations

import json
import math
import sys
import tempfile
from pathlib import Path
from time import process_time

import mitsuba as mi
import numpy as np
from peers import LINK, default_mesh

import meshtrace as mt

VARIANT = "llvm_ad_mono"
_RENDERINGS = 16
_BED = 80.0  # [m], depth where absorption has left nothing


def mitsuba_gain(
    link: mt.Link, mesh: mt.TriangleMesh, samples: int, seed: int, lamp_radius: float = 0.4
) -> tuple[float, float]:
    """Return gain and standard error, the latter from the scatter of renderings."""
    receiver = link.receiver
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "sea.ply"
        _write(path, mesh)
        scene = mi.load_dict(_scene(link, path, lamp_radius))
    power = math.pi**2 * lamp_radius**2
    area = math.pi * receiver.radius**2
    found = [
        float(np.array(mi.render(scene, spp=samples // _RENDERINGS, seed=seed + i)).ravel()[0])
        for i in range(_RENDERINGS)
    ]
    gains = np.array(found) * area / power
    return float(gains.mean()), float(gains.std(ddof=1)) / math.sqrt(_RENDERINGS)


def _scene(link: mt.Link, path: Path, lamp_radius: float) -> dict[str, object]:
    """Return the scene as Mitsuba takes it."""
    water, lamp, receiver = link.water, link.transmitter, link.receiver
    to_world = mi.ScalarTransform4f
    down = to_world().translate([*receiver.position, receiver.height]).rotate([1, 0, 0], 180)
    medium = {
        "type": "homogeneous",
        "albedo": water.b / (water.a + water.b),
        "sigma_t": water.a + water.b,
        "phase": {"type": "hg", "g": water.phase.g},
    }
    return {
        "type": "scene",
        "integrator": {"type": "volpath", "max_depth": 64, "rr_depth": 16},
        "sea": {
            "type": "ply",
            "filename": str(path),
            "face_normals": True,
            "bsdf": {"type": "dielectric", "int_ior": water.n, "ext_ior": link.n_air},
            "interior": medium,
        },
        "lamp": {
            "type": "disk",
            "to_world": to_world().translate([*lamp.position, -lamp.depth]).scale(lamp_radius),
            "bsdf": {"type": "null"},
            "emitter": {"type": "area", "radiance": 1.0},
        },
        "receiver": {
            "type": "disk",
            "to_world": down.scale(receiver.radius),
            "bsdf": {"type": "null"},
            "sensor": {
                "type": "irradiancemeter",
                "film": {
                    "type": "hdrfilm",
                    "width": 1,
                    "height": 1,
                    "rfilter": {"type": "box"},
                    "pixel_format": "luminance",
                },
                "sampler": {"type": "independent"},
            },
        },
    }


def _write(path: Path, mesh: mt.TriangleMesh) -> None:
    """Write the closed sea as a PLY file."""
    vertices, faces = _closed(mesh)
    sea = mi.Mesh("sea", len(vertices), len(faces))
    parameters = mi.traverse(sea)
    parameters["vertex_positions"] = vertices.astype(np.float32).ravel()
    parameters["faces"] = faces.astype(np.uint32).ravel()
    parameters.update()
    sea.write_ply(str(path))


def _closed(mesh: mt.TriangleMesh) -> tuple[np.ndarray, np.ndarray]:
    """Return the mesh with walls and a bed."""
    edges = np.sort(mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    directed = mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    _, index, count = np.unique(edges, axis=0, return_index=True, return_counts=True)
    rim = directed[index[count == 1]]
    n = len(mesh.vertices)
    below = mesh.vertices.copy()
    below[:, 2] = -_BED
    vertices = np.concatenate([mesh.vertices, below, [[*mesh.bounds[:, :2].mean(axis=0), -_BED]]])
    a, b = rim.T
    walls = np.concatenate([np.stack([a, n + a, b], 1), np.stack([b, n + a, n + b], 1)])
    bed = np.stack([n + b, n + a, np.full(len(a), 2 * n)], 1)
    return vertices, np.concatenate([mesh.faces, walls, bed])


if __name__ == "__main__":
    mi.set_variant(VARIANT)
    samples, mesh = int(sys.argv[1]), default_mesh()
    mitsuba_gain(LINK, mesh, _RENDERINGS, seed=0)  # compiles
    start = process_time()
    gain, stderr = mitsuba_gain(LINK, mesh, samples, seed=1)
    print(json.dumps({"gain": gain, "stderr": stderr, "cpu_s": process_time() - start}))
