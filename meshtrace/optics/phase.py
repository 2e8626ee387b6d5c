"""Scattering phase functions of sea water: base, closed forms, and the tables that kernels sample.

Every class is a frozen model with the same interface (`PhaseFunction`). Angles are in radians,
phase functions in 1/sr with 2 pi * integral of pdf(theta) sin(theta) = 1. Inside, the angle is
carried as s = sin^2(theta / 2), in which dOmega = 4 pi ds.
"""

from __future__ import annotations

import itertools
from abc import abstractmethod
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import pydantic
from numpy.typing import ArrayLike
from pydantic import Field

from meshtrace.checks import RangedArray
from meshtrace.errors import Described, Refused, require_range
from meshtrace.kernels.medium import PhaseTables
from meshtrace.models import Family, FamilyTuple, Floats, Numbers
from meshtrace.optics.power_laws import Segments, power_law_segments
from meshtrace.optics.pure_water import read_table
from meshtrace.quadrature import gauss_legendre
from meshtrace.tables import Column, read_columns, with_file
from meshtrace.units import is_convertible

# Largest error of a sampler's CDF. Tuned: it trades the size of the tables for accuracy.
_QUANTILE_TOLERANCE = 5e-7
# Equal intervals of u in a table: the first attempt, the limit, and the factor between attempts.
_FEWEST_INTERVALS, _MOST_INTERVALS, _FINER = 4096, 65536, 4


def _invert(function: Callable[[Floats], Floats], u: Floats) -> Floats:
    """Solve function(y) = u on [0, 1] by bisection, for a function that grows from 0 to 1."""
    low, high = np.zeros_like(u), np.ones_like(u)
    # 60 halvings: 2^-60 is below the spacing of doubles near 1
    for _ in range(60):
        y = 0.5 * (low + high)
        below = function(y) < u
        low, high = np.where(below, y, low), np.where(below, high, y)
    return 0.5 * (low + high)


def sample_s(tables: PhaseTables, u: Floats) -> Floats:
    """Return samples of s, the array twin of `meshtrace.kernels.medium.sample_s`."""
    # nodes: s^(1/exponent) at the first k + 1 points of the grid, then s from point k on
    nodes, k, exponent = tables
    grid = np.linspace(0.0, 1.0, len(nodes) - 1)
    power = np.interp(u, grid[: k + 1], nodes[: k + 1]) ** exponent
    return np.where(u < grid[k], power, np.interp(u, grid[k:], nodes[k + 1 :]))


class PhaseFunction(Family, frozen=True, default="fournier-forand"):
    """Base of the phase functions: a subclass defines `density` alone.

    Notes
    -----
    Densities are joined by power laws of s = sin^2(theta / 2) between 8192 angles, and the law of
    the first two is carried on to 0: normalisation, CDF and moments agree to rounding. Samples are
    interpolated between quantiles, and meet the CDF within 5e-7, or 8e-6 where a density jumps.
    A subclass declares its parameters as annotated class attributes; see the guide
    "A phase function of your own".

    Examples
    --------
    >>> class Forward(PhaseFunction):
    ...     width: float = 0.2
    ...     def density(self, theta):
    ...         return np.exp(-theta / self.width) + 1e-3
    >>> round(Forward().mean_cosine, 3)
    0.852
    """

    def pdf(self, theta: RangedArray) -> Floats:
        """Return the phase function.

        Parameters
        ----------
        theta : array_like
            Scattering angle [rad], 0 ... pi.

        Returns
        -------
        ndarray
            Density per solid angle [1/sr].

        Raises
        ------
        Refused
            If a theta lies outside 0 ... pi.
        """
        return self._pdf_s(s_of(theta))

    def cdf(self, theta: RangedArray) -> Floats:
        """Return the probability of a scattering angle up to theta.

        Parameters
        ----------
        theta : array_like
            Scattering angle [rad], 0 ... pi.

        Returns
        -------
        ndarray
            Probability, 0 ... 1.

        Raises
        ------
        Refused
            If a theta lies outside 0 ... pi.
        """
        return self._cdf_s(s_of(theta))

    def sample(self, u: Annotated[ArrayLike, Field(ge=0.0, lt=1.0)]) -> Floats:
        """Map uniforms to scattering angles by the tables that the photon kernels use.

        Parameters
        ----------
        u : array_like
            Uniform numbers in [0, 1).

        Returns
        -------
        ndarray
            Scattering angle [rad], growing with u.

        Raises
        ------
        Refused
            If a u lies outside [0, 1).
        """
        return 2.0 * np.arcsin(np.sqrt(sample_s(self.tables(), np.asarray(u))))

    @property
    def mean_cosine(self) -> float:
        """Asymmetry g, the mean of cos(theta)."""
        return 1.0 - 2.0 * self._mean_s()

    @property
    def backscatter_fraction(self) -> float:
        """Fraction B of the scattered light that goes beyond 90 degrees."""
        # s = 1/2 at 90 degrees
        return float(1.0 - self._cdf_s(np.array(0.5)))

    def tables(self) -> PhaseTables:
        """Return the tables for `meshtrace.kernels.medium.sample_s`; cached."""
        return _tables(self)

    @abstractmethod
    def density(self, theta: Floats) -> Floats:
        """Return the phase function at angles [rad], in any unit: > 0 for theta > 0."""

    def _segments(self) -> Segments:
        """Return the pieces in the order of s, by default from `density`.

        The angles are 0.4 % or 0.04 degrees apart, whichever is less.
        """
        theta = np.union1d(np.geomspace(1e-6, np.pi, 4097), np.linspace(0.0, np.pi, 4097)[1:])
        value = np.broadcast_to(np.asarray(self.density(theta), np.float64), theta.shape)
        wrong = ~(np.isfinite(value) & (value > 0.0))
        if wrong.any():
            where = Described(f"{value[wrong][0]:g} at theta = {theta[wrong][0]:g}")
            raise Refused("density", where, "finite numbers > 0 where theta > 0")
        return power_law_segments(s_of(theta), value)

    def _pdf_s(self, s: Floats) -> Floats:
        """Return the phase function [1/sr] at s."""
        return _segments(self).pdf(s)

    def _cdf_s(self, s: Floats) -> Floats:
        """Return the probability of scattering to s or less."""
        return _segments(self).cdf(s)

    def _mean_s(self) -> float:
        """Return the mean of s."""
        return _segments(self).mean()

    @property
    def _exponent(self) -> float:
        """Power of u with which the quantiles of s rise from 0."""
        # the CDF of the first piece goes as s^p
        return float(1.0 / _segments(self).p[0])

    def _root_quantiles(self, u: Floats) -> Floats:
        """Return y = s^(1 / exponent) at the cumulative probabilities u, linear in u near 0."""
        return _segments(self).quantile(u) ** (1.0 / self._exponent)


class BuiltInPhase(PhaseFunction, frozen=True):
    """Base of phase functions defined by `_segments` or `_pdf_s` instead of `density`."""

    def density(self, theta: Floats) -> Floats:
        """Return the phase function [1/sr] at angles [rad]."""
        return self.pdf(theta)


class ClosedPhase(BuiltInPhase, frozen=True):
    """Base of the phase functions with a CDF in closed form; quantiles are found by bisection."""

    @property
    def _exponent(self) -> float:
        # a density that is finite at s = 0: the CDF is linear there
        return 1.0

    def _root_quantiles(self, u: Floats) -> Floats:
        y = _invert(lambda y: self._cdf_s(y**self._exponent), u)
        # the last u is 1, where the bisection may stop short by rounding
        y[-1] = 1.0
        return y


@lru_cache(maxsize=64)
def _segments(phase: PhaseFunction) -> Segments:
    return phase._segments()


@lru_cache(maxsize=64)
def _tables(phase: PhaseFunction) -> PhaseTables:
    """Tabulate quantiles at equal steps of u: y = s^(1/exponent) in the first k, s in the others.

    Linear interpolation of s in u errs in proportion to s''/s', which grows towards the forward
    peak; there y is nearly linear in u. The steps are made finer until the CDF is met within the
    tolerance at the middle of every one, or the limit is reached: where a density jumps the error
    is then up to half a step.
    """
    intervals, exponent = _FEWEST_INTERVALS, phase._exponent
    while True:
        u = np.linspace(0.0, 1.0, intervals + 1)
        y, middle = phase._root_quantiles(u), 0.5 * (u[:-1] + u[1:])
        y[0] = 0.0
        s = y**exponent
        error_s = np.abs(phase._cdf_s(0.5 * (s[:-1] + s[1:])) - middle)
        error_y = np.abs(phase._cdf_s((0.5 * (y[:-1] + y[1:])) ** exponent) - middle)
        needs_y = (error_s > _QUANTILE_TOLERANCE) & (error_y < error_s)
        # y serves the forward peak alone: the first half of the intervals at most
        indices = np.flatnonzero(needs_y[: intervals // 2])
        k = int(indices[-1]) + 1 if indices.size else 0
        worst = max(error_y[:k].max(initial=0.0), error_s[k:].max(initial=0.0))
        if worst <= _QUANTILE_TOLERANCE or intervals == _MOST_INTERVALS:
            return PhaseTables(np.append(y[: k + 1], s[k:]), k, exponent)
        intervals *= _FINER


def s_of(theta: RangedArray) -> Floats:
    """Return sin^2(theta / 2) of checked angles."""
    checked = require_range(theta, 0.0, np.pi, "theta", allowed="0 <= theta <= pi rad")
    return np.sin(0.5 * checked) ** 2


_COLUMNS = (
    Column("theta", "deg", ("angle", "scattering angle", "angles", "psi", "theta_s")),
    Column(
        "value",
        "m-1 sr-1",
        ("vsf", "beta", "phase function", "phase", "p", "pf", "p11", "f11", "s11", "intensity",
         "volume scattering function"),
        relative=True,
    ),
)  # fmt: skip


class TabulatedPhase(BuiltInPhase, frozen=True):
    """Phase function given by a table of angles and values, of any normalisation.

    Parameters
    ----------
    theta_deg : sequence of float
        Scattering angles [degree], increasing, 0 ... 180; at least two above 0.
    value : sequence of float
        Phase function or volume scattering function at these angles, > 0, in any unit.

    file : path, optional
        Text file of both columns in place of them, see `from_file`.

    Notes
    -----
    Between the angles the function is a power of s = sin^2(theta / 2), that is, linear in log-log
    axes; at small angles this is a power of theta. The laws of the first and the last pair of
    angles are carried on to 0 (as Petzold did) and to 180 degrees; a row at exactly 0 is replaced
    by that law. The pieces have closed integrals, so that normalisation, CDF and moments agree with
    `pdf` to rounding.
    """

    kind: Literal["tabulated"] = "tabulated"
    theta_deg: Numbers
    value: Numbers

    @pydantic.model_validator(mode="before")
    @classmethod
    def _from_table(cls, data: Any) -> Any:
        return with_file(data, lambda path: dict(cls.from_file(path)))

    @pydantic.model_validator(mode="after")
    def _check(self) -> Self:
        theta, value = np.array(self.theta_deg), np.array(self.value)
        if theta.size != value.size or np.count_nonzero(theta > 0.0) < 2:
            sizes = Described(f"{theta.size} and {value.size} numbers")
            allowed = "as many of each, at least two with theta_deg > 0"
            raise Refused("theta_deg, value", sizes, allowed)
        if np.any(np.diff(theta) <= 0.0) or theta[0] < 0.0 or theta[-1] > 180.0:
            ends = Described(f"{theta[0]} ... {theta[-1]}")
            raise Refused("theta_deg", ends, "increasing within 0 ... 180")
        if np.any(value <= 0.0):
            raise Refused("value", value.min(), "value > 0")
        self._segments()
        return self

    @classmethod
    def from_file(cls, path: str | Path, *, delimiter: str | None = None) -> Self:
        """Read a text file of the columns theta [deg] and value, see `tables.read_columns`.

        The unit of the angles may be another one, such as "theta [rad]". Values are per solid
        angle, of any scale.

        Raises
        ------
        Refused
            If the table cannot be read, angles without unit end at pi, or values are per angle.
        """
        table = read_columns(path, _COLUMNS, delimiter=delimiter)
        theta, value = table["theta"], table["value"]
        # without a unit angles are read as degrees: 3.14 at the end tells that they are radians
        off_pi = abs(float(theta.values[-1]) - np.pi)
        if (theta.heading is None or theta.heading.unit is None) and off_pi < 0.01:
            angles = Described(f"angles that end at {theta.values[-1]:g}, without unit")
            raise Refused(str(path), angles, "a heading theta [deg] or theta [rad]")
        unit = value.heading.unit if value.heading else None
        if unit and any(is_convertible(unit, density) for density in ("rad-1", "m-1 rad-1", "dB")):
            allowed = "values per solid angle, such as [sr-1] or [m-1 sr-1], or relative ones"
            raise Refused(str(path), Described(f"values in {unit}"), allowed)
        # pi rounded to 3.142 rad is 180.023 degrees: take it for 180; more is refused by `_check`
        largest = 180.0 if theta.values[-1] < 180.03 else np.inf
        return cls(theta_deg=np.minimum(theta.values, largest), value=value.values)

    def _segments(self) -> Segments:
        theta = np.radians(self.theta_deg)
        return power_law_segments(s_of(theta)[theta > 0.0], np.array(self.value)[theta > 0.0])


class Petzold(BuiltInPhase, frozen=True):
    """Phase functions that Petzold measured in 1971, at 514 nm.

    Parameters
    ----------
    water : {"average", "clear", "coastal", "harbour"}
        Average particle, or the total phase function of a water: the average is over three harbour
        stations less pure sea water; clear is Tongue of the Ocean, coastal San Pedro Channel,
        harbour San Diego.

    Notes
    -----
    55 angles from 0.1 to 180 degrees, joined and normalised as in `TabulatedPhase`. The printed
    table 3.10 of Mobley (1994) has 2.188e2 for the average particle at 0.501 degrees, 9 % above
    its neighbours' trend; the file of the Ocean Optics Web Book has 2.018e2 (on the file's scale),
    which is used here.

    References
    ----------
    Petzold 1972, SIO Ref. 72-78, Scripps Institution of Oceanography; Mobley 1994, Light and Water,
    table 3.10; Ocean Optics Web Book, "Petzold's measurements".

    Examples
    --------
    >>> round(Petzold().backscatter_fraction, 4)
    0.0183
    """

    kind: Literal["petzold"] = "petzold"
    water: Literal["average", "clear", "coastal", "harbour"] = "average"

    def _segments(self) -> Segments:
        column = ("clear", "coastal", "harbour", "average").index(self.water) + 1
        theta_deg, value = read_table("petzold_vsf.csv")[:, (0, column)].T
        return power_law_segments(s_of(np.radians(theta_deg)), value)


class HistogramPhase(BuiltInPhase, frozen=True, populate_by_name=True):
    """Phase function with a constant value in each bin of the scattering angle.

    Parameters
    ----------
    theta_edges : sequence of float
        Edges of the bins [rad], increasing from 0 to pi, shape (n + 1,).
    cdf : sequence of float
        Probability of an angle up to each edge, from 0 to 1 and not decreasing, shape (n + 1,).

    Examples
    --------
    >>> isotropic = HistogramPhase(theta_edges=(0.0, np.pi / 2, np.pi), cdf=(0.0, 0.5, 1.0))
    >>> round(float(isotropic.pdf(1.0) * 4.0 * np.pi), 12)
    1.0
    """

    kind: Literal["histogram"] = "histogram"
    theta_edges: Numbers
    cdf_edges: Numbers = Field(alias="cdf")

    @pydantic.model_validator(mode="after")
    def _check(self) -> Self:
        theta, cdf = np.array(self.theta_edges), np.array(self.cdf_edges)
        if theta.size != cdf.size or theta.size < 2:
            sizes = Described(f"{theta.size} and {cdf.size} numbers")
            raise Refused("theta_edges, cdf", sizes, "as many of each, at least two")
        if np.any(np.diff(theta) <= 0.0) or theta[0] != 0.0 or abs(theta[-1] - np.pi) > 1e-12:
            ends = Described(f"{theta[0]} ... {theta[-1]}")
            raise Refused("theta_edges", ends, "increasing from 0 to pi")
        if np.any(np.diff(cdf) < 0.0) or cdf[0] != 0.0 or abs(cdf[-1] - 1.0) > 1e-12:
            raise Refused("cdf", Described(f"{cdf[0]} ... {cdf[-1]}"), "not decreasing from 0 to 1")
        return self

    def _segments(self) -> Segments:
        s = np.sin(0.5 * np.array(self.theta_edges)) ** 2
        # the last edge may be pi less its rounding
        s[-1] = 1.0
        mass = np.diff(self.cdf_edges)
        return Segments(s[:-1], s[1:], np.ones_like(mass), mass / mass.sum())


class FournierForand(ClosedPhase, frozen=True):
    r"""Fournier-Forand phase function: Mie scattering by a power-law size distribution.

    .. math::
        F(\theta) = 1 - (1 - s) \frac{1 - \delta^{-v}}{1 - \delta}
        + \frac{K}{8} \cos\theta \sin^2\theta, \qquad
        \delta = \frac{4 s}{3 (n - 1)^2}, \quad v = \frac{3 - \mu}{2}, \quad
        K = \frac{\delta_\pi^{-v} - 1}{\delta_\pi - 1}, \quad \delta_\pi = \delta(s = 1)

    Parameters
    ----------
    n : float
        Refractive index of the particles relative to water, 1 < n <= 1.5.
    mu : float
        Slope of the (Junge) size distribution, 3.01 <= mu < 5.
    cdf_coef : {"exact", "paper"}
        Factor of the last term of the CDF: the exact K / 8 or the published K / (16 pi).

    Notes
    -----
    The CDF is algebraically that of Fournier and Jonasz (1999), arranged so that nothing cancels
    at delta = 1. The paper prints K / (16 pi) cos sin^2 (equation of theta_s for FF); the integral
    of its own phase function has 1/8. The two differ by at most 9.7e-4 and have the same
    backscatter fraction and mean cosine. With ``cdf_coef="paper"`` `pdf` is the derivative of the
    published CDF, so that both still describe the samples.
    The phase function grows without bound, but integrably, as theta goes to 0. The defaults have
    the backscatter fraction 0.0183 of Petzold's average particle.
    The sampler meets the CDF within 5e-7 for the defaults, and within 2e-6 for n >= 1.01 and
    3.05 <= mu <= 4.95. Towards mu = 3 ever more light goes to angles that underflow to 0.

    References
    ----------
    Fournier and Forand 1994, Proc. SPIE 2258, doi:10.1117/12.190063;
    Fournier and Jonasz 1999, Proc. SPIE 3761, doi:10.1117/12.366488;
    Mobley, Sundman and Boss 2002, Appl. Opt. 41:1035, doi:10.1364/AO.41.001035.

    Examples
    --------
    >>> phase = FournierForand(n=1.1, mu=3.5835)
    >>> round(phase.backscatter_fraction, 7)
    0.0183127
    """

    kind: Literal["fournier-forand"] = "fournier-forand"
    n: float = Field(default=1.1, gt=1.0, le=1.5, allow_inf_nan=False)
    mu: float = Field(default=3.5835, ge=3.01, lt=5.0, allow_inf_nan=False)
    cdf_coef: Literal["exact", "paper"] = "exact"

    @property
    def _v(self) -> float:
        return (3.0 - self.mu) / 2.0

    @property
    def _last_factor(self) -> float:
        """Factor of cos sin^2 in the CDF: K / 8 or K / (16 pi)."""
        delta_pi = 4.0 / (3.0 * (self.n - 1.0) ** 2)
        k = (delta_pi**-self._v - 1.0) / (delta_pi - 1.0)
        return k / 8.0 if self.cdf_coef == "exact" else k / (16.0 * np.pi)

    def _delta(self, s: Floats) -> Floats:
        return 4.0 * s / (3.0 * (self.n - 1.0) ** 2)

    def _pdf_s(self, s: Floats) -> Floats:
        # Fournier and Jonasz (1999), 4 pi times the first term:
        # [v e - (1 - delta^v) + (delta (1 - delta^v) - v e) / s] / (e^2 delta^v), e = 1 - delta
        v = self._v
        with np.errstate(divide="ignore", invalid="ignore"):
            delta = self._delta(s)
            e = 1.0 - delta
            # the division by delta^v is carried out first
            w = delta**-v
            bracket = w * v * e + 1.0 - w + (delta * (w - 1.0) - w * v * e) / s
            bracket = np.array(bracket / e**2)
            # 0 / 0 at delta = 1: take the series where its six terms are good to about e^6 = 1e-12
            near = np.abs(e) < 1e-2
            bracket[near] = w[near] * _ff_series(v, e[near], s[near])
        cos_theta = 1.0 - 2.0 * s
        # the last term of the CDF, by d/ds over 4 pi
        last = self._last_factor / (2.0 * np.pi) * (3.0 * cos_theta**2 - 1.0)
        return np.where(s == 0.0, np.inf, bracket / (4.0 * np.pi) + last)

    def _cdf_s(self, s: Floats) -> Floats:
        with np.errstate(divide="ignore", invalid="ignore"):
            delta = self._delta(s)
            w = delta**-self._v
            # 1 - (1 - s) ratio (below) over one denominator: it does not cancel towards s = 0
            small_delta = (w * (1.0 - s) - delta + s) / (1.0 - delta)
            log = np.log(delta)
            # (1 - delta^-v) / (1 - delta), regular at delta = 1
            ratio = np.where(log == 0.0, -self._v, np.expm1(-self._v * log) / np.expm1(log))
        # 0.5: anywhere below delta = 1, where the first form is 0 / 0
        first = np.where(delta < 0.5, small_delta, 1.0 - (1.0 - s) * ratio)
        # cos(theta) = 1 - 2 s, sin^2(theta) = 4 s (1 - s)
        return first + self._last_factor * (1.0 - 2.0 * s) * 4.0 * s * (1.0 - s)

    def _mean_s(self) -> float:
        # The mean of s is int (1 - F) ds. With s = y^exponent F is linear in y near 0, so that the
        # integrand is smooth: a composite Gauss rule in y on [0, 1], finer towards 0.
        exponent = self._exponent
        x, weight = gauss_legendre(20)
        edges = np.linspace(0.0, 1.0, 41) ** 2
        width = np.diff(edges)[:, None]
        y = (edges[:-1, None] + width * (x + 1.0) / 2.0).ravel()
        s = y**exponent
        weight = (width * weight / 2.0).ravel()
        # ds = exponent s / y dy
        return float(np.sum(weight * (1.0 - self._cdf_s(s)) * exponent * s / y))

    @property
    def _exponent(self) -> float:
        # towards 0 the CDF goes as delta^-v, v < 0
        return -1.0 / self._v


def _ff_series(v: float, e: Floats, s: Floats) -> Floats:
    """Expand the bracket of `FournierForand._pdf_s`, times delta^v, in e = 1 - delta."""
    # a[k] is the binomial coefficient of v over k + 1, as in delta^v = (1 - e)^v
    a = list(itertools.accumulate(range(1, 8), lambda c, k: c * (v - k) / (k + 1), initial=v))
    powers = [(-e) ** k for k in range(6)]
    first = sum(a[k + 1] * powers[k] for k in range(6))
    second = -sum((a[k + 1] + a[k]) * powers[k] for k in range(6))
    return first + second / s


class HenyeyGreenstein(ClosedPhase, frozen=True):
    r"""Henyey-Greenstein phase function.

    .. math:: \beta(\theta) = \frac{1 - g^2}{4 \pi (1 + g^2 - 2 g \cos\theta)^{3/2}}

    Parameters
    ----------
    g : float
        Mean cosine, -1 < g < 1; 0 is isotropic scattering.

    Notes
    -----
    Density and CDF are written in s, where g = 0 needs no special case.

    References
    ----------
    Henyey and Greenstein 1941, Astrophys. J. 93:70, doi:10.1086/144246.

    Examples
    --------
    >>> round(HenyeyGreenstein(g=0.924).backscatter_fraction, 4)
    0.017
    """

    kind: Literal["henyey-greenstein"] = "henyey-greenstein"
    g: float = Field(default=0.924, gt=-1.0, lt=1.0, allow_inf_nan=False)

    def _pdf_s(self, s: Floats) -> Floats:
        return (1.0 - self.g**2) / (4.0 * np.pi * ((1.0 - self.g) ** 2 + 4.0 * self.g * s) ** 1.5)

    def _cdf_s(self, s: Floats) -> Floats:
        root = np.sqrt((1.0 - self.g) ** 2 + 4.0 * self.g * s)
        return 2.0 * (1.0 + self.g) * s / (root * (root + 1.0 - self.g))

    def _mean_s(self) -> float:
        return (1.0 - self.g) / 2.0


class Rayleigh(ClosedPhase, frozen=True):
    r"""Molecular (Rayleigh-like) phase function.

    .. math:: \beta(\theta) = \frac{3}{4 \pi (3 + \gamma)} (1 + \gamma \cos^2\theta)

    Parameters
    ----------
    gamma : float
        Anisotropy (1 - d) / (1 + d) for the depolarisation ratio d, 0 <= gamma <= 1. 1 is Rayleigh
        scattering, 0.835 (d = 0.09) pure sea water, 0 isotropic scattering.

    References
    ----------
    Morel 1974, in Optical Aspects of Oceanography (Academic Press), 1-24; Mobley 1994, Light and
    Water (Academic Press).

    Examples
    --------
    >>> float(Rayleigh.sea_water().pdf(0.0) / Rayleigh.sea_water().pdf(np.pi / 2))
    1.835
    """

    kind: Literal["rayleigh"] = "rayleigh"
    gamma: float = Field(default=1.0, ge=0.0, le=1.0, allow_inf_nan=False)

    @classmethod
    def sea_water(cls) -> Self:
        """Return the phase function of pure sea water, gamma = 0.835."""
        return cls(gamma=0.835)

    def _pdf_s(self, s: Floats) -> Floats:
        return 3.0 * (1.0 + self.gamma * (1.0 - 2.0 * s) ** 2) / (4.0 * np.pi * (3.0 + self.gamma))

    def _cdf_s(self, s: Floats) -> Floats:
        linear, cubic = 1.0 + self.gamma, self.gamma * (4.0 * s - 6.0) * s / 3.0
        return 3.0 * s * (linear + cubic) / (3.0 + self.gamma)

    def _mean_s(self) -> float:
        return 0.5


class MixturePhase(ClosedPhase, frozen=True):
    """Weighted mean of phase functions, as of water molecules and particles.

    Parameters
    ----------
    components : sequence of PhaseFunction
        Phase functions, at least one; mixtures may be nested.
    weights : sequence of float
        Their weights, > 0, as many; for a water of several constituents their scattering
        coefficients b. They are normalised to 1.

    Examples
    --------
    >>> particles, water = FournierForand(), Rayleigh.sea_water()
    >>> mixed = MixturePhase(components=(particles, water), weights=(0.0346, 0.0024))
    >>> round(mixed.backscatter_fraction, 4)
    0.0496
    """

    kind: Literal["mixture"] = "mixture"
    components: FamilyTuple[PhaseFunction] = Field(min_length=1)
    weights: Numbers

    @pydantic.model_validator(mode="after")
    def _check(self) -> Self:
        if len(self.weights) != len(self.components) or min(self.weights) <= 0.0:
            allowed = f"{len(self.components)} numbers > 0, one for each of the components"
            raise Refused("weights", self.weights, allowed)
        return self

    @property
    def _shares(self) -> list[tuple[float, PhaseFunction]]:
        total = sum(self.weights)
        return [(w / total, c) for w, c in zip(self.weights, self.components, strict=True)]

    def _pdf_s(self, s: Floats) -> Floats:
        return np.sum([w * c._pdf_s(s) for w, c in self._shares], axis=0)

    def _cdf_s(self, s: Floats) -> Floats:
        return np.sum([w * c._cdf_s(s) for w, c in self._shares], axis=0)

    def _mean_s(self) -> float:
        return sum(w * c._mean_s() for w, c in self._shares)

    @property
    def _exponent(self) -> float:
        # towards 0 the component with the strongest forward peak leads
        return max(c._exponent for c in self.components)
