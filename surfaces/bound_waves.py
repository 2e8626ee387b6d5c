"""Bound waves: the second order of a deep-water sea at fixed points, as further plane waves."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from meshtrace.errors import Described, Refused

from .parameters import Floats
from .waves import WaveComponents

NEGLIGIBLE = 1e-4
"""Share of the variance of the bound waves, in elevation and in curvature, that is left out."""

MOST_PAIRS = 4_000_000
"""Bound waves before the small ones are left out, beyond which a sea is refused."""


def interaction_kernels(
    kx: ArrayLike, ky: ArrayLike, other_kx: ArrayLike, other_ky: ArrayLike
) -> tuple[Floats, Floats]:
    r"""Return the kernels K- and K+ [rad m-1] of pairs of deep-water waves.

    .. math::

       K^\mp = (D^\mp - (k_i \cdot k_j \pm k_i k_j)) / \sqrt{k_i k_j} + k_i + k_j, \quad
       D^\mp = \frac{2 (\sqrt{k_i} \mp \sqrt{k_j})^2 (k_i \cdot k_j \pm k_i k_j)}
                    {(\sqrt{k_i} \mp \sqrt{k_j})^2 - |\vec k_i \mp \vec k_j|}

    Parameters
    ----------
    kx, ky : array_like
        Wave vectors of the first waves [rad m-1], not zero.
    other_kx, other_ky : array_like
        Wave vectors of the second waves [rad m-1], not zero; all are broadcast.

    Returns
    -------
    k_minus, k_plus : ndarray
        Kernels of the difference and of the sum wave. K- is 0 for equal wave vectors: there is
        no change of the mean level. Waves of one direction have K+ = ki + kj and
        K- = -\|ki - kj\|.

    Notes
    -----
    Gravity waves, omega^2 = g k.

    References
    ----------
    Longuet-Higgins (1963), J. Fluid Mech. 17, 459-480. Sharma and Dean (1981), Soc. Petroleum
    Eng. J. 21, 129-140.

    Examples
    --------
    >>> minus, plus = interaction_kernels(1.0, 0.0, 0.5, 0.0)
    >>> round(float(minus), 12), round(float(plus), 12)
    (-0.5, 1.5)
    """
    kx, ky, px, py = (np.asarray(a, dtype=np.float64) for a in (kx, ky, other_kx, other_ky))
    ki, kj = np.hypot(kx, ky), np.hypot(px, py)
    dot, product = kx * px + ky * py, ki * kj
    root, linear = np.sqrt(product), ki + kj
    kernels = []
    for sign in (-1.0, 1.0):
        beat = (np.sqrt(ki) + sign * np.sqrt(kj)) ** 2
        bottom = beat - np.hypot(kx + sign * px, ky + sign * py)
        projected = dot - sign * product
        # equal waves: 0 / 0, whose limit is 0
        ratio = np.divide(beat, bottom, out=np.zeros_like(bottom), where=bottom != 0.0)
        kernels.append((2.0 * ratio - 1.0) * projected / root + linear)
    return kernels[0], kernels[1]


def with_bound_waves(free: WaveComponents, omega_max: float, most: int) -> WaveComponents:
    r"""Return waves with the bound waves of all pairs of them up to a frequency.

    .. math::

       \eta_2 = \tfrac14 \sum_{ij} a_i a_j [K^-_{ij} \cos(\phi_i - \phi_j)
                + K^+_{ij} \cos(\phi_i + \phi_j)]

    Parameters
    ----------
    free : WaveComponents
        The waves of first order.
    omega_max : float
        Highest frequency of a wave of a pair [rad s-1].
    most : int
        Largest number of bound waves.

    Returns
    -------
    WaveComponents
        The free waves and then the bound ones, with signed amplitudes.

    Raises
    ------
    Refused
        If there are too many bound waves.

    Notes
    -----
    The smallest bound waves are left out, as long as they carry 1e-4 of the variance of the
    elevation *and* of the curvature (a^2 and a^2 k^4) of all bound waves. This depends on the
    amplitudes alone: seas that differ in phases have the same bound waves.
    """
    chosen = np.flatnonzero((free.amplitude != 0.0) & (free.omega <= omega_max))
    n = len(chosen)
    if n * (n + 1) > MOST_PAIRS:
        found = Described(f"{omega_max:g} rad/s makes {n * (n + 1)} bound waves")
        raise Refused("order_omega_max", found, f"at most {MOST_PAIRS}, small ones included")
    first, second = (chosen[index] for index in np.triu_indices(n))
    k_minus, k_plus = interaction_kernels(
        free.kx[first], free.ky[first], free.kx[second], free.ky[second]
    )
    product = 0.5 * free.amplitude[first] * free.amplitude[second]
    pairs = (1.0, np.where(first == second, 0.5, 1.0) * k_plus), (-1.0, k_minus)
    parts = []
    for sign, kernel in pairs:
        bound = WaveComponents(product * kernel, *(a[first] + sign * a[second] for a in free[1:]))
        # cos is even: the frequency of a difference wave is made positive
        turn = np.where(bound.omega < 0.0, -1.0, 1.0)
        parts.append(WaveComponents(bound.amplitude, *(turn * a for a in bound[1:])))
    bound = WaveComponents(*(np.concatenate(pair) for pair in zip(*parts, strict=True)))
    kept = _largest(bound)
    if len(kept) > most:
        found = Described(f"{omega_max:g} rad/s makes {len(kept)} bound waves")
        raise Refused("order_omega_max", found, f"at most {most} bound waves")
    return WaveComponents(*(np.concatenate([a, b[kept]]) for a, b in zip(free, bound, strict=True)))


def _largest(bound: WaveComponents) -> np.ndarray:
    """Return the indices of the waves with a relevant share of some variance."""
    kept = np.zeros(len(bound.amplitude), dtype=bool)
    for power in (0, 2):
        variance = bound.amplitude**2 * (bound.kx**2 + bound.ky**2) ** power
        order = np.argsort(variance, kind="stable")
        small = np.cumsum(variance[order]) <= NEGLIGIBLE * variance.sum()
        kept[order[~small]] = True
    return np.flatnonzero(kept & (bound.amplitude != 0.0))
