"""Analog photons as an estimator of the scattered light of receivers.

They count where they hit an aperture. Their scores are bounded by the absorption on the shortest
way, so that their errors have no heavy tail, whatever the phase function and the waves.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from meshtrace.engine.bvh import EmbreeIntersector
from meshtrace.engine.photons.analog import run_analog
from meshtrace.engine.photons.joined import PhotonParts
from meshtrace.engine.photons.targets import N_PARTS
from meshtrace.engine.setup.options import Analog, Arrivals
from meshtrace.kernels.tally import ARRIVAL
from meshtrace.link import Link
from meshtrace.mesh import TriangleMesh
from meshtrace.stored import SHIFTS

_ROULETTE = 0.5  # of the largest weight that arrives: lighter photons are ended or made heavier


def largest_weight(link: Link, trough: float) -> float:
    """Return an upper bound on the transmission by absorption between water and air.

    Parameters
    ----------
    link : Link
        The link.
    trough : float
        Height of the lowest trough [m].
    """
    if link.physics.absorption != "continuous":
        return 1.0
    water = link.water
    a = water.a if water.layers is None else min(row[1] for row in water.layers)
    depth = min(-item.center[2] for _, item in link.items() if item.center[2] < 0.0)
    return math.exp(-a * max(depth + trough, 0.0))


class ArrivingPhotons(NamedTuple):
    """Analog photons of a link, for any surface, without its unscattered light.

    Parameters
    ----------
    link : Link
        The link, with the receivers that the photons serve.
    photons : int
        Photons, >= 32.
    seed : int
        Key of the random numbers, 0 <= seed < 2^64.
    normals : {"vertex", "facet"}
        Normals interpolated from the corners, or those of the facets.
    threads : int
        Threads; results do not depend on them.
    """

    link: Link
    photons: int
    seed: int
    normals: str = "vertex"
    threads: int = 1

    def evaluate(self, mesh: TriangleMesh, arrivals: bool = False) -> PhotonParts:
        """Return the gain over a mesh in parts, on demand with every arrival."""
        options = Analog(roulette=_ROULETTE * largest_weight(self.link, float(mesh.bounds[0, 2])))
        sums = run_analog(
            self.link, EmbreeIntersector(mesh, self.threads), options, photons=self.photons,
            seed=self.seed, normals=self.normals, threads=self.threads, unscattered=False,
            record=[Arrivals()],
        )  # fmt: skip
        light = np.concatenate([np.zeros(0, ARRIVAL), *sums.arrivals])
        n, receivers, weight = self.photons, len(self.link.receivers), light["weight"]
        group = light["photon"] % SHIFTS
        per_group = np.bincount(np.arange(n) % SHIFTS, minlength=SHIFTS)
        shape = N_PARTS, receivers, SHIFTS
        cell = np.ravel_multi_index((light["part"], light["receiver"], group), shape)
        groups = np.bincount(cell, weight, np.prod(shape)).reshape(shape) / per_group
        # a photon may bring light several times
        place = (light["photon"] * N_PARTS + light["part"]) * receivers + light["receiver"]
        first, which = np.unique(place, return_inverse=True)
        score, at = np.bincount(which, weight, len(first)), first % (N_PARTS * receivers)
        square = np.bincount(at, score**2, N_PARTS * receivers).reshape(N_PARTS, receivers)
        scored = np.bincount(at, minlength=N_PARTS * receivers).reshape(N_PARTS, receivers)
        once = light[light["part"] < N_PARTS - 1]
        orders = np.zeros((receivers, int(once["order"].max(initial=0)) + 1))
        np.add.at(orders, (once["receiver"], once["order"]), once["weight"] / n)
        rows = None
        if arrivals:
            columns = weight / (SHIFTS * per_group[group]), light["water"], light["air"], group
            table = np.column_stack(columns)
            rows = [table[light["receiver"] == r] for r in range(receivers)]
        number = np.full(receivers, n)
        return PhotonParts(
            number, groups, orders, scored, square / n, rows, estimator="analog photons"
        )
