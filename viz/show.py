"""Output of scenes: a window, pictures, movies of a moving sea and of its light pattern."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from ctypes.util import find_library
from functools import cache
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pyvista as pv
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap, Normalize, PowerNorm
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from numpy.typing import ArrayLike, NDArray

from meshtrace.daylight import Daylight
from meshtrace.engine.paths import PhotonPaths
from meshtrace.engine.setup.options import Meshing
from meshtrace.engine.simulate import simulate
from meshtrace.errors import Described, Refused, require_finite, require_whole, require_writable
from meshtrace.fading.spectral import resolve_band
from meshtrace.files import atomic
from meshtrace.link import Link
from meshtrace.mesh import MeshSource, SurfaceModel, TriangleMesh
from meshtrace.parallel import paced
from meshtrace.results.daylight import IrradianceSeries
from meshtrace.results.gain import GainResult
from meshtrace.results.series import CoverageMap, GainSeries

from .export import SCENE_SUFFIXES, export_scene, require_suffix, save_screenshot
from .scenes import RECEIVED_SHOWN, SceneStyle, scene
from .style import CHALK, DUSK, FATE_COLORS, NIGHT, PALETTE, RC, axis_label, water_map

SIZE = (1280, 640)
"""Pixels of a movie of a scene; multiples of 16, as encoders need them."""

LIGHT_SIZE = (960, 464)
"""Pixels of a movie of the light pattern."""

_SCENE_SHARE = 0.64  # of the width of a frame: the rest shows the gain
_SCENE_SIZE = (round(_SCENE_SHARE * SIZE[0]), SIZE[1])
# Tuned, for the eye: ends of the colour scales of the light, over its mean (the colours go as the
# square root), and of the sea, in standard deviations of its slope.
_BRIGHTEST = 16.0
_STEEPEST = 2.5
_LIGHT_QUALITY = 4.0  # tuned: caustics that move leave an encoder little to predict
_CELLS = 150  # cells over the half-width of a map


def save_movie(
    link: Link,
    surface: MeshSource,
    times: ArrayLike,
    path: str | Path,
    *,
    gain: GainSeries | None = None,
    frame_rate: float | None = None,
    photons: int = 1024,
    quality: float = 8.0,
    progress: Callable[[int], None] | None = None,
    paths: PhotonPaths | int | None = None,
    received: PhotonPaths | int | None = None,
    coverage: CoverageMap | int | None = None,
    seed: int = 1,
    daylight: Daylight | None = None,
    style: SceneStyle = SceneStyle(),  # noqa: B008
) -> Path:
    """Write a movie of a moving sea, with a plot of the gain up to each frame.

    Parameters
    ----------
    link : Link
        The link.
    surface : MeshSource
        The sea, by default with the waves of `time_series`: all that make
        the light of the link fade.
    times : array_like, shape (n,)
        Times of the frames [s], n >= 2.
    path : path
        File, .mp4 or .gif.
    gain : GainSeries, optional
        Gain at these times; computed if not given.
    frame_rate : float, optional
        Frames per second of the movie; by default those at which the sea moves at natural speed.
    photons : int
        Chains of a gain that is computed here.
    quality : float
        Quality of the pictures of an .mp4, 0 to 10 (best); a step enlarges a file by 10 to 30 %.
    progress : callable, optional
        Called with 1 after each frame.
    paths, received, coverage, seed, daylight, style
        As in `scene`; the seed is also that of the gain, and the frames have one `color_limit`.

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
    from meshtrace.studies.series import time_series

    frame_times, path = require_finite(times, "times", "two times or more"), Path(path)
    if len(frame_times) < 2:
        raise Refused("times", frame_times.tolist(), "two times or more")
    rate = natural_rate(frame_times) if frame_rate is None else frame_rate
    options = writer_options(path, rate, quality)
    # the waves that the gain of `time_series` has
    surface = resolve_band(link, surface, fading=True)
    gain = gain or time_series(link, surface, frame_times, photons=photons, seed=seed)
    if not np.array_equal(gain.coordinate, frame_times):
        raise Refused("gain", Described("at other times"), "a series at the times of the frames")
    heights = surface.mesh(float(frame_times[0]), extent=20.0, spacing=1.0).vertices[:, 2]
    # one colour scale for all frames: the elevations [m] of the first, 20 % more for later crests
    limit = style.color_limit or 1.2 * float(np.abs(heights).max()) or None
    style = style.replace(color_limit=limit, off_screen=True, window_size=_SCENE_SIZE)

    def pictures() -> Iterator[NDArray[np.uint8]]:
        plotter = None
        try:
            for time in map(float, frame_times):
                plotter = scene(
                    link, surface, time=time, paths=paths, received=received, coverage=coverage,
                    seed=seed, daylight=daylight, style=style, plotter=plotter,
                )  # fmt: skip
                yield np.asarray(plotter.screenshot(return_img=True))
        # also if a frame fails: no window stays open
        finally:
            if plotter is not None:
                plotter.close()

    return _write_movie(path, _beside_gain(pictures(), gain), len(frame_times), options, progress)


def save_light(
    link: Link,
    surface: Any,
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
    link, surface
        As in `meshtrace.light_pattern`.
    path, frame_rate, progress
        As in `save_irradiance`.
    times : array_like, shape (n,)
        Times of the frames [s], n >= 2 in a movie.
    extent, step : float, optional
        Half-width of the map and edge of its cells [m]; by default 0.4 of the receiver's height,
        in 300 by 300 cells.

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
    path, frame_times = Path(path), require_finite(times, "times", "(n,) times [s]")
    options = writer_options(path, frame_rate, _LIGHT_QUALITY, (".png",))
    if len(frame_times) < (1 if path.suffix == ".png" else 2):
        shape = Described(f"shape {frame_times.shape}")
        raise Refused("times", shape, "(n,) with n >= 2, or a .png")
    height = link.only_receiver.height
    extent = 0.4 * height if extent is None else extent
    step = extent / _CELLS if step is None else step
    from meshtrace.studies.caustics import light_pattern, pattern_ends

    pattern_ends(link, surface, extent, step)  # refuses what has no pattern
    # all waves that make the light fade: those of a mean gain are longer than most patterns
    surface = resolve_band(link, surface, fading=True)
    lines, slope = _sea_crossed(link, surface, extent, float(frame_times[0]))
    # about level water, as a patch within one wave has a slope of its own; a flat sea has no slopes
    # to scale by: any range will do
    steepest = _STEEPEST * float(np.sqrt(np.square(slope).mean())) or 0.1
    first = light_pattern(link, surface, extent, step, time=float(frame_times[0])).gain
    # the mean of the first frame for all: scaled to the mean of each, caustics would pulse
    mean = float(first.mean())
    brightest = min(_BRIGHTEST, max(2.0, 1.3 * float(first.max()) / mean))
    map_ends = [float(x) + np.array([-extent, extent]) for x in link.only_receiver.position]
    with mpl.rc_context(RC):
        left, right = _figure(LIGHT_SIZE, 80).subplots(1, 2)
        sea, label = Normalize(-steepest, steepest), "gain of unscattered light over its mean"
        images = [
            _add_map(left, lines, axis_label("slope_x"), water_map(), sea),
            _add_map(right, map_ends, label, "inferno", PowerNorm(0.5, 0.0, brightest)),
        ]

    def frames() -> Iterator[_Frame]:
        for i, time in enumerate(map(float, frame_times)):
            gain = light_pattern(link, surface, extent, step, time=time).gain if i else first
            slope = _sea_crossed(link, surface, extent, time)[1]
            titles = "sea that the light crosses", f"light {height:g} m above it, t = {time:.2f} s"
            yield (slope, gain / mean), titles

    return _save_maps(path, images, frames(), len(frame_times), options, progress)


def _sea_crossed(
    link: Link, surface: Any, extent: float, time: float
) -> tuple[list[NDArray[np.float64]], NDArray[np.float64]]:
    """Return the limits [m] and slopes of the sea patch crossed by the light of a map."""
    source, receiver = link.transmitters[0], link.only_receiver
    depth = getattr(source, "depth", 1.0)
    # paraxial Snell: rays run off sideways n times as far per metre of air as per metre of water
    share = depth / (depth + link.water.n / link.n_air * receiver.height)
    centers = zip(source.position, receiver.position, strict=True)
    # where the lines from the source to the ends of the map cross the surface, along x and y
    ends: Any = [s + share * (c + np.array([-extent, extent]) - s) for s, c in centers]
    x, y = (np.linspace(a, b, 400) for a, b in ends)
    _, normals = surface.sheet(x, y, time)
    return ends, np.asarray(-normals[..., 0] / normals[..., 2])


def save_irradiance(
    series: IrradianceSeries,
    path: str | Path,
    *,
    depths: Sequence[float] | None = None,
    frame_rate: float = 25.0,
    progress: Callable[[int], None] | None = None,
) -> Path:
    """Write a picture or a movie of the irradiance under a moving sea, over its mean.

    Parameters
    ----------
    series : IrradianceSeries
        Result of `irradiance_series` with a `patch`.
    path : path
        File, .png for the first time, .mp4 or .gif for all.
    depths : sequence of float, optional
        Depths of the series that are shown beside each other [m]; by default the first two.
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
        If the series has no pattern or no such depth, the suffix is another, or a movie has fewer
        than two times.
    """
    path = Path(path)
    options = writer_options(path, frame_rate, _LIGHT_QUALITY, (".png",))
    if series.pattern is None:
        raise Refused("series", Described("no pattern"), "one with a patch")
    depths_of_series = series.depth.tolist()
    depths_shown = depths_of_series[:2] if depths is None else [float(depth) for depth in depths]
    for depth in depths_shown:
        if depth not in depths_of_series:
            raise Refused("depths", depth, f"depths of the series: {depths_of_series}")
    if path.suffix != ".png" and len(series.time) < 2:
        raise Refused("times", series.time.tolist(), "two times or more, or a .png")
    pattern = series.pattern[:, [depths_of_series.index(depth) for depth in depths_shown]]
    # shape (times, depths, nx, ny); the mean of each depth over time and place
    pattern = pattern / pattern.mean(axis=(0, 2, 3), keepdims=True)
    ends = [np.asarray(c)[[0, -1]] for c in (series.x, series.y)]
    with mpl.rc_context(RC):
        axes = _figure(LIGHT_SIZE, 80).subplots(1, len(depths_shown), squeeze=False)[0]
        norm, label = PowerNorm(0.5, 0.0, _BRIGHTEST), "irradiance over its mean"
        images = [_add_map(ax, ends, label, "inferno", norm) for ax in axes]
    titles = ([f"{depth:g} m deep, t = {t:.3f} s" for depth in depths_shown] for t in series.time)
    frames = zip(pattern, titles, strict=True)
    return _save_maps(path, images, frames, len(series.time), options, progress)


def natural_rate(times: NDArray[np.float64]) -> float:
    """Return the frames per second that show times [s] at natural speed."""
    step = float(np.diff(times).mean())
    if not step > 0.0:
        raise Refused("times", times.tolist(), "increasing times, or a frame rate")
    return 1.0 / step


def writer_options(
    path: Path, frame_rate: float, quality: float = 8.0, stills: tuple[str, ...] = ()
) -> dict[str, Any]:
    """Return the options of imageio for a movie, none for a still; refuse other files."""
    if require_suffix(path, (*stills, ".mp4", ".gif")).suffix in stills:
        return {}
    if not frame_rate > 0.0:
        raise Refused("frame_rate", frame_rate, "> 0 frames per second")
    if path.suffix == ".gif":
        # imageio takes milliseconds per frame for a .gif; loop 0 is without end
        return {"duration": 1000.0 / frame_rate, "loop": 0}
    # x264 counts the other way: from 0, lossless, to 51, the worst
    crf = ["-crf", str(round(51 - 5.1 * quality)), "-preset", "slow"]
    return {"fps": frame_rate, "quality": None, "output_params": crf}


def _write_movie(
    path: Path, frames: Iterable[NDArray[np.uint8]], total: int, options: dict[str, Any],
    progress: Callable[[int], None] | None,
) -> Path:  # fmt: skip
    """Write frames (height, width, 3) as a movie."""
    from imageio import v2 as imageio

    with atomic(path) as temporary, imageio.get_writer(temporary, **options) as writer:
        for frame in paced(frames, total, f"{total:,} frames"):
            writer.append_data(frame)  # type: ignore[attr-defined]
            if progress is not None:
                progress(1)
    return path


def _figure(size: tuple[int, int], dpi: int) -> Figure:
    """Return a figure of a size [pixel] on an Agg canvas."""
    figure = Figure(figsize=(size[0] / dpi, size[1] / dpi), dpi=dpi, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def _pixels(figure: Figure) -> NDArray[np.uint8]:
    """Return the pixels (height, width, 3) of a figure."""
    canvas: Any = figure.canvas
    canvas.draw()
    # a copy, since the next frame is drawn into the same buffer
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


_TEXTS = ("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color")


def _beside_gain(
    pictures: Iterable[NDArray[np.uint8]], gain: GainSeries
) -> Iterator[NDArray[np.uint8]]:
    """Yield frames with the scene on the left and the gain so far on the right."""
    from .plots_results import plot_gain_series

    figure, times, gains = _figure(SIZE, 100), gain.coordinate, gain.gains[:, 0]
    with mpl.rc_context(RC | dict.fromkeys(_TEXTS, CHALK)):
        figure.set_layout_engine("none")
        background = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        sky = LinearSegmentedColormap.from_list("sky", [DUSK, NIGHT])
        background.axis("off")
        background.imshow(np.linspace(0.0, 1.0, 256)[:, None], cmap=sky, aspect="auto")
        left = figure.add_axes((0.0, 0.0, _SCENE_SHARE, 1.0))
        left.axis("off")
        picture_shown = left.imshow(np.full((*_SCENE_SIZE[::-1], 3), 255, np.uint8))
        right = figure.add_axes((_SCENE_SHARE + 0.085, 0.16, 0.96 - _SCENE_SHARE - 0.085, 0.7))
        right.set_facecolor("none")
        plot_gain_series(gain, ax=right)
        for text in list(right.texts):  # the title of each frame states the gain instead
            text.remove()
        # the whole series has set the limits of the axes; hidden, it leaves them in place
        for artist in (*right.lines, *right.collections):
            artist.set_visible(False)
        (past,) = right.plot([], [], color=PALETTE["sky"], lw=1.8)
        color = FATE_COLORS["received"]
        (mark,) = right.plot([], [], "o", markersize=9, color=color)
        now = right.axvline(times[0], lw=0.8, color=color)
        title = right.set_title("")
    for i, picture in enumerate(pictures):
        picture_shown.set_data(picture)
        past.set_data(times[: i + 1], gains[: i + 1])
        mark.set_data(times[i : i + 1], gains[i : i + 1])
        now.set_xdata([times[i], times[i]])
        title.set_text(f"t = {times[i]:.2f} s, gain = {gains[i]:.2e}")
        yield _pixels(figure)


_Frame = tuple[Any, Sequence[str]]  # arrays (nx, ny) of the maps, and their titles


def _add_map(ax: Axes, ends: Sequence[Any], label: str, colors: Any, norm: Normalize) -> AxesImage:
    """Add an empty map between its ends along x and y [m], with a colour bar."""
    from .marks import seen_from_above

    extent: Any = np.concatenate(ends)
    image = ax.imshow(
        np.zeros((2, 2)), extent=extent, interpolation="bilinear", origin="lower", cmap=colors,
        norm=norm,
    )  # fmt: skip
    extend = "both" if norm.vmin else "max"  # light has no values below 0
    ax.figure.colorbar(image, ax=ax, label=label, extend=extend, shrink=0.78, aspect=18)
    seen_from_above(ax)
    return image


@mpl.rc_context(RC)
def _save_maps(
    path: Path, images: Sequence[AxesImage], frames: Iterable[_Frame], total: int,
    options: dict[str, Any], progress: Callable[[int], None] | None,
) -> Path:  # fmt: skip
    """Write the maps of a figure: the first frame as a .png, or all as a movie."""
    figure: Any = images[0].figure

    def draw(values: Any, titles: Sequence[str]) -> Figure:
        for image, map_values, title in zip(images, values, titles, strict=True):
            image.set_data(map_values.T)
            image.axes.set_title(title)
        return figure

    if path.suffix == ".png":
        with atomic(path) as temporary:
            draw(*next(iter(frames))).savefig(temporary, dpi=130)
        return path
    pictures = (_pixels(draw(*frame)) for frame in frames)
    return _write_movie(path, pictures, total, options, progress)


SUFFIXES = {
    "screenshot": (".png",),
    "html": (".html",),
    "movie": (".mp4", ".gif"),
    "pattern": (".png", ".mp4", ".gif"),
}
"""File name suffixes of each kind of output."""

FRAME_RATE = 30.0
"""Frames per second of a movie, unless a gain with times of its own is given."""


def view(
    link: Link | None,
    surface: MeshSource | TriangleMesh,
    *,
    time: float = 0.0,
    screenshot: str | Path | None = None,
    html: str | Path | None = None,
    movie: str | Path | None = None,
    pattern: str | Path | None = None,
    export: str | Path | None = None,
    gain: GainSeries | GainResult | None = None,
    frames: int = 300,
    frame_rate: float | None = None,
    title: str = "meshtrace",
    progress: Callable[[int], None] | None = None,
    paths: PhotonPaths | int | None = None,
    received: PhotonPaths | int | None = None,
    coverage: CoverageMap | int | None = None,
    seed: int = 1,
    daylight: Daylight | None = None,
    style: SceneStyle = SceneStyle(),  # noqa: B008
) -> list[Path]:
    """Show a link over a sea in a window, or write pictures and data to files.

    Parameters
    ----------
    link : Link or None
        The link; None shows the surface alone.
    surface : MeshSource or TriangleMesh
        The sea, or a mesh.
    time : float
        Time of the sea [s], at which the movie begins.
    screenshot, html, movie : path, optional
        Files to write: .png, .html, .mp4 or .gif. Without any file or folder a window opens.
    pattern : path, optional
        Picture or movie of the light pattern to write, by `save_light`: .png, .mp4 or .gif.
    export : path, optional
        Folder for VTK files, or a file .glb, .gltf or .obj, by `export_scene`.
    gain : GainSeries or GainResult, optional
        Gain over the times of the movie, or that in the caption of a picture; by default that of
        `simulate` with its default options.
    frames : int
        Frames of the movie, unless a gain is given: 10 s by default.
    frame_rate : float, optional
        Frames per second; by default 30 or, with a given gain, those at which its times run at
        natural speed.
    title : str
        Heading of the web page.
    progress : callable, optional
        Called with 1 after each frame of the movie.
    paths, received, coverage, seed, daylight, style
        As in `scene`; by default 500 paths in pictures and none in movies.

    Returns
    -------
    list of Path
        The files that were written.

    Raises
    ------
    Refused
        If a file could not be written, there is no display to open a window on, no OpenGL to draw
        with, or a movie of a mesh is requested.
    """
    outputs = {"screenshot": screenshot, "html": html, "movie": movie, "pattern": pattern}
    require_outputs(outputs | {"export": export})
    window = not (any(outputs.values()) or export)
    if movie and (link is None or isinstance(surface, TriangleMesh)):
        raise Refused("movie", Described("of a mesh, which does not move"), "a link over a sea")
    series = gain if isinstance(gain, GainSeries) else None
    files: list[Path] = []
    if window or screenshot or html or export:
        still_paths = 500 if paths is None else paths or None  # 0 asks for none
        caption_gain = gain if isinstance(gain, GainResult) else _gain_of(link, surface, time, seed)
        if window or screenshot or export:
            plotter = scene(
                link, surface, time=time, paths=still_paths, received=received, coverage=coverage,
                seed=seed, daylight=daylight, gain=caption_gain,
                style=style.replace(off_screen=not window),
            )  # fmt: skip
            if screenshot:
                files.append(save_screenshot(plotter, screenshot))
            if export:
                files += export_scene(plotter, export)
            if window:
                plotter.show(title=title)
            plotter.close()
        if html:
            from .page import save_html  # pictures need nothing of it

            files.append(save_html(
                link, surface, html, time=time, gain=caption_gain, title=title, paths=still_paths,
                received=received, coverage=coverage, seed=seed, daylight=daylight, style=style,
            ))  # fmt: skip
    if movie or pattern:
        times, rate = _frames(series, time, frames, frame_rate)
    if movie and isinstance(link, Link) and isinstance(surface, MeshSource):
        # a movie shows received light only by default: other paths would hide the sea
        files.append(save_movie(
            link, surface, times, movie, gain=series, frame_rate=rate, progress=progress,
            paths=paths or None, received=received or RECEIVED_SHOWN, coverage=coverage, seed=seed,
            daylight=daylight, style=style,
        ))  # fmt: skip
    if pattern:
        if link is None or not isinstance(surface, SurfaceModel):
            raise Refused("pattern", Described("of a mesh"), "a link over a sea")
        files.append(save_light(
            link, surface, pattern, times, extent=style.extent, frame_rate=rate, progress=progress
        ))  # fmt: skip
    return files


def _gain_of(
    link: Link | None, surface: MeshSource | TriangleMesh, time: float, seed: int
) -> GainResult | None:
    """Compute the gain for the caption; None if `simulate` refuses the link."""
    if link is None:
        return None
    mesh = None if isinstance(surface, TriangleMesh) else Meshing(time=time)
    try:
        return simulate(link, surface, mesh=mesh, seed=seed)
    except Refused:
        return None


def _frames(
    gain: GainSeries | None, start: float, frames: int, rate: float | None
) -> tuple[np.ndarray, float]:
    """Return the times of the frames [s] and the frame rate [s-1]."""
    require_whole(frames, 2, 100_000, "frames")
    if rate is not None and not rate > 0.0:
        raise Refused("frame_rate", rate, "> 0 frames per second")
    if gain is None:
        rate = rate or FRAME_RATE
        return start + np.arange(frames) / rate, rate
    require_whole(len(gain.time), 2, 100_000, "times of the gain")
    return gain.time, rate or natural_rate(gain.time)


def require_outputs(outputs: Mapping[str, str | Path | None]) -> None:
    """Refuse outputs that cannot be drawn or written, and a window without a display."""
    if not any(outputs.values()) and not has_display():
        raise Refused("view", Described("no display"), "screenshot, html, movie or export")
    drawn = next((name for name in ("screenshot", "movie", "pattern") if outputs[name]), None)
    if drawn and not can_draw():
        need = "html, which a browser draws, or libegl1 or libosmesa6 of the system"
        raise Refused(drawn, Described("no OpenGL"), need)
    for kind, name in outputs.items():
        if name is None:
            continue
        path = Path(name)
        if kind in SUFFIXES or path.suffix in SCENE_SUFFIXES:
            suffixes = SUFFIXES.get(kind, SCENE_SUFFIXES)
            require_writable(require_suffix(path, suffixes, kind), field=kind)
            continue
        folder = path if path.exists() else path.parent
        if not (folder.is_dir() and os.access(folder, os.W_OK)):
            raise Refused(kind, str(name), "a folder to write to")


def has_display() -> bool:
    """Return True if a window can be opened; without a display VTK renders in memory."""
    if not sys.platform.startswith("linux"):
        return True
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return False
    # VTK falls back to windows in memory, of these classes, where no display answers
    return not any(kind in _window_class(off_screen=False) for kind in ("EGL", "OSOpenGL"))


def can_draw() -> bool:
    """Return False where the process would crash at its first picture.

    Without a display and EGL the last resort of VTK is OSMesa, which it does not bring along.
    """
    crashes = sys.platform.startswith("linux") and "OSOpenGL" in _window_class(off_screen=True)
    return not crashes or find_library("OSMesa") is not None


@cache  # a view asks twice: the command before its work, and `view` itself
def _window_class(off_screen: bool) -> str:
    """Return the class name of windows of VTK."""
    with pv.vtk_verbosity("off"):
        plotter = pv.Plotter(off_screen=off_screen)
        window: Any = plotter.render_window
        kind = str(window.GetClassName())
        plotter.close()
    return kind
