"""Analog photons as an estimator of the scattered light of receivers.

They count where they hit an aperture. Their scores are bounded by the absorption on the shortest
way, so that their errors have no heavy tail, whatever the phase function and the waves.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from meshtrace.engine.bvh import EmbreeIntersector
from meshtrace.engine.gains import Gains, shares_of, table_of
from meshtrace.engine.photons.analog import run_analog
from meshtrace.engine.setup.options import Analog, Arrivals
from meshtrace.link import Link
from meshtrace.mesh import TriangleMesh

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

    def evaluate(self, mesh: TriangleMesh, record: bool = False) -> Gains:
        """Return the gain over a mesh, on demand with every row of its light."""
        options = Analog(roulette=_ROULETTE * largest_weight(self.link, float(mesh.bounds[0, 2])))
        sums = run_analog(
            self.link, EmbreeIntersector(mesh, self.threads), options, photons=self.photons,
            seed=self.seed, normals=self.normals, threads=self.threads, unscattered=False,
            record=[Arrivals()],
        )  # fmt: skip
        arrivals = sums.all_arrivals
        orders = int(arrivals["order"].max(initial=0)) + 1
        gains = Gains.zeros(1, len(self.link.receivers), orders)
        gains.add_arrivals(arrivals, arrivals["weight"][None], 0, self.photons)
        if record:
            weight = arrivals["weight"] * shares_of(arrivals, self.photons)
            gains.table.append(table_of(arrivals, weight, 1.0, self.link))
        return gains.of_photons(self.photons).by_wavelength()[0]
