"""Background light of a receiver: rays back to sky and sun, over the same mesh as the link.

From a receiver in the air rays follow the mirror direction over up to eight reflections; at each of
them the sun is connected by the density of the slopes that the mesh leaves out (`daylight.upward`),
or, over a mesh that leaves none out, by the points of the mesh that mirror it exactly
(`view.bent_sun`). For a receiver in the water see `submerged`.
"""

from __future__ import annotations

import math
from typing import Any, Unpack, overload

import numpy as np
from numpy.typing import ArrayLike

from meshtrace.daylight.light import SUN_RADIUS_DEG, Daylight, sky_radiance
from meshtrace.daylight.upward import connected_glint
from meshtrace.engine.backward.submerged import seen_from_water, walked
from meshtrace.engine.backward.view import (
    FOAM,
    GLINT,
    SKY,
    SUN,
    WATER,
    Hit,
    Reflection,
    SeenSea,
    View,
    bent_sun,
    first_hits,
    only_aperture,
    scene_of,
)
from meshtrace.engine.bvh import EmbreeIntersector
from meshtrace.engine.setup.meshing import mesh_for
from meshtrace.engine.setup.options import Case, HasCase, Meshing, Shortcuts, resolve
from meshtrace.errors import Refused, require_kind, require_whole, require_word
from meshtrace.kernels.interface import split_rays
from meshtrace.link import Link
from meshtrace.mesh import MeshSource, TriangleMesh
from meshtrace.models import Floats
from meshtrace.results.background import PARTS, Background
from meshtrace.results.provenance import provenance
from meshtrace.results.tallies import error_of_groups
from meshtrace.results.wavelengths import ByWavelength, checked_wavelengths
from meshtrace.stored import SHIFTS

_BOUNCES = 8
_OFFSET = 1e-5  # start of a ray above its facet, in units of the frame


def seen_from_air(case: Case, sea: EmbreeIntersector, day: Daylight, photons: int) -> Floats:
    """Return the radiances of the parts by shift (shifts, parts) for a receiver in the air."""
    seed = case.run.seed
    view, scene = View.of(case.link, photons, seed), scene_of(case, sea, day)
    parts = follow(scene, view.origins(), view.directions(), view.uniforms[:, 4:], seed)
    parts = parts.reshape(SHIFTS, -1, len(PARTS)).mean(axis=1)
    if day.direct > 0.0:
        parts[:, SUN] += sun_in_view(scene, view)
        if not scene.rough:
            law = Reflection(np.array(day.sun), scene.n)
            glint = bent_sun(scene, law, view)
            parts[:, GLINT] += day.direct * (1.0 - scene.foam) * glint
    if day.water == "walk":
        light = walked(case, sea, day, view, in_water=False)
        parts[:, WATER] += light.sum(axis=1)
    return parts


def sun_in_view(scene: SeenSea, view: View) -> float:
    """Return the mean radiance of the part of the sun's disk within the field of view."""
    sun = np.array(scene.day.sun)
    cosine = float(sun @ view.axis)
    share = view.share_of_disk(sun, math.radians(SUN_RADIUS_DEG))
    if cosine <= 0.0 or share == 0.0:
        return 0.0
    blocked = scene.intersector.intersect([view.center], [sun]).facet[0] >= 0
    return 0.0 if blocked else share * scene.day.direct * cosine / (math.pi * view.sin2_psi)


def follow(scene: SeenSea, origin: Floats, direction: Floats, u: Floats, seed: int) -> Floats:
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
        if scene.foam > 0.0:
            glow = scene.day.foam_reflectance * scene.day.irradiance / math.pi
            out[rays, FOAM] += weight * scene.foam * glow
            weight = weight * (1.0 - scene.foam)
        if scene.day.direct > 0.0 and scene.rough:
            out[rays, GLINT] += weight * _glint(scene, hit, view)
        draws = u[rays] if bounce == 0 else rng.random((len(u), 3))[rays]
        rho, (mirrored, refracted) = np.empty(len(rays)), np.empty((2, len(rays), 3))
        split_rays(
            direction[at_sea], hit.normal, hit.facet_normal, draws, scene.surface.roughness,
            scene.n, rho, mirrored, refracted,
        )  # fmt: skip
        if scene.water is not None:
            light = scene.water.upwelling(-refracted) / scene.n**2
            out[rays, WATER] += weight * (1.0 - rho) * light
        weight = weight * rho
        origin, direction = hit.point + _OFFSET * hit.facet_normal, mirrored
    return out


def _glint(scene: SeenSea, hit: Hit, view: Floats) -> Floats:
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


@overload
def background(
    link: Link | HasCase,
    surface: MeshSource | TriangleMesh | None = None,
    daylight: Daylight | None = None,
    *,
    wavelengths_nm: None = None,
    **options: Any,
) -> Background: ...


@overload
def background(
    link: Link | HasCase,
    surface: MeshSource | TriangleMesh | None = None,
    daylight: Daylight | None = None,
    *,
    wavelengths_nm: ArrayLike,
    **options: Any,
) -> ByWavelength[Background]: ...


def background(  # type: ignore[misc]
    link: Link | HasCase,
    surface: MeshSource | TriangleMesh | None = None,
    daylight: Daylight | None = None,
    *,
    photons: int = 4096,
    seed: int = 1,
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
    >>> found = background(Link(), FlatSea(), Daylight(direct=1.42, diffuse=0.295))
    >>> f"{found.parts['sky']:.2e}"
    '2.08e-03'
    """
    day = getattr(link, "daylight", None) if daylight is None else daylight
    require_kind(day, Daylight | None, "daylight")
    if day is None:
        raise Refused("daylight", None, "a Daylight")
    require_whole(photons, SHIFTS, 10_000_000, "photons")
    require_whole(seed, 0, 2**64 - 1, "seed")
    if water is not None:
        require_word(water, ("quasi-single", "walk", "none"), "water")
        day = day.replace(water=water)
    case = resolve(link, surface, mesh=mesh, **options)
    found, config = mesh_for(case.link, case.surface, case.meshing)
    run = {"photons": photons, "seed": seed, **case.meshing.model_dump()}
    case = case._replace(run=case.run.replace(seed=seed, threads=threads))
    sea = EmbreeIntersector(found, case.threads)

    def at(link: Link, day: Daylight) -> Background:
        origin = {**provenance(link, config, run), "daylight": day.model_dump(mode="json")}
        return background_over(case._replace(link=link), sea, day, photons, origin)

    if wavelengths_nm is None:
        return at(case.link, day)
    waves = checked_wavelengths(wavelengths_nm)
    results = [at(case.link.at_wavelength(nm), day.at_wavelength(nm)) for nm in waves]
    return ByWavelength(np.array(waves), tuple(results))


def background_over(
    case: Case, sea: EmbreeIntersector, day: Daylight, photons: int, origin: dict[str, Any]
) -> Background:
    """Return the background of the one receiver of a link over a mesh, of checked inputs."""
    aperture = only_aperture(case.link)
    seen = seen_from_air if aperture.center[2] > 0.0 else seen_from_water
    by_shift = seen(case, sea, day, photons)
    total = by_shift.sum(axis=1)
    sin2 = math.sin(math.radians(0.5 * aperture.fov_deg)) ** 2
    return Background(
        part_radiance=by_shift.mean(axis=0),
        part_radiance_stderr=error_of_groups(by_shift),
        radiance=float(total.mean()),
        radiance_stderr=float(error_of_groups(total)),
        acceptance=math.pi**2 * aperture.radius**2 * sin2,
        wavelength_nm=day.wavelength_nm,
        provenance=origin,
    )
