"""One door for the command line: a window, a picture, a web page or a movie."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from meshtrace.link import Link
from meshtrace.mesh import SurfaceModel, TriangleMesh
from meshtrace.transport.paths import PhotonPaths

from .html import save_html
from .movie import save_movie
from .scenes import scene


def view(
    link: Link | None,
    surface: SurfaceModel | TriangleMesh,
    *,
    time: float = 0.0,
    paths: PhotonPaths | int | None = 100,
    screenshot: str | Path | None = None,
    html: str | Path | None = None,
    movie: str | Path | None = None,
    frames: int = 50,
    frame_rate: float = 10.0,
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
        Files to write: .png, .html, .mp4 or .gif. Without any a window opens.
    frames : int
        Frames of the movie.
    frame_rate : float
        Frames per second, in which the sea moves as in nature.
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
        If there is no display to open a window on, or a movie of a mesh is asked for.
    """
    files: list[Path] = []
    window = not (screenshot or html or movie)
    if window and not _has_display():
        raise ValueError("view: no display to open a window on, allowed screenshot, html or movie")
    if movie:
        if link is None or isinstance(surface, TriangleMesh):
            raise ValueError("movie: of a mesh, which does not move; allowed a link over a sea")
        times = time + np.arange(frames) / frame_rate
        options = {"received": 40, "frame_rate": frame_rate, "progress": progress, **look}
        files.append(save_movie(link, surface, times, movie, **options))
    if window or screenshot or html:
        paths = paths if link is not None else None
        plotter = scene(link, surface, time=time, paths=paths, off_screen=not window, **look)
        if screenshot:
            plotter.screenshot(screenshot)
            files.append(Path(screenshot))
        if html:
            files.append(save_html(plotter, html, title))
        if window:
            plotter.show(title=title)
        plotter.close()
    return files


def _has_display() -> bool:
    if not sys.platform.startswith("linux"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
