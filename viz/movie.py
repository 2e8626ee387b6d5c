"""Movies of a moving sea with its gain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from meshtrace.daylight.light import Daylight
from meshtrace.errors import Described, Refused, require_finite
from meshtrace.files import atomic
from meshtrace.link import Link
from meshtrace.mesh import MeshSource
from meshtrace.results.coverage import CoverageMap
from meshtrace.results.series import GainSeries
from meshtrace.studies.series import time_series
from meshtrace.transport.paths import PhotonPaths

from .checks import checked
from .plots_gain import plot_gain_series
from .scenes import SceneStyle, scene
from .style import PALETTE, RC, SKY

SIZE = (1280, 640)
"""Pixels of a movie; multiples of 16, as encoders need them."""

_SCENE_SHARE = 0.64


@checked
def save_movie(
    link: Link,
    sea: MeshSource,
    times: ArrayLike,
    path: str | Path,
    *,
    gain: GainSeries | None = None,
    frame_rate: float | None = None,
    photons: int = 1024,
    paths: PhotonPaths | int | None = None,
    received: PhotonPaths | int | None = None,
    coverage: CoverageMap | int | None = None,
    seed: int = 1,
    daylight: Daylight | None = None,
    quality: float = 8.0,
    style: SceneStyle = SceneStyle(),  # noqa: B008
    progress: Callable[[int], None] | None = None,
) -> Path:
    """Write a movie of a moving sea, with the gain so far drawn beside it.

    Parameters
    ----------
    link : Link
        The link.
    sea : MeshSource
        The sea.
    times : array_like, shape (n,)
        Times of the frames [s], n >= 2.
    path : path
        File, .mp4 or .gif.
    gain : GainSeries, optional
        Gain at these times; computed if not given.
    frame_rate : float, optional
        Frames per second of the movie; by default those at which the sea moves at natural speed.
    photons, seed : int
        Chains and seed of a gain that is computed here, and seed of the paths.
    daylight, paths, received, coverage, style
        As in `scene`; a `color_limit` common to all frames by default.
    quality : float
        Quality of the pictures of an .mp4, 0 ... 10; a file grows by a tenth or a third per step.
    progress : callable, optional
        Called with 1 after each frame.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    Refused
        If the suffix is not .mp4 or .gif, there are fewer than two times, or the gain has other
        times.
    """
    from imageio import v2 as imageio

    path, times = Path(path), require_finite(times, "times", "two times or more")
    if len(times) < 2:
        raise Refused("times", times.tolist(), "two times or more")
    if frame_rate is None:
        frame_rate = natural_rate(times)
    options = writer_options(path, frame_rate, quality)
    gain = gain or time_series(link, sea, times, photons=photons, seed=seed)
    if not np.array_equal(gain.coordinate, times):
        raise Refused("gain", Described("at other times"), "a series at the times of the frames")
    heights = sea.elevation(*np.meshgrid(np.linspace(-20, 20, 41), np.linspace(-20, 20, 41)))
    limit = style.color_limit or 1.2 * float(np.abs(heights).max()) or None
    frame, plotter = _Frame(gain), None
    style = replace(style, color_limit=limit, off_screen=True, window_size=frame.scene_size)
    light: Any = {"paths": paths, "received": received, "coverage": coverage, "seed": seed}
    light["daylight"] = daylight
    with atomic(path) as temporary, imageio.get_writer(temporary, **options) as writer:
        for time in times:
            plotter = scene(link, sea, time=float(time), **light, style=style, plotter=plotter)
            picture = np.asarray(plotter.screenshot(return_img=True))
            writer.append_data(frame.draw(picture, float(time)))  # type: ignore[attr-defined]
            if progress is not None:
                progress(1)
    if plotter is not None:
        plotter.close()
    return path


def natural_rate(times: NDArray[np.float64]) -> float:
    """Return the frames per second that show times [s] at natural speed."""
    step = float(np.diff(times).mean())
    if not step > 0.0:
        raise Refused("times", times.tolist(), "increasing times, or a frame rate")
    return 1.0 / step


def writer_options(
    path: Path,
    frame_rate: float,
    quality: float = 8.0,
    suffixes: tuple[str, ...] = (".mp4", ".gif"),
) -> dict[str, Any]:
    """Return the options of imageio for a movie; refuse other files."""
    if not frame_rate > 0.0:
        raise Refused("frame_rate", frame_rate, "> 0 frames per second")
    if path.suffix == ".gif":
        return {"duration": 1000.0 / frame_rate, "loop": 0}
    if path.suffix == ".mp4":
        crf = ["-crf", str(round(51 - 5.1 * quality)), "-preset", "slow"]
        return {"fps": frame_rate, "quality": None, "output_params": crf}
    *first, last = suffixes
    raise Refused("path", str(path), f"a file name in {', '.join(first)} or {last}")


class _Frame:
    """Figure with the scene on the left and the gain up to its time on the right."""

    @mpl.rc_context(RC)
    def __init__(self, gain: GainSeries) -> None:
        width, height = SIZE
        self.scene_size = (round(_SCENE_SHARE * width), height)
        figure = Figure(figsize=(width / 100.0, height / 100.0), dpi=100, facecolor=SKY)
        figure.set_layout_engine("none")
        self._canvas = FigureCanvasAgg(figure)
        left = figure.add_axes((0.0, 0.0, _SCENE_SHARE, 1.0))
        left.axis("off")
        self._image = left.imshow(np.full((height, self.scene_size[0], 3), 255, np.uint8))
        right = figure.add_axes((_SCENE_SHARE + 0.085, 0.16, 0.96 - _SCENE_SHARE - 0.085, 0.7))
        right.set_facecolor(SKY)
        plot_gain_series(gain, ax=right)
        for text in list(right.texts):  # the title takes its place
            text.remove()
        self._times = gain.coordinate
        self._gain = gain.gain if gain.gain.ndim == 1 else gain.gain[:, 0]
        for earlier in (*right.lines, *right.collections):
            earlier.set_alpha(0.15)
        (self._past,) = right.plot([], [], color=PALETTE["blue"], lw=1.8)
        (self._mark,) = right.plot([], [], "o", color=PALETTE["vermilion"], markersize=9)
        self._now = right.axvline(self._times[0], color=PALETTE["vermilion"], lw=0.8)
        self._title = right.set_title("")

    def draw(self, picture: NDArray[np.uint8], time: float) -> NDArray[np.uint8]:
        """Return the pixels (height, width, 3) of one frame."""
        gain = float(np.interp(time, self._times, self._gain))
        past = self._times <= time
        self._image.set_data(picture)
        self._past.set_data(self._times[past], self._gain[past])
        self._mark.set_data([time], [gain])
        self._now.set_xdata([time, time])
        self._title.set_text(f"t = {time:.2f} s, gain = {gain:.2e}")
        self._canvas.draw()
        return np.asarray(self._canvas.buffer_rgba())[..., :3].copy()
