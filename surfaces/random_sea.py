"""Base of the random seas: free waves from a seed, bound waves, and slopes that meshes lack."""

from __future__ import annotations

from abc import abstractmethod
from functools import cached_property
from typing import Any, ClassVar, Literal, Self

import numpy as np
from pydantic import PrivateAttr, model_validator

from meshtrace.errors import Refused
from meshtrace.mesh import UnresolvedSlopes

from .bound_waves import with_bound_waves
from .parameters import Positive, Seed, Variances
from .statistics import meshed_slope_variance, unresolved_slope_variance
from .wave_surface import WaveSurface
from .waves import WaveComponents

_ORDER_OMEGA_MAX = 3.0  # highest frequency of waves that make bound waves, over the peak's


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

    _common: dict[str, Any] = PrivateAttr(default_factory=dict)
    """Results that do not depend on the seed."""

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
        limit = self.order_omega_max or _ORDER_OMEGA_MAX * self._peak_frequency()
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
        """Return another realization of the same sea with the same grid factors.

        Parameters
        ----------
        seed : int
            Seed of the new phases, >= 0.

        Returns
        -------
        RandomSea
            The same parameters with the new seed. Its meshes on a grid that this sea has used
            cost a matrix product only, unless `jitter` draws new frequencies.

        Examples
        --------
        >>> from meshtrace.surfaces import JonswapSea
        >>> sea = JonswapSea(wind_speed=13.0, seed=7)
        >>> sea.with_seed(8) == JonswapSea(wind_speed=13.0, seed=8)
        True
        """
        other = self.model_copy(update={"seed": seed})
        if not getattr(self, "jitter", False):  # which draws new wave vectors
            other._factors.share(self._factors)
            other._common = self._common
        return other

    @property
    def slope_variance(self) -> Variances | None:
        """Slope variances of the real sea along and across the wind; None if not known."""
        return None

    @property
    def _slopes_along_deg(self) -> float:
        """Direction of the first of the slope variances."""
        return getattr(self, "wind_direction_deg", 0.0)

    def unresolved_slopes(self, spacing: float) -> UnresolvedSlopes | None:
        """Return the slope variances that a mesh of this spacing [m] leaves out of `mss`.

        The slopes of a choppy mesh are taken as those of its labels, off by O(mss).
        """
        real = self.slope_variance
        if real is None:
            return None
        wind = self._slopes_along_deg
        vertex, facet = (
            unresolved_slope_variance(real, resolved)
            for resolved in meshed_slope_variance(self.components, spacing, wind)
        )
        return UnresolvedSlopes(vertex, facet, wind)
