"""A link and its sea as one 3D scene."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Annotated, Any, TypedDict

import numpy as np
from pydantic import Field

from meshtrace.daylight.light import Daylight
from meshtrace.engine.paths import PhotonPaths
from meshtrace.engine.simulate import trace_paths
from meshtrace.errors import Described, Refused, require_whole
from meshtrace.link import Link
from meshtrace.mesh import MeshSource, TriangleMesh
from meshtrace.models import Model, Positive
from meshtrace.results.coverage import CoverageMap
from meshtrace.results.gain import GainResult
from meshtrace.studies.coverage import coverage_map

from .light import PathColor, add_coverage, add_footprint, add_paths, select_paths
from .parts import (
    SurfaceColor,
    add_bubbles,
    add_receiver,
    add_surface,
    add_transmitter,
    add_uav,
)
from .stage import ScenePlotter, Stage, add_caption, add_compass, add_key, add_scale, look, stage_of
from .style import SLIDE
from .water import SeaLight, ShadedSea

RECEIVED_SHOWN = 40
"""Number of paths of received light shown with other paths."""

MOST_CELLS = 1000
"""Largest number of mesh cells along the half-width of the sea."""

ACRONYMS = {"jonswap": "JONSWAP", "tma": "TMA"}
"""Kinds of seas written in capitals."""

FOOTPRINT_PATHS = 2000
"""Number of paths of received light for the footprint."""

_DUSK = "#728CA6"  # light on the sea of a link without daylight

_Pixels = Annotated[int, Field(ge=1, le=10_000)]


class SceneStyle(Model, frozen=True):
    """Appearance of a scene.

    Parameters
    ----------
    color : str
        Colour of the surface: "water" as a viewer sees it, "elevation", "slope", "slope_x",
        "slope_y", "plain".
    color_limit : float, optional
        End of the colours of the surface, which begin at its negative (slope: 0); the range of
        the values by default.
    path_color : {"fate", "weight"}
        Colour of the paths.
    edges : bool
        Draw the edges of the facets.
    opacity : float
        Opacity of the surface.
    footprint : bool
        With received light, draw its crossings of the surface.
    bubbles, uav, labels : bool
        Draw the bubbles, the aircraft, scale and texts.
    extent, spacing : float, optional
        Half-width of the sea shown and its mesh spacing [m]; by default in proportion to the
        link. A small extent gives a close-up of the surface.
    off_screen : bool
        Render without a window, as always if `pyvista.OFF_SCREEN` is set.
    window_size : tuple of int
        Pixels.

    Raises
    ------
    Refused
        If a value is not allowed.
    """

    color: SurfaceColor = "water"
    color_limit: Positive | None = None
    path_color: PathColor = "fate"
    edges: bool = False
    opacity: float = Field(0.88, ge=0.0, le=1.0)
    footprint: bool = True
    bubbles: bool = True
    uav: bool = True
    labels: bool = True
    extent: Positive | None = None
    spacing: Positive | None = None
    off_screen: bool = False
    window_size: tuple[_Pixels, _Pixels] = SLIDE


class Shown(TypedDict, total=False):
    """Light and appearance of a scene, keywords of `scene` that movies and views take, too."""

    paths: PhotonPaths | int | None
    received: PhotonPaths | int | None
    coverage: CoverageMap | int | None
    seed: int
    daylight: Daylight | None
    style: SceneStyle


def scene(
    link: Link | None,
    surface: MeshSource | TriangleMesh,
    *,
    time: float = 0.0,
    paths: PhotonPaths | int | None = None,
    received: PhotonPaths | int | None = None,
    coverage: CoverageMap | int | None = None,
    seed: int = 1,
    daylight: Daylight | None = None,
    gain: GainResult | None = None,
    style: SceneStyle = SceneStyle(),  # noqa: B008
    plotter: ScenePlotter | None = None,
) -> ScenePlotter:
    """Show a link over a sea.

    Parameters
    ----------
    link : Link or None
        The link; None shows the surface alone.
    surface : MeshSource or TriangleMesh
        The sea, or a mesh.
    time : float
        Time of the sea [s].
    paths : PhotonPaths or int, optional
        Analog photon paths, or the number to trace.
    received : PhotonPaths or int, optional
        Paths of received light, or the number to draw, in proportion to the light they carry;
        40 when `paths` are shown, so that received ones are always among them.
    coverage : CoverageMap or int, optional
        Map in the plane of the receiver, or the number of photons for one over half the sea.
    seed : int
        Seed of the paths that are traced.
    daylight : Daylight, optional
        Sun and sky that the water reflects; by default a sun that stands behind the sea.
    gain : GainResult, optional
        Gain of the link over this sea, for the caption.
    style : SceneStyle
        Colours, parts, extent and window.
    plotter : ScenePlotter, optional
        Scene to redraw, with its camera.

    Returns
    -------
    ScenePlotter
        A pyvista plotter: `show()`, `screenshot(...)`, or continue with `add_mesh(...)` and the
        `add_` functions of this package.

    Raises
    ------
    Refused
        If an option is not allowed.

    Examples
    --------
    >>> import meshtrace as mt
    >>> from meshtrace.surfaces import FlatSea
    >>> plotter = scene(mt.Link(), FlatSea(), style=SceneStyle(off_screen=True))
    >>> sorted(plotter.key)
    []
    """
    stage = stage_of(link, surface, style.extent)
    if plotter is None:
        plotter = ScenePlotter(
            stage, off_screen=style.off_screen or None, window_size=style.window_size
        )
    plotter.wipe()
    plotter.suppress_rendering = True  # once shown, it would be rendered after every part
    shown = shown_mesh(surface, stage, time, style.spacing)
    bubbles = link.bubbles if link is not None and style.bubbles else None
    coverage = _map_of(coverage, link, surface, 0.5 * stage.half, time, seed)
    # from back to front: translucent parts are blended in this order
    if link is not None:
        add_bubbles(plotter, shown, bubbles)
        add_transmitter(plotter, link, shown, labels=style.labels)
    look_of = style.model_dump(include={"color", "color_limit", "edges", "opacity"})
    if style.color == "water":
        light = SeaLight.of(link, daylight, wind_of(surface))
        longest, texels = longest_left_out(surface), texels_for(style.window_size)
        look_of["shaded"] = ShadedSea(shown, light, longest, time, texels)
        look_of["light"] = "white" if link is None or daylight else _DUSK
    add_surface(plotter, shown, **look_of)
    if link is not None:
        trace = partial(trace_paths, link, surface, time=time, seed=seed)
        paths = trace(paths) if isinstance(paths, int) else paths
        crossing, brightest = received_light(trace, paths, received)
        for drawn in (paths, brightest):
            if drawn is not None:
                add_paths(plotter, drawn, color=style.path_color)
        if crossing is not None and style.footprint:
            add_footprint(plotter, shown, crossing)
        aside = 0.0 if coverage is None else float(1.1 * coverage.x[-1])
        add_receiver(plotter, link, shown, labels=style.labels, aside=aside)
        if style.uav:
            add_uav(plotter, link)
        add_bubbles(plotter, shown, bubbles, near=True)
    if coverage is not None:
        add_coverage(plotter, coverage)
        look(plotter, elevation_deg=24.0)  # by default the map is seen from its edge
    if style.labels:
        add_scale(plotter)
        add_compass(plotter, *wind_of(surface))
        add_caption(plotter, caption(link, surface, time, gain))
        add_key(plotter)
    plotter.suppress_rendering = False
    plotter.render()
    return plotter


def _map_of(
    given: CoverageMap | int | None,
    link: Link | None,
    surface: MeshSource | TriangleMesh,
    half: float,
    time: float,
    seed: int,
) -> CoverageMap | None:
    """Return the map, or one of a number of photons in 40 by 40 cells of a half-width [m]."""
    if not isinstance(given, int):
        return given
    if link is None:
        raise Refused("coverage", Described("of a mesh alone"), "with a link")
    run: Any = {"times": (time,), "photons": given, "seed": seed}
    found: CoverageMap = coverage_map(link, surface, half, half / 20.0, **run)
    return found


def shown_mesh(
    surface: MeshSource | TriangleMesh, stage: Stage, time: float, spacing: float | None
) -> TriangleMesh:
    """Return the surface within the stage: a triangulated sea, or the mesh."""
    if isinstance(surface, TriangleMesh):
        return surface
    step = spacing or stage.half / 100.0
    if stage.half / step > MOST_CELLS:
        allowed = f">= {stage.half / MOST_CELLS:g} m for a half-width of {stage.half:g} m"
        raise Refused("spacing", step, allowed)
    return surface.mesh(time, stage.half, step, center=stage.center)


def wind_of(surface: Any) -> tuple[float | None, float]:
    """Return the wind speed [m s-1] of a surface, if it has one, and the wind direction [deg]."""
    spectrum = getattr(surface, "spectrum", None)
    speed = getattr(surface, "wind_speed", getattr(spectrum, "wind_speed", None))
    return speed, getattr(surface, "wind_direction_deg", 0.0)


def longest_left_out(surface: MeshSource | TriangleMesh) -> float | None:
    """Return the longest wave beyond the band of a sea [m], None for a sea without waves."""
    waves = getattr(surface, "components", None)
    if waves is None or not len(waves.kx):
        return None
    return float(2.0 * math.pi / max(np.hypot(waves.kx, waves.ky).max(), 1e-9))


def texels_for(window_size: tuple[int, int]) -> int:
    """Return the points of the colours of the water along a side, by the width of the window."""
    return int(np.clip(2 ** round(math.log2(max(window_size[0], 1) / 1.5)), 64, 1024))


def caption(link: Link | None, surface: Any, time: float, gain: GainResult | None) -> str:
    """Return the caption of a scene: link, sea with wind and seed, time, gain."""
    parts = []
    if link is not None:
        ends = link.transmitters[0], link.receivers[0]
        parts.append(" to ".join(_place(item) for item in ends))
    speed = wind_of(surface)[0]
    kind = getattr(surface, "kind", "mesh")
    words = ["mesh" if kind == "mesh" else f"{ACRONYMS.get(kind, kind)} sea"]
    if speed is not None:
        words.append(f"wind {speed:g} m/s")
    if (seed := getattr(surface, "seed", None)) is not None:
        words.append(f"seed {seed}, t = {time:.2f} s")
    parts.append(", ".join(words))
    if gain is not None:
        value, error = (np.ravel(v)[0] for v in (gain.gain, gain.gain_stderr))
        parts.append(f"gain {value:.2e} ± {error:.0e}")
    return "; ".join(parts)


def _place(item: Any) -> str:
    """Return kind and level of a source or receiver."""
    name = "LED" if getattr(item, "pattern", "") == "led" else item.kind.replace("-", " ")
    if not hasattr(item, "center"):
        return name
    z = item.center[2]
    return f"{name} at height {z:g} m" if z > 0.0 else f"{name} at depth {-z:g} m"


def received_light(
    trace: Callable[..., PhotonPaths],
    paths: PhotonPaths | None,
    received: PhotonPaths | int | None,
) -> tuple[PhotonPaths | None, PhotonPaths | None]:
    """Return the received light for the footprint, and the paths to draw."""
    if isinstance(received, PhotonPaths):
        return received, received
    if received is not None:
        require_whole(received, 1, 100_000, "received")
    if paths is None and received is None:
        return None, None
    try:
        light = trace(max(received or 0, FOOTPRINT_PATHS), received_only=True)
    except Refused:
        if received is not None:
            raise
        return None, None  # only analog photons follow this link: theirs are shown
    return light, select_paths(light, slice(received or RECEIVED_SHOWN))
