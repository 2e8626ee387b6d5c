"""Weights of one path at other wavelengths, as logarithms of their ratios to its own weight.

The geometry of a path does not depend on absorption, scattering and phase function: at another
wavelength j its weight is

    ln(w_j / w) = sum_k ln(b_j p_j / b p)(z_k, theta_k) - int (c_j - c)(z) dl

over its scatterings k at depth z_k by the angle theta_k, and its way l through the water. b and p
are scattering coefficient and phase function, c is the attenuation; those without an index belong
to the base, the wavelength at which the path is traced. As functions of depth and angle, the terms
of all wavelengths are linear combinations of few common functions, called tints. A path sums up the
tints (`log_weights`), and the combinations follow at its end.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.jit import entry, inlined, outlined
from meshtrace.kernels.medium import LOG_SMALLEST, SMALLEST_ANGLE, lookup, mean_between

TINTS = 12
"""Largest number of common functions that a path sums up."""

TINT_CELLS_PER_LOG = 50.0
"""Cells of the phase functions per unit of ln(theta), from `SMALLEST_ANGLE` on: 2 % wide each."""


class Tints(NamedTuple):
    """Common functions of the wavelengths, in parts by depth and by angle, one row each.

    Those of the depth are tables on a uniform grid below z = 0, of two nodes in uniform water;
    those of the scattering angle on equal cells of its logarithm, of one cell if the phase
    functions of all wavelengths are equal.
    """

    step: float  # of the depth [m]
    c: NDArray[np.float64]  # (tints, nodes) difference of attenuation to the base's [m-1]
    c_path: NDArray[np.float64]  # its integral from z = 0 [1]
    b: NDArray[np.float64]  # (tints, nodes) logarithm of the scattering coefficient over the base's
    phase: NDArray[np.float64]  # (tints, cells) logarithm of the phase function over the base's
    bubble_c: NDArray[np.float64]  # (tints,) excess attenuation by bubbles, over the base's
    bubble: NDArray[np.float64]  # (tints, cells) logarithm of b p of the bubbles


NO_TINTS = None
"""Paths of one wavelength: kernels are compiled without sums for the type of None."""


@inlined
def reset_tint(tints, log_weights):
    """Set the sums of a path to zero.

    Array twin: `log_weights[:] = 0`.
    """
    if tints is not None:
        for r in range(len(tints.c)):
            log_weights[r] = 0.0


@inlined
def copy_tint(tints, log_weights, out):
    """Copy the sums of a path to `out`.

    Array twin: `out[:] = log_weights`.
    """
    if tints is not None:
        for r in range(len(tints.c)):
            out[r] = log_weights[r]


@outlined
def tint_way(tints, log_weights, z0, z1, length):
    """Add a straight path through the water, from height z0 to z1, to the sums.

    Array twin: direct runs of the wavelengths.
    """
    if tints is not None:
        # Nearly all links are in uniform water, whose two nodes need no interpolation.
        uniform = tints.c.shape[1] == 2
        for r in range(len(tints.c)):
            c = tints.c[r, 0]
            if not uniform:
                c = mean_between(tints.c[r], tints.c_path[r], tints.step, -z0, -z1)
            # -int (c_j - c) dl of the law of Beer and Lambert
            log_weights[r] -= length * c


@outlined
def tint_scattering(tints, log_weights, z, theta, by_bubble):
    """Add a scattering at height z by the angle theta [rad], by the water or a bubble, to the sums.

    Array twin: direct runs of the wavelengths.
    """
    if tints is not None:
        j, cells = 0, tints.phase.shape[1]
        if cells > 1:
            log = math.log(max(theta, SMALLEST_ANGLE))
            j = min(max(int((log - LOG_SMALLEST) * TINT_CELLS_PER_LOG), 0), cells - 1)
        for r in range(len(tints.c)):
            if by_bubble:
                log_weights[r] += tints.bubble[r, j]
            else:
                log_weights[r] += lookup(tints.b[r], -z / tints.step) + tints.phase[r, j]


class Mixture(NamedTuple):
    """Weights at all wavelengths of paths traced at one of several bases, by the balance heuristic.

    At wavelength j a path of base k with the sums t counts its weight times
    exp(t . shares_j) d_k / sum_i parts_i d_i, where d_i = exp(density_i . t) is the probability
    density of the path at base i, but for a common factor.
    """

    shares: NDArray[np.float64]  # (tints, wavelengths) logarithms of weights over the base's
    density: NDArray[np.float64]  # (bases, tints)
    parts: NDArray[np.float64]  # (bases,) shares of the photons traced at each base, of sum 1
    base: int  # index k


ALONE = Mixture(np.zeros((0, 1)), np.zeros((1, 0)), np.ones(1), 0)
"""Paths of one base at its own wavelength."""


@inlined
def balance(mixture, log_weights):
    """Return the factor of the balance heuristic on a path.

    Array twin: `Tinting.mixed`.
    """
    # Veach and Guibas (1995), doi:10.1145/218380.218498: d_k / sum_i n_i d_i
    total, base_density = 0.0, 1.0
    for k in range(len(mixture.density)):
        log = 0.0
        for r in range(mixture.density.shape[1]):
            log += mixture.density[k, r] * log_weights[r]
        density = math.exp(log)
        total += mixture.parts[k] * density
        if k == mixture.base:
            base_density = density
    return base_density / total


@inlined
def fill_factors(mixture, log_weights, factors):
    """Write the factors of all wavelengths over the base on a path to row 0 of `factors`.

    Array twin: `Tinting.factors`.
    `factors` has the shape (2, wavelengths): row 1 is scratch for `exponentiate`.
    """
    factors[0, :] = 0.0
    _add_tint(mixture, log_weights, factors)


@inlined
def _add_tint(mixture, log_weights, factors):
    """Add the logarithms of a path to those in row 0 of `factors`, and exponentiate the sums."""
    logs = factors[0]
    for r in range(len(mixture.shares)):
        summed, row = log_weights[r], mixture.shares[r]
        for c in range(len(logs)):
            logs[c] += summed * row[c]
    exponentiate(logs, factors[1])


@entry
def add_tinted(arrivals, group, mixture, step, log, phase, factors, out):
    """Add recorded light, at all wavelengths, to the sums of groups of photons.

    Array twin: `Tinting.mixed`.
    The factors of the last scattering, `log` and `phase`, are linear between nodes, and go on along
    a straight line below the last depth.

    Parameters
    ----------
    arrivals : ndarray of `ARRIVAL`
        Recorded light. Backward photons record the height of the last scattering [m] in `air` and
        its angle [rad] in `water`.
    group : ndarray, shape (photons,)
        Group of each photon.
    mixture : Mixture
        Base of the photons, and factors of the wavelengths.
    step : float
        Step of the depth in `log` [m].
    log : ndarray, shape (nodes, wavelengths)
        Logarithm of the factor of the depth of the last scattering.
    phase : ndarray, shape (angles, wavelengths)
        Factor of its angle, from 0 to pi.
    factors : ndarray, shape (2, wavelengths)
        Scratch, as of `fill_factors`.
    out : ndarray, shape (groups, wavelengths)
        Sums, added to.
    """
    per_angle = (len(phase) - 1) / math.pi
    for i in range(len(arrivals)):
        a = arrivals[i]
        # Each base alone would give the whole light: the heuristic shares it between them.
        weight = a.weight * balance(mixture, a.tint)
        position = max(-a.air, 0.0) / step
        j = min(int(position), len(log) - 2)
        # f and g: fractions of the steps in depth and in angle
        f, angle = position - j, a.water * per_angle
        m = min(max(int(angle), 0), len(phase) - 2)
        g = angle - m
        logs, sums = factors[0], out[group[a.photon]]
        above, below = log[j], log[j + 1]
        for c in range(len(logs)):
            logs[c] = (1.0 - f) * above[c] + f * below[c]
        _add_tint(mixture, a.tint, factors)
        smaller, larger = phase[m], phase[m + 1]
        for c in range(len(logs)):
            sums[c] += weight * logs[c] * ((1.0 - g) * smaller[c] + g * larger[c])


@inlined
def is_tinted(tints):
    """Return whether paths sum up functions, for which scattering angles are computed.

    Array twin: none.
    """
    return tints is not None


def common_functions(
    functions: NDArray[np.float64], exact: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return coefficients (n, k) and common functions (k, nodes) of functions (n, nodes).

    functions ~ coefficients @ common functions, of as few as leave no element an error above
    `exact`: singular vectors, of the coefficients in an orthogonal basis by pivoted Gram-Schmidt.
    Products by einsum, as the threads of a linear algebra library would cost more.
    """
    # Pivoted: the largest remainder becomes the next vector, so that few of them reach the error.
    rest, basis, parts = functions.copy(), list[NDArray[np.float64]](), list[NDArray[np.float64]]()
    while len(basis) < len(functions) and np.abs(rest).max() > 1e-3 * exact:
        first = rest[np.argmax(np.einsum("ij,ij->i", rest, rest))]
        basis.append(first / math.sqrt(float(np.einsum("j,j", first, first))))
        parts.append(np.einsum("ij,j->i", rest, basis[-1]))
        rest -= parts[-1][:, None] * basis[-1]
    if not basis:
        return np.zeros((len(functions), 1)), np.zeros((1, functions.shape[1]))
    # The singular vectors of the coefficients give the best approximation of each rank.
    u, s, v = np.linalg.svd(np.transpose(parts), full_matrices=False)
    functions, rest = np.einsum("ik,kj->ij", v, np.array(basis)), functions.copy()
    for k in range(len(s)):
        rest -= (u[:, k] * s[k])[:, None] * functions[k]
        if np.abs(rest).max() <= exact:
            break
    return u[:, : k + 1] * s[: k + 1], functions[: k + 1]


_MOST = 700.0  # exp(710) would overflow, and exp(-709) lose digits
_PER_LN2 = 1.0 / math.log(2.0)
# ln 2 as a sum, the first part with so many zero bits at its end that k times it is exact
_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
_ROUNDS = 1.5 * 2.0**52  # a sum with it is rounded to a whole number, which its lowest bits hold
_BIAS, _FRACTION_BITS = 1023, 52  # of IEEE 754 double precision
_C2, _C3, _C4, _C5, _C6, _C7, _C8, _C9, _C10, _C11, _C12 = (
    1.0 / math.factorial(k) for k in range(2, 13)
)


@inlined
def exponentiate(x, powers):
    """Replace numbers (n,) by their exponentials, to 3e-16; those beyond +-700 by the one there.

    Array twin: `numpy.exp`.
    Why so: exp(x) = 2^k exp(r), |r| <= ln(2) / 2 (Cody and Waite 1980), and a polynomial in r have
    no branch and no table, in contrast to the C library: a row of 32 takes less than half of the
    time.

    Parameters
    ----------
    x : ndarray, shape (n,)
        Numbers.
    powers : ndarray, shape (n,)
        Scratch for powers of two.
    """
    bits = powers.view(np.int64)  # the same memory as integers
    for c in range(len(x)):
        # exp(x) = 2^k exp(r): k = round(x / ln 2) by adding and subtracting 1.5 * 2^52, which
        # leaves k in the lowest bits of `rounded`, and r = x - k ln 2 in two steps that lose no
        # digit.
        limited = min(max(x[c], -_MOST), _MOST)
        rounded = limited * _PER_LN2 + _ROUNDS
        k = rounded - _ROUNDS
        r = (limited - k * _LN2_HIGH) - k * _LN2_LOW
        r2 = r * r
        # Estrin's scheme: terms in pairs, which a processor evaluates side by side.
        low = (_C2 + _C3 * r) + (_C4 + _C5 * r) * r2
        high = (_C6 + _C7 * r) + (_C8 + _C9 * r) * r2
        high += ((_C10 + _C11 * r) + _C12 * r2) * (r2 * r2)
        x[c] = 1.0 + (r + r2 * (low + high * (r2 * r2)))
        powers[c] = rounded
    for c in range(len(x)):
        # 2^k as bits of IEEE 754: the exponent k + 1023 above 52 bits of fraction.
        bits[c] = (bits[c] + _BIAS) << _FRACTION_BITS
    for c in range(len(x)):
        x[c] *= powers[c]
