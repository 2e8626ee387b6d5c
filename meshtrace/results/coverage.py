"""Gain of a receiver over the places of its plane."""

from __future__ import annotations

from dataclasses import dataclass, field
from statistics import NormalDist
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from meshtrace.models import Floats
from meshtrace.results.provenance import water_of
from meshtrace.stored import Stored, Variable

LIT = 0.01
"""Share of the highest gain below which errors are relative to it."""


@dataclass(frozen=True, eq=False, repr=False)
class CoverageMap(Stored):
    """Gain of a receiver at each place of its plane.

    Attributes
    ----------
    x, y : ndarray, shape (nx,), (ny,)
        Centres of the cells [m].
    gain, gain_stderr : ndarray, shape (nx, ny)
        Gain of the link's receiver if it were there, averaged over the cell, and its error.
    provenance : dict
        Versions and configuration.
    gain_bound : ndarray, shape (nx, ny), or None
        Upper bound of the gain at 95 % confidence in cells without received light, nan
        elsewhere; None if all received light, or without a tolerance.
    """

    x: Annotated[Floats, Variable("x")]
    y: Annotated[Floats, Variable("y")]
    gain: Annotated[Floats, Variable("x y")]
    gain_stderr: Annotated[Floats, Variable("x y")]
    provenance: dict[str, Any] = field(default_factory=dict)
    gain_bound: Annotated[Floats | None, Variable("x y")] = None

    kind: ClassVar[str] = "coverage"
    title: ClassVar[str] = "meshtrace coverage map"

    def _headline(self) -> str:
        shape = " x ".join(map(str, self.gain.shape))
        return f"{shape} places, gains up to {self.gain.max():.4e}"

    def summary(self) -> str:
        """Return size, extremes and errors of the map as text for a terminal."""
        header = (
            f"gain at {self.gain.size} places, x {self.x[0]:g} to {self.x[-1]:g} m, "
            f"y {self.y[0]:g} to {self.y[-1]:g} m"
        )
        lit = self.gain > 0.0
        if not lit.any():
            return f"{header}\n  no light received"
        highest = self.gain == self.gain.max()
        found = place_of_highest(self.gain, self.gain_stderr)
        place = f"place not resolved: {as_high(self.gain, self.gain_stderr).sum()} within errors"
        if found is not None:
            place = f"at ({self.x[found[0]]:g}, {self.y[found[1]]:g}) m"
        error = np.median(self.gain_stderr[lit] / self.gain[lit])
        rows = [
            header,
            f"  highest              {self.gain.max():.4e} +- "
            f"{self.gain_stderr[highest].max():.1e} {place}",
            f"  mean                 {self.gain.mean():.4e}",
            f"  dark places          {int((~lit).sum())}",
            f"  median error         {100.0 * error:.2g} %",
        ]
        if self.gain_bound is not None:
            rows.append(f"  bound where dark     {np.nanmax(self.gain_bound):.1e}")
        return "\n".join([*rows, *self._origin_lines()])

    def _origin_lines(self) -> list[str]:
        """Return the water of the link."""
        if "link" not in self.provenance:
            return []
        return [f"  water                {water_of(self.provenance)}"]


def relative_errors(gain: Floats, stderr: Floats) -> Floats:
    """Return the errors of cells over their gains, or over 1 % of the highest gain."""
    highest = float(gain.max())
    if highest == 0.0:
        return np.full(gain.shape, np.inf)
    return np.asarray(stderr / np.maximum(gain, LIT * highest))


def as_high(gain: Floats, stderr: Floats) -> NDArray[np.bool_]:
    """Return the cells of a map (nx, ny) that may be as high as the highest one.

    The error of a difference is that of independent errors, at 95 % confidence for all cells
    together: of many cells with noise the highest is a chance.
    """
    z = -NormalDist().inv_cdf(0.05 / gain.size)
    best = np.unravel_index(int(gain.argmax()), gain.shape)
    near: NDArray[np.bool_] = gain + z * np.hypot(stderr, stderr[best]) >= gain[best]
    return near


def place_of_highest(gain: Floats, stderr: Floats) -> tuple[int, int] | None:
    """Return the indices of the highest gain of a map (nx, ny), None if errors hide its place.

    It is resolved if all cells that are `as_high` are next to it.
    """
    best = np.array(np.unravel_index(int(gain.argmax()), gain.shape))
    away = np.abs(np.argwhere(as_high(gain, stderr)) - best)
    return (int(best[0]), int(best[1])) if (away <= 1).all() else None
