"""A wave that leans over: an overhanging surface of known shape."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from meshtrace import TriangleMesh
from meshtrace.errors import Refused
from meshtrace.surfaces import Surface, parameters, triangulate

_STEPS = 60  # of Newton and bisection for the label over a place


class LeaningWave(Surface, frozen=True):
    """A wave at rest whose crests lean towards +x, and overhang if they lean far.

    z = a cos(k s), x = s + lean (max(z, 0) / a)^2, the same for all y

    Parameters
    ----------
    amplitude : float
        Half the wave height a [m], > 0.
    wavelength : float
        Wavelength 2 pi / k [m], > 0.
    lean : float
        Shift of the crests [m], >= 0. From 1 / k on they overhang.

    Notes
    -----
    A shear (x, z) -> (x + g(z), z) of a height field never meets itself and keeps areas: the
    surface is sound for any lean, and the volume under it is that of the cosine. It overhangs
    between the folds dx/ds = 0, where lean k sin(2 k s) = 1 and 0 < k s < pi / 2. It is a test
    surface; no wave on water has this shape. Its meshes are tensor grids of labels s and y; they
    cover up to `lean` more of x than `extent`.

    Examples
    --------
    >>> wave = LeaningWave(amplitude=0.3, wavelength=4.0, lean=0.9)
    >>> round(wave.overlap, 4), wave.single_valued
    (0.1364, False)
    """

    amplitude: parameters.Positive
    wavelength: parameters.Positive
    lean: Annotated[float, Field(ge=0.0, allow_inf_nan=False)]

    @property
    def wavenumber(self) -> float:
        """Wavenumber k [m-1]."""
        return 2.0 * math.pi / self.wavelength

    @property
    def single_valued(self) -> bool:
        """Whether every crest is a height field, lean < 1 / k."""
        return self.lean * self.wavenumber < 1.0

    @property
    def folds(self) -> NDArray[np.float64]:
        """Label s, position x and height z [m] of the two folds at the crest x = 0, shape (2, 3).

        Empty, shape (0, 3), where nothing overhangs.
        """
        if self.single_valued:
            return np.empty((0, 3))
        first = math.asin(1.0 / (self.lean * self.wavenumber))
        s = np.array([first, math.pi - first]) / (2.0 * self.wavenumber)
        x, z = self.profile(s)
        return np.stack([s, x, z], axis=1)

    @property
    def overlap(self) -> float:
        """Width of the strip of three crossings of a vertical with each crest [m]."""
        folds = self.folds
        return float(folds[0, 1] - folds[1, 1]) if len(folds) else 0.0

    def profile(self, s: ArrayLike) -> tuple[parameters.Floats, parameters.Floats]:
        """Return the positions x and heights z [m] at labels s [m]."""
        s = parameters.finite_array("s", s)
        z = self.amplitude * np.cos(self.wavenumber * s)
        return s + self.lean * (np.maximum(z, 0.0) / self.amplitude) ** 2, z

    def _tangent(self, s: parameters.Floats) -> tuple[parameters.Floats, parameters.Floats]:
        """Return dx/ds and dz/ds at labels s [m]."""
        k = self.wavenumber
        z, dz = self.amplitude * np.cos(k * s), -self.amplitude * k * np.sin(k * s)
        return 1.0 + 2.0 * self.lean * np.maximum(z, 0.0) * dz / self.amplitude**2, dz

    def elevation(self, x: ArrayLike, y: ArrayLike, time: float = 0.0) -> parameters.Floats:
        """Return z [m]; see `Surface.elevation`. Refused for overhanging crests."""
        parameters.finite_array("time", time)
        x, y = parameters.points(x, y)
        return self.profile(self._labels(x))[1]

    def slopes(
        self, x: ArrayLike, y: ArrayLike, time: float = 0.0
    ) -> tuple[parameters.Floats, parameters.Floats]:
        """Return dz/dx and dz/dy = 0; see `elevation`."""
        parameters.finite_array("time", time)
        x, y = parameters.points(x, y)
        dx, dz = self._tangent(self._labels(x))
        return dz / dx, np.zeros(x.shape)

    def _labels(self, x: parameters.Floats) -> parameters.Floats:
        """Return the labels s [m] of positions x [m]: Newton, kept in a bracket."""
        if not self.single_valued:
            critical = 1.0 / self.wavenumber
            allowed = f"lean < {critical:.4g} m for one elevation at each place; use mesh()"
            raise Refused("lean", self.lean, allowed)
        low, high, s = x - self.lean, x + 0.0, x - 0.5 * self.lean
        for _ in range(_STEPS):
            beyond = self.profile(s)[0] - x
            low, high = np.where(beyond < 0.0, s, low), np.where(beyond < 0.0, high, s)
            step = s - beyond / self._tangent(s)[0]
            s = np.where((step >= low) & (step <= high), step, 0.5 * (low + high))
        return s

    def sheet(
        self, x_axis: ArrayLike, y_axis: ArrayLike, time: float = 0.0
    ) -> tuple[parameters.Floats, parameters.Floats]:
        """Return points and normals over a tensor grid of labels s and y; see `Surface.sheet`."""
        parameters.finite_array("time", time)
        s, y = parameters.grid_lines(x_axis, y_axis)
        (x, z), (dx, dz) = self.profile(s), self._tangent(s)
        length = np.hypot(dx, dz)
        normals = triangulate.grid_points(-dz / length, np.zeros_like(y), (dx / length)[:, None])
        return triangulate.grid_points(x, y, z[:, None]), normals

    def mesh(
        self,
        time: float = 0.0,
        extent: float = 20.0,
        spacing: float = 0.1,
        *,
        center: tuple[float, float] = (0.0, 0.0),
        fine_extent: float | None = None,
        coarse_spacing: float | None = None,
    ) -> TriangleMesh:
        """Triangulate the surface; see `Surface.mesh`."""
        lines, half = (
            triangulate.GridLines(extent, spacing, fine_extent, coarse_spacing),
            0.5 * self.lean,
        )
        s = lines.widened(half).axis(center[0] - half)
        y = lines.axis(center[1])
        return triangulate.mesh_of_sheet(*self.sheet(s, y, time), overhangs=not self.single_valued)
