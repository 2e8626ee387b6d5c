"""The analog engine backwards: photons from a receiver to the sky, connected to the sun.

Radiance over the squared index is kept along a ray, whatever the mesh: the mean score of photons
that start by the cosine law inside the field of view is the mean radiance of the sky that they
meet, times the squared index at the receiver. Sunlight is added at each collision in the water,
through still water. Under water its disk has a radius of 3 degrees, which bounds the phase function
and leaves fluxes unchanged. For a receiver in the air light scattered by less than 10 degrees stays
in the sun's beam: the rare paths that are scattered back and then end near the sun would carry
most of the error.
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from meshtrace.bvh import EmbreeIntersector
from meshtrace.daylight.light import Daylight
from meshtrace.errors import Refused
from meshtrace.kernels.sky import Backward
from meshtrace.kernels.vectors import Vec3
from meshtrace.link import Link
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Floats
from meshtrace.optics.fresnel import fresnel_reflectance
from meshtrace.optics.phase_base import PhaseFunction
from meshtrace.parallel import ordered_map
from meshtrace.stored import SHIFTS
from meshtrace.transport.analog import chunk_tallies, setup_of
from meshtrace.transport.frame import frame_of
from meshtrace.transport.options import Analog

_BLUR = math.radians(3.0)
_ANGLES = 1024
_RINGS = 2000
_FORWARD = math.radians(10.0)
_WIDE = np.linspace(0.0, math.pi, _ANGLES) > _FORWARD


def walked(
    link: Link, mesh: TriangleMesh, day: Daylight, origins: Floats, directions: Floats, seed: int,
    normals: str, threads: int, *, in_water: bool,
) -> Floats:  # fmt: skip
    """Return the radiance of sky and of scattered sun at a receiver by shift (shifts, 2).

    From the air only light that has been in the water counts. `origins` are local coordinates.

    Raises
    ------
    Refused
        If the water absorbs otherwise than along the way, or the forms are those of the paper.
    """
    if link.physics.absorption != "continuous" or link.physics.snell != "physical":
        allowed = "absorption continuous and snell physical for light that is followed backwards"
        raise Refused("physics", link.physics.absorption, allowed)
    frame, n = frame_of(link), link.water.n / link.n_air
    bare = link.model_copy(update={"receiver": (), "planes": None})
    local = EmbreeIntersector(frame.mesh(mesh), threads)
    options = Analog(roulette=1e-3, max_surface_events=100)
    setup = setup_of(bare, frame, local, seed, normals, options, 1)
    sun, irradiance = refracted_sun(day, n)
    world, foam = setup.world, setup.world.interface.foam_transmittance
    bubbles = link.bubbles.phase_function() if link.bubbles else link.water.phase
    back = Backward(
        np.ascontiguousarray(origins), np.ascontiguousarray(directions), in_water, not in_water,
        day.sky, Vec3(*sun.tolist()), foam * irradiance if world.medium.b_max > 0.0 else 0.0,
        1.0 if in_water else 1.0 - float(link.water.phase.cdf(_FORWARD)),
        *(blurred_phase(p) * (in_water | _WIDE) for p in (link.water.phase, bubbles)),
    )  # fmt: skip
    spans = [(i, min(i + options.batch_size, len(origins)))
             for i in range(0, len(origins), options.batch_size)]  # fmt: skip
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
