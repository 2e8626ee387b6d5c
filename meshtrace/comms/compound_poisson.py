"""Exact law of filtered photon counts: a compound Poisson variable, inverted by FFT.

The Gaussian models take mean and variance of the receiver's sample. This is the law itself: every
count adds g(age) times its number of avalanches, and counts of different ages are independent.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from meshtrace.comms.pulses import PulseFilters
from meshtrace.models import Floats

ComplexArray = NDArray[np.complex128]

_POINTS = 2**16
_INDEX = np.arange(_POINTS // 2 + 1)


def compound_poisson_decision(
    low: float,
    high: float,
    filters: PulseFilters,
    bit_time: float,
    removed: Floats,
    branching: float,
    thermal_std: float,
) -> tuple[float, float]:
    """Decide between zeros and ones in filtered shot noise, without Gaussian assumption.

    ln E exp(-i w X) = sum over counts of [B(exp(-i w (1 - lam) g)) - 1] - (w s_th)^2 / 2,

    B the generating function of the Borel law; random earlier bits average the characteristic
    function, exactly.

    Parameters
    ----------
    low, high : float
        Primary counts during long zeros and long ones [s-1], 0 < low < high.
    filters : PulseFilters
        Poles and window.
    bit_time : float
        T [s].
    removed : ndarray
        Mean that an equaliser takes off for each of the present and earlier bits that was a one
        (memory,) [s-1]; its length is the number of bits that matter.
    branching : float
        Mean number of direct secondaries per avalanche, 0 <= lam < 1.
    thermal_std : float
        Standard deviation of the Gaussian noise in the sample [s-1], > 0.

    Returns
    -------
    tuple of float
        Bit error rate, with an absolute error of some 1e-12, and threshold [s-1].

    Notes
    -----
    The amplitudes of single counts are rounded to a lattice of 65536 values that spans the
    sample's range.
    """
    share = 1.0 - branching
    top = low + (high - low) * float(filters.mean_step(bit_time * removed.size))
    spread = math.sqrt(top * filters.noise_energy / share)
    below = 8.0 * thermal_std + float(removed.sum())
    reach = top + 12.0 * spread + 30.0 * share * filters.peak + 8.0 * thermal_std
    step = (reach + below) / _POINTS
    frequency = 2.0 * math.pi * np.fft.rfftfreq(_POINTS, step)
    borel = _borel(branching)
    amplitudes = (np.arange(1, math.ceil(share * filters.peak / step) + 1) - 0.5) * step / share
    young, old = filters.ages_above(np.minimum(amplitudes, filters.peak))

    def exponent(light: Callable[[Floats], Floats]) -> ComplexArray:
        # Counts whose response lies between two edges of the lattice.
        counts = np.zeros(_POINTS)
        above = light(old) - light(young)
        counts[1 : above.size + 1] = above - np.append(above[1:], 0.0)
        spectrum = np.fft.fft(counts)
        branched = sum(p * spectrum[(m * _INDEX) % _POINTS] for m, p in enumerate(borel, 1))
        return np.asarray(branched - counts.sum())

    zero = np.exp(
        exponent(lambda age: low * age)
        - 0.5 * (thermal_std * frequency) ** 2
        - 1j * frequency * math.ceil(below / step) * step
    )

    def bit(ago: int) -> ComplexArray:
        light = exponent(lambda age: (high - low) * filters.light_since(age, ago, bit_time))
        return np.asarray(np.exp(light + 1j * frequency * removed[ago]))

    for ago in range(1, removed.size):
        zero = zero * 0.5 * (1.0 + bit(ago))
    one = zero * bit(0)
    ber, index = _least_error(np.fft.irfft(zero, _POINTS), np.fft.irfft(one, _POINTS))
    return ber, (index - 0.5 - math.ceil(below / step)) * step


def _borel(branching: float) -> Floats:
    """Return the probabilities of 1, 2, ... avalanches per primary, down to 1e-16, of sum 1."""
    from scipy.special import gammaln

    m = np.arange(1, 400)
    if branching == 0.0:
        return np.ones(1)
    p = np.exp(-branching * m + (m - 1) * np.log(branching * m) - gammaln(m + 1))
    kept = p[p > 1e-16]
    return np.asarray(kept / kept.sum())


def _least_error(zero: Floats, one: Floats) -> tuple[float, int]:
    """Return the error rate of the best threshold, and the lowest lattice point above it."""
    missed = np.concatenate(([0.0], np.cumsum(one)))
    false = np.concatenate((np.cumsum(zero[::-1])[::-1], [0.0]))
    index = int(np.argmin(missed + false))
    return max(0.5 * float(missed[index] + false[index]), 0.0), index
