"""Surfaces that are sums of plane waves, and the single wave."""

from __future__ import annotations

import math
from abc import abstractmethod
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, PrivateAttr

from .dispersion import angular_frequency
from .parameters import TIME, Depth, Finite, Floats, Positive, finite_array
from .surface import Surface
from .waves import (
    FactorCache,
    WaveComponents,
    sum_elevation,
    sum_second_derivatives,
    sum_slopes,
)


class WaveSurface(Surface, frozen=True):
    """Base of the sums of plane waves: a subclass defines the components.

    z = sum a cos(omega t - kx x - ky y + phase)

    Notes
    -----
    On tensor grids (`grid`, `mesh`) the sum is a matrix product, see `waves.GridFactors`. The
    factors that depend on the grid alone are cached for the last grids used, so that time steps
    and new phases are cheap. The digits of a mesh do not depend on the number of threads.
    """

    _factors: FactorCache = PrivateAttr(default_factory=FactorCache)

    @property
    @abstractmethod
    def components(self) -> WaveComponents:
        """The plane waves as plain arrays."""

    def elevation(self, x: ArrayLike, y: ArrayLike, time: float = 0.0) -> Floats:
        """Return z [m]; see `Surface.elevation`."""
        return sum_elevation(self.components, x, y, TIME.check(time))

    def slopes(self, x: ArrayLike, y: ArrayLike, time: float = 0.0) -> tuple[Floats, Floats]:
        """Return dz/dx and dz/dy; see `Surface.slopes`."""
        return sum_slopes(self.components, x, y, TIME.check(time))

    def second_derivatives(
        self, x: ArrayLike, y: ArrayLike, time: float = 0.0
    ) -> tuple[Floats, Floats, Floats]:
        """Return the second derivatives zxx, zxy, zyy [m-1]; arguments as for `elevation`."""
        return sum_second_derivatives(self.components, x, y, TIME.check(time))

    def grid(
        self, x_axis: ArrayLike, y_axis: ArrayLike, time: float = 0.0
    ) -> tuple[Floats, Floats, Floats]:
        """Return z [m], dz/dx and dz/dy on a tensor grid; see `Surface.grid`."""
        waves = self.components
        x_axis, y_axis = finite_array("x_axis", x_axis), finite_array("y_axis", y_axis)
        factors = self._factors.get(waves, x_axis, y_axis)
        turn = np.exp(1j * (waves.omega * TIME.check(time) + waves.phase))
        return factors.evaluate(waves.amplitude * turn)


class SinusoidalSea(WaveSurface, frozen=True):
    """One plane wave, z = amplitude cos(omega t - k (x cos d + y sin d) + phase).

    Parameters
    ----------
    amplitude : float
        Half the wave height [m], >= 0.
    wavelength : float
        Wavelength 2 pi / k [m].
    direction_deg : float
        Direction d the wave travels to, counter-clockwise from +x [deg].
    phase : float
        Phase at the origin and time 0 [rad].
    depth : float, optional
        Water depth [m]; None is deep water.
    capillary : bool
        Add the surface tension to the dispersion.

    Examples
    --------
    >>> wave = SinusoidalSea(amplitude=0.1, wavelength=2.0)
    >>> wave.elevation([0.0, 1.0, 2.0], 0.0).round(12)
    array([ 0.1, -0.1,  0.1])
    """

    kind: Literal["sinusoid"] = "sinusoid"
    amplitude: Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
    wavelength: Positive
    direction_deg: Finite = 0.0
    phase: Finite = 0.0
    depth: Depth | None = None
    capillary: bool = False

    @cached_property
    def components(self) -> WaveComponents:
        """The one wave as arrays of length one."""
        k = 2.0 * math.pi / self.wavelength
        omega = float(angular_frequency(k, self.depth, self.capillary))
        heading = math.radians(self.direction_deg)
        wave = self.amplitude, omega, k * math.cos(heading), k * math.sin(heading), self.phase
        return WaveComponents(*(np.array([value]) for value in wave))
