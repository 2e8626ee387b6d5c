"""Measured intensities of a lamp: a table over the angle to its axis and the azimuth about it.

The intensity is bilinear in s = sin^2(theta / 2) and in the azimuth phi between the nodes, at equal
steps of theta and of phi. In s, dOmega = 2 ds dphi, so that the integral over a cell is that of a
bilinear function, and its inverse the root of a quadratic equation.

A table is one array of doubles, of which kernels get the address: a number passes through records
and tuples of all kinds of sources, where an array would need a place in each.
"""

from __future__ import annotations

import ctypes
import math
from enum import IntEnum
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from meshtrace.kernels.jit import config, entry, inlined, outlined
from meshtrace.kernels.vectors import TWO_PI, combine, cross, dot, minus, plus, row, scaled


class Place(IntEnum):
    """Positions of the numbers in front of the nodes."""

    RINGS = 0  # nodes of theta, from 0 to the dark angle or to pi
    AZIMUTHS = 1  # nodes of phi, from 0 to 2 pi
    STEP = 2  # of theta [rad]
    DARK = 3  # angle beyond which there is no light [rad]
    # then the intensities [sr-1] of each ring, their integrals over phi / (2 pi) from 0, and the
    # share of the power inside of each ring
    NODES = 4


@intrinsic
def _compiled_number(typing_context: Any, address: Any, place: Any) -> Any:
    """Return the double at a place of an array, from a kernel."""

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        start = builder.inttoptr(arguments[0], ir.DoubleType().as_pointer())
        return builder.load(builder.gep(start, [arguments[1]]))

    return types.float64(types.int64, types.int64), emit


def _plain_number(address: int, place: int) -> float:
    """Return the number of `_compiled_number`, under NUMBA_DISABLE_JIT."""
    return ctypes.c_double.from_address(int(address) + 8 * int(place)).value


number: Any = _plain_number if config.DISABLE_JIT else _compiled_number
"""Number at a place of a table, by its address."""


def packed(intensity: NDArray[np.float64], step: float) -> NDArray[np.float64]:
    """Return a table of unit power from relative intensities (rings, azimuths), see `Place`.

    The last azimuth is that of the first. `step` is that of theta [rad].
    """
    rings, azimuths = intensity.shape
    s = np.sin(0.5 * step * np.arange(rings)) ** 2
    width = 1.0 / (azimuths - 1)
    over_phi = np.zeros_like(intensity)
    np.cumsum(0.5 * width * (intensity[:, 1:] + intensity[:, :-1]), axis=1, out=over_phi[:, 1:])
    # the power per s, 4 pi times the mean over phi, is linear in s between the rings
    per_s = 4.0 * math.pi * over_phi[:, -1]
    inside = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(s) * (per_s[1:] + per_s[:-1]))])
    power = inside[-1]
    dark = min(step * (rings - 1), math.pi)
    nodes = (np.ravel(intensity) / power, np.ravel(over_phi) / power, inside / power)
    return np.concatenate([[rings, azimuths, step, dark], *nodes])


@inlined
def _ring(table, k):
    """Return s of a ring."""
    sine = math.sin(0.5 * number(table, Place.STEP.value) * k)
    return sine * sine


@outlined
def intensity(table, w, axis, e1, e2):
    """Return the intensity [sr-1] of a lamp of unit power along a unit vector w.

    Array twin: bilinear interpolation of the nodes in the tests.
    """
    # (w - axis)^2 = 4 s, without the cancellation of 1 - cos
    off = minus(w, axis)
    s = 0.25 * dot(off, off)
    rings, azimuths = int(number(table, 0)), int(number(table, 1))
    theta = 2.0 * math.asin(math.sqrt(min(s, 1.0)))
    if theta > number(table, Place.DARK.value):
        return 0.0
    k = min(int(theta / number(table, Place.STEP.value)), rings - 2)
    low, high = _ring(table, k), _ring(table, k + 1)
    f = min(max((s - low) / (high - low), 0.0), 1.0)
    turns = math.atan2(dot(w, e2), dot(w, e1)) / TWO_PI
    turns = (turns - math.floor(turns)) * (azimuths - 1)
    j = min(int(turns), azimuths - 2)
    g = turns - j
    start = Place.NODES.value + k * azimuths + j
    inner = (1.0 - g) * number(table, start) + g * number(table, start + 1)
    outer = (1.0 - g) * number(table, start + azimuths) + g * number(table, start + azimuths + 1)
    return (1.0 - f) * inner + f * outer


@entry
def intensities(table, directions, axis, e1, e2, out):
    """Write the intensities [sr-1] along unit vectors (n, 3).

    Array twin: `intensity` of each.
    """
    for i in range(len(directions)):
        out[i] = intensity(table, row(directions, i), axis, e1, e2)


@inlined
def _part(q, a, b):
    """Return f with int_0^f (a + (b - a) x) dx = q, for 0 <= q <= (a + b) / 2."""
    root = a + math.sqrt(max(a * a + 2.0 * (b - a) * q, 0.0))
    return min(2.0 * q / root, 1.0) if root > 0.0 else 0.0


@outlined
def direction(table, u, v, axis, e1):
    """Return a random direction of a lamp by two uniforms: first the ring, then the azimuth.

    Array twin: `intensity`, chi-square tested.
    """
    rings, azimuths = int(number(table, 0)), int(number(table, 1))
    nodes, inside = Place.NODES.value, Place.NODES.value + 2 * rings * azimuths
    # bisection for the last ring with a share of at most u inside
    k, above = 0, rings - 1
    while above - k > 1:
        middle = (k + above) // 2
        if number(table, inside + middle) <= u:
            k = middle
        else:
            above = middle
    # means over phi of the inner and outer ring of the cell
    mean = nodes + rings * azimuths + (k + 1) * azimuths - 1
    a, b = number(table, mean), number(table, mean + azimuths)
    low, high = _ring(table, k), _ring(table, k + 1)
    # power per s is 4 pi times the mean
    f = _part((u - number(table, inside + k)) / (4.0 * math.pi * (high - low)), a, b)
    s = low + f * (high - low)
    first = nodes + rings * azimuths + k * azimuths
    wanted = v * ((1.0 - f) * a + f * b)
    j, above = 0, azimuths - 1
    while above - j > 1:
        middle = (j + above) // 2
        at = first + middle
        if (1.0 - f) * number(table, at) + f * number(table, at + azimuths) <= wanted:
            j = middle
        else:
            above = middle
    at, node = first + j, nodes + k * azimuths + j
    before = (1.0 - f) * number(table, at) + f * number(table, at + azimuths)
    a = (1.0 - f) * number(table, node) + f * number(table, node + azimuths)
    b = (1.0 - f) * number(table, node + 1) + f * number(table, node + azimuths + 1)
    phi = TWO_PI * (j + _part((wanted - before) * (azimuths - 1), a, b)) / (azimuths - 1)
    sin_theta = 2.0 * math.sqrt(max(s * (1.0 - s), 0.0))
    # seen from behind the lamp azimuths run counter-clockwise: e1, e2 and the axis are left-handed
    across = combine(math.cos(phi), e1, math.sin(phi), cross(e1, axis))
    return plus(scaled(sin_theta, across), scaled(1.0 - 2.0 * s, axis))
