"""The same chains over the sum of waves itself."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from meshtrace.kernels import wave_sum as analytic
from meshtrace.kernels.aiming import ROOT, Emitter, Scene
from meshtrace.kernels.chains import Chains
from meshtrace.mesh import SurfaceModel
from meshtrace.studies.convergence.checks import Floats
from meshtrace.studies.convergence.exhaustive import ExhaustiveDetection
from meshtrace.studies.convergence.meshes import nested_mesh, probes
from meshtrace.transport.forced import SHIFTS, crossing_reach

if TYPE_CHECKING:
    pass

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


@runtime_checkable
class WaveSum(SurfaceModel, Protocol):
    """A sea that is a sum of plane waves."""

    @property
    def components(self) -> Any:
        """Amplitudes, frequencies, wave vectors and phases as arrays."""
        ...


class OverWaves(ExhaustiveDetection):
    """The same chains over the sum of waves itself."""

    def over(self, sea: WaveSum, time: float, spacing: float) -> Reference:
        """Return the gain over the sum of waves; a mesh of some spacing names the crossings."""
        mesh = nested_mesh(self.link, sea, time, spacing, np.zeros(2))
        aimed, waves = self._over(mesh), waves_at(sea, time)
        scattered, direct = np.zeros(SHIFTS), np.zeros(2)
        counters = np.zeros(len(analytic.Moved), np.int64)
        for power, emitter, strata in zip(self._power, self._emitters, self._strata, strict=True):
            scene = aimed._scene(emitter, self._targets[0])
            for stratum in strata:
                _, arrivals = aimed.aim(emitter, self._targets[0], 0, stratum, keep=True)
                score = np.zeros(len(stratum.audit))
                analytic.move_crossings(stratum.chains, arrivals, waves, scene, score, counters)
                scattered += power * score.reshape(SHIFTS, -1).mean(axis=1)
            lit = mesh.faces[np.flatnonzero(aimed.facet_gains(emitter, self._targets[0]))]
            crossings = mesh.vertices[lit].mean(axis=1)
            coarse, fine = (_direct(waves, scene, crossings, n) for n in (4, 8))
            if abs(fine - coarse) > _QUADRATURE_ERROR * fine:  # a caustic lies on the aperture
                coarse, fine = self._finely_meshed(sea, time, emitter, crossings, spacing)
            direct += power * np.array([fine, abs(fine - coarse)])
        slope_x, slope_y = sea.slopes(*probes(crossing_reach(self.link)), time)
        return Reference(
            samples=direct[0] + scattered,
            ballistic=float(direct[0]),
            quadrature_error=float(direct[1]),
            slope_variance=float(np.mean(slope_x**2 + slope_y**2)),
            lost=int(counters[analytic.Moved.LOST]),
        )

    def _finely_meshed(
        self, sea: WaveSum, time: float, emitter: Emitter, crossings: Floats, spacing: float
    ) -> tuple[float, float]:
        """Return the unscattered gain of two meshes where light crosses, the finer extrapolated.

        The image of a mesh adds up at a caustic, where the light on a point has no bound.
        """
        low, high = crossings[:, :2].min(axis=0), crossings[:, :2].max(axis=0)
        extent = 0.5 * float((high - low).max()) + 2.0 * spacing
        center = tuple(0.5 * (low + high))
        gains = []
        for parts in (8, 16):
            mesh = sea.mesh(time, extent, max(spacing / parts, extent / 500.0), center=center)
            gains.append(self._over(mesh).ballistic(emitter, self._targets[0]))
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


def waves_at(sea: WaveSum, time: float) -> analytic.Waves:
    """Return the waves of a sea at one instant as the kernels take them."""
    waves = sea.components
    return analytic.Waves(
        np.ascontiguousarray(waves.amplitude),
        np.ascontiguousarray(waves.kx),
        np.ascontiguousarray(waves.ky),
        waves.omega * time + waves.phase,
    )


def wave_sum(sea: SurfaceModel) -> WaveSum:
    """Return a sea that is a sum of waves; refuse others."""
    if not isinstance(sea, WaveSum):
        raise ValueError(
            f"reference: 'analytic' for {type(sea).__name__}, allowed None: not a sum of waves"
        )
    return sea
