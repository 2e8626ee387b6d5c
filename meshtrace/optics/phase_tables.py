"""Tables of phase functions: power-law pieces, quantiles, and the arrays that kernels sample.

The angle is carried as s = sin^2(theta / 2), in which dOmega = 4 pi ds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.errors import Described, Refused
from meshtrace.kernels import phase as kernel
from meshtrace.kernels.phase import PhaseTables
from meshtrace.models import Floats

_QUANTILE_TOLERANCE = 5e-7
_FEWEST_INTERVALS, _MOST_INTERVALS = 4096, 65536
_GUIDE_PER_BIN = 2


class MixtureComponent(NamedTuple):
    """One component of a mixture on its way into `PhaseTables`."""

    weight: float
    kind: int
    param: tuple[float, ...]
    nodes: Floats = np.empty(0)
    guide: NDArray[np.int64] = np.empty(0, dtype=np.int64)


class Segments(NamedTuple):
    """Pieces s_lo < s <= s_hi with a density in s that goes as s^(p - 1), and their masses."""

    s_lo: Floats
    s_hi: Floats
    p: Floats
    mass: Floats

    @property
    def log_ratio(self) -> Floats:
        """Logarithm of s_lo / s_hi."""
        with np.errstate(divide="ignore"):
            return np.log(self.s_lo / self.s_hi)

    @property
    def _integral(self) -> Floats:
        return power_integral(self.p, self.log_ratio)

    def pdf(self, s: Floats) -> Floats:
        """Return the phase function [1/sr] at s."""
        i = self._index(s)
        with np.errstate(divide="ignore"):
            shape = (s / self.s_hi[i]) ** (self.p[i] - 1.0)
        scale = self.mass / (4.0 * np.pi * self.s_hi * self._integral)
        return scale[i] * shape

    def cdf(self, s: Floats) -> Floats:
        """Return the share of light that is scattered to s or less."""
        i = self._index(s)
        with np.errstate(divide="ignore"):
            above = power_integral(self.p[i], np.log(s / self.s_hi[i]))
        share = above / self._integral[i]
        return np.cumsum(self.mass)[i] - share * self.mass[i]

    def mean(self) -> float:
        """Return the mean of s."""
        first = power_integral(self.p + 1.0, self.log_ratio)
        return float(np.sum(self.mass * self.s_hi * first / self._integral))

    def _index(self, s: Floats) -> NDArray[np.intp]:
        return np.minimum(np.searchsorted(self.s_hi, s, side="left"), len(self.s_hi) - 1)


def power_integral(p: Floats, log_ratio: Floats) -> Floats:
    """Integrate x^(p - 1) from exp(log_ratio) to 1."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        return np.where(p == 0.0, -log_ratio, -np.expm1(p * log_ratio) / p)


def power_law_segments(s: Floats, value: Floats) -> Segments:
    """Join (s, value) by power laws, carried on to s = 0 and s = 1, and normalise."""
    slope = np.diff(np.log(value)) / np.diff(np.log(s))
    p = 1.0 + np.concatenate([slope[:1], slope, slope[-1:]])
    p[np.abs(p) < 1e-7] = 0.0
    p[np.abs(p - 1.0) < 1e-7] = 1.0
    if p[0] <= 0.0:
        law = f"theta^{2.0 * p[0] - 2.0:.3g}"
        rise = Described(f"{value[0]:g}, {value[1]:g}, ... rise towards 0 as {law}")
        raise Refused("value", rise, "less steeply than theta^-2, else it has no integral")
    s_lo, s_hi = np.concatenate([[0.0], s]), np.concatenate([s, [1.0]])
    at_hi = np.concatenate([value, value[-1:] * s[-1] ** -slope[-1]])
    keep = s_lo < s_hi
    seg = Segments(s_lo[keep], s_hi[keep], p[keep], np.ones(keep.sum()))
    mass = at_hi[keep] * seg.s_hi * power_integral(seg.p, seg.log_ratio)
    return seg._replace(mass=mass / mass.sum())


def quantile_component(cdf_s: Callable[[Floats], Floats], exponent: float) -> MixtureComponent:
    """Tabulate s at equal steps of u, and s^(1/exponent) if s is a power of u.

    Linear interpolation of s in u errs in proportion to s''/s', which grows towards the forward
    peak; there y = s^(1/exponent) is nearly linear in u. The number of steps is doubled until the
    CDF is met within the tolerance at the middle of every step.
    """
    intervals = _FEWEST_INTERVALS
    while True:
        u = np.linspace(0.0, 1.0, intervals + 1)
        y = _invert(lambda y: cdf_s(y**exponent), u)
        s, middle = y**exponent, 0.5 * (u[:-1] + u[1:])
        error_s = np.abs(cdf_s(0.5 * (s[:-1] + s[1:])) - middle)
        error_y = np.abs(cdf_s((0.5 * (y[:-1] + y[1:])) ** exponent) - middle)
        coarse = (error_s > _QUANTILE_TOLERANCE) & (error_y < error_s)
        better = np.flatnonzero(coarse[: intervals // 2])
        k0 = int(better[-1]) + 1 if better.size else 0
        worst = max(error_y[:k0].max(initial=0.0), error_s[k0:].max(initial=0.0))
        if worst <= _QUANTILE_TOLERANCE or intervals == _MOST_INTERVALS:
            param = (float(intervals), float(k0), exponent)
            return MixtureComponent(
                1.0, kernel.Component.QUANTILES, param, np.append(y[: k0 + 1], s[k0:])
            )
        intervals *= 2


def _invert(function: Callable[[Floats], Floats], u: Floats) -> Floats:
    """Solve function(y) = u on [0, 1] by bisection, for a function that grows from 0 to 1."""
    low, high = np.zeros_like(u), np.ones_like(u)
    for _ in range(60):
        y = 0.5 * (low + high)
        below = function(y) < u
        low, high = np.where(below, y, low), np.where(below, high, y)
    y = 0.5 * (low + high)
    y[0], y[-1] = 0.0, 1.0
    return y


def bin_component(seg: Segments) -> MixtureComponent:
    """Write pieces of non-zero mass as the rows and the guide table of `kernel.Component.BINS`."""
    seg = Segments(*(column[seg.mass > 0.0] for column in seg))
    with np.errstate(divide="ignore"):
        exponent = np.where(seg.p == 0.0, 0.0, 1.0 / seg.p)
    ratio = np.where(seg.p == 0.0, -seg.log_ratio, np.exp(seg.p * seg.log_ratio))
    top = np.cumsum(seg.mass)
    low = np.append(0.0, top[:-1] / top[-1])
    rows = np.column_stack([low, seg.s_hi, ratio, exponent])
    end = np.array([[1.0, 1.0, 0.0, 1.0]])
    steps = np.arange(_GUIDE_PER_BIN * len(low)) / (_GUIDE_PER_BIN * len(low))
    guide = np.searchsorted(low, steps, side="right") - 1
    nodes = np.vstack([rows, end]).ravel()
    return MixtureComponent(1.0, kernel.Component.BINS, (float(len(low)),), nodes, guide)


def joined(parts: Sequence[MixtureComponent]) -> PhaseTables:
    """Return the components of a phase function as arrays."""
    param = np.zeros((len(parts), 4))
    for row, part in zip(param, parts, strict=True):
        row[: len(part.param)] = part.param
    cum_weight = np.cumsum([part.weight for part in parts])
    return PhaseTables(
        kind=np.array([part.kind for part in parts], dtype=np.int64),
        param=param,
        cum_weight=cum_weight / cum_weight[-1],
        start=np.cumsum([0, *(part.nodes.size for part in parts)], dtype=np.int64),
        nodes=np.concatenate([part.nodes for part in parts]),
        guide_start=np.cumsum([0, *(part.guide.size for part in parts)], dtype=np.int64),
        guide=np.concatenate([part.guide for part in parts]),
    )


def sample_s(tables: PhaseTables, u: Floats) -> Floats:
    """Return samples of s, the array twin of `meshtrace.kernels.phase.sample_s`."""
    j = np.minimum(np.searchsorted(tables.cum_weight, u, side="right"), len(tables.kind) - 1)
    low = np.append(0.0, tables.cum_weight)[j]
    inner = np.minimum((u - low) / (tables.cum_weight[j] - low), 1.0)
    s = np.empty_like(u)
    for component in range(len(tables.kind)):
        chosen = j == component
        s[chosen] = _component_s(tables, component, inner[chosen])
    return np.minimum(s, 1.0)


def _component_s(tables: PhaseTables, j: int, u: Floats) -> Floats:
    """Sample component j."""
    kind, param = tables.kind[j], tables.param[j]
    nodes = tables.nodes[tables.start[j] : tables.start[j + 1]]
    if kind == kernel.Component.HENYEY_GREENSTEIN:
        g = param[0]
        return (1.0 - g) ** 2 * u * (1.0 + g - g * u) / (1.0 + g - 2.0 * g * u) ** 2
    if kind == kernel.Component.RAYLEIGH:
        root = np.sqrt(param[0])
        x = np.arcsinh(1.5 * root * (1.0 + param[0] / 3.0) * (1.0 - 2.0 * u))
        return np.clip(0.5 - np.sinh(x / 3.0) / root, 0.0, 1.0)
    if kind == kernel.Component.QUANTILES:
        k0 = int(param[1])
        grid = np.linspace(0.0, 1.0, int(param[0]) + 1)
        power = np.interp(u, grid[: k0 + 1], nodes[: k0 + 1]) ** param[2]
        return np.where(u < grid[k0], power, np.interp(u, grid[k0:], nodes[k0 + 1 :]))
    rows = nodes.reshape(-1, kernel.ROW)
    i = np.searchsorted(rows[:-1, 0], u, side="right") - 1
    low, s_hi, ratio, exponent = rows[i].T
    r = (u - low) / (rows[i + 1, 0] - low)
    with np.errstate(over="ignore"):
        law = s_hi * (ratio + r * (1.0 - ratio)) ** exponent
        return np.where(exponent == 0.0, s_hi * np.exp((r - 1.0) * ratio), law)
