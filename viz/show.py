"""Output of a scene: a window, a picture, a web page, a movie or files."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv

from meshtrace.daylight.light import Daylight
from meshtrace.engine.paths import PhotonPaths
from meshtrace.engine.setup.options import Meshing
from meshtrace.engine.simulate import simulate
from meshtrace.errors import Described, Refused, require_whole, require_writable
from meshtrace.files import atomic
from meshtrace.link import Link
from meshtrace.mesh import MeshSource, SurfaceModel, TriangleMesh
from meshtrace.results.coverage import CoverageMap
from meshtrace.results.gain import GainResult
from meshtrace.results.series import GainSeries

from .checks import checked
from .export import export_scene
from .html import save_html
from .movie import natural_rate, save_light, save_movie
from .scenes import RECEIVED_SHOWN, SceneStyle, scene

SUFFIXES = {
    "screenshot": (".png",),
    "html": (".html",),
    "movie": (".mp4", ".gif"),
    "light": (".png", ".mp4", ".gif"),
}
"""File name suffixes of each kind of output."""

FRAME_RATE = 30.0
"""Frames per second of a movie without a given gain."""


@checked
def view(
    link: Link | None,
    surface: MeshSource | TriangleMesh,
    *,
    time: float = 0.0,
    paths: PhotonPaths | int | None = None,
    received: PhotonPaths | int | None = None,
    coverage: CoverageMap | int | None = None,
    seed: int = 1,
    daylight: Daylight | None = None,
    style: SceneStyle = SceneStyle(),  # noqa: B008
    screenshot: str | Path | None = None,
    html: str | Path | None = None,
    movie: str | Path | None = None,
    light: str | Path | None = None,
    export: str | Path | None = None,
    gain: GainSeries | None = None,
    frames: int = 300,
    frame_rate: float | None = None,
    title: str = "meshtrace",
    progress: Callable[[int], None] | None = None,
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
    paths : PhotonPaths or int, optional
        Photon paths, or the number to trace: 100 in pictures and none in movies by default.
    received, coverage, seed, daylight, style
        As in `scene`.
    screenshot, html, movie : path, optional
        Files to write: .png, .html, .mp4 or .gif. Without any file or folder a window opens.
    light : path, optional
        Picture or movie of the light pattern to write, by `save_light`: .png, .mp4 or .gif.
    export : path, optional
        Folder for the surface, paths and map as VTK files.
    gain : GainSeries, optional
        Gain over the times of the movie; computed if not given.
    frames : int
        Frames of the movie, unless a gain is given: 10 s by default.
    frame_rate : float, optional
        Frames per second, at natural speed: 30 by default, those of a given gain.
    title : str
        Heading of the web page.
    progress : callable, optional
        Called with 1 after each frame of the movie.

    Returns
    -------
    list of Path
        The files that were written.

    Raises
    ------
    Refused
        If a file could not be written, there is no display to open a window on, or a movie of a
        mesh is requested.
    """
    outputs = {"screenshot": screenshot, "html": html, "movie": movie, "light": light}
    _refuse_unwritable({**outputs, "export": export})
    window = not (any(outputs.values()) or export)
    if window and not has_display():
        raise Refused("view", Described("no display"), "screenshot, html, movie or export")
    if movie and (link is None or isinstance(surface, TriangleMesh)):
        raise Refused("movie", Described("of a mesh, which does not move"), "a link over a sea")
    files: list[Path] = []
    if window or screenshot or html or export:
        traced = (100 if paths is None else paths or None) if link is not None else None
        drawn: Any = {"paths": traced, "received": received, "coverage": coverage, "seed": seed}
        drawn |= {"daylight": daylight, "gain": _gain_of(link, surface, time, seed)}
        shown = replace(style, off_screen=not window)
        plotter = scene(link, surface, time=time, **drawn, style=shown)
        if screenshot:
            with atomic(screenshot) as temporary:
                plotter.screenshot(temporary)
            files.append(Path(screenshot))
        if html:
            files.append(save_html(plotter, html, title))
        if export:
            files += export_scene(plotter, export)
        if window:
            plotter.show(title=title)
        plotter.close()
    if movie and isinstance(link, Link) and isinstance(surface, MeshSource):
        times, rate = _frames(gain, time, frames, frame_rate)
        frames_of: Any = {"gain": gain, "frame_rate": rate, "progress": progress}
        drawn = {"paths": paths or None, "received": received or RECEIVED_SHOWN}
        drawn |= {"coverage": coverage, "seed": seed, "daylight": daylight}
        files.append(save_movie(link, surface, times, movie, **frames_of, **drawn, style=style))
    if light:
        if link is None or not isinstance(surface, SurfaceModel):
            raise Refused("light", Described("of a mesh"), "a link over a sea")
        times, rate = _frames(gain, time, frames, frame_rate)
        sizes: Any = {"extent": style.extent, "frame_rate": rate, "progress": progress}
        files.append(save_light(link, surface, light, times, **sizes))
    return files


def _gain_of(
    link: Link | None, surface: MeshSource | TriangleMesh, time: float, seed: int
) -> GainResult | None:
    """Return the gain for the caption, None for a link that is refused."""
    if link is None:
        return None
    mesh = None if isinstance(surface, TriangleMesh) else Meshing(time=time)
    try:
        return simulate(link, surface, mesh=mesh, photons=2048, seed=seed)
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


def _refuse_unwritable(outputs: dict[str, str | Path | None]) -> None:
    """Check before the work that all outputs can be written."""
    for kind, name in outputs.items():
        if name is None:
            continue
        path, suffixes = Path(name), SUFFIXES.get(kind)
        if suffixes and path.suffix not in suffixes:
            raise Refused(kind, str(name), f"a file name in {' or '.join(suffixes)}")
        if suffixes:
            require_writable(path, field=kind)
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
    with pv.vtk_verbosity("off"):
        plotter = pv.Plotter(off_screen=False)
        window: Any = plotter.render_window
        kind = window.GetClassName()
        plotter.close()
    return "EGL" not in kind and "OSOpenGL" not in kind
