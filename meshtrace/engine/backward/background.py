"""Background light of a receiver: rays back to sky and sun, over the same mesh as the link.

From a receiver in the air rays follow the mirror direction over up to eight reflections; at each of
them the sun is connected by the density of the slopes that the mesh leaves out (`daylight.upward`),
or, over a mesh that leaves none out, by the points of the mesh that mirror it exactly
(`view.bent_sun`).

For light in the water the analog engine runs backwards: photons from a receiver to the sky,
connected to the sun. Radiance over the squared index is kept along a ray, whatever the mesh: the
mean score of photons that start by the cosine law inside the field of view is the mean radiance of
the sky that they meet, times the squared index at the receiver. Sunlight is added at each collision
in the water, through still water. Under water its disk has a radius of 3 degrees, which bounds the
phase function and leaves fluxes unchanged. For a receiver in the air light scattered by less than
10 degrees stays in the sun's beam: the rare paths that are scattered back and then end near the sun
would carry most of the error.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache, lru_cache, partial
from typing import Annotated, Any, NamedTuple, Unpack, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from meshtrace.checks import Seed, check_call
from meshtrace.daylight.light import SUN_RADIUS_DEG, Daylight, refracted_sun
from meshtrace.daylight.patterns import sky_radiance
from meshtrace.daylight.upward import Refraction, by_slopes, slopes_of
from meshtrace.engine.backward.view import (
    Depth,
    Hit,
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
from meshtrace.engine.setup.meshing import mesh_for
from meshtrace.engine.setup.options import (
    Analog,
    BackgroundOptions,
    Case,
    HasCase,
    Meshing,
    Shortcuts,
    resolve,
)
from meshtrace.engine.setup.tinting import CommonPaths, photon_paths
from meshtrace.errors import Refused, require_word
from meshtrace.kernels.interface import split_rays
from meshtrace.kernels.sources import BUBBLE_SCORE, SKY_SCORE, SUN_SCORE, Backward
from meshtrace.kernels.tally import Tallies
from meshtrace.kernels.tints import NO_TINTS, LastScattering, Tints, add_tinted, factors_of
from meshtrace.kernels.vectors import Vec3
from meshtrace.link import Link
from meshtrace.mesh import MeshSource, TriangleMesh
from meshtrace.models import Floats
from meshtrace.optics.phase import PhaseFunction
from meshtrace.parallel import one_blas_thread, ordered_map
from meshtrace.results.daylight import PARTS, Background
from meshtrace.results.provenance import provenance
from meshtrace.results.series import ByWavelength, checked_wavelengths
from meshtrace.stored import SHIFTS

SKY, GLINT, WATER, FOAM, SUN = range(len(PARTS))

_REACH = 6.0  # standard deviations of the slopes, to which the cone about the sun is sampled
_ARRIVALS = 64  # room for the light of a photon
_LEVELS = 4000  # of the optical depth
_BLUR = math.radians(3.0)
_ANGLES = 1024
_RINGS = 2000
_FORWARD = math.radians(10.0)
_WIDE = np.linspace(0.0, math.pi, _ANGLES) > _FORWARD


def seen_from_water(
    case: Case, mesh: TriangleMesh, links: Sequence[Link], days: Sequence[Daylight], photons: int
) -> Floats:
    """Return the radiances of the parts by shift for a receiver in the water.

    At the wavelengths of links (wavelengths, shifts, parts). Sun that reaches the receiver
    unscattered passes the mesh; scattered sunlight passes still water before it.
    """
    view = View.of(links[0], photons, case.run.seed)
    parts = np.zeros((len(links), SHIFTS, len(PARTS)))
    light = walked(case, mesh, links, days, view, in_water=True)
    parts[..., SKY], parts[..., SUN] = light[..., 0], light[..., 1]
    scene = scene_of(case, mesh, links, days)
    if not scene.direct.any():
        return parts
    depths = [optical_depth(link) for link in links]
    through = []
    for n in scene.indices.tolist():
        law = Refraction(scene.sun, n)
        direct = _through_slopes if scene.rough else bent_sun
        through.append(direct(scene, law, view, depths))
    sun = scene.direct[:, None] * (1.0 - scene.foam)
    parts[..., SUN] += sun * scene.at_wavelengths(through)
    return parts


def optical_depth(link: Link) -> Depth:
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


def _through_slopes(scene: SeenSea, law: Refraction, view: View, depths: Sequence[Depth]) -> Floats:
    """Return the mean radiance of the sun through unresolved slopes (wavelengths, shifts).

    Over its irradiance.

    L / E = (1 - rho) n^2 cos(theta_a) cos(theta_w) p(s_r - s_m) cos(b_g)
    / (cos^4(b) (n cos(theta_w) - cos(theta_a))^2 |w . n_g|): the microfacet law of Walter et al.
    (2007) in slopes, along rays drawn uniformly in a cone about the refracted sun.
    """
    surface, n = scene.surface, law.n
    axis, _ = refracted_sun(scene.days[0], n)
    spread = math.hypot(surface.roughness.along, surface.roughness.across)
    spread = math.hypot(spread, float(slopes_of(surface.vertex_normals).std(axis=0).max()))
    lever = 1.0 - law.sun[2] / (n * axis[2])  # turn of the refracted ray by a turn of the normal
    half = min(_REACH * lever * spread / axis[2], math.radians(80.0))
    off = 1.0 - math.cos(half)

    def mean(rays: View) -> Floats:
        cos_t = 1.0 - rays.uniforms[:, 2] * off
        towards = cone(axis, 1.0 - cos_t**2, rays.uniforms[:, 3])
        hit, _ = first_hits(scene, rays.origins(), towards, below=True)
        light = by_slopes(law, -towards, hit.normal, -hit.facet_normal, surface.roughness)
        tau = np.array([depth(hit.point) for depth in depths]) / np.maximum(towards[:, 2], 1e-6)
        seen = light * np.exp(-tau) * rays.accepted(towards) * (towards[:, 2] > 0.0)
        return np.asarray(seen.reshape(len(depths), -1, rays.per_shift).mean(axis=2))

    means = np.concatenate([mean(rays) for rays in view.blocks()], axis=1)
    return np.asarray(2.0 * off / view.sin2_psi * means)


def walked(
    case: Case, mesh: TriangleMesh, links: Sequence[Link], days: Sequence[Daylight], view: View,
    *, in_water: bool,
) -> Floats:  # fmt: skip
    """Return the radiance of sky and of scattered sun at a receiver (wavelengths, shifts, 2).

    From the air only light that has been in the water counts.

    Raises
    ------
    Refused
        If the water absorbs otherwise than along the way, or the forms are those of the paper.
    """
    for name, kept in (("absorption", "continuous"), ("snell", "physical")):
        form = getattr(links[0].physics, name)
        if form != kept:
            raise Refused(f"physics.{name}", form, f"{kept}, for light that is traced backwards")
    found = np.zeros((len(links), SHIFTS, 2))
    waiting = list(range(len(links)))
    while waiting:
        _, common = photon_paths(links, waiting)
        rows = common.rows
        some, lit = [links[i] for i in rows], [days[i] for i in rows]
        walk = _Walk(case, mesh, view, in_water)
        found[rows] = (
            walk.alone(some[0], lit[0]) if len(rows) == 1 else walk.light(some, lit, common)
        )
        waiting = [i for i in waiting if i not in rows]
    return found


class _Walk(NamedTuple):
    """Photons from a receiver to sky and sun."""

    case: Case
    mesh: TriangleMesh
    view: View
    in_water: bool

    def alone(self, link: Link, day: Daylight) -> Floats:
        """Return the radiance of sky and of scattered sun at one wavelength (1, shifts, 2)."""
        rays = np.arange(len(self.view.uniforms))
        scores = np.concatenate([one.score for one in self._tallies(link, day, rays, NO_TINTS)])
        sky, sun = scores[:, SKY_SCORE], scores[:, SUN_SCORE] + scores[:, BUBBLE_SCORE]
        by_shift = np.stack([sky, sun], axis=1).reshape(1, SHIFTS, -1, 2).mean(axis=2)
        return by_shift * self._squared_index(link)

    def light(self, links: Sequence[Link], days: Sequence[Daylight], common: CommonPaths) -> Floats:
        """Return the radiances at the wavelengths of common photons (wavelengths, shifts, 2).

        Photons are those of several bases in turn, and of the smallest and the largest index, as in
        `engine.correlated.analog_sums`.
        """
        tinting = common.tinting
        assert tinting is not None
        several = [links[i] for i in tinting.bases] or [common.bases[0]]
        per_shift = self.view.per_shift
        runs = [(base, end) for base in range(len(several)) for end in range(len(common.bases))]
        turn = np.arange(per_shift) * len(runs) // per_shift  # a part of a net is one, too
        numbers = np.bincount(turn, minlength=len(runs)).reshape(len(several), -1)
        found, factors = np.zeros((len(links), SHIFTS, 2)), factors_of(len(links))
        none = np.zeros((2, len(links)))
        even = days[0].replace(direct=1.0 if any(day.direct for day in days) else 0.0, diffuse=1.0)
        for k, (base, end) in enumerate(runs):
            link = several[base].replace("water.n", common.bases[end].water.n)
            rays = np.flatnonzero(np.tile(turn == k, SHIFTS))
            shifts = rays // per_shift
            of_end = numbers[:, end] / numbers[:, end].sum()
            part = common.shares if end else 1.0 - common.shares
            scale = part * per_shift / numbers[:, end].sum() if len(common.bases) > 1 else 1.0
            sun, _ = refracted_sun(even, link.water.n / link.n_air)
            unlit = LastScattering(1.0, none, none + 1.0)  # light of the sky has no last scattering
            slant = float(sun[2])
            sunlit = [_sunlit(link, links, slant, self.in_water, of) for of in (False, True)]
            run, mixture = np.zeros((3, SHIFTS, len(links))), tinting.mixture(base, of_end.copy())
            for tallies in self._tallies(link, even, rays, tinting.tints):
                rows = tallies.arrivals[: int(tallies.n_arrivals[0])]
                for score, last in enumerate((unlit, *sunlit)):
                    add_tinted(rows, score, shifts, mixture, last, factors, run[score])
            by_light = np.stack([run[SKY_SCORE], run[SUN_SCORE] + run[BUBBLE_SCORE]])
            run = by_light.transpose(2, 1, 0) / per_shift
            run *= self._squared_index(link)
            found += run * np.broadcast_to(scale, len(links))[:, None, None]
        lit = np.array([(day.diffuse, day.direct) for day in days])
        return found * lit[:, None]

    def _squared_index(self, link: Link) -> tuple[float, float]:
        n = link.water.n / link.n_air
        return (n**2, 1.0) if self.in_water else (1.0, 1.0 / n**2)

    def _tallies(
        self, link: Link, day: Daylight, rays: NDArray[np.int64], tints: Tints | None
    ) -> Iterator[Tallies]:
        """Return the tallies of chunks of photons that start as some rays of the view."""
        case, in_water = self.case, self.in_water
        bare = link.model_copy(update={"receiver": (), "planes": None})
        options, frame = Analog(roulette=1e-3, max_surface_events=100), frame_of(link)
        over = EmbreeIntersector(self.mesh, case.threads)
        setup = setup_of(
            bare, over, options, case.run.seed, case.meshing.normals, frame=frame
        )  # fmt: skip
        sun, irradiance = refracted_sun(day, link.water.n / link.n_air)
        world, foam = setup.world, setup.world.interface.foam_transmittance
        bubbles = link.bubbles.phase_function() if link.bubbles else link.water.phase
        back = Backward(
            origin=self.view.origins()[rays],
            direction=self.view.directions()[rays],
            in_water=in_water,
            after_water=not in_water,
            sky=day.sky,
            sun=Vec3(*sun.tolist()),
            irradiance=foam * irradiance if world.medium.b_max > 0.0 else 0.0,
            lost_water=_lost(link.water.phase, in_water),
            lost_bubble=_lost(bubbles, in_water),
            phase_water=blurred_phase(link.water.phase) * (in_water | _WIDE),
            phase_bubble=blurred_phase(bubbles) * (in_water | _WIDE),
        )
        starts = range(0, len(rays), options.batch_size)
        spans = [(i, min(i + options.batch_size, len(rays))) for i in starts]
        kept = 0 if tints is None else _ARRIVALS
        setup = setup._replace(world=world._replace(back=back, tints=tints), arrivals=kept)
        for _, tallies in ordered_map(partial(chunk_tallies, setup), spans, case.threads):
            tallies.arrivals["water"] /= frame.unit  # angles
            yield tallies


def _lost(phase: PhaseFunction, in_water: bool) -> float:
    """Return the share of the scattering that takes light out of the sun's beam."""
    return 1.0 if in_water else 1.0 - float(phase.cdf(_FORWARD))


def _sunlit(
    base: Link, links: Sequence[Link], slant: float, in_water: bool, by_bubbles: bool
) -> LastScattering:
    """Return the ratio of the scattering of sunlight into a path at wavelengths to the base's.

    b_c p_c(theta) / (b p(theta)) exp(-(tau_c - tau) / slant), tau the optical depth below still
    water; without b for bubbles, which are alike in number.
    """
    layers = [link.water.layers[-1][0] for link in (base, *links) if link.water.layers]
    grid = np.linspace(0.0, max(layers), _LEVELS) if layers else np.array([0.0, 1.0])
    logs, phases = [], []
    for link in (base, *links):
        a, b = (np.broadcast_to(x, grid.shape) for x in link.water.profile(grid))
        lost = a + _lost(link.water.phase, in_water) * b
        path = np.concatenate([[0.0], np.cumsum(0.5 * grid[1] * (lost[1:] + lost[:-1]))])
        logs.append(-path / slant + (0.0 if by_bubbles else np.log(np.maximum(b, 1e-300))))
        phase = link.bubbles.phase_function() if by_bubbles and link.bubbles else link.water.phase
        phases.append(blurred_phase(phase))
    log = np.array(logs[1:]).T - logs[0][:, None]
    ratio = np.array(phases[1:]).T / np.maximum(phases[0], 1e-300)[:, None]
    return LastScattering(float(grid[1]), log, ratio)


@lru_cache(maxsize=256)
def blurred_phase(phase: PhaseFunction) -> Floats:
    """Return a phase function, averaged over a disk, at equal steps of the angle from 0 to pi.

    Rings of the phase function are weighted by the part of them that lies in the disk: the peak at
    small angles counts by its probability.
    """
    edges, inside = _disk_of_rings()
    return np.asarray(inside @ np.diff(phase.cdf(edges))) / (
        2.0 * math.pi * (1.0 - math.cos(_BLUR))
    )


@cache
def _disk_of_rings() -> tuple[Floats, Any]:
    """Return the edges of rings, and the parts of rings in disks at equal steps of the angle."""
    from scipy.sparse import csr_array

    small = np.geomspace(1e-6, _BLUR, _RINGS)
    ring = np.concatenate([[0.0], small, np.linspace(_BLUR, math.pi, 2 * _RINGS)[1:]])
    middle = 0.5 * (ring[1:] + ring[:-1])
    center = np.linspace(0.0, math.pi, _ANGLES)[:, None]
    sines = np.maximum(np.sin(middle) * np.sin(center), 1e-15)
    cosine = (math.cos(_BLUR) - np.cos(middle) * np.cos(center)) / sines
    return ring, csr_array(np.arccos(np.clip(cosine, -1.0, 1.0)) / math.pi)


_BOUNCES = 8
_OFFSET = 1e-5  # start of a ray above its facet, in units of the frame


def seen_from_air(
    case: Case, mesh: TriangleMesh, links: Sequence[Link], days: Sequence[Daylight], photons: int
) -> Floats:
    """Return the radiances of the parts by shift for a receiver in the air.

    At all wavelengths of links that are otherwise alike, (wavelengths, shifts, parts).
    """
    view, scene = View.of(links[0], photons, case.run.seed), scene_of(case, mesh, links, days)
    each = [follow(scene, rays, case.run.seed) for rays in view.blocks()]
    parts = np.concatenate(each, axis=1)
    if scene.direct.any():
        sun = scene.direct[:, None]
        parts[..., SUN] += sun * sun_in_view(scene, view)
        if not scene.rough:
            glint = scene.at_wavelengths(bent_sun(scene, scene.mirror, view))
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


def follow(scene: SeenSea, view: View, seed: int) -> Floats:
    """Return the mean radiance of each part along the rays of a view, without the sun's disk.

    At the wavelengths, (wavelengths, shifts, parts).
    """
    origin, direction, u = view.origins(), view.directions(), view.uniforms[:, 4:]
    out = np.zeros((len(scene.days), len(origin), len(PARTS)))
    weight, rays = np.ones((len(scene.days), len(origin))), np.arange(len(origin))
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
        hit, light = Hit(*(v[at_sea] for v in hit)), -direction[at_sea]
        if scene.foam > 0.0:
            out[:, rays, FOAM] += weight * scene.foam * glow
            weight = weight * (1.0 - scene.foam)
        if scene.direct.any() and scene.rough:
            out[:, rays, GLINT] += weight * _glint(scene, hit, light)
        if bounce > 0:
            u = view.later_tilts(bounce, seed)
        rho, mirrored, water = _split(scene, direction[at_sea], hit, u[rays])
        out[:, rays, WATER] += weight * water
        weight = weight * rho
        origin, direction = hit.point + _OFFSET * hit.facet_normal, mirrored
    return np.asarray(out.reshape(len(out), -1, view.per_shift, len(PARTS)).mean(axis=2))


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
    sun = scene.sun
    glint = scene.at_wavelengths(
        by_slopes(scene.mirror, view, hit.normal, hit.facet_normal, scene.surface.roughness)
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
    >>> found = background(Link(), FlatSea(), Daylight(direct=1.42, diffuse=0.295))
    >>> f"{found.parts['sky']:.2e}"
    '2.08e-03'
    """
    day = getattr(link, "daylight", None) if daylight is None else daylight
    if day is None:
        raise Refused("daylight", None, "a Daylight")
    if water is not None:
        require_word(water, ("quasi-single", "walk", "none"), "water")
        day = day.replace(water=water)
    case = resolve(link, surface, mesh=mesh, **options)
    run = {"photons": photons, "seed": seed, **case.meshing.model_dump()}
    case = case._replace(run=case.run.replace(seed=seed, threads=threads))
    links, days, waves = [case.link], [day], np.zeros(0)
    if wavelengths_nm is not None:
        waves = np.array(checked_wavelengths(wavelengths_nm))
        links = [case.link.at_wavelength(nm) for nm in waves.tolist()]
        days = [day.at_wavelength(nm) for nm in waves.tolist()]
    with one_blas_thread():
        found, config = mesh_for(case.link, case.surface, case.meshing)
        each = list(backgrounds_over(case, found, links, days, photons))
    results = list[Background]()
    for one, at, light in zip(each, links, days, strict=True):
        origin = {**provenance(at, config, run), "daylight": light.model_dump(mode="json")}
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
    acceptance = math.pi**2 * aperture.radius**2 * sin2
    each = zip(seen(case, mesh, links, days, photons), days, strict=True)
    return [Background.of_groups(parts, acceptance, day.wavelength_nm) for parts, day in each]
