"""Gain of a receiver over the places of its plane."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

import numpy as np

from meshtrace.models import Floats
from meshtrace.results.provenance import water_of
from meshtrace.results.variables import StoredArrays, Variable


@dataclass(frozen=True, eq=False, repr=False)
class CoverageMap(StoredArrays):
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
        place = (
            f"gain at {self.gain.size} places, x {self.x[0]:g} to {self.x[-1]:g} m, "
            f"y {self.y[0]:g} to {self.y[-1]:g} m"
        )
        lit = self.gain > 0.0
        if not lit.any():
            return f"{place}\n  no light received"
        peak = np.unravel_index(int(self.gain.argmax()), self.gain.shape)
        error = np.median(self.gain_stderr[lit] / self.gain[lit])
        rows = [
            place,
            f"  highest              {self.gain[peak]:.4e} +- {self.gain_stderr[peak]:.1e} at "
            f"({self.x[peak[0]]:g}, {self.y[peak[1]]:g}) m",
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
