"""Route of a receiver: waypoints with straight lines between them."""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np
from pydantic import model_validator

from meshtrace.errors import Described, Refused, require_finite
from meshtrace.models import Finite, Floats, Model, Position, Positive


class Place(NamedTuple):
    """Horizontal position (n, 2) and height (n,) of a receiver [m]."""

    position: Floats
    height: Floats


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
    >>> route.at([0.0, 2.5], height=5.0).position
    array([[-5. ,  0. ],
           [-2.5,  0. ]])
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

    def at(self, times: Floats | list[float], height: Positive) -> Place:
        """Return the places at times (n,) [s].

        Parameters
        ----------
        times : ndarray, shape (n,)
            Times [s] from the first waypoint to the last.
        height : float
            Height [m] of a route without heights.

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
        columns = np.transpose(self.positions)
        position = np.stack([np.interp(wanted, self.times, c) for c in columns], axis=-1)
        # the height of the link's receiver holds along the route
        if self.heights is None:
            return Place(position, np.full(len(wanted), height))
        return Place(position, np.interp(wanted, self.times, self.heights))
