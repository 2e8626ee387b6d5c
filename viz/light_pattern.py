"""Pictures and movies of the light pattern over a moving sea."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike, NDArray

from meshtrace.errors import Described, Refused
from meshtrace.files import atomic
from meshtrace.link import Link
from meshtrace.results.coverage import CoverageMap
from meshtrace.studies.light_pattern import light_pattern

from .movie import writer_options
from .style import RC, SKY, axis_label, water_map

SIZE = (960, 464)
"""Pixels of a movie; multiples of 16, as encoders need them."""

_BRIGHTEST = 4.0  # end of the colours, in means
_STEEPEST = 2.5  # end of the colours, in standard deviations of the slope
_QUALITY = 4.0  # of the encoder: fine caustics that move leave little to predict
_CELLS = 150  # over the half-width of the map


def save_light(
    link: Link,
    sea: Any,
    path: str | Path,
    times: ArrayLike = (0.0,),
    *,
    extent: float | None = None,
    step: float | None = None,
    frame_rate: float = 10.0,
    progress: Callable[[int], None] | None = None,
) -> Path:
    """Write a picture or a movie of the light pattern on the plane of the receiver.

    The sea is shown by its slope along x over the patch that the light crosses, the light by its
    gain over the mean.

    Parameters
    ----------
    link, sea
        As in `meshtrace.light_pattern`.
    path : path
        File, .png for the first time, .mp4 or .gif for all.
    times : array_like, shape (n,)
        Times of the frames [s], n >= 2 in a movie.
    extent, step : float, optional
        Half-width of the map and edge of its cells [m]; by default 0.4 of the receiver's height,
        in 300 by 300 cells.
    frame_rate : float
        Frames per second of the movie.
    progress : callable, optional
        Called with 1 after each frame.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    Refused
        If the suffix is another, a movie has fewer than two times, or as in
        `meshtrace.light_pattern`.
    """
    path, at = Path(path), np.atleast_1d(np.asarray(times, dtype=float))
    still = path.suffix == ".png"
    options = {} if still else writer_options(path, frame_rate, _QUALITY, (".png", ".mp4", ".gif"))
    if at.ndim != 1 or len(at) < (1 if still else 2):
        raise Refused("times", Described(f"shape {at.shape}"), "(n,) with n >= 2, or a .png")
    extent = extent or 0.4 * link.only_receiver.height
    size: Any = {"extent": extent, "step": step or extent / _CELLS}
    frame = None
    with atomic(path) as temporary:
        if still:
            frame = _Frame(link, sea, light_pattern(link, sea, **size, time=float(at[0])))
            frame.figure.savefig(temporary, dpi=130)
            return path
        from imageio import v2 as imageio

        with imageio.get_writer(temporary, **options) as writer:
            for time in at:
                pattern = light_pattern(link, sea, **size, time=float(time))
                frame = frame or _Frame(link, sea, pattern)
                writer.append_data(frame.draw(pattern, float(time)))  # type: ignore[attr-defined]
                if progress is not None:
                    progress(1)
    return path


class _Frame:
    """Figure with the slope of the sea on the left and the light on the right."""

    @mpl.rc_context(RC | {"axes.grid": False})
    def __init__(self, link: Link, sea: Any, pattern: CoverageMap) -> None:
        depth, height = getattr(link.transmitters[0], "depth", 1.0), link.only_receiver.height
        share = depth / (depth + link.water.n / link.n_air * height)
        source = np.array(link.transmitters[0].position)
        self.sea, self.mean = sea, float(pattern.gain.mean())
        corner = [np.array([c[0], c[-1]]) for c in (pattern.x, pattern.y)]
        lines = [s + share * (c - s) for s, c in zip(source, corner, strict=True)]
        self.axes = [np.linspace(*line, 400) for line in lines]
        slope = self._slope(0.0)
        limit = _STEEPEST * float(slope.std()) or 0.1
        width, tall = SIZE
        self.figure = Figure(figsize=(width / 80.0, tall / 80.0), dpi=80, facecolor=SKY)
        self._canvas = FigureCanvasAgg(self.figure)
        left, right = self.figure.subplots(1, 2)
        parts = (
            (left, slope, lines, water_map(), (-limit, limit), axis_label("slope_x")),
            (right, pattern.gain / self.mean, corner, "inferno", (0.0, _BRIGHTEST),
             "gain of unscattered light over its mean"),
        )  # fmt: skip
        self._images = [self._show(*part) for part in parts]
        left.set_title("surface where the light crosses")
        self._title = right.set_title(f"light {height:g} m above the sea")

    def _slope(self, time: float) -> NDArray[np.float64]:
        _, normals = self.sea.sheet(*self.axes, time)
        return np.asarray(-normals[..., 0] / normals[..., 2])

    def _show(self, ax: Any, values: Any, corner: Any, colors: Any, limits: Any, label: str) -> Any:
        (x0, x1), (y0, y1) = corner
        image = ax.imshow(
            values.T, origin="lower", extent=(x0, x1, y0, y1), cmap=colors,
            vmin=limits[0], vmax=limits[1], interpolation="bilinear",
        )  # fmt: skip
        extend = "max" if limits[0] == 0.0 else "both"
        self.figure.colorbar(image, ax=ax, label=label, extend=extend, shrink=0.78, aspect=18)
        ax.set(xlabel=axis_label("x"), ylabel=axis_label("y"))
        for axis in (ax.xaxis, ax.yaxis):
            axis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
        return image

    def draw(self, pattern: CoverageMap, time: float) -> NDArray[np.uint8]:
        """Return the pixels (height, width, 3) of one frame."""
        self._images[0].set_data(self._slope(time).T)
        self._images[1].set_data((pattern.gain / self.mean).T)
        self._title.set_text(f"light above the sea, t = {time:.2f} s")
        self._canvas.draw()
        return np.asarray(self._canvas.buffer_rgba())[..., :3].copy()
