"""Daylight at a receiver in the water: sky by photons traced backwards, sun through the sea.

The analog engine runs backwards: photons from a receiver to the sky, connected to the sun. Radiance
over the squared index is kept along a ray, whatever the mesh: the mean score of photons that start
by the cosine law inside the field of view is the mean radiance of the sky that they meet, times the
squared index at the receiver. Sunlight is added at each collision in the water, through still
water. Under water its disk has a radius of 3 degrees, which bounds the phase function and leaves
fluxes unchanged. For a receiver in the air light scattered by less than 10 degrees stays in the
sun's beam: the rare paths that are scattered back and then end near the sun would carry most of the
error.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache, partial

import numpy as np

from meshtrace.daylight.light import Daylight
from meshtrace.daylight.upward import slope_density, slopes_of
from meshtrace.engine.backward.view import (
    SKY,
    SUN,
    Refraction,
    SeenSea,
    View,
    bent_sun,
    cone,
    first_hits,
    only_aperture,
    scene_of,
)
from meshtrace.engine.bvh import EmbreeIntersector
from meshtrace.engine.photons.analog import chunk_tallies, setup_of
from meshtrace.engine.setup.arrays import frame_of
from meshtrace.engine.setup.options import Analog, Case
from meshtrace.errors import Refused
from meshtrace.kernels.sources import Backward
from meshtrace.kernels.vectors import Vec3
from meshtrace.link import Link
from meshtrace.models import Floats
from meshtrace.optics.fresnel import fresnel_reflectance
from meshtrace.optics.phase import PhaseFunction
from meshtrace.parallel import ordered_map
from meshtrace.results.background import PARTS
from meshtrace.stored import SHIFTS

_REACH = 6.0  # standard deviations of the slopes, to which the cone about the sun is sampled
_LEVELS = 4000  # of the optical depth
_BLUR = math.radians(3.0)
_ANGLES = 1024
_RINGS = 2000
_FORWARD = math.radians(10.0)
_WIDE = np.linspace(0.0, math.pi, _ANGLES) > _FORWARD


def seen_from_water(case: Case, sea: EmbreeIntersector, day: Daylight, photons: int) -> Floats:
    """Return the radiances of the parts by shift (shifts, parts) for a receiver in the water.

    Sun that reaches the receiver unscattered passes the mesh; scattered sunlight passes still
    water before it.
    """
    view = View.of(case.link, photons, case.run.seed)
    parts = np.zeros((SHIFTS, len(PARTS)))
    light = walked(case, sea, day, view, in_water=True)
    parts[:, SKY], parts[:, SUN] = light[:, 0], light[:, 1]
    if day.direct == 0.0:
        return parts
    scene, depths = scene_of(case, sea, day), optical_depth(case.link)
    if scene.rough:
        direct = _through_slopes(scene, view, depths)
    else:
        law = Refraction(np.array(day.sun), scene.n)
        direct = bent_sun(scene, law, view, depths)
    parts[:, SUN] += day.direct * (1.0 - scene.foam) * direct
    return parts


def optical_depth(link: Link) -> Callable[[Floats], Floats]:
    """Return the vertical optical depth of attenuation from points of the surface to the receiver.

    A function of points (n, 3) in local coordinates; above still water there are no bubbles.
    """
    unit = frame_of(link).unit
    depth = np.linspace(0.0, -only_aperture(link).center[2], _LEVELS)
    a, b = link.water.profile(depth)
    c = a + b
    if link.bubbles is not None:
        c = c + link.bubbles.b(depth)
    path = np.concatenate([[0.0], np.cumsum(0.5 * depth[1] * (c[1:] + c[:-1]))])
    top = float(a[0] + b[0])

    def below(points: Floats) -> Floats:
        z = unit * points[:, 2]
        above = np.interp(np.maximum(-z, 0.0), depth, path)
        return np.asarray(path[-1] - above + top * np.maximum(z, 0.0))

    return below


def _through_slopes(scene: SeenSea, view: View, depths: Callable[[Floats], Floats]) -> Floats:
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


def walked(
    case: Case, sea: EmbreeIntersector, day: Daylight, view: View, *, in_water: bool
) -> Floats:
    """Return the radiance of sky and of scattered sun at a receiver by shift (shifts, 2).

    From the air only light that has been in the water counts.

    Raises
    ------
    Refused
        If the water absorbs otherwise than along the way, or the forms are those of the paper.
    """
    link, threads = case.link, case.threads
    for name, kept in (("absorption", "continuous"), ("snell", "physical")):
        form = getattr(link.physics, name)
        if form != kept:
            raise Refused(f"physics.{name}", form, f"{kept}, for light that is traced backwards")
    n = link.water.n / link.n_air
    bare = link.model_copy(update={"receiver": (), "planes": None})
    options = Analog(roulette=1e-3, max_surface_events=100)
    setup = setup_of(
        bare, sea, options, case.run.seed, case.meshing.normals, frame=frame_of(link)
    )  # fmt: skip
    sun, irradiance = refracted_sun(day, n)
    world, foam = setup.world, setup.world.interface.foam_transmittance
    bubbles = link.bubbles.phase_function() if link.bubbles else link.water.phase
    back = Backward(
        origin=view.origins(),
        direction=view.directions(),
        in_water=in_water,
        after_water=not in_water,
        sky=day.sky,
        sun=Vec3(*sun.tolist()),
        irradiance=foam * irradiance if world.medium.b_max > 0.0 else 0.0,
        kept=1.0 if in_water else 1.0 - float(link.water.phase.cdf(_FORWARD)),
        phase_water=blurred_phase(link.water.phase) * (in_water | _WIDE),
        phase_bubble=blurred_phase(bubbles) * (in_water | _WIDE),
    )
    rays, step = len(view.uniforms), options.batch_size
    spans = [(i, min(i + step, rays)) for i in range(0, rays, step)]
    setup = setup._replace(world=world._replace(back=back))
    done = ordered_map(partial(chunk_tallies, setup), spans, threads)
    scores = np.concatenate([tallies.score for _, tallies in done])
    by_shift = scores.reshape(SHIFTS, -1, 2).mean(axis=1)
    return by_shift * ((n**2, 1.0) if in_water else (1.0, 1.0 / n**2))


def refracted_sun(day: Daylight, n: float) -> tuple[Floats, float]:
    """Return the direction to the sun under still water, and its irradiance across it."""
    sun = np.array(day.sun)
    inside = sun / n
    inside[2] = math.sqrt(1.0 - inside[0] ** 2 - inside[1] ** 2)
    through = 1.0 - float(fresnel_reflectance(sun[2], 1.0, n))
    return inside, day.direct * through * float(sun[2] / inside[2])


@lru_cache(maxsize=8)
def blurred_phase(phase: PhaseFunction) -> Floats:
    """Return a phase function, averaged over a disk, at equal steps of the angle from 0 to pi.

    Rings of the phase function are weighted by the part of them that lies in the disk: the peak at
    small angles counts by its probability.
    """
    small = np.geomspace(1e-6, _BLUR, _RINGS)
    ring = np.concatenate([[0.0], small, np.linspace(_BLUR, math.pi, 2 * _RINGS)[1:]])
    share = np.diff(phase.cdf(ring))
    middle = 0.5 * (ring[1:] + ring[:-1])
    center = np.linspace(0.0, math.pi, _ANGLES)[:, None]
    sines = np.maximum(np.sin(middle) * np.sin(center), 1e-15)
    cosine = (math.cos(_BLUR) - np.cos(middle) * np.cos(center)) / sines
    inside = np.arccos(np.clip(cosine, -1.0, 1.0)) / math.pi
    return np.asarray(inside @ share) / (2.0 * math.pi * (1.0 - math.cos(_BLUR)))
