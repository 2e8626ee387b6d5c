"""Daylight at a receiver in the water: sky by photons followed backwards, sun through the sea."""

from __future__ import annotations

import math

import numpy as np

from meshtrace.daylight.glint import slope_density, slopes_of
from meshtrace.daylight.light import Daylight
from meshtrace.link import Link
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Floats
from meshtrace.results.background import PARTS
from meshtrace.stored import SHIFTS
from meshtrace.transport.frame import frame_of
from meshtrace.transport.scene_light import SKY, SUN, Scene, first_hits, scene_of
from meshtrace.transport.sun_points import Refraction, attenuated_sun
from meshtrace.transport.view import View, cone, only_aperture, shifted_points
from meshtrace.transport.walk import refracted_sun, walked

_REACH = 6.0  # standard deviations of the slopes, to which the cone about the sun is sampled
_LEVELS = 4000  # of the optical depth


def seen_from_water(
    link: Link, mesh: TriangleMesh, day: Daylight, photons: int, seed: int, normals: str,
    threads: int,
) -> Floats:  # fmt: skip
    """Return the radiances of the parts by shift (shifts, parts) for a receiver in the water.

    Sun that reaches the receiver unscattered passes the mesh; scattered sunlight passes still
    water before it.
    """
    view = View.of(only_aperture(link), frame_of(link), shifted_points(photons, 7, seed))
    parts = np.zeros((SHIFTS, len(PARTS)))
    light = walked(
        link, mesh, day, view.origins(), view.directions(), seed, normals, threads, in_water=True
    )
    parts[:, SKY], parts[:, SUN] = light[:, 0], light[:, 1]
    if day.direct == 0.0:
        return parts
    scene, depths = scene_of(link, mesh, day, normals, threads), OpticalDepth(link)
    if scene.rough:
        direct = _through_slopes(scene, view, depths)
    else:
        law = Refraction(np.array(day.sun), scene.n)
        direct = attenuated_sun(scene.intersector, scene.surface, law, view, depths)
    parts[:, SUN] += day.direct * (1.0 - scene.foam) * direct
    return parts


class OpticalDepth:
    """Vertical optical depth of attenuation between points of the surface and the receiver."""

    def __init__(self, link: Link) -> None:
        self._unit = frame_of(link).unit
        self._bottom = -only_aperture(link).center[2]
        self._depth = np.linspace(0.0, self._bottom, _LEVELS)
        a, b = link.water.profile(self._depth)
        c = a + b
        if link.bubbles is not None:
            c = c + link.bubbles.b(self._depth)
        step = self._depth[1]
        self._path = np.concatenate([[0.0], np.cumsum(0.5 * step * (c[1:] + c[:-1]))])
        self._top = float(a[0] + b[0])

    def __call__(self, points: Floats) -> Floats:
        """Return the optical depth below points (n, 3) in local coordinates; bubbles below 0."""
        z = self._unit * points[:, 2]
        below = np.interp(np.maximum(-z, 0.0), self._depth, self._path)
        return np.asarray(self._path[-1] - below + self._top * np.maximum(z, 0.0))


def _through_slopes(scene: Scene, view: View, depths: OpticalDepth) -> Floats:
    """Return the mean radiance of the sun through unresolved slopes, over its irradiance, by shift.

    L / E = (1 - rho) n^2 cos(theta_a) cos(theta_w) p(s_r - s_m) cos(b_g)
    / (cos^4(b) (n cos(theta_w) - cos(theta_a))^2 |w . n_g|): the microfacet law of Walter et al.
    (2007) in slopes, along rays drawn uniformly in a cone about the refracted sun.
    """
    day, surface, n = scene.day, scene.surface, scene.n
    axis, _ = refracted_sun(day, n)
    spread = math.hypot(surface.roughness.along, surface.roughness.across)
    spread = math.hypot(spread, float(slopes_of(surface.vertex_normals).std(axis=0).max()))
    lever = 1.0 - day.sun[2] / (n * axis[2])  # turn of the refracted ray by a turn of the normal
    half = min(_REACH * lever * spread / axis[2], math.radians(80.0))
    cos_t = 1.0 - view.uniforms[:, 2] * (1.0 - math.cos(half))
    towards = cone(axis, 1.0 - cos_t**2, view.uniforms[:, 3])
    origins = view.origins()
    hit, _ = first_hits(scene, origins, towards, below=True)
    law, light = Refraction(np.array(day.sun), n), -towards
    facing = np.abs(np.einsum("ij,ij->i", towards, hit.facet_normal))
    wanted = law.normal(light)
    upright = wanted[:, 2] > 1e-6
    slopes = slopes_of(np.where(upright[:, None], wanted, 1.0)) - slopes_of(hit.normal)
    radiance = law.strength(light) * slope_density(slopes, surface.roughness)
    radiance *= hit.facet_normal[:, 2] / np.maximum(facing, 1e-6)
    tau = depths(hit.point) / np.maximum(towards[:, 2], 1e-6)
    seen = radiance * np.exp(-tau) * view.accepted(towards) * (upright & (towards[:, 2] > 0.0))
    solid = 2.0 * math.pi * (1.0 - math.cos(half))
    return solid * seen.reshape(SHIFTS, -1).mean(axis=1) / (math.pi * view.sin2_psi)
