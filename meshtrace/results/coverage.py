"""Gain of a receiver over the places of its plane."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from meshtrace.fields import attrs
from meshtrace.stored import Stored

if TYPE_CHECKING:
    import xarray as xr


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
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    gain: NDArray[np.float64]
    gain_stderr: NDArray[np.float64]
    provenance: dict[str, Any] = field(default_factory=dict)

    kind: ClassVar[str] = "coverage"
    title: ClassVar[str] = "meshtrace coverage map"

    def _headline(self) -> str:
        shape = " x ".join(map(str, self.gain.shape))
        return f"{shape} places, gains up to {self.gain.max():.4e}"

    def summary(self) -> str:
        """Return size, extremes and errors of the map as text for a terminal."""
        peak = np.unravel_index(int(self.gain.argmax()), self.gain.shape)
        lit = self.gain > 0.0
        error = np.median(self.gain_stderr[lit] / self.gain[lit]) if lit.any() else np.nan
        return "\n".join(
            [
                f"gain at {self.gain.size} places, x {self.x[0]:g} to {self.x[-1]:g} m, "
                f"y {self.y[0]:g} to {self.y[-1]:g} m",
                f"  highest              {self.gain[peak]:.4e} +- {self.gain_stderr[peak]:.1e} at "
                f"({self.x[peak[0]]:g}, {self.y[peak[1]]:g}) m",
                f"  mean                 {self.gain.mean():.4e}",
                f"  dark places          {int((~lit).sum())}",
                f"  median error         {100.0 * error:.2g} %",
            ]
        )

    def _content(self) -> xr.Dataset:
        import xarray as xr

        return xr.Dataset(
            {n: (("x", "y"), getattr(self, n), attrs(n)) for n in ("gain", "gain_stderr")},
            {name: (name, getattr(self, name), attrs(name)) for name in ("x", "y")},
        )

    @classmethod
    def _restored(cls, data: xr.Dataset, provenance: Any) -> CoverageMap:
        names = ("x", "y", "gain", "gain_stderr")
        return cls(**{name: data[name].to_numpy() for name in names}, provenance=provenance)
