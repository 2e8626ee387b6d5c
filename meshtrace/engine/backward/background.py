"""Background light of a receiver: rays back to sky and sun, over the same mesh as the link.

From a receiver in the air rays follow the mirror direction over up to eight reflections; at each of
them the sun is connected by the density of the slopes that the mesh leaves out (`daylight.upward`),
or, over a mesh that leaves none out, by the points of the mesh that mirror it exactly
(`view.bent_sun`). For a receiver in the water see `submerged`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
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


def seen_from_air(
    case: Case, mesh: TriangleMesh, links: Sequence[Link], days: Sequence[Daylight], photons: int
) -> Floats:
    """Return the radiances of the parts by shift for a receiver in the air.

    At all wavelengths of links that are otherwise alike, (wavelengths, shifts, parts).
    """
    seed = case.run.seed
    view, scene = View.of(links[0], photons, seed), scene_of(case, mesh, links, days)
    parts = follow(scene, view.origins(), view.directions(), view.uniforms[:, 4:], seed)
    parts = parts.reshape(len(links), SHIFTS, -1, len(PARTS)).mean(axis=2)
    if scene.direct.any():
        sun = scene.direct[:, None]
        parts[..., SUN] += sun * sun_in_view(scene, view)
        if not scene.rough:
            law = Reflection(scene.sun, tuple(scene.indices.tolist()))
            glint = scene.at_wavelengths(bent_sun(scene, law, view))
            parts[..., GLINT] += sun * (1.0 - scene.foam) * glint
    if days[0].water == "walk":
        light = walked(case, mesh, links, days, view, in_water=False)
        parts[..., WATER] += light.sum(axis=-1)
    return parts


def sun_in_view(scene: SeenSea, view: View) -> float:
    """Return the mean radiance of the sun's disk within the field of view, over its irradiance."""
    sun = scene.sun
    cosine = float(sun @ view.axis)
    share = view.share_of_disk(sun, math.radians(SUN_RADIUS_DEG))
    if cosine <= 0.0 or share == 0.0:
        return 0.0
    blocked = scene.intersector.intersect([view.center], [sun]).facet[0] >= 0
    return 0.0 if blocked else share * cosine / (math.pi * view.sin2_psi)


def follow(scene: SeenSea, origin: Floats, direction: Floats, u: Floats, seed: int) -> Floats:
    """Return the radiance of each part along rays, without the disk of the sun.

    At the wavelengths, (wavelengths, rays, parts).
    """
    out = np.zeros((len(scene.days), len(origin), len(PARTS)))
    weight, rays = np.ones((len(scene.days), len(origin))), np.arange(len(origin))
    rng = np.random.default_rng((seed, 23))
    sky, diffuse = scene.days[0].replace(diffuse=1.0).sky, [[day.diffuse] for day in scene.days]
    glow = np.array([[day.foam_reflectance * day.irradiance / math.pi] for day in scene.days])
    for bounce in range(_BOUNCES + 1):
        hit, at_sea = first_hits(scene, origin, direction)
        if bounce == _BOUNCES or (bounce > 0 and not scene.second_hits):
            at_sea[:] = False
        free = ~at_sea
        out[:, rays[free], SKY] += weight[:, free] * diffuse * sky_radiance(sky, direction[free])
        if not at_sea.any():
            break
        rays, weight = rays[at_sea], weight[:, at_sea]
        hit, view = Hit(*(v[at_sea] for v in hit)), -direction[at_sea]
        if scene.foam > 0.0:
            out[:, rays, FOAM] += weight * scene.foam * glow
            weight = weight * (1.0 - scene.foam)
        if scene.direct.any() and scene.rough:
            out[:, rays, GLINT] += weight * _glint(scene, hit, view)
        draws = u[rays] if bounce == 0 else rng.random((len(u), 3))[rays]
        rho, mirrored, water = _split(scene, direction[at_sea], hit, draws)
        out[:, rays, WATER] += weight * water
        weight = weight * rho
        origin, direction = hit.point + _OFFSET * hit.facet_normal, mirrored
    return out


def _split(
    scene: SeenSea, direction: Floats, hit: Hit, draws: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return reflectances and light out of the water (wavelengths, rays), mirrored directions."""
    rhos, lights, mirrored = list[Floats](), list[Floats](), np.empty((len(direction), 3))
    for i, n in enumerate(scene.indices.tolist()):
        rho, refracted = np.empty(len(direction)), np.empty((len(direction), 3))
        split_rays(
            direction, hit.normal, hit.facet_normal, draws, scene.surface.roughness, n, rho,
            mirrored, refracted,
        )  # fmt: skip
        rhos.append(rho)
        below = scene.water[i].upwelling(-refracted).T if scene.water else np.zeros(1)
        lights.append(below * ((1.0 - rho) / n**2))
    return scene.at_wavelengths(rhos), mirrored, scene.at_wavelengths(lights)


def _glint(scene: SeenSea, hit: Hit, view: Floats) -> Floats:
    """Return the radiance of the sun mirrored by unresolved slopes (wavelengths, rays).

    Shadows by one ray.
    """
    sun, rough = scene.sun, scene.surface.roughness
    glint = scene.at_wavelengths(
        [connected_glint(view, sun, hit.normal, hit.facet_normal, rough, n) for n in scene.indices]
    )
    lit = np.flatnonzero((glint[0] > 0.0) & (hit.facet_normal @ sun > 0.0))
    start = hit.point[lit] + _OFFSET * hit.facet_normal[lit]
    shadow = scene.intersector.intersect(start, np.broadcast_to(sun, start.shape)).facet >= 0
    seen = np.zeros(len(view), bool)
    seen[lit[~shadow]] = True
    return scene.direct[:, None] * glint * seen


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
    links, days, waves = [case.link], [day], np.zeros(0)
    if wavelengths_nm is not None:
        waves = np.array(checked_wavelengths(wavelengths_nm))
        links = [case.link.at_wavelength(nm) for nm in waves.tolist()]
        days = [day.at_wavelength(nm) for nm in waves.tolist()]
    results = list[Background]()
    for one in backgrounds_over(case, found, links, days, photons):
        link, day = links[len(results)], days[len(results)]
        origin = {**provenance(link, config, run), "daylight": day.model_dump(mode="json")}
        results.append(replace(one, provenance=origin))
    return results[0] if wavelengths_nm is None else ByWavelength(waves, tuple(results))


def backgrounds_over(
    case: Case, mesh: TriangleMesh, links: Sequence[Link], days: Sequence[Daylight], photons: int
) -> list[Background]:
    """Return the backgrounds over a mesh at the wavelengths of links, of checked inputs.

    The links have one receiver and are alike but for their waters and lamps.
    """
    aperture = only_aperture(links[0])
    seen = seen_from_air if aperture.center[2] > 0.0 else seen_from_water
    sin2 = math.sin(math.radians(0.5 * aperture.fov_deg)) ** 2
    found = []
    for by_shift, day in zip(seen(case, mesh, links, days, photons), days, strict=True):
        total = by_shift.sum(axis=1)
        found.append(
            Background(
                part_radiance=by_shift.mean(axis=0),
                part_radiance_stderr=error_of_groups(by_shift),
                radiance=float(total.mean()),
                radiance_stderr=float(error_of_groups(total)),
                acceptance=math.pi**2 * aperture.radius**2 * sin2,
                wavelength_nm=day.wavelength_nm,
            )
        )
    return found
