"""Gain over the exact sum of waves, with the chains of the meshes."""

from __future__ import annotations

import math
from typing import Any, NamedTuple, TypeGuard

import numpy as np

from meshtrace.engine.chains import wave_sum as analytic
from meshtrace.engine.chains.sampling import Chains
from meshtrace.engine.crossing import ROOT
from meshtrace.engine.forced import ForcedDetection
from meshtrace.engine.setup.arrays import IDENTITY, Frame
from meshtrace.engine.setup.ends import crossing_reach
from meshtrace.errors import Refused
from meshtrace.kernels.scene import Scene
from meshtrace.mesh import SurfaceModel, WaveSum
from meshtrace.models import Floats
from meshtrace.stored import SHIFTS
from meshtrace.studies.convergence.meshes import nested_mesh, probes

_QUADRATURE_ERROR = 1e-5  # relative, of the unscattered light through the exact surface


class Reference(NamedTuple):
    """The gain over the exact surface, with the chains of the study."""

    samples: Floats  # (shifts,) gain of each shift of the chains
    ballistic: float
    quadrature_error: float  # of the unscattered gain
    slope_variance: float
    lost: int  # crossings of the mesh next to which Newton found none of the exact surface

    @property
    def gain(self) -> float:
        """Gain over the exact surface."""
        return float(self.samples.mean())


def over_waves(forced: ForcedDetection, sea: WaveSum, time: float, spacing: float) -> Reference:
    """Return the gain over the sum of waves, from crossings found on a mesh of some spacing.

    The search of the chains has to be thorough.
    """
    link, mesh = forced.arrays, nested_mesh(forced.link, sea, time, spacing, np.zeros(2))
    aimed, waves = forced.over(mesh), waves_at(sea, time, link.frame)
    scattered, direct = np.zeros(SHIFTS), np.zeros(2)
    counters = np.zeros(len(analytic.Moved), np.int64)
    for source, power in enumerate(link.power):
        scene = aimed.scene(link.emitters[source], link.targets[0])
        for chains in forced.scattered_sets[source]:
            _, arrivals = aimed.aim(source, 0, chains, keep=True)
            score = np.zeros(len(chains.audit))
            analytic.move_crossings(chains.chains, arrivals, waves, scene, score, counters)
            scattered += power * score.reshape(SHIFTS, -1).mean(axis=1)
        crossings = aimed.centroids[np.flatnonzero(aimed.facet_gains(source, 0))]
        coarse, fine = (_direct(waves, scene, crossings, n) for n in (4, 8))
        if abs(fine - coarse) > _QUADRATURE_ERROR * fine:  # a caustic lies on the aperture
            coarse, fine = _finely_meshed(forced, sea, time, source, crossings, spacing)
        direct += power * np.array([fine, abs(fine - coarse)])
    slope_x, slope_y = sea.slopes(*probes(crossing_reach(forced.link)), time)
    return Reference(
        samples=direct[0] + scattered,
        ballistic=float(direct[0]),
        quadrature_error=float(direct[1]),
        slope_variance=float(np.mean(slope_x**2 + slope_y**2)),
        lost=int(counters[analytic.Moved.LOST]),
    )


def _finely_meshed(
    forced: ForcedDetection,
    sea: WaveSum,
    time: float,
    source: int,
    crossings: Floats,
    spacing: float,
) -> tuple[float, float]:
    """Return the unscattered gain of two meshes of the crossing region, extrapolated.

    The image of a mesh adds up at a caustic, where the light on a point has no bound.
    """
    metres = forced.arrays.frame.metres(crossings)[:, :2]
    low, high = metres.min(axis=0), metres.max(axis=0)
    extent = 0.5 * float((high - low).max()) + 2.0 * spacing
    center = tuple(0.5 * (low + high))
    gains = []
    for parts in (8, 16):
        mesh = sea.mesh(time, extent, max(spacing / parts, extent / 500.0), center=center)
        gains.append(float(forced.over(mesh).facet_gains(source, 0).sum()))
    return gains[1], gains[1] + (gains[1] - gains[0]) / 3.0


def _direct(waves: analytic.Waves, scene: Scene, crossings: Floats, rings: int) -> float:
    """Return the unscattered gain by quadrature over the aperture."""
    points = _aperture_points(rings)
    score, room = np.zeros(len(points.weight)), np.empty(len(crossings), ROOT)
    analytic.direct_light(points, crossings, waves, scene, room, score)
    return float(score.sum())


def _aperture_points(rings: int) -> Chains:
    """Return points of the unit disk with weights that add to 1, as chains that never scatter.

    Gauss-Legendre in the square of the radius, equal steps in azimuth.
    """
    node, weight = np.polynomial.legendre.leggauss(rings)
    radius, azimuths = np.sqrt(0.5 * (1.0 + node)), 3 * rings
    azimuth = 2.0 * math.pi * (np.arange(azimuths) + 0.5) / azimuths
    disk = radius[:, None, None] * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    n = rings * azimuths
    return Chains(
        vertex=np.zeros((n, 0, 3)),
        kind=np.zeros((n, 0), np.int8),
        last=np.zeros((n, 3)),
        path=np.zeros(n),
        weight=np.repeat(0.5 * weight / azimuths, azimuths),
        disk=disk.reshape(n, 2),
        tail=np.zeros((n, 3)),
        tilt=np.zeros((n, 2)),
    )


def waves_at(sea: WaveSum, time: float, frame: Frame = IDENTITY) -> analytic.Waves:
    """Return the waves of a sea at one instant as arrays for the kernels, in a local frame."""
    waves = sea.components
    return analytic.Waves(
        np.ascontiguousarray(waves.amplitude) / frame.unit,
        np.ascontiguousarray(waves.kx) * frame.unit,
        np.ascontiguousarray(waves.ky) * frame.unit,
        waves.omega * time + waves.phase - waves.kx * frame.x - waves.ky * frame.y,
    )


def is_wave_sum(sea: Any) -> TypeGuard[WaveSum]:
    """Return whether the elevation of a sea is a sum of waves; that of a choppy sea is not."""
    return isinstance(sea, WaveSum) and not getattr(sea, "choppy", False)


def wave_sum(sea: SurfaceModel) -> WaveSum:
    """Return a sea that is a sum of waves; refuse others."""
    if not is_wave_sum(sea):
        kind = "a choppy sea" if getattr(sea, "choppy", False) else type(sea).__name__
        raise Refused("reference", f"analytic for {kind}", "None: not a sum of waves")
    return sea
