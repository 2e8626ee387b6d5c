"""A link and its sea as one 3D scene."""

from __future__ import annotations

from meshtrace.link import Link
from meshtrace.mesh import SurfaceModel, TriangleMesh
from meshtrace.results.coverage import CoverageMap
from meshtrace.studies.series import coverage_map
from meshtrace.transport.paths import PhotonPaths
from meshtrace.transport.simulate import trace_paths

from .light import PathColor, add_coverage, add_footprint, add_paths, select_paths
from .parts import add_bubbles, add_receiver, add_surface, add_transmitter, add_uav
from .stage import Scene, Stage, add_compass, add_key, add_scale, look, stage_of
from .style import SLIDE

RECEIVED_SHOWN = 40
"""Paths of received light among those shown."""

MOST_CELLS = 1000
"""Mesh cells along the half-width of the sea beyond which none is drawn."""

FOOTPRINT_PATHS = 2000
"""Paths of received light that make the footprint."""


def scene(
    link: Link | None,
    surface: SurfaceModel | TriangleMesh,
    *,
    time: float = 0.0,
    paths: PhotonPaths | int | None = None,
    received: PhotonPaths | int | None = None,
    coverage: CoverageMap | int | None = None,
    color: str = "elevation",
    color_limit: float | None = None,
    path_color: PathColor = "fate",
    edges: bool = False,
    opacity: float = 0.88,
    footprint: bool = True,
    bubbles: bool = True,
    uav: bool = True,
    labels: bool = True,
    extent: float | None = None,
    spacing: float | None = None,
    seed: int = 1,
    off_screen: bool | None = None,
    window_size: tuple[int, int] = SLIDE,
    plotter: Scene | None = None,
) -> Scene:
    """Show a link over a sea.

    Parameters
    ----------
    link : Link or None
        The link; None shows the surface alone.
    surface : SurfaceModel or TriangleMesh
        The sea, or a mesh of its own.
    time : float
        Time of the sea [s].
    paths : PhotonPaths or int, optional
        Analog photon paths, or how many to trace.
    received : PhotonPaths or int, optional
        Paths of received light, or how many to draw, in proportion to the light they carry;
        40 when `paths` are shown, so that received ones are always among them.
    coverage : CoverageMap or int, optional
        Map in the plane of the receiver, or of how many photons to make one over half the sea.
    color : str
        What the surface is coloured by: "elevation", "slope", "slope_x", "slope_y", "plain".
    color_limit : float, optional
        End of the colours of the surface, which begin at its negative (slope: 0); the range of
        the values by default.
    path_color : {"fate", "weight"}
        What the paths are coloured by.
    edges : bool
        Draw the edges of the facets.
    opacity : float
        Opacity of the surface.
    footprint : bool
        Where received light is shown, draw also where it crosses the surface.
    bubbles, uav, labels : bool
        Draw the bubbles, the aircraft, scale and texts.
    extent, spacing : float, optional
        Half-width of the sea shown and its mesh spacing [m]; by default in proportion to the
        link. A small extent gives a close-up of the surface.
    seed : int
        Seed of the paths that are traced.
    off_screen : bool, optional
        Render without a window.
    window_size : tuple of int
        Pixels.
    plotter : Scene, optional
        Draw anew on this one, from where it looks.

    Returns
    -------
    Scene
        A pyvista plotter: `show()`, `screenshot(...)`, or go on with `add_mesh(...)` and the
        `add_` functions of this package.

    Raises
    ------
    ValueError
        If an option is not allowed.

    Examples
    --------
    >>> import meshtrace as mt
    >>> from meshtrace.surfaces import FlatSea
    >>> plotter = scene(mt.Link(), FlatSea(), off_screen=True)
    >>> sorted(plotter.key)
    []
    """
    mesh = surface if isinstance(surface, TriangleMesh) else None
    stage = stage_of(link, mesh, extent)
    if plotter is None:
        plotter = Scene(stage, off_screen=off_screen, window_size=window_size)
    plotter.wipe()
    plotter.suppress_rendering = True  # once shown, it would be rendered after every part
    shown = shown_mesh(surface, stage, time, spacing)
    # from back to front: what is translucent is blended in this order
    if link is not None:
        add_bubbles(plotter, shown, link.bubbles if bubbles else None)
        add_transmitter(plotter, link, shown)
    add_surface(plotter, shown, color=color, color_limit=color_limit, edges=edges, opacity=opacity)
    if link is not None:
        add_light(
            plotter,
            link,
            surface,
            shown,
            time=time,
            paths=paths,
            received=received,
            path_color=path_color,
            footprint=footprint,
            seed=seed,
        )
        add_receiver(plotter, link, shown)
        if uav:
            add_uav(plotter, link)
        add_bubbles(plotter, shown, link.bubbles if bubbles else None, near=True)
    if coverage is not None:
        if isinstance(coverage, int):
            coverage = coverage_of(link, surface, stage, coverage, time=time, seed=seed)
        add_coverage(plotter, coverage)
        look(plotter, elevation_deg=24.0)  # else the map is seen from its edge
    if labels:
        add_scale(plotter)
        add_compass(plotter, *wind_of(surface))
        add_key(plotter)
    plotter.suppress_rendering = False
    plotter.render()
    return plotter


def shown_mesh(
    surface: SurfaceModel | TriangleMesh, stage: Stage, time: float, spacing: float | None
) -> TriangleMesh:
    """Return the surface within the stage: a sea triangulated anew, a mesh as it is."""
    if isinstance(surface, TriangleMesh):
        return surface
    step = spacing or stage.half / 100.0
    if stage.half / step > MOST_CELLS:
        raise ValueError(
            f"spacing: {step:g} m, allowed >= {stage.half / MOST_CELLS:g} m for a sea of "
            f"half-width {stage.half:g} m"
        )
    return surface.mesh(time, stage.half, step, center=stage.center)


def coverage_of(
    link: Link | None,
    surface: SurfaceModel | TriangleMesh,
    stage: Stage,
    photons: int,
    *,
    time: float,
    seed: int,
) -> CoverageMap:
    """Return a coverage map over half the width of the stage, in 40 by 40 cells."""
    if link is None:
        raise ValueError("coverage: of a mesh alone, allowed with a link")
    half = 0.5 * stage.half
    return coverage_map(link, surface, half, half / 20.0, times=(time,), photons=photons, seed=seed)


def wind_of(surface: SurfaceModel | TriangleMesh) -> tuple[float | None, float]:
    """Return wind speed [m s-1], if the surface knows one, and where it blows to [deg]."""
    spectrum = getattr(surface, "spectrum", None)
    speed = getattr(surface, "wind_speed", getattr(spectrum, "wind_speed", None))
    return speed, getattr(surface, "wind_direction_deg", 0.0)


def add_light(
    plotter: Scene,
    link: Link,
    surface: SurfaceModel | TriangleMesh,
    mesh: TriangleMesh,
    *,
    time: float = 0.0,
    paths: PhotonPaths | int | None = None,
    received: PhotonPaths | int | None = None,
    path_color: PathColor = "fate",
    footprint: bool = True,
    seed: int = 1,
) -> Scene:
    """Trace and draw photon paths, received light and its footprint; arguments as for `scene`."""
    if paths is None and received is None:
        return plotter
    if isinstance(paths, int):
        paths = trace_paths(link, surface, paths, time=time, seed=seed)
    if paths is not None:
        add_paths(plotter, paths, color=path_color)
    if isinstance(received, PhotonPaths):
        light, shown = received, received
    else:
        try:
            n = max(received or 0, FOOTPRINT_PATHS)
            light = trace_paths(link, surface, n, received_only=True, time=time, seed=seed)
        except ValueError:
            if received is not None:
                raise
            return plotter  # only analog photons follow this link: theirs are shown
        shown = select_paths(light, slice(received or RECEIVED_SHOWN))
    add_paths(plotter, shown, color=path_color)
    if footprint:
        add_footprint(plotter, mesh, light)
    return plotter
