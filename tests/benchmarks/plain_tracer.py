"""The peer: the same algorithm as a careful user would write it with numpy and trimesh.

Photons are followed in batches of arrays: Lambertian launch, free paths from b with exp(-a s),
scattering angles by interpolation of the CDF, trimesh's Embree ray queries, Fresnel weight and
Snell's law at the facet, straight flight to the aperture. Reflected light and second hits are left
out, as in the paper.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from trimesh.ray.ray_pyembree import RayMeshIntersector

import meshtrace as mt

Array = NDArray[np.float64]

LEAST_WEIGHT = 1e-4  # of a photon that is still followed


def plain_gain(
    link: mt.Link, mesh: mt.TriangleMesh, photons: int, seed: int, batch: int = 100_000
) -> tuple[float, float]:
    """Return gain and standard error for facet normals.

    Parameters
    ----------
    link : Link
        One `Led`, one `Receiver`, homogeneous water without bubbles.
    mesh : TriangleMesh
        The surface.
    photons : int
        Photons.
    seed : int
        Seed of numpy's generator.
    batch : int
        Photons that are followed together.
    """
    rng = np.random.default_rng(seed)
    rays = RayMeshIntersector(mesh.to_trimesh())
    theta = np.concatenate([[0.0], np.geomspace(1e-7, math.pi, 20_000)])
    table = link.water.phase.cdf(theta), theta
    total = squares = 0.0
    for start in range(0, photons, batch):
        n = min(batch, photons - start)
        score = _batch(link, mesh, rays, table, n, rng)
        total += score.sum()
        squares += (score**2).sum()
    mean = total / photons
    return mean, math.sqrt((squares / photons - mean**2) / (photons - 1))


def _batch(
    link: mt.Link,
    mesh: mt.TriangleMesh,
    rays: RayMeshIntersector,
    table: tuple[Array, Array],
    n: int,
    rng: np.random.Generator,
) -> Array:
    """Return what each photon of a batch brings into the aperture."""
    led, water = link.transmitter, link.water
    position = np.tile([*led.position, -led.depth], (n, 1))
    cos_theta = rng.random(n) ** (1.0 / (led.order + 1.0))
    direction = turn(np.tile((0.0, 0.0, 1.0), (n, 1)), cos_theta, rng)
    weight = np.ones(n)
    photon = np.arange(n)
    score = np.zeros(n)
    lowest = mesh.bounds[0, 2]
    while len(photon):
        s = rng.exponential(1.0 / water.b, len(photon))
        end = position + s[:, None] * direction
        up = np.flatnonzero(end[:, 2] >= lowest)
        point, ray, facet = rays.intersects_location(
            position[up], direction[up], multiple_hits=False
        )
        ray = up[ray]
        distance = np.linalg.norm(point - position[ray], axis=1)
        out = distance < s[ray]
        ray, facet, point, distance = ray[out], facet[out], point[out], distance[out]
        w = weight[ray] * np.exp(-water.a * distance)
        score[photon[ray]] += received(link, point, direction[ray], mesh.face_normals[facet], w)
        weight = weight * np.exp(-water.a * s)
        alive = weight > LEAST_WEIGHT
        alive[ray] = False
        alive &= end[:, 2] < mesh.bounds[1, 2]
        photon, weight, position = photon[alive], weight[alive], end[alive]
        angle = np.interp(rng.random(len(photon)), *table)
        direction = turn(direction[alive], np.cos(angle), rng)
    return score


def turn(direction: Array, cos_theta: Array, rng: np.random.Generator) -> Array:
    """Turn unit vectors by polar angles and random azimuths."""
    phi = 2.0 * math.pi * rng.random(len(direction))
    other = np.where(np.abs(direction[:, :1]) < 0.5, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    e1 = np.cross(direction, other)
    e1 /= np.linalg.norm(e1, axis=1)[:, None]
    e2 = np.cross(direction, e1)
    across = np.cos(phi)[:, None] * e1 + np.sin(phi)[:, None] * e2
    sin_theta = np.sqrt(np.maximum(1.0 - cos_theta**2, 0.0))
    return cos_theta[:, None] * direction + sin_theta[:, None] * across


def received(link: mt.Link, point: Array, direction: Array, normal: Array, weight: Array) -> Array:
    """Refract light at the surface and return what of it enters the aperture."""
    receiver, n = link.receiver, link.water.n
    cos_i = np.einsum("ij,ij->i", direction, normal)
    cos2_t = 1.0 - n**2 * (1.0 - cos_i**2)
    cos_t = np.sqrt(np.maximum(cos2_t, 0.0))
    rs = (n * cos_i - cos_t) / (n * cos_i + cos_t)
    rp = (cos_i - n * cos_t) / (cos_i + n * cos_t)
    transmitted = 1.0 - 0.5 * (rs**2 + rp**2)
    out = n * direction + (cos_t - n * cos_i)[:, None] * normal
    axis, center = np.array(receiver.axis), np.array(receiver.center)
    along = out @ axis
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (center - point) @ axis / along
        off = np.linalg.norm(point + t[:, None] * out - center, axis=1)
    seen = (cos2_t > 0.0) & (cos_i > 0.0) & (t > 0.0) & (off <= receiver.radius)
    seen &= along >= math.cos(math.radians(receiver.fov_deg / 2.0))
    return np.where(seen, weight * transmitted, 0.0)
