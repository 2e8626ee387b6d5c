"""Background light of a receiver: rays back to sky and sun, over the same mesh as the link.

From a receiver in the air rays follow the mirror direction over up to eight reflections; at each of
them the sun is connected by the density of the slopes that the mesh leaves out (`daylight.upward`),
or, over a mesh that leaves none out, by the points of the mesh that mirror it exactly
(`view.bent_sun`).

Light in the water is that of photons which run backwards from the receiver (`walk`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Unpack, overload

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from meshtrace.checks import Seed, check_call
from meshtrace.daylight.light import SUN_RADIUS_DEG, Daylight, refracted_sun
from meshtrace.daylight.patterns import sky_radiance
from meshtrace.daylight.upward import Refraction, by_slopes, slopes_of
from meshtrace.engine.backward.view import (
    SeenSea,
    View,
    bent_sun,
    cone,
    first_hits,
    view_of,
)
from meshtrace.engine.backward.walk import walked_radiance
from meshtrace.engine.setup.meshing import mesh_for
from meshtrace.engine.setup.options import (
    BackgroundOptions,
    Case,
    HasCase,
    Meshing,
    Shortcuts,
    resolve,
)
from meshtrace.errors import Refused, require_word
from meshtrace.kernels.interface import split_rays
from meshtrace.link import Link
from meshtrace.mesh import MeshSource, TriangleMesh
from meshtrace.models import Floats
from meshtrace.parallel import one_blas_thread
from meshtrace.results.daylight import PARTS, Background
from meshtrace.results.provenance import provenance
from meshtrace.results.series import ByWavelength, checked_wavelengths
from meshtrace.stored import SHIFTS

SKY, GLINT, WATER, FOAM, SUN = range(len(PARTS))
"""Columns of a radiance by parts, as in `PARTS`. GLINT: sun mirrored by the surface.

SUN: seen directly from the air; under water refracted, or scattered there.
"""

_REACH = 6.0  # Radius of the cone sampled about the sun, in standard deviations of the slopes. A
# Gaussian of two components leaves out exp(-6^2 / 2) = 2e-8 of the light; a wider cone holds fewer
# rays that count.


def seen_from_water(sea: SeenSea, view: View) -> Floats:
    """Return the radiances of the parts by shift for a receiver in the water.

    Shape (wavelengths, shifts, pixels, parts) [W m-2 sr-1 nm-1]; a pixel has its share of the mean
    over the field of view. Sunlight that reaches the receiver unscattered crosses the mesh;
    sunlight that is scattered on its way enters through a level surface.
    """
    parts = np.zeros((len(sea.links), SHIFTS, view.pixels, len(PARTS)))
    walked = walked_radiance(sea, view)
    parts[..., SKY], parts[..., SUN] = walked[..., 0], walked[..., 1]
    if not sea.direct.any():
        return parts
    through = []  # at each index, the smallest and the largest: radiance over irradiance [sr-1]
    for n in sea.indices.tolist():
        law = Refraction(sea.sun, n)
        # random slopes bend the sun to the receiver everywhere, a mesh alone at separate points
        refract_sun = _through_slopes if sea.rough else bent_sun
        through.append(refract_sun(sea, law, view).reshape(len(parts), -1))
    # irradiance across the sun's beam [W m-2 nm-1], times the share of the sea that is free of foam
    sun = sea.direct[:, None] * (1.0 - sea.foam) * sea.at_wavelengths(through)
    parts[..., SUN] += sun.reshape(parts.shape[:-1])
    return parts


def _through_slopes(sea: SeenSea, law: Refraction, view: View) -> Floats:
    """Return the mean radiance of the sun through unresolved slopes, over its irradiance [sr-1].

    Shape (wavelengths, shifts, pixels); the irradiance E is that across the sun's beam in the air.

    L / E = (1 - rho) n^2 cos(theta_a) cos(theta_w) p(s_r - s_m) cos(b_g)
    / (cos^4(b) (n cos(theta_w) - cos(theta_a))^2 |w . n_g|): the microfacet law of Walter et al.
    (2007) in slopes, along rays drawn uniformly in a cone about the refracted sun. theta are angles
    to the normal that refracts the sun into a ray w, in air and water, b its angle to the vertical;
    p is the density of the random slopes, s_r the slope that is needed, s_m that of the mesh, n_g
    and b_g normal and inclination of the facet.
    """
    surface, n = sea.surface, law.n
    axis, _ = refracted_sun(sea.days[0], n)  # to the sun, as seen below still water
    # Variances of random slopes and of those of the mesh add. The cone is round: it takes the sum
    # over both random components, and the larger component of the mesh.
    spread = math.hypot(surface.roughness.along, surface.roughness.across)
    spread = math.hypot(spread, float(slopes_of(surface.vertex_normals).std(axis=0).max()))
    # turn of the refracted ray by a turn of the normal: Snell's law, sin(theta_a) = n sin(theta_w),
    # gives 1 - d theta_w / d theta_a
    lever = 1.0 - law.sun[2] / (n * axis[2])
    # tuned: wider for a slanted sun, within the hemisphere; a wider cone costs rays, not bias
    half_angle = min(_REACH * lever * spread / axis[2], math.radians(80.0))
    cone_size = 1.0 - math.cos(half_angle)  # its solid angle over 2 pi

    def mean(rays: View) -> Floats:
        # uniform over the solid angle of the cone: the cosine is uniform
        cos_t = 1.0 - rays.uniforms[:, 2] * cone_size
        towards = cone(axis, 1.0 - cos_t**2, rays.uniforms[:, 3])
        point, facet_normal, normal, _ = first_hits(sea, rays.origins(), towards)
        # Light travels against `towards`. Slopes take the normal that points up, the area seen
        # takes that of the facet's lower side.
        radiance = by_slopes(law, -towards, normal, -facet_normal, surface.roughness)
        # rays at or below the horizontal are masked below: 1e-6 only spares a division by 0
        tau = sea.optical_depths(point) / np.maximum(towards[:, 2], 1e-6)
        # `accepted` is the cosine at the aperture, 0 outside of the field of view
        seen = radiance * np.exp(-tau) * rays.accepted(towards) * (towards[:, 2] > 0.0)
        return rays.means(seen, towards)

    means = np.concatenate([mean(rays) for rays in view.blocks()], axis=1)
    # Mean radiance = int L cos dOmega / (pi sin^2 psi), psi half the field of view: the integral is
    # the mean over the rays, times the solid angle of their cone, 2 pi (1 - cos).
    return np.asarray(2.0 * cone_size / view.sin2_psi * means)


_BOUNCES = 8  # reflections of a ray that are followed; of light at near-normal incidence, with a
# reflectance of 0.02, 0.02^8 is left
_OFFSET = 1e-5  # start of a ray above its facet, in local units: Embree's single precision rounds
# coordinates of 100 by about as much


def seen_from_air(sea: SeenSea, view: View) -> Floats:
    """Return the radiances of the parts by shift for a receiver in the air.

    Shape (wavelengths, shifts, pixels, parts) [W m-2 sr-1 nm-1], as in `seen_from_water`.
    """
    parts = np.concatenate([_follow(sea, rays) for rays in view.blocks()], axis=1)
    if sea.direct.any():
        sun = sea.direct[:, None, None]
        # the disk of the sun counts for the pixel of its centre
        pixel = int(view.pixels_of(sea.sun[None])[0])
        parts[:, :, pixel, SUN] += sea.direct[:, None] * _sun_in_view(sea, view)
        # with random slopes `_follow` has connected the sun at each reflection
        if not sea.rough:
            bent = bent_sun(sea, sea.mirror, view)
            glint = sea.at_wavelengths(bent.reshape(len(bent), -1))
            parts[..., GLINT] += sun * (1.0 - sea.foam) * glint.reshape(parts.shape[:-1])
    if sea.days[0].water == "walk":
        parts[..., WATER] += walked_radiance(sea, view).sum(axis=-1)
    return parts


def _sun_in_view(sea: SeenSea, view: View) -> float:
    """Return the mean radiance of the sun's disk in the field of view, over its irradiance [sr-1].

    The disk has a radius of a quarter of a degree.
    """
    sun = sea.sun
    cosine = float(sun @ view.axis)
    share = view.share_of_disk(sun, math.radians(SUN_RADIUS_DEG))
    if cosine <= 0.0 or share == 0.0:
        return 0.0
    # one ray: a wave in front of the sun hides all of its small disk, or nothing
    blocked = sea.intersector.intersect([view.center], [sun]).facet[0] >= 0
    # int L cos dOmega = E share cos, over the etendue per area, pi sin^2(psi)
    return 0.0 if blocked else share * cosine / (math.pi * view.sin2_psi)


def _follow(sea: SeenSea, view: View) -> Floats:
    """Return the mean radiance of each part along the rays of a view, without the sun's disk.

    Shape (wavelengths, shifts, pixels, parts).
    """
    # columns 0 to 3 of the uniforms give the rays, the last three the random slope of a first hit
    origin, towards, u = view.origins(), view.directions(), view.uniforms[:, 4:]
    direction = towards
    out = np.zeros((len(sea.days), len(origin), len(PARTS)))
    # `weight` is the product of the reflectances so far, for the rays that are still under way
    weight, rays = np.ones((len(sea.days), len(origin))), np.arange(len(origin))
    # sky of unit irradiance, the same pattern at all wavelengths
    sky, diffuse = sea.days[0].replace(diffuse=1.0).sky, [[day.diffuse] for day in sea.days]
    # foam reflects all irradiance evenly: radiance E R / pi
    foam_radiance = np.array(
        [[day.foam_reflectance * day.irradiance / math.pi] for day in sea.days]
    )
    # what is left after the last reflection sees the sky: no light is lost
    last = _BOUNCES if sea.links[0].physics.second_hit == "trace" else 1
    for bounce in range(last + 1):
        *hits, at_sea = first_hits(sea, origin, direction)
        if bounce == last:
            at_sea[:] = False
        free = ~at_sea
        out[:, rays[free], SKY] += weight[:, free] * diffuse * sky_radiance(sky, direction[free])
        if not at_sea.any():
            break
        rays, weight = rays[at_sea], weight[:, at_sea]
        point, facet_normal, normal = (values[at_sea] for values in hits)
        direction = direction[at_sea]
        if sea.foam > 0.0:
            out[:, rays, FOAM] += weight * sea.foam * foam_radiance
            weight = weight * (1.0 - sea.foam)
        if sea.direct.any() and sea.rough:
            glint = _glint(sea, point, facet_normal, normal, -direction)
            out[:, rays, GLINT] += weight * glint
        # the first tilt is a part of the quasi-random points, later ones, which matter less, random
        if bounce > 0:
            u = view.later_tilts(bounce, sea.case.run.seed)
        rho, direction, water = _split(sea, direction, facet_normal, normal, u[rays])
        # the ray goes on as mirrored light; the transmitted part meets light out of the water
        out[:, rays, WATER] += weight * water
        weight = weight * rho
        origin = point + _OFFSET * facet_normal
    return np.moveaxis(view.means(np.moveaxis(out, -1, 1), towards), 1, -1)


def _split(
    sea: SeenSea, direction: Floats, facet_normal: Floats, normal: Floats, draws: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return (reflectances, mirrored directions, radiance out of the water) of rays.

    Shapes (wavelengths, rays), (rays, 3), (wavelengths, rays). `draws` (rays, 3) are uniforms of
    the random slopes.
    """
    rhos, leaving, mirrored = list[Floats](), list[Floats](), np.empty((len(direction), 3))
    # the same draws for both indices: reflected directions depend on the normal alone
    for i, n in enumerate(sea.indices.tolist()):
        rho, refracted = np.empty(len(direction)), np.empty((len(direction), 3))
        split_rays(
            direction, normal, facet_normal, draws, sea.surface.roughness, n, rho, mirrored,
            refracted,
        )  # fmt: skip
        rhos.append(rho)
        below = sea.water[i].upwelling(-refracted).T if sea.water else np.zeros(1)
        # radiance over the squared index does not change at the surface
        leaving.append(below * ((1.0 - rho) / n**2))
    return sea.at_wavelengths(rhos), mirrored, sea.at_wavelengths(leaving)


def _glint(
    sea: SeenSea, point: Floats, facet_normal: Floats, normal: Floats, back: Floats
) -> Floats:
    """Return the radiance of the sun mirrored by unresolved slopes (wavelengths, rays).

    `back` (rays, 3) are unit vectors from the points along the rays that arrived. One ray to the
    center of the sun tells whether a wave hides it.
    """
    sun = sea.sun
    glint = sea.at_wavelengths(
        by_slopes(sea.mirror, back, normal, facet_normal, sea.surface.roughness)
    )
    # Only points that would shine cast a ray to the sun; the density of slopes, which makes them
    # dark, is the same at all wavelengths.
    bright = np.flatnonzero((glint[0] > 0.0) & (facet_normal @ sun > 0.0))
    start = point[bright] + _OFFSET * facet_normal[bright]
    shadow = sea.intersector.intersect(start, np.broadcast_to(sun, start.shape)).facet >= 0
    seen = np.zeros(len(back), bool)
    seen[bright[~shadow]] = True
    return sea.direct[:, None] * glint * seen


@overload
def background(
    link: Link | HasCase,
    surface: MeshSource | TriangleMesh | None = None,
    daylight: Daylight | None = None,
    *,
    wavelengths_nm: None = None,
    **options: Unpack[BackgroundOptions],
) -> Background: ...


@overload
def background(
    link: Link | HasCase,
    surface: MeshSource | TriangleMesh | None = None,
    daylight: Daylight | None = None,
    *,
    wavelengths_nm: ArrayLike,
    **options: Unpack[BackgroundOptions],
) -> ByWavelength[Background]: ...


@check_call
def background(
    link: Link | HasCase,
    surface: MeshSource | TriangleMesh | None = None,
    daylight: Daylight | None = None,
    *,
    photons: Annotated[int, Field(ge=SHIFTS, le=10_000_000)] = 4096,
    seed: Seed = 1,
    water: str | None = None,
    wavelengths_nm: ArrayLike | None = None,
    mesh: Meshing | None = None,
    threads: int | None = None,
    **options: Unpack[Shortcuts],
) -> Background | ByWavelength[Background]:
    """Return the background light of the receiver of a link.

    Parameters
    ----------
    link : Link or Scenario
        The link, with one receiver.
    surface : MeshSource or TriangleMesh, optional
        The sea, as in `simulate`.
    daylight : Daylight, optional
        Light above the sea; by default that of a scenario.
    photons : int
        Rays from the receiver, 32 ... 10 000 000.
    seed : int
        Key of the random numbers.
    water : {"quasi-single", "walk", "none"}, optional
        Light out of the water, by default `daylight.water`.
    wavelengths_nm : array_like, optional
        Wavelengths [nm], in place of that of the sources: a background for each, of the same rays
        from the receiver over one mesh, under the light of the same model
        (`Daylight.at_wavelength`).
    mesh : Meshing, optional
        Time and resolution of the surface.
    threads : int, optional
        Threads, all cores by default; the result does not depend on them.
    **options
        Fields of `Meshing`.

    Returns
    -------
    Background, or ByWavelength of them

    Raises
    ------
    Refused
        If an option is out of range, the link has several receivers, or water or light are known at
        one wavelength alone.

    Notes
    -----
    Not modelled: Raman scattering, fluorescence, polarised skylight. Beyond the mesh the sea is
    level.

    Examples
    --------
    >>> from meshtrace.surfaces import FlatSea
    >>> result = background(Link(), FlatSea(), Daylight(direct=1.42, diffuse=0.295))
    >>> f"{result.parts['sky']:.2e}"
    '2.08e-03'
    """
    day = getattr(link, "daylight", None) if daylight is None else daylight
    if day is None:
        raise Refused("daylight", None, "a Daylight")
    if water is not None:
        require_word(water, ("quasi-single", "walk", "none"), "water")
        day = day.replace(water=water)
    case = resolve(link, surface, mesh=mesh, **options)
    run = {"photons": photons, "seed": seed} | case.meshing.model_dump()
    case = case._replace(run=case.run.replace(seed=seed, threads=threads))
    links, days, waves = [case.link], [day], np.zeros(0)
    if wavelengths_nm is not None:
        waves = np.array(checked_wavelengths(wavelengths_nm))
        links = [case.link.at_wavelength(nm) for nm in waves.tolist()]
        days = [day.at_wavelength(nm) for nm in waves.tolist()]
    with one_blas_thread():
        sea_mesh, config = mesh_for(case.link, case.surface, case.meshing)
        backgrounds = backgrounds_over(case, sea_mesh, links, days, photons)
    results = list[Background]()
    for result, at, light_model in zip(backgrounds, links, days, strict=True):
        origin = provenance(at, config, run) | {"daylight": light_model.model_dump(mode="json")}
        results.append(replace(result, provenance=origin))
    return results[0] if wavelengths_nm is None else ByWavelength(waves, tuple(results))


def backgrounds_over(
    case: Case, mesh: TriangleMesh, links: Sequence[Link], days: Sequence[Daylight], photons: int
) -> list[Background]:
    """Return the backgrounds over a mesh at the wavelengths of links, of checked inputs.

    The links have one receiver and differ in their waters and lamps alone.
    """
    links[0].require_no_bodies("none: bodies hide and reflect no daylight here")
    sea, view = SeenSea(case, mesh, links, days), view_of(links[0], photons, case.run.seed)
    radiances = (seen_from_water if sea.in_water else seen_from_air)(sea, view)
    # etendue A pi sin^2(psi) [m2 sr], which turns mean radiance into power
    acceptance = math.pi**2 * view.aperture.radius**2 * view.sin2_psi
    return [
        Background.of_groups(parts, acceptance, day.wavelength_nm)
        for parts, day in zip(radiances, days, strict=True)
    ]
