"""One door for the command line: a window, a picture, a web page, a movie or files."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv

from meshtrace.errors import Refused
from meshtrace.files import atomic, check_writable
from meshtrace.link import Link
from meshtrace.mesh import SurfaceModel, TriangleMesh
from meshtrace.results.series import GainSeries
from meshtrace.transport.paths import PhotonPaths

from .export import export_scene
from .html import save_html
from .movie import save_movie
from .scenes import scene

SUFFIXES = {"screenshot": (".png",), "html": (".html",), "movie": (".mp4", ".gif")}
"""File names that each kind of output takes."""

FRAME_RATE = 10.0
"""Frames per second, where no gain says at which times they are."""


def view(
    link: Link | None,
    surface: SurfaceModel | TriangleMesh,
    *,
    time: float = 0.0,
    paths: PhotonPaths | int | None = 100,
    screenshot: str | Path | None = None,
    html: str | Path | None = None,
    movie: str | Path | None = None,
    export: str | Path | None = None,
    gain: GainSeries | None = None,
    frames: int = 50,
    frame_rate: float | None = None,
    title: str = "meshtrace",
    progress: Callable[[int], None] | None = None,
    **look: Any,
) -> list[Path]:
    """Show a link over a sea in a window, or write what it looks like to files.

    Parameters
    ----------
    link : Link or None
        The link; None shows the surface alone.
    surface : SurfaceModel or TriangleMesh
        The sea, or a mesh of its own.
    time : float
        Time of the sea [s], at which the movie begins.
    paths : PhotonPaths or int, optional
        Photon paths, or how many to trace; not in movies, where the received light is shown.
    screenshot, html, movie : path, optional
        Files to write: .png, .html, .mp4 or .gif. Without any file or folder a window opens.
    export : path, optional
        Folder for the surface, paths and map as VTK files.
    gain : GainSeries, optional
        Gain over the times of the movie, which is computed otherwise.
    frames : int
        Frames of the movie, where no gain says their times.
    frame_rate : float, optional
        Frames per second; by default the sea moves as in nature.
    title : str
        Heading of the web page.
    progress : callable, optional
        Called with 1 after each frame of the movie.
    **look
        Further options of `scene`.

    Returns
    -------
    list of Path
        The files that were written.

    Raises
    ------
    ValueError
        If a file could not be written, there is no display to open a window on, or a movie of a
        mesh is asked for.
    """
    _refuse_unwritable({"screenshot": screenshot, "html": html, "movie": movie, "export": export})
    window = not (screenshot or html or movie or export)
    if window and not has_display():
        raise ValueError(
            "view: no display to open a window on, allowed screenshot, html, movie or export"
        )
    if movie and (link is None or isinstance(surface, TriangleMesh)):
        raise ValueError("movie: of a mesh, which does not move, allowed a link over a sea")
    files: list[Path] = []
    if window or screenshot or html or export:
        paths = paths if link is not None else None
        plotter = scene(link, surface, time=time, paths=paths, off_screen=not window, **look)
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
    if movie and isinstance(link, Link) and isinstance(surface, SurfaceModel):
        times, rate = _frames(gain, time, frames, frame_rate)
        options = {"received": 40, "gain": gain, "frame_rate": rate, "progress": progress, **look}
        files.append(save_movie(link, surface, times, movie, **options))
    return files


def _frames(
    gain: GainSeries | None, start: float, frames: int, rate: float | None
) -> tuple[np.ndarray, float]:
    """Return the times of the frames [s] and how many there are per second."""
    if gain is None:
        rate = rate or FRAME_RATE
        return start + np.arange(frames) / rate, rate
    return gain.time, rate or float(1.0 / np.diff(gain.time).mean())


def _refuse_unwritable(outputs: dict[str, str | Path | None]) -> None:
    """Refuse files that could not be written, before anything is computed."""
    for kind, name in outputs.items():
        if name is None:
            continue
        path, suffixes = Path(name), SUFFIXES.get(kind)
        if suffixes and path.suffix not in suffixes:
            raise ValueError(
                f"{kind}: {str(name)!r}, allowed a file name in {' or '.join(suffixes)}"
            )
        if suffixes:
            check_writable(path, field=kind)
            continue
        folder = path if path.exists() else path.parent
        if not (folder.is_dir() and os.access(folder, os.W_OK)):
            raise Refused(kind, str(name), "a folder to write to")


def has_display() -> bool:
    """Whether a window can be opened: without a display that answers VTK draws in memory."""
    if not sys.platform.startswith("linux"):
        return True
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return False
    with pv.vtk_verbosity("off"):
        plotter = pv.Plotter(off_screen=False)
        kind = plotter.render_window.GetClassName()
        plotter.close()
    return "EGL" not in kind and "OSOpenGL" not in kind
