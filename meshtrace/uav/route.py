"""Route of a receiver: waypoints with straight lines between them."""

from __future__ import annotations

from typing import Self

import numpy as np
from pydantic import model_validator

from meshtrace.errors import Described, Refused, require_finite
from meshtrace.models import Finite, Floats, Model, Position, Positive


class Route(Model, frozen=True):
    """Waypoints of a receiver, with straight lines at constant speed between them.

    Parameters
    ----------
    times : sequence of float, length n
        Times at the waypoints [s], increasing, n >= 2.
    positions : sequence of (float, float), length n
        Horizontal positions (x, y) [m].
    heights : sequence of float, length n, optional
        Heights above still water [m], > 0; by default that of the receiver of the link.

    Raises
    ------
    Refused
        If the lengths differ or the times do not increase.

    Examples
    --------
    >>> route = Route(times=(0, 10), positions=((-5, 0), (5, 0)))
    >>> route.at([0.0, 2.5], height=5.0)
    array([[-5. ,  0. ,  5. ],
           [-2.5,  0. ,  5. ]])
    """

    times: tuple[Finite, ...]
    positions: tuple[Position, ...]
    heights: tuple[Positive, ...] | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        n = len(self.times)
        if n < 2 or np.any(np.diff(self.times) <= 0.0):
            raise Refused("times", self.times, "two or more increasing times [s]")
        for name in ("positions", "heights"):
            value = getattr(self, name)
            if value is not None and len(value) != n:
                raise Refused(name, Described(f"{len(value)} of them"), f"{n}, one for each time")
        return self

    def at(self, times: Floats | list[float], height: Positive) -> Floats:
        """Return the positions (x, y, z) [m] at times (n,) [s].

        Parameters
        ----------
        times : ndarray, shape (n,)
            Times [s] from the first waypoint to the last.
        height : float
            Height [m] of a route without heights.

        Returns
        -------
        ndarray, shape (n, 3)

        Raises
        ------
        Refused
            If a time lies outside of the route.
        """
        wanted = require_finite(times, "times", "times (n,) [s]")
        first, last = self.times[0], self.times[-1]
        # beyond the waypoints an interpolation would
        # hold the ends, as if the receiver hovered there
        outside = (wanted < first) | (wanted > last)
        if outside.any():
            raise Refused("times", float(wanted[outside][0]), f"{first:g} <= times <= {last:g}")
        # the height of the link's receiver holds along the route
        heights = self.heights or [height] * len(self.times)
        columns = *np.transpose(self.positions), heights
        return np.stack([np.interp(wanted, self.times, c) for c in columns], axis=-1)
