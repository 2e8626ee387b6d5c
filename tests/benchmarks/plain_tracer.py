"""The peer: the same algorithm as a user would write it with numpy and trimesh.

Photons are followed in batches of arrays, as the engine follows them one by one: Lambertian launch,
free paths from b with exp(-a s), scattering angles by interpolation of the CDF, one trimesh ray
query for every flight, Snell and Fresnel at interpolated normals, the part in the air to the
aperture or, where a wave may stand in its way, one of both parts by chance, the part in the
water on with its weight, Russian roulette for light photons, and a ledger of where weight ends.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from trimesh.ray.ray_pyembree import RayMeshIntersector
from trimesh.triangles import points_to_barycentric

import meshtrace as mt

Array = NDArray[np.float64]

OFFSET = 1e-5  # [m], how far a ray starts off the facet that it leaves


class Plain(NamedTuple):
    """What a run needs, and its ledger."""

    link: mt.Link
    mesh: mt.TriangleMesh
    rays: RayMeshIntersector
    table: tuple[Array, Array]
    rng: np.random.Generator
    least: float  # weight below which Russian roulette is played
    ledger: dict[str, float]


def plain_gain(
    link: mt.Link, mesh: mt.TriangleMesh, photons: int, seed: int, batch: int = 100_000
) -> tuple[float, float, dict[str, float]]:
    """Return gain, standard error and the share of the weight by fate.

    Parameters
    ----------
    link : Link
        One `Led`, one `Receiver`, homogeneous water without bubbles, no random slopes.
    mesh : TriangleMesh
        The surface.
    photons : int
        Photons.
    seed : int
        Seed of numpy's generator.
    batch : int
        Photons that are followed together.
    """
    theta = np.concatenate([[0.0], np.geomspace(1e-7, math.pi, 20_000)])
    plain = Plain(
        link,
        mesh,
        RayMeshIntersector(mesh.to_trimesh()),
        (link.water.phase.cdf(theta), theta),
        np.random.default_rng(seed),
        0.5 * math.exp(-link.water.a * link.transmitter.depth),
        dict.fromkeys(("received", "landed", "absorbed", "roulette", "left"), 0.0),
    )
    total = squares = 0.0
    for start in range(0, photons, batch):
        score = _batch(plain, min(batch, photons - start))
        total += score.sum()
        squares += (score**2).sum()
    mean = total / photons
    stderr = math.sqrt((squares / photons - mean**2) / (photons - 1))
    return mean, stderr, {fate: weight / photons for fate, weight in plain.ledger.items()}


def _batch(plain: Plain, n: int) -> Array:
    """Return what each photon of a batch brings into the aperture."""
    led, water, rng = plain.link.transmitter, plain.link.water, plain.rng
    position = np.tile([*led.position, -led.depth], (n, 1))
    cos_theta = rng.random(n) ** (1.0 / (led.order + 1.0))
    direction = turn(np.tile((0.0, 0.0, 1.0), (n, 1)), cos_theta, rng)
    weight, photon, wet = np.ones(n), np.arange(n), np.ones(n, bool)
    score = np.zeros(n)
    while len(photon):
        s = np.where(wet, rng.exponential(1.0 / water.b, len(photon)), np.inf)
        point, ray, facet = plain.rays.intersects_location(position, direction, multiple_hits=False)
        distance = np.full(len(photon), np.inf)
        distance[ray] = np.linalg.norm(point - position[ray], axis=1)
        hit = np.full(len(photon), -1)
        hit[ray] = facet
        crosses = distance < s
        gone = ~crosses & (~wet | (position[:, 2] + s * direction[:, 2] > plain.mesh.bounds[1, 2]))
        _land(plain, score, photon, position, direction, weight, gone & ~wet)
        plain.ledger["left"] += weight[gone & wet].sum()
        length = np.where(gone, 0.0, np.minimum(distance, s))
        position = position + length[:, None] * direction
        kept = np.where(wet, weight * np.exp(-water.a * length), weight)
        plain.ledger["absorbed"] += (weight - kept).sum()
        weight = kept
        scatters = np.flatnonzero(~crosses & ~gone)
        angle = np.interp(rng.random(len(scatters)), *plain.table)
        direction[scatters] = turn(direction[scatters], np.cos(angle), rng)
        alive = ~gone
        i = np.flatnonzero(crosses)
        alive[i] = _cross(plain, score, photon, position, direction, weight, wet, i, hit[i])
        alive &= _roulette(plain, weight, alive & wet)
        photon, weight, wet = photon[alive], weight[alive], wet[alive]
        position, direction = position[alive], direction[alive]
    return score


def _cross(
    plain: Plain,
    score: Array,
    photon: Array,
    position: Array,
    direction: Array,
    weight: Array,
    wet: Array,
    i: Array,
    facet: Array,
) -> Array:
    """Refract and reflect photons i on their facets; return which of them go on."""
    mesh, n = plain.mesh, plain.link.water.n
    corners = mesh.faces[facet]
    bary = points_to_barycentric(mesh.vertices[corners], position[i])
    normal = np.einsum("ij,ijk->ik", bary, mesh.vertex_normals[corners])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    side = np.where(wet[i], 1.0, -1.0)[:, None]
    d = direction[i]
    eta = np.where(wet[i], n, 1.0 / n)
    cos_i = np.clip(np.einsum("ij,ij->i", d, side * normal), 1e-12, 1.0)
    cos2_t = 1.0 - eta**2 * (1.0 - cos_i**2)
    cos_t = np.sqrt(np.maximum(cos2_t, 0.0))
    rs = (eta * cos_i - cos_t) / (eta * cos_i + cos_t)
    rp = (cos_i - eta * cos_t) / (cos_i + eta * cos_t)
    rho = np.where(cos2_t > 0.0, 0.5 * (rs**2 + rp**2), 1.0)
    refracted = eta[:, None] * d + (cos_t - eta * cos_i)[:, None] * side * normal
    reflected = d - 2.0 * cos_i[:, None] * side * normal
    up = np.where(side > 0.0, refracted, reflected)
    down = np.where(side > 0.0, reflected, refracted)
    share = np.where(wet[i], 1.0 - rho, rho)  # of the weight, that is in the air behind
    free = up[:, 2] > mesh.max_slope * np.hypot(up[:, 0], up[:, 1])
    flies = ~free & (plain.rng.random(len(i)) < share)
    share = np.where(free, share, np.where(flies, 1.0, 0.0))
    leaves = free & (share > 0.0)
    _land(plain, score, photon[i], position[i], up, weight[i] * share, leaves)
    weight[i] *= np.where(flies, 1.0, 1.0 - share)
    wet[i] = ~flies
    direction[i] = np.where(flies[:, None], up, down)
    position[i] += np.where(flies, OFFSET, -OFFSET)[:, None] * mesh.face_normals[facet]
    return weight[i] > 0.0


def _land(
    plain: Plain,
    score: Array,
    photon: Array,
    position: Array,
    direction: Array,
    weight: Array,
    leaves: Array,
) -> None:
    """Score light that leaves for the sky."""
    i = np.flatnonzero(leaves)
    got = weight[i] * enters(plain.link.receiver, position[i], direction[i])
    np.add.at(score, photon[i], got)
    plain.ledger["received"] += got.sum()
    plain.ledger["landed"] += (weight[i] - got).sum()


def _roulette(plain: Plain, weight: Array, plays: Array) -> Array:
    """Raise the weight of survivors among light photons; return which are left."""
    i = np.flatnonzero(plays & (weight < plain.least))
    p = weight[i] / plain.least
    survives = plain.rng.random(len(i)) < p
    plain.ledger["roulette"] += weight[i].sum() - survives.sum() * plain.least
    weight[i] = plain.least
    left = np.ones(len(weight), bool)
    left[i[~survives]] = False
    return left


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


def enters(receiver: mt.Receiver, point: Array, direction: Array) -> NDArray[np.bool_]:
    """Return whether light flies into the aperture inside its field of view."""
    axis, center = np.array(receiver.axis), np.array(receiver.center)
    along = direction @ axis
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (center - point) @ axis / along
        off = np.linalg.norm(point + t[:, None] * direction - center, axis=1)
    seen = (t > 0.0) & (off <= receiver.radius)
    return seen & (along >= math.cos(math.radians(receiver.fov_deg / 2.0)))
