"""Base of the phase functions: evaluated, integrated and sampled from one definition.

Every class is a frozen model with the same interface (`PhaseFunction`). Angles are in radians,
phase functions in 1/sr with 2 pi * integral of pdf(theta) sin(theta) = 1. Inside, the angle is
carried as s = sin^2(theta / 2), in which dOmega = 4 pi ds.
"""

from __future__ import annotations

from abc import abstractmethod
from functools import lru_cache
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BeforeValidator, SerializeAsAny

from meshtrace.errors import Described, Refused, require_all, require_array
from meshtrace.kernels.phase import PhaseTables
from meshtrace.models import Family, Floats
from meshtrace.optics.phase_tables import (
    Component,
    Segments,
    bin_component,
    joined,
    power_law_segments,
    sample_s,
)


class PhaseFunction(Family, frozen=True, default="fournier-forand"):
    """Base of the phase functions: a subclass defines `density` alone.

    Notes
    -----
    Densities are joined by power laws of s = sin^2(theta / 2) between 8192 angles, and the law of
    the first two is carried on to 0: normalisation, CDF, moments and samples agree to rounding.
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

    def pdf(self, theta: ArrayLike) -> Floats:
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

    def cdf(self, theta: ArrayLike) -> Floats:
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

    def sample(self, u: ArrayLike) -> Floats:
        """Map uniforms to scattering angles by the tables that the photon kernels use.

        Parameters
        ----------
        u : array_like
            Uniform numbers in [0, 1).

        Returns
        -------
        ndarray
            Scattering angle [rad]. Without components it grows with u.

        Raises
        ------
        Refused
            If a u lies outside [0, 1).
        """
        u = require_array(u, "u", "0 <= u < 1")
        require_all(u, (u >= 0.0) & (u < 1.0), "u", "0 <= u < 1")
        return 2.0 * np.arcsin(np.sqrt(sample_s(self.tables(), u)))

    @property
    def mean_cosine(self) -> float:
        """Asymmetry g, the mean of cos(theta)."""
        return 1.0 - 2.0 * self._mean_s()

    @property
    def backscatter_fraction(self) -> float:
        """Share B of the light that is scattered by more than 90 degrees."""
        return float(1.0 - self._cdf_s(np.array(0.5)))

    def tables(self) -> PhaseTables:
        """Return the tables for `meshtrace.kernels.phase.sample_s`; cached."""
        return _tables(self)

    @abstractmethod
    def density(self, theta: Floats) -> Floats:
        """Return the phase function at angles [rad], in any unit: > 0 for theta > 0."""

    def _segments(self) -> Segments:
        """Return the pieces in the order of s, by default from `density`.

        A density is joined by power laws between angles 0.4 % or 0.04 degrees apart.
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
        """Return the share of light that is scattered to s or less."""
        return _segments(self).cdf(s)

    def _mean_s(self) -> float:
        """Return the mean of s."""
        return _segments(self).mean()

    def _components(self) -> list[Component]:
        """Return the parts that tables are made of."""
        return [bin_component(_segments(self))]


class BuiltInPhase(PhaseFunction, frozen=True):
    """Base of the phase functions that define their pieces, or more, in closed form."""

    def density(self, theta: Floats) -> Floats:
        """Return the phase function [1/sr] at angles [rad]."""
        return self.pdf(theta)


@lru_cache(maxsize=64)
def _segments(phase: PhaseFunction) -> Segments:
    return phase._segments()


@lru_cache(maxsize=64)
def _tables(phase: PhaseFunction) -> PhaseTables:
    return joined(phase._components())


AnyPhase = Annotated[SerializeAsAny[PhaseFunction], BeforeValidator(PhaseFunction.read)]
"""A phase function, or plain data with its `kind`."""


def s_of(theta: ArrayLike) -> Floats:
    """Return sin^2(theta / 2) of checked angles."""
    theta = require_array(theta, "theta", "0 <= theta <= pi rad")
    good = (theta >= 0.0) & (theta <= np.pi)
    require_all(theta, good, "theta", "0 <= theta <= pi rad")
    return np.sin(0.5 * theta) ** 2
