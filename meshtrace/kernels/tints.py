"""Weights of one path at other wavelengths, as logarithms of their ratios to its own weight.

The geometry of a path does not depend on absorption, scattering and phase function: at another
wavelength j its weight is

    ln(w_j / w) = sum_k ln(b_j p_j / b p)(z_k, theta_k) - int (c_j - c)(z) dl

over its scatterings k and its way through the water. The functions of all wavelengths are
combinations of few common ones, which a path sums up.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.exponentials import exponentiate
from meshtrace.kernels.jit import entry, inlined, outlined
from meshtrace.kernels.medium import lookup, mean_between
from meshtrace.kernels.phase import SMALLEST_ANGLE

TINTS = 12
"""Common functions that a photon sums up at most."""


class Tints(NamedTuple):
    """Common functions of the wavelengths, one row each.

    Those of the depth are tables on a uniform grid below z = 0, of two nodes in uniform water,
    those of the scattering angle on equal cells of its logarithm, or one for equal functions.
    """

    step: float  # [m]
    c: NDArray[np.float64]  # (tints, nodes) attenuation [m-1]
    c_path: NDArray[np.float64]  # its integral from z = 0
    b: NDArray[np.float64]  # (tints, nodes) logarithm of the scattering coefficient
    phase: NDArray[np.float64]  # (tints, cells) logarithm of the phase function
    bubble_c: NDArray[np.float64]  # (tints,) attenuation by bubbles, over their own
    bubble: NDArray[np.float64]  # (tints, cells) logarithm of b p of the bubbles
    log_first: float
    per_log: float


NO_TINTS = None
"""Paths of one wavelength: a type of its own, for which kernels are compiled without any sums."""


@inlined
def reset_tint(tints, tint):
    """Start the sums of a path.

    Array twin: `tint[:] = 0`.
    """
    if tints is not None:
        for r in range(len(tints.c)):
            tint[r] = 0.0


@inlined
def copy_tint(tints, tint, out):
    """Write the sums of a path.

    Array twin: `out[:] = tint`.
    """
    if tints is not None:
        for r in range(len(tints.c)):
            out[r] = tint[r]


@inlined
def tint_way(tints, tint, z0, z1, length):
    """Add a straight way through the water from height z0 to z1.

    Array twin: direct runs of the wavelengths.
    """
    if tints is not None:
        _add_way(tints, tint, z0, z1, length)


@outlined
def _add_way(tints, tint, z0, z1, length):
    """Add a way, see `tint_way`."""
    if tints.c.shape[1] == 2:  # a uniform water
        for r in range(len(tints.c)):
            tint[r] -= length * tints.c[r, 0]
        return
    for r in range(len(tints.c)):
        tint[r] -= length * mean_between(tints.c[r], tints.c_path[r], tints.step, -z0, -z1)


@inlined
def tint_cell(tints, theta):
    """Return the cell of a scattering angle.

    Array twin: numpy.searchsorted in the edges.
    """
    if tints.phase.shape[1] == 1:
        return 0
    j = int((math.log(max(theta, SMALLEST_ANGLE)) - tints.log_first) * tints.per_log)
    return min(max(j, 0), tints.phase.shape[1] - 1)


@inlined
def tint_scattering(tints, tint, z, theta, by_bubble):
    """Add a scattering by the water at height z, or by a bubble.

    Array twin: direct runs of the wavelengths.
    """
    if tints is not None:
        _add_scattering(tints, tint, z, theta, by_bubble)


@outlined
def _add_scattering(tints, tint, z, theta, by_bubble):
    """Add a scattering, see `tint_scattering`."""
    j = tint_cell(tints, theta)
    for r in range(len(tints.c)):
        if by_bubble:
            tint[r] += tints.bubble[r, j]
        else:
            tint[r] += lookup(tints.b[r], -z / tints.step) + tints.phase[r, j]


class Mixture(NamedTuple):
    """Weights of the paths of one of several bases in turn, by the balance heuristic.

    A path of sums t counts at wavelength j exp(t . shares_j) d_k / sum_i parts_i d_i times its
    weight, with the densities d_i = exp(density_i . t) of the bases, of which k drew it.
    """

    shares: NDArray[np.float64]  # (tints, wavelengths) over the base
    density: NDArray[np.float64]  # (bases, tints)
    parts: NDArray[np.float64]  # (bases,) of the photons
    base: int


ALONE = Mixture(np.zeros((0, 1)), np.zeros((1, 0)), np.ones(1), 0)
"""Paths of one base at its own wavelength."""


@inlined
def balance(mixture, tint):
    """Return the factor of the balance heuristic on a path.

    Array twin: `Tinting.mixed`.
    """
    total, own = 0.0, 1.0
    for k in range(len(mixture.density)):
        log = 0.0
        for r in range(mixture.density.shape[1]):
            log += mixture.density[k, r] * tint[r]
        drawn = math.exp(log)
        total += mixture.parts[k] * drawn
        if k == mixture.base:
            own = drawn
    return own / total


class Factors(NamedTuple):
    """Scratch for the factors of all wavelengths on one path."""

    values: NDArray[np.float64]  # (wavelengths,)
    powers: NDArray[np.float64]  # (wavelengths,)
    bits: NDArray[np.int64]  # the same memory


def factors_of(wavelengths: int) -> Factors:
    """Return scratch for a number of wavelengths."""
    powers = np.empty(wavelengths)
    return Factors(np.empty(wavelengths), powers, powers.view(np.int64))


@inlined
def fill_factors(mixture, tint, factors):
    """Write the factors of all wavelengths over the base on a path.

    Array twin: `Tinting.factors`.
    """
    logs = factors.values
    logs[:] = 0.0
    for r in range(len(mixture.shares)):
        add_scaled(logs, tint[r], mixture.shares[r])
    exponentiate(logs, factors.powers, factors.bits)


@inlined
def add_scaled(out, factor, row):
    """Add a multiple of a row.

    Array twin: `out += factor * row`.
    """
    for c in range(len(out)):
        out[c] += factor * row[c]


class LastScattering(NamedTuple):
    """Factors of the wavelengths on light that a last event brings to a path, over the base's.

    Tables that are linear between nodes, in the depth and in the angle; the last two nodes of the
    depth hold below them, too.
    """

    step: float  # of the depth [m]
    log: NDArray[np.float64]  # (nodes, wavelengths)
    phase: NDArray[np.float64]  # (angles, wavelengths) from 0 to pi


@entry
def add_tinted(light, score, group, mixture, last, factors, out):
    """Add kept light at all wavelengths to groups.

    Array twin: `Tinting.mixed`.

    Parameters
    ----------
    light, score : ndarray of `ARRIVAL`, int
        Kept light, and which of it counts; `air` is the height [m], `water` the angle [rad].
    group : ndarray, shape (photons,)
        Group of each photon.
    mixture : Mixture
        Base of the photons, and wavelengths.
    last : LastScattering
        Factors of the last event.
    factors : Factors
        Scratch.
    out : ndarray, shape (groups, wavelengths)
        Sums.
    """
    per_angle = (len(last.phase) - 1) / math.pi
    for i in range(len(light)):
        a = light[i]
        if a.receiver != score:
            continue
        weight = a.weight * balance(mixture, a.tint)
        at = max(-a.air, 0.0) / last.step
        j = min(int(at), len(last.log) - 2)
        f, angle = at - j, a.water * per_angle
        m = min(max(int(angle), 0), len(last.phase) - 2)
        g = angle - m
        logs, sums = factors.values, out[group[a.photon]]
        above, below = last.log[j], last.log[j + 1]
        for c in range(len(logs)):
            logs[c] = (1.0 - f) * above[c] + f * below[c]
        for r in range(len(mixture.shares)):
            add_scaled(logs, a.tint[r], mixture.shares[r])
        exponentiate(logs, factors.powers, factors.bits)
        smaller, larger = last.phase[m], last.phase[m + 1]
        for c in range(len(logs)):
            sums[c] += weight * logs[c] * ((1.0 - g) * smaller[c] + g * larger[c])


@inlined
def is_tinted(tints):
    """Return whether paths sum up functions, which ask for scattering angles.

    Array twin: none.
    """
    return tints is not None


def common_functions(
    rows: NDArray[np.float64], exact: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return coefficients (rows, k) and common functions (k, nodes) of rows.

    As few as `exact` allows, the largest error of an element: singular vectors, of the coefficients
    of an orthogonal basis by pivoted Gram-Schmidt. Threads of a linear algebra library would cost
    more.
    """
    rest, basis, parts = rows.copy(), list[NDArray[np.float64]](), list[NDArray[np.float64]]()
    while len(basis) < len(rows) and np.abs(rest).max() > 1e-3 * exact:
        first = rest[np.argmax(np.einsum("ij,ij->i", rest, rest))]
        basis.append(first / math.sqrt(float(np.einsum("j,j", first, first))))
        parts.append(np.einsum("ij,j->i", rest, basis[-1]))
        rest -= parts[-1][:, None] * basis[-1]
    if not basis:
        return np.zeros((len(rows), 1)), np.zeros((1, rows.shape[1]))
    u, s, v = np.linalg.svd(np.transpose(parts), full_matrices=False)
    functions, rest = np.einsum("ik,kj->ij", v, np.array(basis)), rows.copy()
    for k in range(len(s)):
        rest -= (u[:, k] * s[k])[:, None] * functions[k]
        if np.abs(rest).max() <= exact:
            break
    return u[:, : k + 1] * s[: k + 1], functions[: k + 1]
