"""Base of the bubble populations: depths, optical depth and profile."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BeforeValidator, SerializeAsAny

from meshtrace.errors import Refused, require_all, require_array, require_between
from meshtrace.models import Family, Floats

if TYPE_CHECKING:
    from meshtrace.optics.phase import PhaseFunction

# Depth of the layer in e-folding depths: `BubblePopulation.profile` ends there.
LAYER = 12.0
_MOST_NODES = 10**7
# Highest crest [m] to which a population is continued upwards with depth="mean_level".
HIGHEST = 20.0


class BubblePopulation(Family, frozen=True, default="hall-novarini"):
    """Base of the bubble populations: a subclass defines `b`, `e_folding` and `phase_function`.

    Parameters
    ----------
    depth : {"local", "clamped", "mean_level"}
        Depth under waves in the transport: the distance to the surface above the point,
        max(0, -z), or -z even in crests, where depths are negative.
    """

    depth: Literal["local", "clamped", "mean_level"] = "local"

    @property
    @abstractmethod
    def e_folding(self) -> float:
        """Depth scale of the layer [m]: b is tabulated in steps of 1/64 of it, down to 12."""

    @abstractmethod
    def b(self, depth: ArrayLike) -> Floats:
        """Return the scattering coefficient [m-1] at depths [m]."""

    @abstractmethod
    def phase_function(self) -> PhaseFunction:
        """Return the phase function of the population, the same at all depths."""

    def _checked(self, depth: ArrayLike) -> Floats:
        values = require_array(depth, "depth", "finite depths [m]")
        lowest = -HIGHEST if self.depth == "mean_level" else 0.0
        good = np.isfinite(values) & (values >= lowest)
        require_all(values, good, "depth", f"finite depth >= {lowest:g} m")
        return values

    def optical_depth(self, depth1: ArrayLike, depth2: ArrayLike) -> Floats:
        """Return the vertical optical depth of the bubbles between two depths.

        tau = |integral of b(z) dz from depth1 to depth2|

        Parameters
        ----------
        depth1, depth2 : array_like
            Depths [m], in any order, broadcast.

        Returns
        -------
        ndarray
            Optical depth.

        Notes
        -----
        Gauss-Legendre quadrature with 128 nodes, good to 1e-12; all that lies 40 e-folding depths
        below the upper end is left out.
        """
        ends = np.broadcast_arrays(self._checked(depth1), self._checked(depth2))
        upper, lower = np.minimum(*ends), np.maximum(*ends)
        return integrate(self.b, upper, np.minimum(lower, upper + 40.0 * self.e_folding), 128)

    def profile(
        self, dz: float, max_depth: float = math.inf, crest: float = 0.0
    ) -> tuple[Floats, Floats, Floats]:
        """Return b and its integral on a uniform grid of depths.

        Parameters
        ----------
        dz : float
            Spacing [m].
        max_depth : float
            Deepest depth needed [m].
        crest : float
            Height [m] above the mean level at which the grid begins; only with
            depth="mean_level", otherwise 0.

        Returns
        -------
        depth : ndarray, shape (n,)
            Nodes [m], -crest + i dz, to the first at or below `max_depth` or 12 L, whichever
            is higher.
        b : ndarray, shape (n,)
            Scattering coefficient [m-1].
        cumulative : ndarray, shape (n,)
            Optical depth from the first node, zero there.

        Raises
        ------
        Refused
            If `dz` or `max_depth` is not positive, or `crest` is not allowed.

        Notes
        -----
        At the nodes the cumulative is good to 1e-12 (1e-7 for dz = 5 L). Between nodes a cubic
        Hermite interpolant with slopes b errs by about (dz/L)^4/400 of the layer's optical depth,
        a straight line by (dz/L)^2/8. Below 12 L take b = 0: that leaves out 1.1e-5 (5 m/s),
        2.5e-5 (13 m/s) or 5.6e-5 (20 m/s) of the layer's optical depth.

        Examples
        --------
        >>> from meshtrace.optics.bubbles import HallNovarini
        >>> depth, b, cumulative = HallNovarini(wind_speed=13.0, q=2.0).profile(dz=0.01)
        >>> round(float(cumulative[1000]), 7)
        0.0989773
        """
        dz = require_between(dz, 0.0, math.inf, "dz")
        require_between(max_depth, 0.0, math.inf, "max_depth", "(]", "max_depth > 0 m")
        highest = HIGHEST if self.depth == "mean_level" else 0.0
        require_between(crest, 0.0, highest, "crest", "[]", f"0 <= crest <= {highest:g} m")
        most = min(max_depth, LAYER * self.e_folding) + crest
        if most / dz > _MOST_NODES:
            raise Refused("dz", dz, f"at most {_MOST_NODES} nodes over {most:g} m")
        cells = math.ceil(most / dz)
        depth = dz * np.arange(cells + 1, dtype=np.float64) - crest
        steps = integrate(self.b, depth[:-1], depth[1:], 16)
        return depth, self.b(depth), np.concatenate(([0.0], np.cumsum(steps)))


AnyBubbles = Annotated[SerializeAsAny[BubblePopulation], BeforeValidator(BubblePopulation.read)]
"""A bubble population, or plain data with its `kind`."""


def integrate(
    function: Callable[[Floats], Floats], lower: Floats, upper: Floats, nodes: int
) -> Floats:
    """Return the integral of `function` from `lower` to `upper` by Gauss-Legendre quadrature."""
    node, weight = np.polynomial.legendre.leggauss(nodes)
    half = (upper - lower) / 2.0
    points = lower[..., None] + half[..., None] * (1.0 + node)
    return half * (function(points) @ weight)
