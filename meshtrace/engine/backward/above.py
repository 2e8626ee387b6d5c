"""Background of a receiver in the air: rays mirrored by the sea to the sky, connected to the sun.

Rays follow the mirror direction over up to eight reflections; at each of them the sun is connected
by the density of the slopes that the mesh leaves out (`daylight.glint`), or, over a mesh that
leaves none out, by the points of the mesh that mirror it exactly (`engine.backward.sun_points`).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from meshtrace.daylight.glint import connected_glint
from meshtrace.daylight.light import SUN_RADIUS_DEG, Daylight
from meshtrace.daylight.patterns import sky_radiance
from meshtrace.engine.backward.submerged import walked
from meshtrace.engine.backward.sun_points import Reflection, bent_sun
from meshtrace.engine.backward.view import (
    FOAM,
    GLINT,
    SKY,
    SUN,
    WATER,
    Hit,
    Scene,
    View,
    first_hits,
    scene_of,
)
from meshtrace.kernels.facets import Surface
from meshtrace.link import Link
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Floats
from meshtrace.optics.fresnel import fresnel_reflectance
from meshtrace.results.background import PARTS
from meshtrace.stored import SHIFTS

_BOUNCES = 8
_OFFSET = 1e-5  # start of a ray above its facet, in units of the frame
_LEAST_ROUGH = 0.3  # normal_z: no slopes are added to steeper facets, as in the photon kernels


def seen_from_air(
    link: Link, mesh: TriangleMesh, day: Daylight, photons: int, seed: int, normals: str,
    threads: int,
) -> Floats:  # fmt: skip
    """Return the radiances of the parts by shift (shifts, parts) for a receiver in the air."""
    view = View.of(link, photons, seed)
    scene = scene_of(link, mesh, day, normals, threads)
    parts = follow(scene, view.origins(), view.directions(), view.uniforms[:, 4:], seed)
    parts = parts.reshape(SHIFTS, -1, len(PARTS)).mean(axis=1)
    if day.direct > 0.0:
        parts[:, SUN] += sun_in_view(scene, view)
        if not scene.rough:
            law = Reflection(np.array(day.sun), scene.n)
            glint = bent_sun(scene, law, view)
            parts[:, GLINT] += day.direct * (1.0 - scene.foam) * glint
    if day.water == "walk":
        light = walked(link, mesh, day, view, seed, normals, threads, in_water=False)
        parts[:, WATER] += light.sum(axis=1)
    return parts


def sun_in_view(scene: Scene, view: View) -> float:
    """Return the mean radiance of the part of the sun's disk within the field of view."""
    sun = np.array(scene.day.sun)
    cosine = float(sun @ view.axis)
    share = view.share_of_disk(sun, math.radians(SUN_RADIUS_DEG))
    if cosine <= 0.0 or share == 0.0:
        return 0.0
    blocked = scene.intersector.intersect([view.center], [sun]).facet[0] >= 0
    return 0.0 if blocked else share * scene.day.direct * cosine / (math.pi * view.sin2_psi)


def follow(scene: Scene, origin: Floats, direction: Floats, u: Floats, seed: int) -> Floats:
    """Return the radiance of each part along rays (rays, parts), without the disk of the sun."""
    out = np.zeros((len(origin), len(PARTS)))
    weight, rays = np.ones(len(origin)), np.arange(len(origin))
    rng = np.random.default_rng((seed, 23))
    sky = scene.day.sky
    for bounce in range(_BOUNCES + 1):
        hit, at_sea = first_hits(scene, origin, direction)
        if bounce == _BOUNCES or (bounce > 0 and not scene.second_hits):
            at_sea[:] = False
        free = ~at_sea
        out[rays[free], SKY] += weight[free] * sky_radiance(sky, direction[free])
        if not at_sea.any():
            break
        rays, weight = rays[at_sea], weight[at_sea]
        hit, view = Hit(*(v[at_sea] for v in hit)), -direction[at_sea]
        weight = _foam(scene, out, rays, weight)
        if scene.day.direct > 0.0 and scene.rough:
            out[rays, GLINT] += weight * _glint(scene, hit, view)
        draws = u[rays] if bounce == 0 else rng.random((len(u), 3))[rays]
        rho, mirrored, refracted = _split(scene, hit, view, draws)
        if scene.water is not None:
            light = scene.water.upwelling(-refracted) / scene.n**2
            out[rays, WATER] += weight * (1.0 - rho) * light
        weight = weight * rho
        origin, direction = hit.point + _OFFSET * hit.facet_normal, mirrored
    return out


def _foam(scene: Scene, out: Floats, rays: Any, weight: Floats) -> Floats:
    """Score the foam and return the weight of the rays that meet water."""
    if scene.foam == 0.0:
        return weight
    day = scene.day
    out[rays, FOAM] += weight * scene.foam * day.foam_reflectance * day.irradiance / math.pi
    return weight * (1.0 - scene.foam)


def _glint(scene: Scene, hit: Hit, view: Floats) -> Floats:
    """Return the radiance of the sun mirrored by unresolved slopes, shadows by one ray."""
    sun = np.array(scene.day.sun)
    glint = connected_glint(
        view, sun, hit.normal, hit.facet_normal, scene.surface.roughness, scene.n
    )
    lit = np.flatnonzero((glint > 0.0) & (hit.facet_normal @ sun > 0.0))
    start = hit.point[lit] + _OFFSET * hit.facet_normal[lit]
    shadow = scene.intersector.intersect(start, np.broadcast_to(sun, start.shape)).facet >= 0
    out = np.zeros(len(view))
    out[lit[~shadow]] = glint[lit[~shadow]]
    return scene.day.direct * out


def _split(scene: Scene, hit: Hit, view: Floats, u: Floats) -> tuple[Floats, Floats, Floats]:
    """Return reflectance and both directions of rays, twin of `kernels.interface.branches`."""
    direction = -view
    normal = _tilted(scene.surface, hit, direction, u)
    rho, mirrored, refracted = _branches(direction, normal, scene.n)
    wrong = np.einsum("ij,ij->i", mirrored, hit.facet_normal) <= 0.0
    wrong |= np.einsum("ij,ij->i", direction, normal) >= 0.0
    if wrong.any():
        again = _branches(direction[wrong], hit.facet_normal[wrong], scene.n)
        rho[wrong], mirrored[wrong], refracted[wrong] = again
    return rho, mirrored, refracted


def _branches(direction: Floats, normal: Floats, n: float) -> tuple[Floats, Floats, Floats]:
    cos_i = np.clip(-np.einsum("ij,ij->i", direction, normal), 0.0, 1.0)
    mirrored = direction + 2.0 * cos_i[:, None] * normal
    cos_t = np.sqrt(1.0 - (1.0 - cos_i**2) / n**2)
    refracted = direction / n + (cos_i / n - cos_t)[:, None] * normal
    return fresnel_reflectance(cos_i, 1.0, n), mirrored, refracted


def _tilted(surface: Surface, hit: Hit, direction: Floats, u: Floats) -> Floats:
    """Return normals tilted by unresolved slopes, twin of `photon_events._roughened`."""
    roughness, normal = surface.roughness, hit.normal
    if roughness.along == 0.0 == roughness.across:
        return normal
    r, phi = np.sqrt(-2.0 * np.log(u[:, 0])), 2.0 * math.pi * u[:, 1]
    along, across = roughness.along * r * np.cos(phi), roughness.across * r * np.sin(phi)
    tilt = np.stack(
        [roughness.cos * along - roughness.sin * across,
         roughness.sin * along + roughness.cos * across], axis=1
    )  # fmt: skip
    facing = np.einsum("ij,ij->i", direction, normal)
    shown = 1.0 - normal[:, 2] * np.einsum("ij,ij->i", direction[:, :2], tilt) / facing
    tilt[2.0 * u[:, 2] >= np.clip(shown, 0.0, 2.0)] *= -1.0
    tilt[hit.facet_normal[:, 2] <= _LEAST_ROUGH] = 0.0
    out = normal.copy()
    out[:, :2] -= tilt * normal[:, 2:]
    return out / np.linalg.norm(out, axis=1, keepdims=True)
