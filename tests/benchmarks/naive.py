"""The naive tracer: 45 lines of NumPy over Open3D's ray casting, or over embreex without Open3D.

Photons of a lamp of Lambertian order m in water of Henyey-Greenstein phase function, facets as they
are, Fresnel by chance, no variance reduction but absorption as a weight.
"""

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np

import meshtrace as mt


def caster(mesh: mt.TriangleMesh, open3d: bool) -> Callable[[Any, Any], tuple[Any, Any]]:
    """Return a function that gives facet and distance of rays."""
    vertices, faces = mesh.vertices.astype(np.float32), mesh.faces
    if open3d:
        import open3d as o3d

        o3d_scene = o3d.t.geometry.RaycastingScene()
        o3d_scene.add_triangles(vertices, faces.astype(np.uint32))

        def cast(p: Any, d: Any) -> tuple[Any, Any]:
            hit = o3d_scene.cast_rays(np.hstack([p, d]).astype(np.float32))
            return hit["primitive_ids"].numpy().astype(np.int64), hit["t_hit"].numpy()

        return cast
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    scene = EmbreeScene(robust=True)
    TriangleMesh(scene, vertices, faces)

    def cast_embreex(p: Any, d: Any) -> tuple[Any, Any]:
        hit = scene.run(p.astype(np.float32), d.astype(np.float32), output=1)
        return hit["primID"], np.where(hit["primID"] >= 0, hit["tfar"], np.inf)

    return cast_embreex


HAS_OPEN3D = find_spec("open3d") is not None


# fmt: off
def turned(d, c, rng):
    """Return directions at polar cosines c around d."""
    phi, s = 2 * np.pi * rng.random(len(d)), np.sqrt(np.maximum(1 - c**2, 0))
    e = np.cross(d, np.where(np.abs(d[:, :1]) < 0.7, [[1.0, 0, 0]], [[0, 1.0, 0]]))
    e /= np.linalg.norm(e, axis=1)[:, None]
    f = np.cross(d, e)
    return c[:, None] * d + (s * np.cos(phi))[:, None] * e + (s * np.sin(phi))[:, None] * f


def naive_gain(cast, link, mesh, n, seed):
    """Return gain and standard error of n photons."""
    rng, water, rx, lamp = np.random.default_rng(seed), link.water, link.receiver, link.transmitter
    g, index, score = water.phase.g, np.arange(n), np.zeros(n)
    p = np.tile([*lamp.position, -lamp.depth], (n, 1)).astype(float)
    d = turned(np.tile([0.0, 0, 1], (n, 1)), rng.random(n) ** (1 / (lamp.order + 1)), rng)
    w, wet = np.ones(n), np.ones(n, bool)
    while len(w):
        facet, t = cast(p, d)
        free = np.where(wet, rng.exponential(1 / water.b, len(w)), np.inf)
        crosses, scatters = np.isfinite(t) & (t <= free), wet & (free < t)
        up = ~wet & ~crosses & (d[:, 2] > 0)
        way = (rx.height - p[up, 2]) / d[up, 2]
        at = p[up] + way[:, None] * d[up] - np.array([*rx.position, rx.height])
        seen = (way > 0) & (np.hypot(at[:, 0], at[:, 1]) <= rx.radius)
        np.add.at(score, index[up], w[up] * (seen & (d[up, 2] >= np.cos(np.radians(rx.fov_deg / 2)))))
        step = np.where(crosses, t, np.where(scatters, free, 0.0))
        p, w = p + step[:, None] * d, w * np.where(wet, np.exp(-water.a * step), 1.0)
        s = 1 + g * g - ((1 - g * g) / (1 - g + 2 * g * rng.random(scatters.sum()))) ** 2
        d[scatters] = turned(d[scatters], s / (2 * g), rng)
        c = np.flatnonzero(crosses)
        normal = mesh.face_normals[facet[c]] * np.where(wet[c], 1.0, -1.0)[:, None]
        eta, cos_i = np.where(wet[c], water.n, 1 / water.n), np.einsum("ij,ij->i", d[c], normal)
        cos_t2 = 1 - eta**2 * (1 - cos_i**2)
        cos_t = np.sqrt(np.maximum(cos_t2, 0))
        rs, rp = ((eta * cos_i - cos_t) / (eta * cos_i + cos_t),
                  (cos_i - eta * cos_t) / (cos_i + eta * cos_t))
        back = (cos_t2 <= 0) | (rng.random(len(c)) < (rs**2 + rp**2) / 2)
        through = eta[:, None] * d[c] + (cos_t - eta * cos_i)[:, None] * normal
        d[c] = np.where(back[:, None], d[c] - 2 * cos_i[:, None] * normal, through)
        p[c] += np.where(back, -1e-4, 1e-4)[:, None] * normal
        wet[c] ^= ~back
        low = w < 0.05 * np.exp(-water.a * lamp.depth)
        w, kills = np.where(low, 2 * w, w), low & (rng.random(len(w)) < 0.5)
        on = (crosses | scatters) & ~kills
        p, d, w, wet, index = p[on], d[on], w[on], wet[on], index[on]
    return score.mean(), score.std() / np.sqrt(n)
