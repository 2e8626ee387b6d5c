"""Base of random seas: waves with random phases, bound waves, and the slopes of the real sea."""

from __future__ import annotations

from abc import abstractmethod
from functools import cached_property
from typing import Any, ClassVar, Literal, Self

import numpy as np
from pydantic import PrivateAttr, model_validator

from meshtrace.errors import Refused
from meshtrace.mesh import Cumulants, UnresolvedSlopes

from .gram_charlier import real_cumulants
from .nonlinear import with_bound_waves
from .parameters import Positive, Seed, Variances
from .statistics import meshed_slope_variance, real_slope_variance, unresolved_slope_variance
from .surface import WaveSurface
from .waves import WaveComponents

# Highest frequency of the waves that make bound waves, over that of the peak. Tuned: a higher one
# adds bound waves of short waves, whose sum diverges, and their number grows with its square.
_PAIRED_OVER_PEAK = 3.0


class RandomSea(WaveSurface, frozen=True):
    """A sum of waves with random phases, one realization per seed.

    Parameters
    ----------
    seed : int
        Seed of the random phases.
    choppy : bool
        First order in Lagrangian coordinates, with sharper crests; see `WaveSurface`.
    order : {1, 2}
        2 adds the bound waves of second order at fixed points, see `with_bound_waves`: crests
        are higher and troughs flatter, and the elevation is skewed. For deep water.
    order_omega_max : float, optional
        Highest frequency of waves that make bound waves [rad s-1], by default 3 times that of the
        peak. The second order diverges for short waves on long ones: waves beyond it are
        superposed linearly.

    Raises
    ------
    Refused
        If `order` is 2 for a choppy sea or in water of finite depth.

    Notes
    -----
    Phases are 2 pi `numpy.random.default_rng(seed).random((n_omega, n_theta))`, frequencies
    along the first axis. A subclass defines `free_waves`.
    """

    seed: Seed = 0
    order: Literal[1, 2] = 1
    order_omega_max: Positive | None = None

    _seedless: dict[str, Any] = PrivateAttr(default_factory=dict)
    """Results that all seeds share: "waves" are the free waves with phases of zero."""
    _unresolved: dict[float, UnresolvedSlopes] = PrivateAttr(default_factory=dict)
    """Results of `unresolved_slopes`, by the spacing of the mesh [m]."""

    # bounds memory and time; a sea with more free, or more bound, waves is refused
    most_components: ClassVar[int] = 1_000_000

    @property
    @abstractmethod
    def free_waves(self) -> WaveComponents:
        """The plane waves of first order."""

    @cached_property
    def components(self) -> WaveComponents:
        """The plane waves as plain arrays: the free ones and, with `order` 2, the bound ones.

        Bound waves are sums and differences of two waves: they do not follow the dispersion.
        """
        free = self.free_waves
        if self.order == 1:
            return free
        limit = self.order_omega_max or _PAIRED_OVER_PEAK * self._peak_frequency()
        return with_bound_waves(free, limit, self.most_components)

    def _peak_frequency(self) -> float:
        """Return the frequency of the largest wave [rad s-1]."""
        waves = self.free_waves
        return float(waves.omega[np.argmax(waves.amplitude)])

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        if self.order == 1:
            if self.order_omega_max is not None:
                raise Refused("order_omega_max", self.order_omega_max, "only with order = 2")
            return self
        if self.choppy:
            raise Refused("order", 2, "1 with choppy = true: both sharpen the same crests")
        if self._water_depth() is not None:
            raise Refused("order", 2, "1 with depth: bound waves are those of deep water")
        return self

    def with_seed(self, seed: int) -> Self:
        """Return another realization of the same sea, which shares the plans of its grids.

        Parameters
        ----------
        seed : int
            Seed of the new phases, >= 0.

        Returns
        -------
        RandomSea
            The same parameters with the new seed. On a grid that this sea has used, a mesh of the
            new one costs no more than a transform.

        Examples
        --------
        >>> from meshtrace.surfaces import JonswapSea
        >>> sea = JonswapSea(wind_speed=13.0, seed=7)
        >>> sea.with_seed(8) == JonswapSea(wind_speed=13.0, seed=8)
        True
        """
        other = self.model_copy(update={"seed": seed})
        # a copy starts empty: share the plans of the sums, and all of the waves but their phases
        other._grids = self._grids  # type: ignore[misc]  # private: not frozen
        other._seedless = self._seedless  # type: ignore[misc]
        return other

    @property
    def _wind(self) -> tuple[float, float | None]:
        """Wind speed [m s-1] and fetch [m] that set the slopes of the real sea."""
        # never read in such a sea: mss = "band" needs no wind
        return 5.0, None

    @property
    def slope_variance(self) -> Variances | None:
        """Slope variances of the real sea along and across the wind, None for `mss` = "band"."""
        return real_slope_variance(getattr(self, "mss", "band"), *self._wind)

    @property
    def _slopes_along_deg(self) -> float:
        """Direction of the slopes along the wind, counter-clockwise from +x [deg]."""
        return getattr(self, "wind_direction_deg", 0.0)

    @property
    def slope_cumulants(self) -> Cumulants:
        """Third and fourth cumulants of the slopes of the real sea, by `slope_law`."""
        law = getattr(self, "slope_law", "gaussian")
        return real_cumulants(law, self._wind[0], self.slope_variance)

    def unresolved_slopes(self, spacing: float) -> UnresolvedSlopes | None:
        """Return the slopes of the real sea that a mesh of this spacing [m] leaves out.

        The slopes of a choppy mesh are taken as those over its labels (the points at rest, see
        `nonlinear`): this neglects terms of relative order `mss`.
        """
        real = self.slope_variance
        # sums over all waves are stored: every mesh of a series asks for the same spacing
        if real is not None and spacing not in self._unresolved:
            wind = self._slopes_along_deg
            vertex, facet = (
                unresolved_slope_variance(real, resolved)
                for resolved in meshed_slope_variance(self.components, spacing, wind)
            )
            slopes = UnresolvedSlopes(vertex, facet, wind, self.slope_cumulants)
            self._unresolved[spacing] = slopes
        return self._unresolved.get(spacing)
