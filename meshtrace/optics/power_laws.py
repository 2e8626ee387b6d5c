"""Densities over s = sin^2(theta / 2) that are power laws between nodes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.errors import Described, Refused
from meshtrace.models import Floats


class Segments(NamedTuple):
    """Pieces s_lo < s <= s_hi with a density in s that goes as s^(p - 1), and their masses.

    All arrays have shape (n,), in increasing s from 0 to 1; the masses are probabilities.
    """

    s_lo: Floats
    s_hi: Floats
    p: Floats
    mass: Floats

    @classmethod
    def from_densities(cls, s_lo: Floats, s_hi: Floats, p: Floats, at_hi: Floats) -> Segments:
        """Return pieces with the densities `at_hi` (in any unit) at s_hi, normalised."""
        # the masses here are placeholders: `_integral` does not use them
        pieces = cls(s_lo, s_hi, p, at_hi)
        mass = at_hi * s_hi * pieces._integral
        return pieces._replace(mass=mass / mass.sum())

    @property
    def _integral(self) -> Floats:
        """Integral of x^(p - 1) over a piece, where x = s / s_hi."""
        return power_integral(self.p, self.s_lo / self.s_hi)

    def pdf(self, s: Floats) -> Floats:
        """Return the phase function [1/sr] at s."""
        i = self._index(s)
        with np.errstate(divide="ignore"):
            shape = (s / self.s_hi[i]) ** (self.p[i] - 1.0)
        # value at s_hi, from mass = 4 pi pdf(s_hi) s_hi integral
        scale = self.mass / (4.0 * np.pi * self.s_hi * self._integral)
        return scale[i] * shape

    def cdf(self, s: Floats) -> Floats:
        """Return the probability of scattering to s or less."""
        i = self._index(s)
        above = power_integral(self.p[i], s / self.s_hi[i])
        # fraction of the piece's mass between s and s_hi
        fraction = above / self._integral[i]
        return np.cumsum(self.mass)[i] - fraction * self.mass[i]

    def quantile(self, u: Floats) -> Floats:
        """Return s at the cumulative probabilities u, the inverse of `cdf`."""
        # rounding may leave u above the last sum: the search must not end in a piece without mass
        top, last = np.cumsum(self.mass), np.flatnonzero(self.mass)[-1]
        i = np.minimum(np.searchsorted(top, u, side="right"), last)
        above = np.clip((top[i] - u) / self.mass[i], 0.0, 1.0) * self._integral[i]
        # `power_integral` solved for its lower end: above = (1 - x^p) / p with x = s / s_hi
        with np.errstate(divide="ignore", invalid="ignore"):
            log_x = np.log1p(-self.p[i] * above) / self.p[i]
        return self.s_hi[i] * np.exp(np.where(self.p[i] == 0.0, -above, log_x))

    def mean(self) -> float:
        """Return the mean of s."""
        first_moment = power_integral(self.p + 1.0, self.s_lo / self.s_hi)
        return float(np.sum(self.mass * self.s_hi * first_moment / self._integral))

    def _index(self, s: Floats) -> NDArray[np.intp]:
        """Return the index of the piece that holds s."""
        return np.minimum(np.searchsorted(self.s_hi, s, side="left"), len(self.s_hi) - 1)


def power_integral(p: Floats, ratio: Floats) -> Floats:
    """Integrate x^(p - 1) from `ratio` >= 0 to 1."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        log_ratio = np.log(ratio)
        return np.where(p == 0.0, -log_ratio, -np.expm1(p * log_ratio) / p)


def power_law_segments(s: Floats, value: Floats) -> Segments:
    """Join the points (s, value) by power laws, extrapolate them to s = 0 and 1, and normalise."""
    slope = np.diff(np.log(value)) / np.diff(np.log(s))
    p = 1.0 + np.concatenate([slope[:1], slope, slope[-1:]])
    # Rounding of the logarithms must not decide whether the law has an integral (p > 0), or whether
    # a flat table (p = 1) stays finite at s = 0.
    p[np.abs(p) < 1e-7] = 0.0
    p[np.abs(p - 1.0) < 1e-7] = 1.0
    if p[0] <= 0.0:
        # at small angles s^(p - 1) goes as theta^(2 p - 2)
        law = f"theta^{2.0 * p[0] - 2.0:.3g}"
        rise = Described(f"{value[0]:g}, {value[1]:g}, ... rise towards 0 as {law}")
        raise Refused("value", rise, "less steeply than theta^-2, else it has no integral")
    s_lo, s_hi = np.concatenate([[0.0], s]), np.concatenate([s, [1.0]])
    # the law of the last pair, extrapolated to s = 1
    at_hi = np.concatenate([value, value[-1:] * s[-1] ** -slope[-1]])
    # the last piece is empty if the table ends at s = 1
    filled = s_lo < s_hi
    return Segments.from_densities(s_lo[filled], s_hi[filled], p[filled], at_hi[filled])
