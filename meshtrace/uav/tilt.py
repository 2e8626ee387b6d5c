"""Law of the tilt of an aircraft in gusts, exact or as the paper's Gamma approximation.

The tilt is alpha = arctan(K V^2), where V is the speed of the wind with its gusts [m s-1] and K the
tilt coefficient of the aircraft [s2 m-2]. It multiplies the gain by h_alpha = cos(alpha), or by 0
where the vertical is outside the field of view.
"""

from __future__ import annotations

import abc
import functools
import math
from collections.abc import Callable
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from meshtrace.checks import Infinite, check_call, check_methods
from meshtrace.models import Floats, Model, NonNegative, Positive
from meshtrace.quadrature import gauss_legendre

FieldOfView = Annotated[float, Field(gt=0.0, le=math.pi)]
"""Full field of view [rad]."""


@check_call
def h_alpha(tilt: ArrayLike, fov: FieldOfView) -> Floats:
    """Return the factor h_alpha by which a tilt reduces the gain of light that arrives vertically.

    h = cos(alpha) if alpha <= fov / 2, else 0

    Parameters
    ----------
    tilt : array_like
        Tilt angle alpha [rad], any shape.
    fov : float
        Full field of view [rad].

    Returns
    -------
    ndarray
        The factor, same shape.

    Raises
    ------
    Refused
        If `fov` is outside (0, pi].

    Notes
    -----
    The paper's factor cuts at alpha = fov, its test on the photons at fov / 2; the half angle is
    the one that a full field of view means, and is used for both here.
    """
    return np.where(np.asarray(tilt) <= 0.5 * fov, np.cos(tilt), 0.0)


_Square = Annotated[ArrayLike, Field(ge=0.0)]  # V^2 [m2 s-2]
_Angle = Annotated[ArrayLike, Field(ge=0.0, lt=0.5 * math.pi)]  # tilt [rad]


_FACTORS = 48  # nodes of the factor: the mean of cos(alpha) to 1e-9, that of error rates to 1e-4
_TABLE = 256  # angles at which a distribution function is tabulated, see `_tilt_table`
_LEAST_BER = 1e-15  # error rates below it do not matter for any device


@check_methods
class TiltFactors(NamedTuple):
    """Law of the tilt factor h_alpha behind a field of view, as weighted nodes.

    Attributes
    ----------
    h : ndarray, shape (m,)
        Factors [1]; 0 for tilts that leave the field of view.
    weight : ndarray, shape (m,)
        Their probabilities, of sum 1.
    law : TiltLaw, optional
        Law of the tilt; None for a constant one.
    fov : float
        Full field of view [rad].
    """

    h: Floats
    weight: Floats
    law: TiltLaw | None = None
    fov: float = math.pi

    @property
    def outage(self) -> float:
        """Probability that the tilt leaves the field of view."""
        return float(self.weight[self.h == 0.0].sum())

    def below(self, h: Annotated[ArrayLike, Infinite()]) -> Floats:
        """Return P(h_alpha < h) for h > 0, any shape."""
        level = np.asarray(h, dtype=float)
        if self.law is None:
            return (self.h < level[..., None]) @ self.weight
        # h_alpha < h is alpha > arccos(h), or alpha beyond the field of view, where h_alpha is 0
        tilt = np.minimum(np.arccos(np.clip(level, 0.0, 1.0)), 0.5 * self.fov)
        return np.where(level >= 1.0, 1.0, _tilt_table(self.law)(tilt))


@check_call
def tilt_outage_note(outage: float, wind: str = "") -> str:
    """Describe the share of tilts that leave the field of view; "" for a negligible share.

    Parameters
    ----------
    outage : float
        Probability that the tilt leaves the field of view.
    wind : str
        Text after "tilt of the aircraft", such as " at 13 m/s".
    """
    least_ber = 0.5 * outage  # without light half of the bits are wrong
    if least_ber < _LEAST_BER:
        return ""
    return (
        f"tilt of the aircraft{wind}: {100.0 * outage:.2g} % of the time beyond half of the field "
        f"of view, so that no power has an error rate below {least_ber:.2e}"
    )


@functools.lru_cache(64)
def _bulk_of_tilt(law: TiltLaw) -> tuple[float, float]:
    """Return the quantiles of the tilt at 1e-9 and 1 - 1e-9 [rad]."""
    return law.ppf(1e-9), law.ppf(1.0 - 1e-9)


@functools.lru_cache(64)
def _tilt_table(law: TiltLaw) -> Callable[[Floats], Floats]:
    """Return a function for P(alpha > tilt), interpolated in the logarithm to 1e-5."""
    from scipy.interpolate import PchipInterpolator

    low, high = (math.atan(law.tilt_coefficient * v2) for v2 in law._bulk())
    tilt = np.linspace(low, high, _TABLE)
    # of the logarithm, since tails span many decades; by a monotone interpolant
    table = PchipInterpolator(tilt, np.log(np.maximum(law.sf(tilt), 1e-300)))
    return lambda angle: np.exp(table(np.clip(angle, low, high)))


class TiltLaw(Model, abc.ABC, frozen=True):
    """Law of the tilt angle alpha = arctan(K V^2) and of the factor h_alpha = cos(alpha).

    Subclasses give the law of V^2; everything else follows by change of variable.
    """

    tilt_coefficient: Positive  # K [s2 m-2]

    @abc.abstractmethod
    def _squared_wind(self, v2: ArrayLike, function: Literal["pdf", "cdf", "sf"]) -> Floats:
        """Return the density, P(V^2 <= v2) or P(V^2 > v2) of V^2, precise in both tails."""

    def squared_wind_pdf(self, v2: _Square) -> Floats:
        """Return the density of V^2 [s2 m-2] at `v2` [m2 s-2]."""
        return self._squared_wind(v2, "pdf")

    def squared_wind_cdf(self, v2: _Square) -> Floats:
        """Return P(V^2 <= v2), with full relative precision in the lower tail."""
        return self._squared_wind(v2, "cdf")

    def squared_wind_sf(self, v2: _Square) -> Floats:
        """Return P(V^2 > v2), with full relative precision in the upper tail."""
        return self._squared_wind(v2, "sf")

    @abc.abstractmethod
    def _bulk(self) -> tuple[float, float]:
        """Return the interval of V^2 that leaves less than 1e-17 of the mass on either side."""

    def _v2(self, tilt: _Angle) -> Floats:
        """Return the squared wind V^2 [m2 s-2] of a tilt [rad]."""
        return np.tan(np.asarray(tilt, dtype=float)) / self.tilt_coefficient

    def pdf(self, tilt: _Angle) -> Floats:
        """Return the density of the tilt, f(alpha) = f_V2(tan(alpha) / K) sec^2(alpha) / K [rad-1].

        Parameters
        ----------
        tilt : array_like
            alpha [rad] in [0, pi/2), any shape.
        """
        v2 = self._v2(tilt)
        k = self.tilt_coefficient
        # sec^2(alpha) = 1 + tan^2(alpha) = 1 + (K V^2)^2
        return self.squared_wind_pdf(v2) * (1.0 + (k * v2) ** 2) / k

    def cdf(self, tilt: _Angle) -> Floats:
        """Return P(alpha <= tilt), tilt in [0, pi/2) [rad]."""
        return self.squared_wind_cdf(self._v2(tilt))

    def sf(self, tilt: _Angle) -> Floats:
        """Return P(alpha > tilt), tilt in [0, pi/2) [rad]."""
        return self.squared_wind_sf(self._v2(tilt))

    def ppf(self, probability: Annotated[float, Field(gt=1e-15, lt=1.0 - 1e-15)]) -> float:
        """Return the quantile of the tilt [rad], 1e-15 < probability < 1 - 1e-15."""
        from scipy.optimize import brentq

        low, high = self._bulk()
        v2 = brentq(lambda v: float(self.squared_wind_cdf(v)) - probability, low, high)
        return math.atan(self.tilt_coefficient * float(v2))

    def mean(self) -> float:
        """Return the mean tilt [rad]."""
        tilt, weight = self._quadrature()
        return float(weight @ tilt)

    def std(self) -> float:
        """Return the standard deviation of the tilt [rad]."""
        tilt, weight = self._quadrature()
        return math.sqrt(float(weight @ (tilt - weight @ tilt) ** 2))

    def outage(self, fov: FieldOfView) -> float:
        """Return P(alpha > fov / 2), the vertical outside a full field of view `fov` [rad].

        This is also the mass of h_alpha at 0.
        """
        return float(self.sf(0.5 * fov)) if fov < math.pi else 0.0

    def h_pdf(self, h: ArrayLike, fov: FieldOfView = math.pi) -> Floats:
        """Return the density of h_alpha on [cos(fov / 2), 1); the mass `outage(fov)` is at 0.

        f(h) = f_alpha(arccos h) / sqrt(1 - h^2)

        Parameters
        ----------
        h : array_like
            Factor in (0, 1), any shape.
        fov : float
            Full field of view [rad].

        Returns
        -------
        ndarray
            Density, same shape; 0 outside of the support.

        Notes
        -----
        Departs from the paper, eq. final_f_h_alpha: its density has no lower limit and no mass at
        0, and its constant is wrong (`GammaTiltLaw.h_pdf_printed`).
        """
        h = np.asarray(h, dtype=float)
        inside = (h > 0.0) & (h < 1.0) & (h >= math.cos(0.5 * fov))
        safe = np.where(inside, h, 0.5)
        return np.where(inside, self.pdf(np.arccos(safe)) / np.sqrt(1.0 - safe**2), 0.0)

    def h_cdf(self, h: ArrayLike, fov: FieldOfView = math.pi) -> Floats:
        """Return P(h_alpha <= h) for h in [0, 1), with the mass at 0 from the field of view."""
        h = np.asarray(h, dtype=float)
        # Tilts beyond the field of view all have h = 0. The bounds are just below pi / 2, where
        # tan(alpha) is infinite.
        tilt = np.minimum(np.arccos(np.clip(h, 1e-12, 1.0)), min(0.5 * fov, 1.5707963267))
        return np.where(h < 0.0, 0.0, np.where(h >= 1.0, 1.0, self.sf(tilt)))

    def h_moment(self, order: int = 1, fov: FieldOfView = math.pi) -> float:
        """Return the moment E[h_alpha^order], the outage of the field of view included.

        Parameters
        ----------
        order : int
            Exponent of h_alpha.
        fov : float
            Full field of view [rad].
        """
        tilt, weight = self._quadrature(0.5 * fov)
        return float(weight @ np.cos(tilt) ** order)

    def factors(self, fov: FieldOfView) -> TiltFactors:
        """Return the law of h_alpha as weighted nodes, the outage of `fov` as one at h = 0.

        Parameters
        ----------
        fov : float
            Full field of view [rad].
        """
        outage = self.outage(fov)
        low, high = _bulk_of_tilt(self)
        high = min(high, 0.5 * fov)
        if high <= low:  # all but 1e-9 of the tilts leave the field of view
            return TiltFactors(np.zeros(1), np.ones(1), self, fov)
        x, w = gauss_legendre(_FACTORS)
        tilt = low + 0.5 * (high - low) * (x + 1.0)
        weight = w * self.pdf(tilt)
        # normalised, with the tails of 1e-9 beyond the nodes
        weight *= (1.0 - outage) / weight.sum()
        h, weight = np.append(np.cos(tilt), 0.0), np.append(weight, outage)
        return TiltFactors(h, weight, self, fov)

    def _quadrature(self, upper: float = 0.5 * math.pi) -> tuple[Floats, Floats]:
        """Return nodes alpha [rad] and weights f(alpha) d(alpha) over the bulk up to `upper`."""
        low, high = (math.atan(self.tilt_coefficient * v2) for v2 in self._bulk())
        high = max(min(high, upper), low)
        x, w = gauss_legendre(400)
        tilt = low + 0.5 * (high - low) * (x + 1.0)
        return tilt, 0.5 * (high - low) * w * self.pdf(tilt)


class GammaTiltLaw(TiltLaw, frozen=True):
    """The paper's approximation: V^2 follows a Gamma law with the exact mean and variance.

    shape = E[V^2]^2 / Var[V^2],  scale = Var[V^2] / E[V^2]

    Parameters
    ----------
    tilt_coefficient : float
        K [s2 m-2].
    shape : float
        alpha_Gamma [1].
    scale : float
        beta_Gamma [m2 s-2], a scale (the paper writes beta and theta for the same number).
    """

    shape: Positive
    scale: Positive

    @functools.cached_property
    def _law(self) -> Any:
        """Gamma law of V^2."""
        from scipy.stats import gamma

        return gamma(self.shape, scale=self.scale)

    def _squared_wind(self, v2: ArrayLike, function: Literal["pdf", "cdf", "sf"]) -> Floats:
        return np.asarray(getattr(self._law, function)(v2))

    def _bulk(self) -> tuple[float, float]:
        return float(self._law.ppf(1e-17)), float(self._law.isf(1e-17))

    def h_pdf_printed(self, h: Annotated[ArrayLike, Field(gt=0.0, lt=1.0)]) -> Floats:
        """Return the density of h_alpha as published, for comparison only.

        f(h) = h^-(a+1) (1 - h^2)^((a-2)/2) exp(-sqrt(1-h^2) / (h K b)) / (K Gamma(a) b^a)

        Parameters
        ----------
        h : array_like
            Factor in (0, 1), any shape.

        Notes
        -----
        Defect of eq. final_f_h_alpha: the constant 1/K must be 1/K^a (a the Gamma shape), so the
        published form integrates to K^(a-1), some 1e-61 for the paper's UAV, and not to 1. Its
        support has no lower limit either. `h_pdf` is the right form.
        """
        from scipy.special import gammaln

        h = np.asarray(h, dtype=float)
        a, k = self.shape, self.tilt_coefficient
        log_pdf = (
            -(a + 1.0) * np.log(h)
            + 0.5 * (a - 2.0) * np.log1p(-h * h)
            - np.sqrt(1.0 - h * h) / (h * k * self.scale)
            - (math.log(k) + gammaln(a) + a * math.log(self.scale))
        )
        return np.exp(log_pdf)


class ExactTiltLaw(TiltLaw, frozen=True):
    """Exact law: V^2 is the sum of a non-central chi-squared variable and a central one.

    F(v) = int phi(w / s_z) / s_z  F_chi2[(v - w^2) / s_h^2; 2, (u / s_h)^2] dw,  |w| <= sqrt(v)

    phi is the standard normal density, F_chi2[x; k, c] the non-central chi-squared law.

    The horizontal gusts have one variance, so V_x^2 + V_y^2 is s_h^2 times a non-central
    chi-squared variable of two degrees of freedom; one quadrature over the vertical gust remains.
    All its terms are positive, hence no loss of precision in either tail.

    Parameters
    ----------
    tilt_coefficient : float
        K [s2 m-2].
    mean_speed : float
        Mean wind u [m s-1].
    std_horizontal, std_vertical : float
        Standard deviations s_h of V_x and V_y and s_z of V_z [m s-1].
    """

    mean_speed: NonNegative
    std_horizontal: Positive
    std_vertical: Positive

    def _squared_wind(self, v2: ArrayLike, function: Literal["pdf", "cdf", "sf"]) -> Floats:
        from scipy.special import erfc
        from scipy.stats import ncx2

        v2 = np.asarray(v2, dtype=float)
        v2 = np.where(v2 < 1e-200, 0.0, v2)  # w^2 below would underflow
        squared = v2[..., None]
        x, weight = gauss_legendre(64)
        # beyond 10 standard deviations a normal law has 1e-23
        reach = np.minimum(np.sqrt(squared), 10.0 * self.std_vertical)
        w = 0.5 * reach * (x + 1.0)
        gauss = np.exp(-0.5 * (w / self.std_vertical) ** 2) / (
            math.sqrt(2.0 * math.pi) * self.std_vertical
        )
        # V_x^2 + V_y^2 has what the vertical gust w leaves of V^2
        rest = np.maximum(squared - w * w, 0.0) / self.std_horizontal**2
        horizontal = getattr(ncx2, function)(rest, 2, (self.mean_speed / self.std_horizontal) ** 2)
        # twice the integral from 0 to `reach`, whose weights are reach weight / 2
        part = np.sum(reach * weight * gauss * horizontal, axis=-1)
        if function == "pdf":
            return part / self.std_horizontal**2
        if function == "sf":  # plus P(|V_z| > sqrt(v2)), whatever the horizontal wind
            return part + erfc(np.sqrt(0.5 * v2) / self.std_vertical)
        return part

    def _bulk(self) -> tuple[float, float]:
        # A normal law has 1e-19 beyond nine deviations; tuned: 1.2 of them for the sum of three
        # components.
        reach = 9.0 * max(self.std_horizontal, self.std_vertical)
        return max(self.mean_speed - reach, 0.0) ** 2, (self.mean_speed + 1.2 * reach) ** 2


class LawComparison(NamedTuple):
    """Distance of two laws of the tilt: D_KS [1], KL divergence [nat], RMSE and MAE [1/degree]."""

    ks: float
    kl: float
    rmse: float
    mae: float


@check_call
def compare_laws(
    exact: TiltLaw,
    approximation: TiltLaw,
    points: Annotated[int, Field(ge=2, le=10**6)] = 400,
) -> LawComparison:
    """Return measures of the error of an approximate law of the tilt.

    Parameters
    ----------
    exact, approximation : TiltLaw
        The two laws.
    points : int
        Even grid between the 1e-5 quantiles of `exact` for RMSE and MAE of the density per degree.

    Returns
    -------
    LawComparison
        Kolmogorov-Smirnov distance, Kullback-Leibler divergence, RMSE and MAE.

    Notes
    -----
    V^2/U^2 has the same law at every wind speed U, and a scale changes neither distance, so D_KS
    and KL do not depend on the wind; the paper prints two different D_KS (a histogram artefact).
    """
    fine = np.linspace(exact.ppf(1e-12), exact.ppf(1.0 - 1e-12), 4001)
    ks = float(np.max(np.abs(exact.cdf(fine) - approximation.cdf(fine))))
    tilt, weight = exact._quadrature()
    positive = weight > 0.0
    # KL = int f ln(f / g)
    ratio = exact.pdf(tilt[positive]) / approximation.pdf(tilt[positive])
    kl = float(weight[positive] @ np.log(ratio))
    grid = np.linspace(exact.ppf(1e-5), exact.ppf(1.0 - 1e-5), points)
    error = (approximation.pdf(grid) - exact.pdf(grid)) * math.pi / 180.0
    return LawComparison(ks, kl, float(np.sqrt(np.mean(error**2))), float(np.mean(np.abs(error))))
