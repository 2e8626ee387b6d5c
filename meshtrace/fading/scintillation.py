"""The scintillation index, free of Monte Carlo noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from meshtrace.errors import require_seed, require_whole
from meshtrace.fading.gains import FloatArray, check_bootstrap, checked
from meshtrace.fading.intervals import Estimate, block_interval, block_means

# Below this number the jackknife of the BCa bootstrap has too little to work on.
_FEWEST_ACCELERATED = 8
# Bound of memory: gains resampled at a time.
_BATCH_ELEMENTS = 1_000_000


def scintillation_index(
    gain: ArrayLike,
    gain_stderr: ArrayLike | None = None,
    *,
    block: int = 1,
    confidence: float = 0.95,
    resamples: int = 1999,
    seed: int = 1,
) -> Estimate:
    r"""Return the scintillation index, Monte Carlo variance removed, with its interval.

    .. math:: \mathrm{SI} = (\mathrm{Var}(g) - \overline{s^2}) / \overline{g}^2

    Parameters
    ----------
    gain : array_like, shape (n,)
        Channel gains [1].
    gain_stderr : array_like, shape () or (n,), optional
        Independent standard error of each gain [1].
    block : int, optional
        Block length [samples]: 1 for independent gains, `block_length(gain)` for a series.
    confidence : float, optional
        Level of the interval [1].
    resamples, seed : int, optional
        Number and seed of the bootstrap replicates.

    Returns
    -------
    Estimate
        Index [1] and its limits. With the noise removed it is unbiased, hence negative at times
        where there is no fading.

    Raises
    ------
    Refused
        If a value is negative or not finite, or an option is out of range.

    Notes
    -----
    Var divides by n - 1. Independent gains: bias-corrected accelerated (BCa) bootstrap of the
    pairs (gain, error), below 8 gains its percentiles. Series: moving blocks; the index of a
    short record is low by about SI / n_eff, see `effective_samples`. Heavy tails (SI above 0.3)
    need thousands of samples before any such interval covers as often as it says.

    References
    ----------
    Efron, B. (1987), doi:10.1080/01621459.1987.10478410. Künsch, H. R. (1989),
    doi:10.1214/aos/1176347265.

    Examples
    --------
    >>> si = scintillation_index([0.9, 1.1, 1.0, 0.8, 1.2], 0.05)
    >>> round(si.value, 4)
    0.0225
    """
    g, noise = checked(gain, gain_stderr)
    check_bootstrap(confidence, resamples)
    require_whole(block, 1, g.size // 2, "block")
    noise = noise / g.mean() ** 2
    g = g / g.mean()
    value = float(_scintillation(g, noise))
    if np.ptp(g) == 0.0:
        return Estimate(value, value, value)
    if block == 1:
        return _accelerated_interval(value, g, noise, confidence, resamples, seed)
    mean, square = block_means((g, g**2), block, resamples, seed)
    raw = (square / mean**2 - 1.0) * g.size / (g.size - 1.0)
    seen = block_interval(float(_scintillation(g, 0.0 * g)), raw, g.size / block, confidence)
    return Estimate(value, seen.low - float(noise.mean()), seen.high - float(noise.mean()))


def _scintillation(g: FloatArray, noise: FloatArray, axis: int = -1) -> FloatArray:
    excess, mean = g.var(axis, ddof=1) - noise.mean(axis), g.mean(axis)
    # A resample of blocked links alone has no light: count it as no fading.
    return np.divide(excess, mean**2, out=np.zeros_like(mean), where=mean > 0.0)


def _accelerated_interval(
    value: float, g: FloatArray, noise: FloatArray, confidence: float, resamples: int, seed: int
) -> Estimate:
    require_seed(seed)
    from scipy import stats

    interval = stats.bootstrap(
        (g, noise),
        _scintillation,
        paired=True,
        vectorized=True,
        confidence_level=confidence,
        n_resamples=resamples,
        batch=max(1, _BATCH_ELEMENTS // g.size),
        method="BCa" if g.size >= _FEWEST_ACCELERATED else "percentile",
        random_state=np.random.default_rng(seed),
    ).confidence_interval
    return Estimate(value, float(interval.low), float(interval.high))
