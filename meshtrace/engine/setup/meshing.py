"""Mesh of a surface for a link: resolution, coverage and the identifying configuration."""

from __future__ import annotations

import hashlib
import math
import warnings
from typing import Any

import numpy as np

from meshtrace.engine.setup.options import Meshing
from meshtrace.errors import Described, DomainWarning, Refused
from meshtrace.link import Link, WaterAperture
from meshtrace.link.link import Footprint
from meshtrace.link.sources import WaterSource
from meshtrace.mesh import (
    MeshSource,
    PlaneSurface,
    SurfaceModel,
    TriangleMesh,
    WaveSum,
    require_surface,
)
from meshtrace.models import Floats

GAIN_SPACING = 0.45
"""Spacing over 1 / k of the shortest wave: 1 % of the mean gain without random slopes.

That of one surface is finer where its curvature changes on the scale of the light.
"""

FADING_SPACING = 0.9
"""The same for many seas: 0.1 % of the mean and 2 % of the scintillation index, 5 % of a gain.

With random slopes beyond the waves it is 0.5 % of a gain.
"""

_MOST_FACETS = 8e6  # of a mesh: some 2 GB with its intersector
_PLANE_CELLS = 128  # over the half-width of a plane, fine or coarse, that needs no fine mesh
_PHOTON_CELLS = 8  # over the half-width for individual photons, which search no facets
_ASIDE = 5.0  # [m], beyond which the forced estimator has fine facets at the crossings alone
_CLEAR = 0.5  # transport depth b (1 - g) d up to which scattered light of a beam crosses near it
_MOST_LIT = 2e6  # facets where unscattered light crosses, to resolve the shortest wave
_MOST_FINER = 1e5  # facets there for the sake of `_MESH_ERROR`
_MESH_ERROR = 2.5e-3  # relative, of the unscattered light of one surface, root mean square
_SLOPES_UNKNOWN = 0.09  # slope variance of a surface that is no sum of waves: slopes of 0.3
_NODES = 32  # over the half-width of the light, to measure how curvature changes
_TOO_SHORT = 0.01  # share of the slope variance in waves that the mesh leaves out, to be warned of
_MOST_CELLS = 1e9  # along a side, when facets are counted: no overflow of their square
_MARGIN, _MARGIN_OF_MANY = 20.0, 10.0  # spacings beyond the farthest crossing; for many seas
_COVER = 1.01  # half-width over the distance of the end farthest aside, which the mesh must cover


def mesh_for(
    link: Link,
    surface: MeshSource | TriangleMesh,
    meshing: Meshing = Meshing(),  # noqa: B008 - frozen
    reach: float | None = None,
    per_wave: float = GAIN_SPACING,
    few: bool = False,
) -> tuple[TriangleMesh, dict[str, Any]]:
    """Return the mesh for a link and the configuration that identifies it.

    Parameters
    ----------
    link : Link
        The link.
    surface : MeshSource or TriangleMesh
        A sea, triangulated over the link's footprint, meshes in time, or a mesh taken as it is.
    meshing : Meshing
        Time and resolution.
    reach : float, optional
        Largest distance from the axis at which light crosses to a receiver [m]: the forced
        estimator needs no more of the surface. Infinite for all of the footprint.
    per_wave : float
        Spacing over 1 / k of the shortest wave of a sum of waves where light crosses, unless the
        spacing is given: `GAIN_SPACING` or `FADING_SPACING`. Only with `reach`.
    few : bool
        Few facets where the surface is a plane, for individual photons.

    Raises
    ------
    Refused
        If a given mesh does not reach over the sources and receivers, or the surface reaches
        a source or a receiver.
    """
    if isinstance(surface, TriangleMesh):
        mesh = surface
    else:
        require_surface(surface)
        lines = mesh_lines(link, surface, meshing, reach, per_wave, few=few)
        mesh = surface.mesh(meshing.time, **lines)
    require_cover(link, mesh)
    return mesh, surface_config(surface)


def surface_config(surface: MeshSource | TriangleMesh) -> dict[str, Any]:
    """Return the configuration that identifies a surface, for a mesh its digest."""
    if not isinstance(surface, TriangleMesh):
        return dict(surface.to_config())
    arrays = surface.vertices, surface.faces, surface.vertex_normals
    digest = hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()
    return {"kind": "mesh", "sha256": digest, "facets": len(surface.faces)}


def mesh_lines(
    link: Link,
    surface: MeshSource,
    meshing: Meshing = Meshing(),  # noqa: B008 - frozen
    reach: float | None = None,
    per_wave: float = GAIN_SPACING,
    lit_share: float = 1.0,
    few: bool = False,
) -> dict[str, Any]:
    """Return the extent, spacing and centre of the mesh of a sea, as arguments of its `mesh`.

    Parameters
    ----------
    link, surface, meshing, reach, per_wave, few
        As for `mesh_for`.
    lit_share : float
        Half-width of the fine part, over that of `Link.lit_patch`; cells widen outside of it.
        Below 1 for studies of many seas.

    Raises
    ------
    Refused
        If the mesh would have too many facets.
    """
    # three meshes: all of the footprint for individual photons (no reach); its crossings resolved
    # for chains whose reach is infinite; the same, cut to the reach
    f = link.footprint() if reach is None else link.footprint(_ASIDE)
    if reach is not None and reach < math.inf:
        f = _within_reach(link, f, reach, lit_share)
    is_given = meshing.spacing is not None or meshing.extent is not None
    if isinstance(surface, PlaneSurface):
        # facets of a plane differ in nothing: as few as the search for crossings takes well
        if few and not is_given:
            f = f._replace(fine_extent=f.extent, spacing=f.extent / _PHOTON_CELLS)
        fine = max(f.spacing, f.fine_extent / _PLANE_CELLS)
        coarse = max(f.coarse_spacing, f.extent / _PLANE_CELLS, fine)
        f = f._replace(spacing=fine, coarse_spacing=coarse)
    elif isinstance(surface, SurfaceModel) and reach is not None and not is_given:
        if link.crossings():
            f = _resolving(link, surface, f, per_wave, meshing.time, lit_share)
    spacing = meshing.spacing or f.spacing
    _require_size(f, meshing)
    if meshing.extent is not None:
        return {"extent": meshing.extent, "spacing": spacing, "center": link.origin}
    coarse = max(f.coarse_spacing, meshing.spacing or 0.0)
    return f._replace(spacing=spacing, coarse_spacing=coarse)._asdict()


def _within_reach(link: Link, f: Footprint, reach: float, lit_share: float) -> Footprint:
    """Return a footprint cut to where light can cross to a receiver.

    Its half-width is the largest of those that light, grid and link ask for.
    """
    places = np.array([item.center[:2] for _, item in link.items()])
    aside = float(np.abs(places - f.center).max())
    coarse = 4.0 * f.spacing
    if _is_narrow(link, f):
        # light of beams crosses within a quarter of the fine part: half of that is fine enough, and
        # what was fine is the whole mesh, if it covers the ends of the link
        extent = max(f.fine_extent, _COVER * aside)
        return f._replace(extent=extent, fine_extent=0.5 * f.fine_extent, coarse_spacing=coarse)
    # received light crosses up to `reach` from the origin of the link, and waves move it outwards
    margin = _MARGIN if lit_share >= 1.0 else _MARGIN_OF_MANY
    crossed = min(reach + math.dist(f.center, link.origin) + margin * f.spacing, f.extent)
    # spacings grow from the fine to the coarse one over some lines
    extent = max(crossed, f.fine_extent + 10.0 * f.spacing)
    if aside > extent:  # light of a lamp close to the water crosses far from the receiver
        extent = _COVER * aside
    return f._replace(extent=extent, coarse_spacing=coarse)


def _is_narrow(link: Link, f: Footprint) -> bool:
    """Return whether all light comes from beams in clear water that cross near the middle."""
    for t in link.transmitters:
        divergence = getattr(t, "divergence_deg", None)
        if divergence is None or not isinstance(t, WaterSource) or t.axis[2] <= 0.0:
            return False
        # the beam in still water: its spot on the surface, twice its divergence wide
        way = t.depth / t.axis[2]
        spot = np.array(t.center[:2]) + way * np.array(t.axis[:2])
        width = t.size + 2.0 * way * math.tan(math.radians(divergence))
        _, b = link.water.profile(np.linspace(0.0, t.depth, 65))
        turned = float(np.mean(b)) * (1.0 - link.water.phase.mean_cosine) * way
        if math.dist(spot, f.center) + width > 0.25 * f.fine_extent or turned > _CLEAR:
            return False
    return True


def _resolving(
    link: Link, surface: SurfaceModel, f: Footprint, per_wave: float, time: float, lit_share: float
) -> Footprint:
    """Return a footprint whose fine part resolves the waves where unscattered light crosses.

    The lines move apart by 10 % each outside. Where that takes more than `_MOST_LIT` facets the
    footprint stays as it is.
    """
    k2, slopes = _slopes_by_wave(surface)
    shortest = math.sqrt(float(k2[slopes > 0.0].max(initial=0.0)))
    spacing = f.spacing if shortest * f.spacing <= per_wave else per_wave / shortest
    # of many surfaces the mean is wanted, in which errors of single meshes cancel
    single = per_wave <= GAIN_SPACING
    if spacing == f.spacing and not single:
        return f
    # slopes of all waves carry the crossings aside, those that the mesh leaves to chance as well
    beyond = getattr(surface, "unresolved_slopes", lambda _: None)(spacing)
    random = (0.0, 0.0) if beyond is None else beyond.vertex
    # half of the variance: that of one component
    center, half = link.lit_patch(math.sqrt(0.5 * (float(slopes.sum()) + sum(random))))
    half *= lit_share
    if single:
        tilts = math.sqrt(min(random)) if link.physics.unresolved == "tilt" else 0.0
        curvature, change = _curvature(surface, center, half, time)
        # two facets a cell: the spacing at which the patch takes all the facets allowed
        finest = 2.0 * half * math.sqrt(2.0 / _MOST_FINER)
        spacing = min(spacing, max(_accurate(link, curvature, change, tilts), finest))
    if spacing == f.spacing:
        return f
    if 2.0 * (2.0 * half / spacing) ** 2 > _MOST_LIT:
        # Nyquist: lines resolve waves of k h <= pi
        short = float(slopes[np.sqrt(k2) * f.spacing > math.pi].sum() / slopes.sum())
        if short > _TOO_SHORT:
            warnings.warn(
                f"{100.0 * short:.2g} % of the slope variance is that of waves shorter than two "
                f"spacings of the mesh, {f.spacing:g} m: the gain is in doubt; a lower omega_max "
                "leaves short waves to random slopes",
                DomainWarning,
                stacklevel=4,
            )
        return f
    # about another centre, and still over all that the footprint covered
    extent = f.extent + math.dist(center, f.center)
    return Footprint(center, extent, spacing, half, f.coarse_spacing)


def _slopes_by_wave(surface: SurfaceModel) -> tuple[Floats, Floats]:
    """Return k^2 and the slope variance of each wave of a sum."""
    if not isinstance(surface, WaveSum):
        return np.zeros(1), np.array([_SLOPES_UNKNOWN])
    waves = surface.components
    k2 = np.square(waves.kx) + np.square(waves.ky)
    # variance of the slope of a wave, a^2 k^2 / 2
    return k2, 0.5 * np.square(waves.amplitude) * k2


def _curvature(
    surface: SurfaceModel, center: tuple[float, float], half: float, time: float
) -> tuple[float, float]:
    """Return the root mean square second and third derivatives [m-1, m-2] where light crosses."""
    if isinstance(surface, WaveSum):
        k2, slopes = _slopes_by_wave(surface)
        return math.sqrt(float(np.sum(slopes * k2))), math.sqrt(float(np.sum(slopes * k2**2)))
    # differences of the exact slopes, on a grid over the light
    step = half / _NODES
    x, y = (middle + np.linspace(-half, half, 2 * _NODES + 1) for middle in center)
    slopes = np.stack(surface.slopes(*np.meshgrid(x, y, indexing="ij"), time))
    first, second = (
        sum(float(np.mean(np.diff(slopes, n, axis=axis) ** 2)) for axis in (1, 2)) for n in (1, 2)
    )
    # the mean is over both components of the slope: twice it is their sum
    return math.sqrt(2.0 * first) / step, math.sqrt(2.0 * second) / step**2


def _accurate(link: Link, curvature: float, change: float, tilts: float) -> float:
    r"""Return the spacing that keeps the error of unscattered light below `_MESH_ERROR`.

    Parameters
    ----------
    link : Link
        The link.
    curvature, change : float
        Root mean square second and third derivative of the surface [m-1, m-2].
    tilts : float
        Standard deviation of the random slopes.

    Notes
    -----
    .. math:: \delta \approx 0.35 \beta \kappa' h / \sqrt{1 + (4 \rho / h)^2}, \quad
        \beta = \beta_0 / \sqrt{1 + (\beta_0 \kappa)^2}

    A facet has one curvature, that of a place up to h / 2 away, and curvature focuses light by
    beta_0 kappa, beta_0 the displacement of a crossing by a unit of slope. The aperture as seen
    from the source and the random slopes average over a radius rho,
    rho^2 = seen^2 + (beta_0 sigma)^2. Fitted to finer meshes: 0.7 to 4 times the root mean square
    error over sinusoids and seas of h = 0.03 to 0.1 m.
    """
    fine = math.inf
    # lever: beta_0 of a source and a receiver, seen: the radius of its aperture at the surface
    for _, lever, seen, *_ in link.crossings():
        focus = lever / math.hypot(1.0, lever * curvature)
        q = _MESH_ERROR / max(0.35 * focus * change, 1e-300)
        wide = 8.0 * math.hypot(seen, lever * tilts)
        # the equation of the notes solved for h, a quadratic in h^2
        fine = min(fine, math.sqrt(0.5 * q * (q + math.hypot(q, wide))))
    return fine


def _require_size(f: Footprint, meshing: Meshing) -> None:
    """Refuse a mesh with too many facets before its creation.

    The fine and the coarse part are counted as full squares of two facets a cell.
    """
    fine = meshing.spacing or f.spacing
    if meshing.extent is not None:
        facets = 2.0 * min(2.0 * meshing.extent / fine, _MOST_CELLS) ** 2
    else:
        coarse = max(f.coarse_spacing, fine)
        cells = (min(f.fine_extent / fine, _MOST_CELLS), min(f.extent / coarse, _MOST_CELLS))
        # estimated, not made: the mesh itself may not fit into memory
        facets = 8.0 * (cells[0] ** 2 + cells[1] ** 2)
    if facets > _MOST_FACETS:
        size = Described(f"{facets / 1e6:.3g} million facets, some {facets * 250e-9:.2g} GB")
        allowed = f"at most {_MOST_FACETS / 1e6:g} million facets; larger spacing or smaller extent"
        raise Refused("mesh", size, allowed)


def require_cover(link: Link, mesh: TriangleMesh) -> None:
    """Refuse a mesh that does not reach over the link, or reaches a source or a receiver."""
    low, high = mesh.bounds
    for path, item in link.items():
        x, y, z = item.center
        if not (low[0] <= x <= high[0] and low[1] <= y <= high[1]):
            covered = f"covers x {low[0]:g}..{high[0]:g} m, y {low[1]:g}..{high[1]:g} m"
            allowed = f"a mesh that covers the beam: {path} at ({x:g}, {y:g}) m"
            raise Refused("mesh", Described(covered), allowed)
        if low[2] <= z < 0.0:
            allowed = f"below the lowest trough, depth > {-low[2]:.3g} m"
            raise Refused(f"{path}.depth", Described(f"{-z:g} m"), allowed)
        if 0.0 < z <= high[2]:
            allowed = f"above the highest crest, height > {high[2]:.3g} m"
            raise Refused(f"{path}.height", Described(f"{z:g} m"), allowed)
        # rays start at the other ends, and need room up to the waves
        if isinstance(item, WaterAperture):
            continue
        least = link.least_distance
        if low[2] - least < z < 0.0:
            allowed = f"at least {least:g} m below the lowest trough at {low[2]:g} m"
            raise Refused(f"{path}.depth", Described(f"{-z:g} m"), allowed)
        if 0.0 < z < high[2] + least:
            allowed = f"at least {least:g} m above the highest crest at {high[2]:g} m"
            raise Refused(f"{path}.height", Described(f"{z:g} m"), allowed)
