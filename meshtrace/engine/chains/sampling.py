"""Scattering chains: all random variables of a photon except its direction of emission.

A chain of order K is the photon's history in the frame of its emission direction, taken as
e_z from the origin: vertices q_1 .. q_K, the kind of scatterer at each, and the direction v_K
of the last, open segment. Lengths come from a mixture of densities, weighed by the balance
heuristic [1]_.

References
----------
.. [1] E. Veach and L. J. Guibas, "Optimally combining sampling techniques for Monte Carlo
   rendering", SIGGRAPH (1995), doi:10.1145/218380.218498.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.jit import entry, inlined, outlined
from meshtrace.kernels.medium import lookup, sample_s
from meshtrace.kernels.vectors import ORIGIN, TWO_PI, UP, along, dot, row, turn, write

DIMENSIONS = 3
"""Uniforms that a vertex takes: distance, polar angle (and scatterer), azimuth."""


class Chains(NamedTuple):
    """Chains of one order, one row each."""

    vertex: NDArray[np.float64]  # (n, K, 3) positions relative to the source [m]
    kind: NDArray[np.int8]  # (n, K) scatterer: 0 water, 1 bubble
    last: NDArray[np.float64]  # (n, 3) direction of the open segment
    path: NDArray[np.float64]  # (n,) length up to the last vertex [m]
    weight: NDArray[np.float64]  # (n,) 1 / (density of distances [m-K], probability of the kinds)
    disk: NDArray[np.float64]  # (n, 2) point of the unit disk aimed at
    tail: NDArray[np.float64]  # (n, 3) last vertex, where the open segment starts; 0 without one
    tilt: NDArray[np.float64]  # (n, 2) random slopes along and across the wind, in deviations
    audit: NDArray[np.float64]  # (n,) uniforms that choose the chains whose facets are all searched

    @classmethod
    def zeros(cls, n: int, order: int) -> Chains:
        """Return arrays for n chains of an order."""
        return cls(
            vertex=np.zeros((n, order, 3)),
            kind=np.zeros((n, order), np.int8),
            last=np.zeros((n, 3)),
            path=np.zeros(n),
            weight=np.zeros(n),
            disk=np.zeros((n, 2)),
            tail=np.zeros((n, 3)),
            tilt=np.zeros((n, 2)),
            audit=np.zeros(n),
        )


class Nominal(NamedTuple):
    """Expected collisions along the shortest straight way from the source to the surface.

    Its tables follow the distance along that way, from the source.
    """

    distance: float  # [m]
    c: float  # attenuation of the free-path part [m-1]
    step: float  # [m] of the tables below
    share: NDArray[np.float64]  # cumulative share of collisions at the nodes, 0 to 1
    density: NDArray[np.float64]  # (nodes,) probability density of collisions [m-1], linear between
    bubble: NDArray[np.float64]  # (nodes,) share of bubbles among the scatterers
    expected: float  # number of collisions on the way
    stretch: NDArray[np.float64]  # (m,) lengths of slanted ways to the surface, over `distance`
    mixture: NDArray[np.float64]  # (m + 2,) shares: free paths, each stretch, fitted chains


@inlined
def _distance(nominal, u):
    """Invert the cumulative collision profile: the distance before which a share u occurs.

    Array twin: numpy.interp of the inverse; `density` is exactly its derivative.
    Inside a cell the density is linear, so that the inverse is a quadratic.
    """
    low, high = 0, len(nominal.share) - 1
    # bisection: share[low] <= u < share[high], neighbours at the end
    while high - low > 1:
        mid = (low + high) // 2
        if nominal.share[mid] <= u:
            low = mid
        else:
            high = mid
    rest = u - nominal.share[low]
    p0, p1 = nominal.density[low], nominal.density[low + 1]
    slope = (p1 - p0) / nominal.step
    # Root of p0 x + slope x^2 / 2 = rest, in the form that does not cancel for small slopes.
    return nominal.step * low + 2.0 * rest / (
        p0 + math.sqrt(max(p0 * p0 + 2.0 * slope * rest, 0.0))
    )


@entry
def make_chains(chains, nominal, medium, uniforms, component):
    """Fill chains of order K from uniforms of shape (n, 3 K + 4).

    Those of a chain are distance, polar angle and azimuth of each vertex, two for the disk, two for
    the tilt. `component` (n,) is the index in `Nominal.mixture` of what draws its distances.

    Array twin: `tests/engine/chains/test_chains.py`.
    Distances are free paths (`component` 0), sorted draws from the nominal profile, stretched
    to a slanted way (component j: by `stretch[j - 1]`), or fitted (the last component): the chain
    is scaled to end a free path below the surface, at whatever length its turns require. The
    weight divides by the density of the mixture (one-sample balance heuristic). Without stretches,
    chains longer than the shortest way have the small density of the free paths alone, and large
    weights; without fitted chains, most chains of many turns end far below the surface.
    """
    # Multiple importance sampling of the lengths of a history whose shape is drawn by the phase
    # function.
    fitted = len(nominal.stretch) + 1
    n, order, _ = chains.vertex.shape
    log_factorial = 0.0
    for k in range(2, order + 1):
        log_factorial += math.log(k)
    for i in range(n):
        u = uniforms[i]
        at = chains.vertex[i]  # at[k, 0] holds the path length of vertex k until it is placed
        for k in range(order):
            if component[i] == fitted:
                # fractions of the length; the last vertex ends it, its uniform draws the length
                _insert(at, k, u[3 * k] if k < order - 1 else 1.0)
            elif component[i] == 0:
                before = at[k - 1, 0] if k > 0 else 0.0
                at[k, 0] = before - math.log(1.0 - u[3 * k]) / nominal.c
            else:
                _insert(at, k, nominal.stretch[component[i] - 1] * _distance(nominal, u[3 * k]))
        if component[i] == fitted:
            total = _fitted_length(at, nominal, medium, u)
            for k in range(order):
                at[k, 0] *= total
        # One-sample balance heuristic (Veach and Guibas 1995): divide by the density of the whole
        # mixture, whichever component has drawn.
        total = at[order - 1, 0] if order > 0 else 0.0
        density = nominal.mixture[0] * math.exp(order * math.log(nominal.c) - nominal.c * total)
        for j in range(len(nominal.stretch)):
            stretch = nominal.stretch[j]
            if total < stretch * nominal.distance:
                # K sorted draws have the joint density K! p(x_1) ... p(x_K); logarithms, as the
                # product underflows at high orders.
                log_profile = log_factorial - order * math.log(stretch)
                for k in range(order):
                    p = lookup(nominal.density, at[k, 0] / (stretch * nominal.step))
                    log_profile += math.log(p)
                density += nominal.mixture[j + 1] * math.exp(log_profile)
        chains.path[i] = total
        weight = _place(chains, i, nominal, medium, u)
        if nominal.mixture[fitted] > 0.0 and order > 0:
            q, v = row(chains.tail, i), row(chains.last, i)
            density += nominal.mixture[fitted] * _fitted_density(q, v, total, order, nominal)
        chains.weight[i] = weight / density
        # even over the unit disk of the aperture
        r = math.sqrt(u[3 * order])
        phi = TWO_PI * u[3 * order + 1]
        chains.disk[i, 0], chains.disk[i, 1] = r * math.cos(phi), r * math.sin(phi)
        # Box and Muller: two standard normal slopes
        r = math.sqrt(-2.0 * math.log(u[3 * order + 2]))
        phi = TWO_PI * u[3 * order + 3]
        chains.tilt[i, 0], chains.tilt[i, 1] = r * math.cos(phi), r * math.sin(phi)


@inlined
def _insert(at, k, s):
    """Insert the path length s into the first k of `at`, which are sorted."""
    j = k
    while j > 0 and at[j - 1, 0] > s:
        at[j, 0] = at[j - 1, 0]
        j -= 1
    at[j, 0] = s


@outlined
def _fitted_length(at, nominal, medium, u):
    """Return the length of a chain whose open segment ends on a sphere about the source.

    The chain of unit length ends at q with the direction v; the open segment t follows the law of
    free paths up to the radius D, and the length T solves |T q + t v| = D. The spheres, one for
    each stretch but the first, pass through crossings at several distances. The uniform of the last
    distance draws sphere and t.
    """
    order = at.shape[0]
    q, d, before = ORIGIN, UP, 0.0
    for k in range(order):
        q = along(q, d, at[k, 0] - before)
        before = at[k, 0]
        d = turn(d, sample_s(medium.phase_water, u[3 * k + 1]), u[3 * k + 2])
    spheres = len(nominal.stretch) - 1
    which = u[3 * order - 3] * spheres
    sphere = min(int(which), spheres - 1)
    radius = nominal.distance * nominal.stretch[1 + sphere]
    # free path of the open segment, cut off at the radius: longer ones would overshoot the sphere
    t = -math.log1p((which - sphere) * math.expm1(-nominal.c * radius)) / nominal.c
    square = max(dot(q, q), 1e-300)
    # T^2 |q|^2 + 2 T t q.v + t^2 = D^2, solved for the positive T
    half = t * dot(q, d) / square
    return -half + math.sqrt(half * half + (radius * radius - t * t) / square)


@outlined
def _fitted_density(q, v, total, order, nominal):
    """Return the density of the path lengths of a fitted chain that ends at q along v.

    Uniform on the simplex of a total length T: (K - 1)! / T^(K - 1) p(T), with
    p(T) = p(t) |dt / dT| summed over the points where the open segment meets the spheres.
    """
    c, qv, square = nominal.c, dot(q, v), dot(q, q)
    density = 0.0
    for sphere in range(1, len(nominal.stretch)):
        radius = nominal.distance * nominal.stretch[sphere]
        disc = qv * qv - square + radius * radius
        if disc > 0.0:
            root = math.sqrt(disc)
            # |dt / dT| from the same quadratic; both points of the sphere may have led to this
            # chain.
            law = c / (-math.expm1(-c * radius) * total * root)
            for t in (root - qv, -root - qv):
                if 0.0 < t < radius:
                    density += law * math.exp(-c * t) * abs(square + t * qv)
    density /= len(nominal.stretch) - 1
    return density * math.exp(math.lgamma(order) - (order - 1.0) * math.log(total))


@inlined
def _place(chains, i, nominal, medium, u):
    """Place the vertices by the path lengths; return 1 / probability of the scatterers."""
    at = chains.vertex[i]
    p, d = ORIGIN, UP
    before = 0.0
    weight = 1.0
    for k in range(at.shape[0]):
        length = at[k, 0] - before
        before = at[k, 0]
        p = along(p, d, length)
        # by the progress along the emission, not the length: a chain that turns aside stays deeper
        share = lookup(nominal.bubble, max(p.z, 0.0) / nominal.step)
        u_theta = u[3 * k + 1]
        # One uniform chooses the scatterer and, rescaled, the angle: a dimension less for the Sobol
        # points.
        if u_theta < share:
            chains.kind[i, k] = 1
            weight /= share
            s = sample_s(medium.phase_bubble, u_theta / share)
        else:
            chains.kind[i, k] = 0
            weight /= 1.0 - share
            s = sample_s(medium.phase_water, (u_theta - share) / (1.0 - share))
        d = turn(d, s, u[3 * k + 2])
        write(at[k], p)
    write(chains.last[i], d)
    write(chains.tail[i], p)
    return weight
