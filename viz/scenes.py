"""A link with its sea and light as a 3D scene."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Annotated, Any, Literal

import numpy as np
import pyvista as pv
from pydantic import Field

from meshtrace.daylight.light import Daylight
from meshtrace.engine.paths import PhotonPaths
from meshtrace.engine.photons.state import Vertex
from meshtrace.engine.simulate import trace_paths
from meshtrace.errors import Described, Refused, require_whole
from meshtrace.link import Link
from meshtrace.mesh import MeshSource, TriangleMesh
from meshtrace.models import Model, Positive
from meshtrace.results.gain import GainResult
from meshtrace.results.series import CoverageMap

from . import parts
from .export import surface_sampler, to_pyvista
from .stage import ScenePlotter, Stage, add_caption, add_compass, add_key, add_scale, look, stage_of
from .style import FATE_COLORS, SEQUENTIAL, SLIDE
from .water import DEFAULT_DAY, SeaLight, ShadedSea, backdrop, is_day

PathColor = Literal["fate", "weight"]

RECEIVED_SHOWN = 40
"""Number of paths of received light drawn along with paths of any light."""

MOST_CELLS = 1000
"""Largest number of mesh cells along the half-width of the sea."""

ACRONYMS = {"jonswap": "JONSWAP", "tma": "TMA"}
"""Kinds of seas written in capitals."""

FOOTPRINT_PATHS = 2000
"""Number of paths of received light that make the footprint."""

_DUSK = "#728CA6"  # colour of the light on the sea of a link without daylight

_Pixels = Annotated[int, Field(ge=1, le=10_000)]


class SceneStyle(Model, frozen=True):
    """Appearance of a scene.

    Parameters
    ----------
    color : str
        Colour of the surface: "water" as a viewer sees it, "elevation", "slope", "slope_x",
        "slope_y", "plain".
    color_limit : float, optional
        End of the colour scale of the surface, in the unit of `color`; it begins at minus this
        value, or at 0 for "slope". By default the range of the values.
    path_color : {"fate", "weight"}
        Colour of the paths.
    edges : bool
        Draw the edges of the facets.
    opacity : float
        Opacity of the surface.
    footprint : bool
        Draw where received light crosses the surface.
    bubbles, uav, labels : bool
        Draw the bubbles, the aircraft, scale and texts.
    extent, spacing : float, optional
        Half-width of the sea shown and its mesh spacing [m]; by default in proportion to the
        link. A small extent gives a close-up of the surface.
    transparent : bool
        Leave the background of a screenshot by `view` out.
    off_screen : bool
        Render without a window, as always if `pyvista.OFF_SCREEN` is set.
    window_size : tuple of int
        Pixels.

    Raises
    ------
    Refused
        If a value is not allowed.
    """

    color: parts.SurfaceColor = "water"
    color_limit: Positive | None = None
    path_color: PathColor = "fate"
    edges: bool = False
    opacity: float = Field(default=0.88, ge=0.0, le=1.0)
    footprint: bool = True
    bubbles: bool = True
    uav: bool = True
    labels: bool = True
    extent: Positive | None = None
    spacing: Positive | None = None
    transparent: bool = False
    off_screen: bool = False
    window_size: tuple[_Pixels, _Pixels] = SLIDE


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
    shown = shown_mesh(surface, stage, time, style.spacing)
    paths, crossing_paths, received_paths, coverage = light_of(
        link, surface, stage, time, paths=paths, received=received, coverage=coverage, seed=seed
    )
    if plotter is None:
        plotter = ScenePlotter(
            stage, off_screen=style.off_screen or None, window_size=style.window_size,
            transparent=style.transparent,
        )  # fmt: skip
    plotter.wipe()
    plotter.suppress_rendering = True  # else a shown scene is rendered after each part
    day = DEFAULT_DAY if link is None and daylight is None else daylight
    plotter.under(backdrop(day) if day is not None and is_day(day) else None)
    bubbles = link.bubbles if link is not None and style.bubbles else None
    # from back to front: translucent parts are blended in this order
    if link is not None:
        parts.add_bodies(plotter, link)
        parts.add_bubbles(plotter, shown, bubbles)
        parts.add_transmitter(plotter, link, shown, labels=style.labels)
    sea_light = None
    if style.color == "water":
        sea_light = SeaLight.from_link(link, daylight, wind_of(surface))
    _add_sea(plotter, shown, surface, sea_light, time, style, "white" if is_day(day) else _DUSK)
    if link is not None:
        for drawn_paths in (paths, received_paths):
            if drawn_paths is not None:
                add_paths(plotter, drawn_paths, color=style.path_color)
        if crossing_paths is not None and style.footprint:
            add_footprint(plotter, shown, crossing_paths)
        text_offset = 0.0 if coverage is None else _beside(coverage, link)
        parts.add_receiver(plotter, link, shown, labels=style.labels, aside=text_offset)
        if style.uav:
            parts.add_uav(plotter, link)
        parts.add_bubbles(plotter, shown, bubbles, near=True)
    if coverage is not None:
        add_coverage(plotter, coverage)
        look(plotter, elevation_deg=24.0)  # the default camera would see the map from its edge
    if style.labels:
        add_scale(plotter)
        add_compass(plotter, *wind_of(surface))
        add_key(plotter)
        add_caption(plotter, caption(link, surface, time, gain))
    plotter.suppress_rendering = False
    plotter.render()
    return plotter


def _add_sea(
    plotter: ScenePlotter,
    shown: TriangleMesh,
    surface: MeshSource | TriangleMesh,
    sea_light: SeaLight | None,
    time: float,
    style: SceneStyle,
    light_color: str,
) -> None:
    """Add the mesh of a sea that is shown, as water in a light or in the colours of a style."""
    shaded = None
    if sea_light is not None:
        longest, texels = longest_left_out(surface), texels_for(style.window_size)
        shaded = ShadedSea(shown, sea_light, longest, time, texels)
    parts.add_surface(
        plotter, shown, color=style.color, color_limit=style.color_limit, edges=style.edges,
        # VTK blends sheets in front of each other in the order of their facets
        opacity=1.0 if shown.overhangs else style.opacity, shaded=shaded, light_color=light_color,
    )  # fmt: skip
    if isinstance(surface, TriangleMesh):
        plotter.shown["surface"] = surface  # files have all of it


def light_of(
    link: Link | None,
    surface: MeshSource | TriangleMesh,
    stage: Stage,
    time: float,
    *,
    paths: PhotonPaths | int | None,
    received: PhotonPaths | int | None,
    coverage: CoverageMap | int | None,
    seed: int,
) -> tuple[PhotonPaths | None, PhotonPaths | None, PhotonPaths | None, CoverageMap | None]:
    """Return the light of a scene; trace the paths and the map that are given as numbers.

    Paths are those of any photons, those of received light for the footprint, and those to draw.
    """
    if isinstance(coverage, int):
        if link is None:
            raise Refused("coverage", Described("of a mesh alone"), "with a link")
        from meshtrace.studies.coverage import coverage_map

        half, photons = 0.5 * stage.half, coverage
        coverage = coverage_map(
            link, surface, half, half / 20.0, times=(time,), photons=photons, seed=seed
        )
    if link is None:
        return None, None, None, coverage
    trace = partial(trace_paths, link, surface, time=time, seed=seed)
    paths = trace(paths) if isinstance(paths, int) else paths
    # many paths for the footprint, few of them to draw
    return paths, *received_light(trace, paths, received), coverage


def _beside(coverage: CoverageMap, link: Link) -> float:
    """Return the distance [m] of labels from receivers next to a gain map.

    That is 5 % of the width of the map beyond its edge, counted from the receiver farthest from it.
    """
    places = [receiver.position[0] for receiver in link.receivers]
    edge = coverage.x[-1] + 0.05 * float(np.ptp(coverage.x))
    return float(edge - min(places, default=0.0))


def shown_mesh(
    surface: MeshSource | TriangleMesh, stage: Stage, time: float, spacing: float | None
) -> TriangleMesh:
    """Return the surface within the stage as a mesh."""
    if isinstance(surface, TriangleMesh):
        return parts.cut_to(surface, stage.bounds)
    mesh_spacing = spacing or stage.half / 100.0
    if stage.half / mesh_spacing > MOST_CELLS:
        allowed = f">= {stage.half / MOST_CELLS:g} m for a half-width of {stage.half:g} m"
        raise Refused("spacing", mesh_spacing, allowed)
    return surface.mesh(time, stage.half, mesh_spacing, center=stage.center)


def wind_of(surface: Any) -> tuple[float | None, float]:
    """Return the wind speed [m s-1] of a surface, if it has one, and the wind direction [deg]."""
    spectrum = getattr(surface, "spectrum", None)
    speed = getattr(surface, "wind_speed", getattr(spectrum, "wind_speed", None))
    return speed, getattr(surface, "wind_direction_deg", 0.0)


def longest_left_out(surface: MeshSource | TriangleMesh) -> float | None:
    """Return the shortest wavelength [m] in the band of a sea; None for a sea without waves.

    The longest wave left out has about that of the shortest wave in the band.
    """
    waves = getattr(surface, "components", None)
    if waves is None or not len(waves.kx):
        return None
    return float(2.0 * math.pi / max(np.hypot(waves.kx, waves.ky).max(), 1e-9))


def texels_for(window_size: tuple[int, int]) -> int:
    """Return the number of texels along a side of the water for the width of a window."""
    # a power of two, for fast transforms, near 1 / 1.5 of the pixels (tuned)
    return int(np.clip(2 ** round(math.log2(max(window_size[0], 1) / 1.5)), 64, 1024))


NOISIEST = 0.1
"""Largest relative standard error of a gain that a caption states."""


def caption(link: Link | None, surface: Any, time: float, gain: GainResult | None) -> str:
    """Return the caption of a scene: link, sea with wind and seed, time, gain."""
    texts = []
    if link is not None:
        ends = link.transmitters[0], link.receivers[0]
        texts.append(" to ".join(" at ".join(parts.words_of(item)) for item in ends))
    speed = wind_of(surface)[0]
    kind = getattr(surface, "kind", "mesh")
    words = ["mesh" if kind == "mesh" else f"{ACRONYMS.get(kind, kind)} sea"]
    if speed is not None:
        words.append(f"wind {speed:g} m/s")
    if (seed := getattr(surface, "seed", None)) is not None:
        words.append(f"seed {seed}, t = {time:.2f} s")
    if (waves := getattr(surface, "components", None)) is not None and len(waves.amplitude):
        # 4 standard deviations of the elevation: a storm on a small stage looks like a slope
        height = 4.0 * math.sqrt(0.5 * float(np.square(waves.amplitude).sum()))
        words.append(f"Hs {height:.2g} m")
    texts.append(", ".join(words))
    if gain is not None:
        value, error = (np.ravel(v)[0] for v in (gain.gain, gain.gain_stderr))
        # a number in a picture is taken for the result: one that is mostly noise is left out
        if value > 0.0 and error <= NOISIEST * value:
            texts.append(f"gain {value:.2e} ± {error:.0e}")
        elif value == 0.0:
            texts.append("no light received")
    return "; ".join(texts)


def received_light(
    trace: Callable[..., PhotonPaths],
    paths: PhotonPaths | None,
    received: PhotonPaths | int | None,
) -> tuple[PhotonPaths | None, PhotonPaths | None]:
    """Return the received paths for the footprint and the subset to draw."""
    if isinstance(received, PhotonPaths):
        return received, received
    if received is not None:
        require_whole(received, 1, 100_000, "received")
    if paths is None and received is None:
        return None, None
    try:
        paths_received = trace(max(received or 0, FOOTPRINT_PATHS), received_only=True)
    except Refused:
        if received is not None:
            raise
        return None, None  # analog photons alone follow this link: `paths` shows them
    return paths_received, select_paths(paths_received, slice(received or RECEIVED_SHOWN))


def add_paths(
    scene: ScenePlotter, paths: PhotonPaths, *, color: PathColor = "fate"
) -> ScenePlotter:
    """Draw photon paths within the stage.

    Parameters
    ----------
    scene : ScenePlotter
        Scene to draw into.
    paths : PhotonPaths
        The paths.
    color : {"fate", "weight"}
        Colour by the fate of the photon, or by its weight along the path. Rays are fainter the more
        there are and the less light they carry, and fade out at the sides of the stage. Received
        light is drawn thicker; dots mark where it is scattered.

    Returns
    -------
    ScenePlotter
        The same scene.

    Raises
    ------
    Refused
        If the colour is unknown.
    """
    scene.shown["received" if paths.received.all() else "paths"] = paths
    # lines and texts are sized for windows of 1600 pixels
    width = scene.window_size[0] / 1600.0
    landed = ~paths.received & (paths.final == Vertex.LANDED)
    # drawn in reversed order, so that received light lies on top
    fates = (paths.received, landed, ~paths.received & ~landed)  # in the order of the colours
    for (name, shade), indices in reversed([*zip(FATE_COLORS.items(), fates, strict=True)]):
        selected = select_paths(paths, indices)
        if not len(selected.what):
            continue
        received = name == "received"
        rays, n_visible = _rays(scene, selected)
        if not n_visible:
            continue
        # over the root of their number: few rays are visible, and many do not fill the picture
        strength = (_RECEIVED if received else _SEEN) / math.sqrt(n_visible)
        # fainter where they overlap in a narrow bundle: the beam below them stays visible
        spread = math.sqrt(max(np.linalg.eigvalsh(np.cov(rays.points.T))[1], 0.0))
        apart = spread / (_WIDE * scene.stage.size) * math.sqrt(RECEIVED_SHOWN / n_visible)
        strength *= min(max(apart, _LEAST_STRENGTH), 1.0)
        alpha: Any = min(strength, 0.8) * rays["fade"] * (1.0 if received else rays["weight"])
        line_width = (1.6 if received else 1.0) * width
        if color == "weight":
            scene.add_mesh(
                rays, scalars="weight", cmap=SEQUENTIAL, clim=(0.0, 1.0), opacity=alpha,
                scalar_bar_args=scene.bar("photon weight"), line_width=line_width, lighting=False,
            )  # fmt: skip
        else:
            scene.add_tinted(rays, shade, alpha, line_width=line_width)
            scene.key[f"photons {name}"] = shade
        if received:
            _add_dots(scene, selected.vertex[selected.what == Vertex.SCATTER], shade)
    return scene


# Tuned, for the eye.
_SEEN, _RECEIVED = 10.0, 3.0  # opacity of rays, other and received, times the root of their number
_WIDE, _LEAST_STRENGTH = 0.01, 0.2  # of bundles: width, over the size of the stage, and opacity
_PIECES = 60  # segments of a ray as long as the stage
_SOFT = 0.1  # width of the rim in which rays fade, over the size of the stage


def path_segments(paths: PhotonPaths) -> tuple[np.ndarray, ...]:
    """Return the indices of path and first vertex of each straight segment of paths."""
    return np.nonzero(np.arange(paths.what.shape[1] - 1) < paths.length[:, None] - 1)


def _rays(scene: ScenePlotter, paths: PhotonPaths) -> tuple[pv.PolyData, int]:
    """Cut photon paths into short segments, and count the photons on the stage.

    Points have the weight, and a factor from 1 to 0 by which rays fade towards the sides of the
    stage, and towards their end unless that is an aperture.
    """
    stage, (path, vertex) = scene.stage, path_segments(paths)
    start, end = paths.vertex[path, vertex], paths.vertex[path, vertex + 1]
    low, high = stage.ends
    length = np.linalg.norm(end - start, axis=1)
    # each piece is cut where it enters and leaves the stage: shares of its length at which it meets
    # the sides of the box (the slab method)
    with np.errstate(divide="ignore", invalid="ignore"):
        sides = np.sort(((low, high) - start[:, None]) / (end - start)[:, None], axis=1)
    entry, leave = sides[:, 0].max(axis=1).clip(0.0, 1.0), sides[:, 1].min(axis=1).clip(0.0, 1.0)
    near = entry < leave
    start, end, length, path, vertex, entry, leave = (
        a[near] for a in (start, end, length, path, vertex, entry, leave)
    )
    ends_freely = (vertex == paths.length[path] - 2) & ~paths.received[path]
    n = np.ceil((leave - entry) * length / stage.size * _PIECES).astype(int) + 1
    # n points per ray; fraction 0 to 1 of the length of the whole ray, for all rays at once
    fraction = (np.arange(n.sum()) - np.repeat(np.cumsum(n) - n, n)) / np.repeat(n - 1, n).clip(1)
    fraction = np.repeat(entry, n) + fraction * np.repeat(leave - entry, n)
    points = np.repeat(start, n, axis=0) + fraction[:, None] * np.repeat(end - start, n, axis=0)
    pairs = np.column_stack([np.arange(n.sum())[:-1], np.arange(n.sum())[1:]])
    # distance to the nearest side of the stage
    to_side = np.minimum(points - low, high - points).min(axis=1)
    to_end = np.where(np.repeat(ends_freely, n), (1.0 - fraction) * np.repeat(length, n), np.inf)
    fade = np.clip(np.minimum(to_side, to_end) / (_SOFT * stage.size), 0.0, 1.0)
    is_first = np.zeros(n.sum(), bool)
    is_first[np.cumsum(n) - n] = True
    # without the pairs that join the end of a ray to the start of the next
    drawn = ~is_first[pairs[:, 1]] & (fade[pairs] > 0.0).any(axis=1)
    # VTK's list of lines: 2 points, their indices
    rays = pv.PolyData(points, lines=np.insert(pairs[drawn], 0, 2, axis=1).ravel())
    before, after = (np.repeat(paths.weight[path, vertex + i], n) for i in (0, 1))
    rays["weight"], rays["fade"] = before + fraction * (after - before), fade
    return rays, len(np.unique(path))


def select_paths(paths: PhotonPaths, which: np.ndarray | slice) -> PhotonPaths:
    """Select paths by indices, mask or slice."""
    try:
        return PhotonPaths(
            paths.vertex[which], paths.weight[which], paths.what[which], paths.photon[which]
        )
    except (IndexError, TypeError) as error:
        raise Refused("which", which, f"indices, a mask or a slice of {len(paths.what)}") from error


_CROSSINGS = (Vertex.SURFACE_OUT, Vertex.SURFACE_IN)


def _add_dots(scene: ScenePlotter, points: np.ndarray, color: str) -> None:
    """Draw small balls at the points within the stage."""
    points = points[scene.stage.contains(points)]
    if len(points):
        radius = 0.002 * scene.stage.size
        ball = pv.Sphere(radius=radius, theta_resolution=10, phi_resolution=10)
        dots = pv.PolyData(points).glyph(geom=ball, scale=False, orient=False)
        scene.add_mesh(dots, color=color, ambient=0.6)


_LEGIBLE = 0.1  # tuned: smallest footprint, over the size of the stage, that has a colour bar
FOOTPRINT_RANGE_DB = 20.0
"""Range of the colours of the footprint below its brightest spot [dB]."""


def add_footprint(scene: ScenePlotter, mesh: TriangleMesh, received: PhotonPaths) -> ScenePlotter:
    """Draw where received light crosses the surface, in decibels below the brightest spot.

    Parameters
    ----------
    scene : ScenePlotter
        Scene to draw into.
    mesh : TriangleMesh
        The surface.
    received : PhotonPaths
        Paths of received light, drawn in proportion to the light they carry.

    Returns
    -------
    ScenePlotter
        The same scene.
    """
    crossings = received.vertex[np.isin(received.what, _CROSSINGS)][:, :2]
    if not len(crossings):
        return scene
    size = scene.stage.size
    patch = _footprint(mesh, crossings, 0.008 * size)
    patch.points += np.array([0.0, 0.0, 1e-3 * size])  # off the surface, or both would flicker
    illuminated = patch.threshold(-FOOTPRINT_RANGE_DB, scalars="footprint", all_scalars=False)
    illuminated = illuminated.clip_box(scene.stage.bounds, invert=False)
    if not illuminated.n_cells:
        return scene
    legible = max(np.ptp(np.reshape(illuminated.bounds, (3, 2)), axis=1)) > _LEGIBLE * size
    scene.add_mesh(
        illuminated, name="footprint", scalars="footprint", clim=(-FOOTPRINT_RANGE_DB, 0.0),
        cmap="inferno", opacity="linear", lighting=False, show_scalar_bar=bool(legible),
        scalar_bar_args=scene.bar("received light crossing [dB]") if legible else None,
    )  # fmt: skip
    return scene


def _footprint(mesh: TriangleMesh, crossings: np.ndarray, blur: float) -> pv.StructuredGrid:
    """Return a surface patch with the blurred density of crossings [dB below its peak]."""
    from scipy.ndimage import gaussian_filter

    # cells of half the blur (standard deviation [m]), 4 of which contain nearly all light
    low, high = crossings.min(axis=0) - 4.0 * blur, crossings.max(axis=0) + 4.0 * blur
    bins = np.clip(np.ceil((high - low) / (0.5 * blur)).astype(int), 2, 300)
    count, edges = np.histogramdd(crossings, bins=bins, range=list(zip(low, high, strict=True)))
    density = gaussian_filter(count, blur * bins / (high - low), mode="constant")
    x, y = np.meshgrid(*(0.5 * (e[1:] + e[:-1]) for e in edges), indexing="ij")
    z = surface_sampler(mesh)(np.column_stack([x.ravel(), y.ravel()])).reshape(x.shape)
    patch = pv.StructuredGrid(x, y, z)
    # cells without light: 10 dB below the lowest colour, since 0 has no logarithm
    floor = 10.0 ** (-0.1 * FOOTPRINT_RANGE_DB - 1.0)
    level = 10.0 * np.log10(np.maximum(density / density.max(), floor))
    patch.point_data["footprint"] = level.ravel(order="F")
    return patch


def add_coverage(scene: ScenePlotter, coverage: CoverageMap) -> ScenePlotter:
    """Draw a map of the gain in the plane of the receiver, clipped to the stage.

    It is more transparent where the gain is smaller, so that it hides nothing.
    """
    scene.shown["map"] = coverage
    data = to_pyvista(coverage).clip_box(scene.stage.bounds, invert=False)
    frame = data.extract_feature_edges()
    scene.add_mesh(frame, color=scene.chalk, opacity=0.5, lighting=False, name="frame")
    scene.add_mesh(
        data, name="coverage", scalars="gain", cmap="inferno", opacity=[0.05, 0.6, 0.7],
        lighting=False, scalar_bar_args=scene.bar("channel gain"),
    )  # fmt: skip
    return scene
