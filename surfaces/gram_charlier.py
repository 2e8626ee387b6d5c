"""Skewness and peakedness of the slopes of the sea, and a density with both."""

from __future__ import annotations

import math
from functools import cache, lru_cache, partial
from typing import Annotated, Literal, Self, get_args

import numpy as np
from numpy.polynomial.hermite_e import herme2poly
from pydantic import BeforeValidator, model_validator

from meshtrace.checks import check_call
from meshtrace.errors import Described, Refused, require_word
from meshtrace.kernels.interface import GAUSSIAN, WIDE, Series
from meshtrace.mesh import Cumulants
from meshtrace.models import Finite, Model

from .parameters import Floats, Mss, Variances, WindSpeed, named_or_given

_REACH, _STEP = 7.0, 0.05  # of the quadrature, in standard deviations
_FARTHEST = 0.5  # chi-square distance of a density from the Gaussian one
_TRIALS = 30
_ACCURACY = 1e-12  # of moments
_POWERS = (0, 0), (1, 0), (2, 0), (3, 0), (4, 0), (0, 2), (1, 2), (2, 2), (0, 4)
"""Powers of the slopes along and across the wind, in the order of `Series`."""

_NORMS = np.sqrt([[math.factorial(i) * math.factorial(j)] for i, j in _POWERS])
_COEFFICIENTS = "c03", "c21", "c04", "c22", "c40"  # in the order of `Cumulants`
_ABOVE = 1.001  # bound over the largest value on the quadrature's points


class GramCharlier(Model, frozen=True):
    r"""Coefficients of a Gram-Charlier series of slopes.

    .. math:: p = \frac{e^{-(\xi^2 + \eta^2) / 2}}{2 \pi \sigma_c \sigma_u} \left[
        1 - \tfrac12 c_{21} (\xi^2 - 1) \eta - \tfrac16 c_{03} (\eta^3 - 3 \eta)
        + \tfrac1{24} c_{40} (\xi^4 - 6 \xi^2 + 3) + \tfrac14 c_{22} (\xi^2 - 1) (\eta^2 - 1)
        + \tfrac1{24} c_{04} (\eta^4 - 6 \eta^2 + 3) \right]

    with the slopes xi across the wind and eta, positive for ascent towards the wind, in standard
    deviations.

    Parameters
    ----------
    c21, c03 : float
        Skewness: -<xi^2 eta> and -<eta^3>. Negative for waves that lean forward.
    c40, c22, c04 : float
        Peakedness: <xi^4> - 3, <xi^2 eta^2> - 1 and <eta^4> - 3.

    Raises
    ------
    Refused
        If a coefficient is not finite, or the slopes are too far from Gaussian ones: the series
        has :math:`\int (p - g)^2 / g` above 0.5 (0.03 for a clean sea at 10 m/s, g the Gaussian
        density), or no density has its moments.

    Notes
    -----
    Form and coefficients of Cox and Munk as quoted in programs that cite the paper, all alike;
    its number of the equation was not read. Other authors exchange the order of the indices.

    References
    ----------
    C. Cox and W. Munk, J. Opt. Soc. Am. 44, 838 (1954), doi:10.1364/JOSA.44.000838.

    Examples
    --------
    >>> GramCharlier(c03=-0.3, c40=0.4).c03
    -0.3
    """

    c21: Finite = 0.0
    c03: Finite = 0.0
    c40: Finite = 0.0
    c22: Finite = 0.0
    c04: Finite = 0.0

    @classmethod
    def cox_munk(cls, wind_speed: WindSpeed) -> GramCharlier:
        """Return the coefficients of a clean sea.

        c21 = 0.01 - 0.0086 U, c03 = 0.04 - 0.033 U, c40 = 0.40, c22 = 0.12, c04 = 0.23

        Parameters
        ----------
        wind_speed : float
            Wind speed U [m s-1].

        Raises
        ------
        Refused
            If the wind speed is out of range.

        Notes
        -----
        As quoted in programs that cite Cox and Munk (1954), with errors of 0.03, 0.12, 0.23, 0.06
        and 0.41. Measured between 1 and 14 m/s; U at 12.5 m is taken for U at 10 m.

        Examples
        --------
        >>> print(f"{GramCharlier.cox_munk(10.0).c03:.2f}")
        -0.29
        """
        c21, c03 = 0.01 - 0.0086 * wind_speed, 0.04 - 0.033 * wind_speed
        return cls(c21=c21, c03=c03, c40=0.40, c22=0.12, c04=0.23)

    @classmethod
    def breon_henriot(cls, wind_speed: WindSpeed) -> GramCharlier:
        """Return the coefficients measured from space.

        c21 = -9.1e-4 U^2, c03 = -0.45 / (1 + exp(7 - U)), c40 = 0.30, c22 = 0.12, c04 = 0.40

        Parameters
        ----------
        wind_speed : float
            Wind speed U at 10 m [m s-1].

        Raises
        ------
        Refused
            If the wind speed is out of range.

        Notes
        -----
        As quoted in a program that cites the paper, with errors of 0.01, 0.01, 0.05, 0.03 and 0.10.

        References
        ----------
        F.-M. Breon and N. Henriot, J. Geophys. Res. 111, C06005 (2006).

        Examples
        --------
        >>> print(f"{GramCharlier.breon_henriot(10.0).c21:.3f}")
        -0.091
        """
        c03 = -0.45 / (1.0 + math.exp(7.0 - wind_speed))
        return cls(c21=-9.1e-4 * wind_speed**2, c03=c03, c40=0.30, c22=0.12, c04=0.40)

    def cumulants(self, slope_variance: Variances) -> Cumulants:
        """Return the third and fourth cumulants of slopes of variances along and across the wind.

        Examples
        --------
        >>> round(GramCharlier(c03=-0.5).cumulants((0.04, 0.01)).along3, 6)
        -0.004
        """
        pairs = zip(_COEFFICIENTS, _scales(slope_variance), strict=True)
        return Cumulants(*(getattr(self, name) * scale for name, scale in pairs))

    @model_validator(mode="after")
    def _check_distance(self) -> Self:
        _ = self.series
        return self

    @property
    def series(self) -> Series:
        r"""Ratio of the density of the slopes to the Gaussian one, nowhere negative.

        The series is negative for some slopes. The density is

        .. math:: p = g \max(P, 0)

        with the Gaussian density g and the polynomial P of fourth degree for which all moments up
        to the fourth are those of the series: mean 0, the variances, skewness and peakedness. It
        is the one with these moments that has the least :math:`\int p^2 / g`, and the series
        itself where that is positive.

        Notes
        -----
        P comes from Newton's method, its integrals from sums over |xi|, |eta| <= 7 in steps of
        0.05. With the coefficients of Cox and Munk half of the integral of the absolute difference
        from the series is 1e-8 at 5 m/s, 1e-4 at 10 m/s and 0.0045 at 14 m/s.
        """
        return _series(self.c21, self.c03, self.c40, self.c22, self.c04)


@cache
def _quadrature() -> tuple[Floats, Floats, Floats]:
    """Return a quadrature over half the plane of slopes, which is symmetric about the wind.

    Squares of the slopes (n,), weights of the Gaussian density (n,), and the polynomials (9, n)
    that are orthonormal under it.
    """
    lines = np.arange(-_REACH, _REACH + 0.5 * _STEP, _STEP)
    a, c = (v.ravel() for v in np.meshgrid(lines, lines[len(lines) // 2 :], indexing="ij"))
    # all densities are even across the wind: a point off the axis stands for two
    twice = np.where(c < 0.5 * _STEP, 1.0, 2.0)
    weight = twice * _STEP**2 / (2.0 * math.pi) * np.exp(-0.5 * (a * a + c * c))
    powers = np.stack([a**i * c**j for i, j in _POWERS])
    return a**2 + c**2, weight, _hermite() @ powers


def _hermite() -> Floats:
    """Return the coefficients of the powers in each orthonormal polynomial."""
    unit = np.eye(5)
    monomials = np.array([np.pad(herme2poly(unit[i, : i + 1]), (0, 4 - i)) for i in range(5)])
    return (
        np.array([[monomials[i, k] * monomials[j, m] for k, m in _POWERS] for i, j in _POWERS])
        / _NORMS
    )


@lru_cache(maxsize=256)
def _series(c21: float, c03: float, c40: float, c22: float, c04: float) -> Series:
    """Return the series with the moments of five coefficients."""
    if not any((c21, c03, c40, c22, c04)):
        return GAUSSIAN
    # in the slope along the wind, -eta
    wanted = np.array([1.0, 0.0, 0.0, c03, c04, 0.0, c21, c22, c40])
    wanted /= _NORMS[:, 0]
    # chi-square distance by Parseval's sum, since the polynomials are orthonormal
    distance = float(wanted @ wanted) - 1.0
    if not distance <= _FARTHEST:
        raise _refused(f"slopes at a distance of {distance:.2g} from Gaussian ones")
    (square, weight, polynomials), moments = _quadrature(), wanted
    for _ in range(_TRIALS):
        density = np.maximum(moments @ polynomials, 0.0)
        error = polynomials @ (weight * density) - wanted
        if np.abs(error).max() < _ACCURACY:
            break
        # derivative of the moments by the coefficients; where P is negative the density stays 0
        slope = (polynomials * (weight * (density > 0.0))) @ polynomials.T
        moments = moments - np.linalg.lstsq(slope, error)[0]
    else:
        raise _refused("moments that no density has")
    # bound of the density over the wider Gaussian that
    # proposes slopes, see `kernels.interface.WIDE`
    most = float((density * np.exp(-0.5 * square * (1.0 - 1.0 / WIDE))).max())
    return Series._make(map(float, (*(moments @ _hermite()), _ABOVE * WIDE * most)))


def _refused(reason: str) -> Refused:
    allowed = f"a distance of at most {_FARTHEST:g}: a mesh that leaves out more slopes, gaussian"
    return Refused("slope_law", Described(reason), allowed)


SlopeLawName = Literal["gaussian", "cox-munk", "breon-henriot"]


_read = partial(named_or_given, GramCharlier, get_args(SlopeLawName), "slope_law")

SlopeLaw = Annotated[SlopeLawName | GramCharlier, BeforeValidator(_read)]
"""Field type of the density of slopes: a name, coefficients, or their plain data."""


def require_random(law: str | GramCharlier, mss: Mss) -> None:
    """Refuse a density of random slopes for a sea without random slopes."""
    if law != "gaussian" and mss == "band":
        raise Refused("slope_law", law, 'gaussian with mss = "band": no slopes are random')


@check_call
def real_cumulants(
    law: str | GramCharlier,
    wind_speed: float,
    slope_variance: Variances | None,
) -> Cumulants:
    """Return the third and fourth cumulants of the slopes of the real sea."""
    if law == "gaussian" or slope_variance is None:
        return Cumulants()
    if isinstance(law, str):
        named = {"cox-munk": GramCharlier.cox_munk, "breon-henriot": GramCharlier.breon_henriot}
        require_word(law, named, "law")
        law = named[law](wind_speed)
    return law.cumulants(slope_variance)


@check_call
def series_of(cumulants: Cumulants, slope_variance: Variances) -> Series:
    """Return the density of random slopes with these cumulants and variances.

    Raises
    ------
    Refused
        If the slopes are too far from Gaussian ones for their variances.
    """
    if not any(cumulants):
        return GAUSSIAN
    if min(slope_variance) == 0.0:
        reason = Described("random slopes without variance along or across the wind")
        raise Refused("slope_law", reason, "gaussian, or a mesh that leaves out more slopes")
    terms = zip(_COEFFICIENTS, cumulants, _scales(slope_variance), strict=True)
    return GramCharlier.model_validate({name: value / scale for name, value, scale in terms}).series


def _scales(slope_variance: Variances) -> tuple[float, ...]:
    """Return the products of standard deviations that normalise the cumulants."""
    a, c = map(math.sqrt, slope_variance)
    return a**3, a * c * c, a**4, a * a * c * c, c**4
