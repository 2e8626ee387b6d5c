"""Chains at other wavelengths: sums over their ways and scatterings, see `kernels.tints`."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine import crossing
from meshtrace.engine.chains.gain import turned
from meshtrace.kernels.jit import entry, inlined, outlined
from meshtrace.kernels.medium import Medium, scattering_path
from meshtrace.kernels.tints import Tints, tint_scattering, tint_way
from meshtrace.kernels.vectors import Vec3, minus, norm, plus, row


class Colours(NamedTuple):
    """Wavelengths of straight ways, and their factors on the weight of the last one."""

    tints: Tints | None
    shares: NDArray[np.float64]  # (wavelengths, tints)
    clear: Medium  # the water with its bubbles alone
    tint: NDArray[np.float64]  # (tints,)
    factor: NDArray[np.float64]  # (wavelengths,)


@outlined
def straight_factors(p, q, colours):
    """Write the factors of a straight way from p to q.

    Array twin: see `tint_chains`.
    """
    colours.tint[:] = 0.0
    _add_way(p, q, colours.clear, colours.tints, colours.tint)
    for j in range(len(colours.factor)):
        log = 0.0
        for r in range(len(colours.tint)):
            log += colours.shares[j, r] * colours.tint[r]
        colours.factor[j] = math.exp(log)


@inlined
def _add_way(p, q, clear, tints, tint):
    """Add a straight way from p to q."""
    if tints is not None:
        length = norm(minus(q, p))
        tint_way(tints, tint, p.z, q.z, length)
        depth = scattering_path(clear, p, q, length)
        for r in range(len(tints.c)):
            tint[r] -= tints.bubble_c[r] * depth


@entry
def tint_chains(chains, arrivals, emitter, clear, tints, out):
    """Write the sums (arrivals, tints) of chains that arrive.

    Array twin: direct runs of the wavelengths.
    `clear` is the water with its bubbles alone.
    """
    for n in range(len(arrivals)):
        a, tint = arrivals[n], out[n]
        i, w = a.chain, Vec3(a.emission[0], a.emission[1], a.emission[2])
        start = crossing.start_of(emitter, chains.disk[i, 0], chains.disk[i, 1])
        end = Vec3(a.point[0], a.point[1], a.point[2])
        for r in range(len(tint)):
            tint[r] = 0.0
        before, last = start, w
        order = chains.vertex.shape[1]
        for k in range(order + 1):
            at = end
            if k < order:
                at = plus(turned(w, row(chains.vertex[i], k)), start)
            way = minus(at, before)
            if k > 0:
                s = 0.5 * norm(minus(_unit(way), _unit(last)))
                theta = 2.0 * math.asin(min(s, 1.0))
                tint_scattering(tints, tint, before.z, theta, chains.kind[i, k - 1] == 1)
            _add_way(before, at, clear, tints, tint)
            before, last = at, way


@inlined
def _unit(way):
    """Return the direction of a way."""
    size = norm(way)
    return Vec3(way.x / size, way.y / size, way.z / size)


@entry
def tint_straight(start, ends, clear, tints, out):
    """Write the sums (ways, tints) of straight ways from a point to ends (ways, 3).

    Array twin: see `tint_chains`.
    """
    for n in range(len(ends)):
        for r in range(len(out[n])):
            out[n, r] = 0.0
        _add_way(start, row(ends, n), clear, tints, out[n])
