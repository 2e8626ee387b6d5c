"""Estimate the scattered light of receivers by analog photons that hit them.

Photons score where they hit an aperture. No score exceeds the transmission on the shortest path, so
that the errors have no heavy tail, whatever the phase function and the waves.
"""

from __future__ import annotations

import math
from itertools import product

from meshtrace.engine.bvh import EmbreeIntersector
from meshtrace.engine.gains import Gains, places_of, shares_of, table_of
from meshtrace.engine.photons.analog import run_analog
from meshtrace.engine.setup.options import Analog, Arrivals
from meshtrace.link import Link
from meshtrace.mesh import TriangleMesh

_ROULETTE = 0.5  # limit of Russian roulette, over the largest weight that can arrive


def largest_weight(link: Link, trough: float) -> float:
    """Return an upper bound on the transmission by absorption from a source to a receiver.

    Parameters
    ----------
    link : Link
        The link.
    trough : float
        Height of the lowest trough [m].
    """
    if link.physics.absorption != "continuous":
        return 1.0
    # by the clearest layer: no path is absorbed less
    water = link.water
    a = water.a if water.layers is None else min(row[1] for row in water.layers)
    if link.direction == "under":
        pairs = product(link.transmitters, link.receivers)
        way = min(math.dist(t.center, r.center) - t.size - r.radius for t, r in pairs)
        return math.exp(-a * max(way, 0.0))
    if link.direction == "over":
        return 1.0  # straight light meets no water
    depth = min(-item.center[2] for _, item in link.items() if item.center[2] < 0.0)
    return math.exp(-a * max(depth + trough, 0.0))


def scattered_gains(
    link: Link, mesh: TriangleMesh, photons: int, seed: int, normals: str, threads: int,
    record: bool = False, lamps: int = 1,
) -> Gains:  # fmt: skip
    """Return the gains of scattered light over a mesh, by analog photons that hit the receivers.

    Parameters
    ----------
    link : Link
        The link, with the receivers that the photons serve.
    mesh : TriangleMesh
        The surface.
    photons : int
        Photons, >= 32.
    seed : int
        Key of the random numbers, 0 <= seed < 2^64.
    normals : {"vertex", "facet"}
        Normals interpolated from the corners, or those of the facets.
    threads : int
        Threads; results do not depend on them.
    record : bool
        Whether every arrival is recorded.
    lamps : int
        Number of lamps of gains by pair, lamp after lamp; 1 for their sums.
    """
    # photons of less than half of the largest weight that can arrive cost as much, but bring less
    options = Analog(roulette=_ROULETTE * largest_weight(link, float(mesh.bounds[0, 2])))
    # unscattered light is left out: the facets give it without noise
    sums = run_analog(
        link, EmbreeIntersector(mesh, threads), options, photons=photons, seed=seed,
        normals=normals, threads=threads, unscattered=False, record=[Arrivals()],
    )  # fmt: skip
    arrivals = sums.all_arrivals
    orders = int(arrivals["order"].max(initial=0)) + 1
    gains = Gains.zeros(1, lamps * len(link.receivers), orders)
    receiver = places_of(arrivals, seed, link, lamps, len(link.receivers))
    gains.add_arrivals(arrivals, arrivals["weight"][None], 0, photons, receiver)
    if record:
        weight = arrivals["weight"] * shares_of(arrivals, photons)
        gains.table.append(table_of(arrivals, weight, 1.0, link))
    return gains.of_photons(photons).by_wavelength()[0]
