"""Sky and scattered sunlight in the water: photons that run backwards from a receiver.

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
from collections.abc import Iterable, Iterator, Sequence
from functools import cache, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshtrace.daylight.light import Daylight, refracted_sun
from meshtrace.engine.backward.view import LEVELS, SeenSea, View
from meshtrace.engine.bvh import EmbreeIntersector
from meshtrace.engine.photons.analog import AnalogPhotons
from meshtrace.engine.setup.arrays import integral
from meshtrace.engine.setup.options import Analog
from meshtrace.engine.setup.tinting import CommonPaths, photon_paths
from meshtrace.errors import Refused
from meshtrace.kernels.sources import BUBBLE_SCORE, SKY_SCORE, SUN_SCORE, Backward
from meshtrace.kernels.tally import Tallies
from meshtrace.kernels.tints import NO_TINTS, Mixture, Tints, add_tinted
from meshtrace.kernels.vectors import Vec3
from meshtrace.link import Link
from meshtrace.models import Floats
from meshtrace.optics.phase import PhaseFunction
from meshtrace.parallel import ordered_map
from meshtrace.stored import SHIFTS

_ARRIVALS = 64  # recorded scores per photon that a chunk has memory for; one with more runs again
_BLUR = math.radians(3.0)  # radius of the sun's disk under water; a larger one: less noise, more
# bias
_ANGLES = 1024  # nodes of the blurred phase function, 0 to pi: 17 over the radius of that disk
_RINGS = 2000  # rings of scattering angle up to _BLUR, of equal logarithmic width; beyond it twice
# as many of equal width
_FORWARD = math.radians(10.0)  # For a receiver in the air, light scattered by less stays in the
# sun's beam: less noise, see the docstring of the module.
_WIDE = np.linspace(0.0, math.pi, _ANGLES) > _FORWARD  # the angles that scatter then


def walked_radiance(sea: SeenSea, view: View) -> Floats:
    """Return the radiance of sky and of scattered sun at a receiver [W m-2 sr-1 nm-1].

    Shape (wavelengths, shifts, pixels, 2). For a receiver in the air only light that has been in
    the water counts.

    Raises
    ------
    Refused
        If absorption is not applied continuously along the path, or Snell's law is not the physical
        form.
    """
    links = sea.links
    for name, required in (("absorption", "continuous"), ("snell", "physical")):
        form = getattr(links[0].physics, name)
        if form != required:
            allowed = f"{required}, for light that is traced backwards"
            raise Refused(f"physics.{name}", form, allowed)
    radiances = np.zeros((len(links), SHIFTS, view.pixels, 2))
    waiting = list(range(len(links)))
    # each pass follows the wavelengths that can share photons, those of alike phase functions
    while waiting:
        _, paths = photon_paths(links, waiting)
        n_runs = max(len(paths.tinting.bases), 1) * len(paths.bases)
        # shared photons need one of each shift at least for each base and index
        if len(paths.wavelengths) == 1 or view.per_shift < n_runs:
            for i in paths.wavelengths:
                radiances[i] = _at_one_wavelength(sea, view, links[i], sea.days[i])
        else:
            radiances[paths.wavelengths] = _at_wavelengths(sea, view, paths)
        waiting = [i for i in waiting if i not in paths.wavelengths]
    return radiances


def _at_one_wavelength(sea: SeenSea, view: View, link: Link, day: Daylight) -> Floats:
    """Return the radiance of sky and of scattered sun (shifts, pixels, 2)."""
    rays = np.arange(len(view.uniforms))
    scores = np.concatenate([t.score for t in _tallies(sea, view, link, day, rays, NO_TINTS)])
    sky, sun = scores[:, SKY_SCORE], scores[:, SUN_SCORE] + scores[:, BUBBLE_SCORE]
    by_pixel = view.means(np.stack([sky, sun], axis=1).T, view.directions())
    return np.moveaxis(by_pixel, 0, -1) * _squared_index(sea, link)


def _at_wavelengths(sea: SeenSea, view: View, paths: CommonPaths) -> Floats:
    """Return the radiances at wavelengths that share photons (wavelengths, shifts, pixels, 2).

    A base is a link whose absorption and scattering the photons follow. They follow several bases
    in turn, each with the smallest and with the largest refractive index, as in
    `engine.correlated.analog_sums`.
    """
    links, days = paths.links, [sea.days[i] for i in paths.wavelengths]
    tinting, per_shift = paths.tinting, view.per_shift
    bases = [links[i] for i in tinting.bases] or [paths.bases[0]]
    # a run is a base (absorption and scattering) and an end (smallest or largest index)
    runs = [(base, end) for base in range(len(bases)) for end in range(len(paths.bases))]
    radiances = np.zeros((len(links), SHIFTS, view.pixels, 2))
    # Run of each ray of a shift, in contiguous parts: a part of a net of quasi-random points is
    # such a net, too.
    turn = np.arange(per_shift) * len(runs) // per_shift
    numbers = np.bincount(turn, minlength=len(runs)).reshape(len(bases), -1)  # (bases, ends)
    # Unit irradiance of sky and sun (0 without any sun): the spectra weigh the sums at the end.
    unit_day = days[0].replace(direct=1.0 if any(day.direct for day in days) else 0.0, diffuse=1.0)
    for k, (base, end) in enumerate(runs):
        link = bases[base].replace("water.n", paths.bases[end].water.n)
        rays = np.flatnonzero(np.tile(turn == k, SHIFTS))
        of_end = numbers[:, end].sum()  # photons of a shift that have this index
        mixture = tinting.mixture(base, numbers[:, end] / of_end)
        tallies = _tallies(sea, view, link, unit_day, rays, tinting.tints)
        last_events = _last_events(sea, link, links, unit_day)
        sums = _sums(view, rays, tallies, last_events, mixture) * _squared_index(sea, link)
        # Radiance is interpolated linearly between the two indices: `paths.shares` is the weight of
        # the largest. `sums` are divided by all photons of a shift; the mean wanted is that over
        # the photons of this index.
        part = paths.shares if end else 1.0 - paths.shares
        scale = part * per_shift / of_end if len(paths.bases) > 1 else 1.0
        radiances += sums * np.broadcast_to(scale, len(links))[:, None, None, None]
    irradiances = np.array([(day.diffuse, day.direct) for day in days])  # of sky and sun
    return radiances * irradiances[:, None, None]


def _last_events(
    sea: SeenSea, base: Link, links: Sequence[Link], day: Daylight
) -> list[tuple[float, Floats, Floats]]:
    """Return the factors on the last event of light, by its score, see `_last_scattering`."""
    sun, _ = refracted_sun(day, base.water.n / base.n_air)
    # light of the sky has no last scattering: factors of 1 (logarithm 0) at any depth and angle
    zeros = np.zeros((2, len(links)))
    scattered = (
        _last_scattering(base, links, float(sun[2]), sea.in_water, by_bubbles)
        for by_bubbles in (False, True)
    )
    return [(1.0, zeros, zeros + 1.0), *scattered]


def _sums(
    view: View, rays: NDArray[np.int64], chunks: Iterable[Tallies],
    last_events: Sequence[tuple[float, Floats, Floats]], mixture: Mixture,
) -> Floats:  # fmt: skip
    """Return the scores (wavelengths, shifts, pixels, 2) of photons, by sky and scattered sun.

    Sums over `rays`, divided by the number of all photons of a shift.
    """
    wavelengths, pixels = mixture.shares.shape[1], view.pixels
    factors = np.empty((2, wavelengths))
    # group of a ray: its shift and the pixel that sees it
    group = rays // view.per_shift * pixels + view.pixels_of(view.directions()[rays])
    sums = np.zeros((len(last_events), SHIFTS * pixels, wavelengths))
    for tallies in chunks:
        arrivals = tallies.arrivals[: int(tallies.n_arrivals[0])]
        for score, last in enumerate(last_events):
            scored = arrivals[arrivals["receiver"] == score]
            # adds to `sums[score]` in place
            add_tinted(scored, group, mixture, *last, factors, sums[score])
    by_light = np.stack([sums[SKY_SCORE], sums[SUN_SCORE] + sums[BUBBLE_SCORE]])
    by_group = by_light.transpose(2, 1, 0).reshape(wavelengths, SHIFTS, pixels, 2)
    return by_group / view.per_shift


def _squared_index(sea: SeenSea, link: Link) -> tuple[float, float]:
    """Return the factors on the radiance of sky and of scattered sun.

    Radiance over the squared index stays constant along a ray. Scores of the sky are radiances in
    the air; those of the sun are radiances in the water, where it is scattered.
    """
    n = link.water.n / link.n_air
    return (n**2, 1.0) if sea.in_water else (1.0, 1.0 / n**2)


def _tallies(
    sea: SeenSea, view: View, link: Link, day: Daylight, rays: NDArray[np.int64],
    tints: Tints | None,
) -> Iterator[Tallies]:  # fmt: skip
    """Yield the tallies of chunks of photons that start as some of the rays of a view."""
    case, in_water = sea.case, sea.in_water
    # photons run backwards: nothing but sky and sun collects them
    bare = link.model_copy(update={"receiver": (), "planes": None})
    # tuned: time for completeness; the roulette is that of forward light from the air, and photons
    # may cross the surface ten times as often as by default
    options = Analog(roulette=1e-3, max_surface_events=100)
    intersector = EmbreeIntersector(sea.mesh, case.threads)
    normals = case.meshing.normals
    photons = AnalogPhotons(bare, intersector, options, case.run.seed, normals, sea.frame)
    sun, irradiance = refracted_sun(day, link.water.n / link.n_air)
    world, foam = photons.world, photons.world.interface.foam_transmittance
    bubbles = link.bubbles.phase_function() if link.bubbles else link.water.phase
    back = Backward(
        origin=view.origins()[rays],
        direction=view.directions()[rays],
        in_water=in_water,
        # `background.seen_from_air` has the light that the surface mirrors
        after_water=not in_water,
        sky=day.sky,
        sun=Vec3(*sun.tolist()),
        # without scattering there is no collision to connect to the sun
        irradiance=foam * irradiance if world.medium.b_max > 0.0 else 0.0,
        lost_water=_lost(link.water.phase, in_water),
        lost_bubble=_lost(bubbles, in_water),
        # for a receiver in the air angles below _FORWARD count as unscattered
        phase_water=blurred_phase(link.water.phase) * (in_water | _WIDE),
        phase_bubble=blurred_phase(bubbles) * (in_water | _WIDE),
    )
    starts = range(0, len(rays), options.batch_size)
    spans = [(i, min(i + options.batch_size, len(rays))) for i in starts]
    photons.world = world._replace(back=back, tints=tints)
    photons.room = 0 if tints is None else _ARRIVALS
    for _, tallies in ordered_map(photons.tallies, spans, case.threads):
        # Backward photons record the angle [rad] of their last scattering in the column of the path
        # in the water, which `AnalogPhotons` multiplies by `unit`: undone here.
        tallies.arrivals["water"] /= sea.frame.unit
        yield tallies


def _lost(phase: PhaseFunction, in_water: bool) -> float:
    """Return the share of scattering that removes light from the sun's beam, 1 in the water."""
    return 1.0 if in_water else 1.0 - float(phase.cdf(_FORWARD))


def _last_scattering(
    base: Link, links: Sequence[Link], cos_sun: float, in_water: bool, by_bubbles: bool
) -> tuple[float, Floats, Floats]:
    """Return step [m], log and phase: factors on the last scattering of sunlight, see `add_tinted`.

    b_c p_c(theta) / (b p(theta)) exp(-(tau_c - tau) / cos_sun) at wavelength c over that of the
    base, tau the optical depth below still water and cos_sun the cosine of the refracted sun's
    zenith angle; without b for bubbles, which are alike in number.
    """
    # uniform water needs two nodes; layers are tabulated down to the deepest one
    layers = [link.water.layers[-1][0] for link in (base, *links) if link.water.layers]
    grid = np.linspace(0.0, max(layers), LEVELS) if layers else np.array([0.0, 1.0])
    logs, phases = [], []
    for link in (base, *links):
        a, b = (np.broadcast_to(x, grid.shape) for x in link.water.profile(grid))
        # quasi-single scattering: light scattered by small angles stays in the beam of the sun;
        # bubbles are alike at all wavelengths and cancel in the ratio
        lost = a + _lost(link.water.phase, in_water) * b
        scattering = 0.0 if by_bubbles else np.log(np.maximum(b, 1e-300))
        logs.append(-integral(lost, grid[1]) / cos_sun + scattering)
        phase = link.bubbles.phase_function() if by_bubbles and link.bubbles else link.water.phase
        phases.append(blurred_phase(phase))
    log = np.array(logs[1:]).T - logs[0][:, None]
    ratio = np.array(phases[1:]).T / np.maximum(phases[0], 1e-300)[:, None]
    # the order of the one array depends on the number of wavelengths, and kernels on the order
    return float(grid[1]), np.ascontiguousarray(log), np.ascontiguousarray(ratio)


@lru_cache(maxsize=256)
def blurred_phase(phase: PhaseFunction) -> Floats:
    """Return a phase function [sr-1], averaged over the disk of the sun under water.

    Shape (_ANGLES,), at equal steps of the angle from 0 to pi. Rings of the phase function are
    weighted by the part of them that lies in the disk: a peak at small angles, however narrow,
    counts by its exact probability.
    """
    edges, inside = _disk_of_rings()
    return np.asarray(inside @ np.diff(phase.cdf(edges))) / (
        2.0 * math.pi * (1.0 - math.cos(_BLUR))
    )


@cache
def _disk_of_rings() -> tuple[Floats, Any]:
    """Return the edges of rings [rad], and the parts (_ANGLES, rings) of them that lie in disks.

    A ring holds the directions between two angles from the direction of the light; the centers of
    the disks, of radius _BLUR, are at equal steps of that angle from 0 to pi.
    """
    # imported here: the import takes as long as a whole first run of `gain`
    from scipy.sparse import csr_array

    # rings narrow at small angles, where phase functions peak
    small = np.geomspace(1e-6, _BLUR, _RINGS)
    ring = np.concatenate([[0.0], small, np.linspace(_BLUR, math.pi, 2 * _RINGS)[1:]])
    middle = 0.5 * (ring[1:] + ring[:-1])
    center = np.linspace(0.0, math.pi, _ANGLES)[:, None]
    sines = np.maximum(np.sin(middle) * np.sin(center), 1e-15)
    # Spherical law of cosines: a ring `middle` meets the rim of a disk about `center` at this
    # azimuth; 1 and -1 where it lies outside or inside.
    cosine = (math.cos(_BLUR) - np.cos(middle) * np.cos(center)) / sines
    return ring, csr_array(np.arccos(np.clip(cosine, -1.0, 1.0)) / math.pi)
