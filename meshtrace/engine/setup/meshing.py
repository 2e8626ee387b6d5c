"""Mesh of a surface for a link: resolution, coverage and the configuration that identifies it."""

from __future__ import annotations

import hashlib
import math
from typing import Any

import numpy as np

from meshtrace.engine.setup.options import Meshing
from meshtrace.errors import Described, DomainWarning, Refused, warn
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
"""Largest k h of the shortest wave, h the spacing: an error of 1 % of the mean gain.

That is without random slopes. Meshes of one surface are finer where its curvature changes within
the light (`_accurate_spacing`).
"""

FADING_SPACING = 0.9
"""Largest k h in ensembles: errors of 0.1 % of the mean gain and 2 % of the scintillation index.

Of one gain 5 %, or 0.5 % where random slopes stand for shorter waves.
"""

_MOST_FACETS = 8e6  # of a mesh: some 2 GB with its intersector
_PLANE_CELLS = 128  # at most, over the half-width of the fine part and of the mesh of a plane
_PHOTON_CELLS = 8  # the same for analog photons: rays, whose cost hardly depends on the cells
_ASIDE = 5.0  # [m] for `Link.footprint` in forced detection: ends farther aside get no fine part
# transport depth b (1 - g) s, s the path of a beam, up to which its scattered light stays near it
_CLEAR = 0.5
# most facets in the patch where unscattered light crosses, to resolve the shortest wave
_MOST_IN_PATCH = 2e6
_MOST_FINER = 1e5  # most facets there to keep `_MESH_ERROR`, which takes finer ones; tuned: time
_MESH_ERROR = 2.5e-3  # relative rms error of the unscattered light of one surface
_SLOPES_UNKNOWN = 0.09  # slope variance of a surface that is no sum of waves: slopes of 0.3
_NODES = 32  # grid steps over the half-width of the patch, to measure curvature by differences
_TOO_SHORT = 0.01  # share of the slope variance in waves that the mesh leaves out, to be warned of
_MOST_CELLS = 1e9  # cap of the cells along a side, so that their square does not overflow
# spacings beyond the farthest crossing, where waves may move it: for one sea and for many; tuned
_MARGIN, _MARGIN_OF_MANY = 20.0, 10.0
_COVER = 1.01  # half-width over the largest offset of an end: `require_cover` needs 1


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
        Largest distance from `Link.origin` at which light crosses to a receiver [m]: forced
        detection needs no more of the surface. Infinite for the whole footprint with resolved
        crossings; None for the plain footprint.
    per_wave : float
        Largest k h of the shortest wave of a sum of waves where light crosses, h the spacing,
        unless `meshing` gives it: `GAIN_SPACING` or `FADING_SPACING`. Used with `reach` alone.
    few : bool
        Whether to make few facets where the surface is a plane, as for analog photons.

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
    """Return the configuration that identifies a surface; for a mesh, a digest of its arrays."""
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
    fine_patch: float = 1.0,
    few: bool = False,
) -> dict[str, Any]:
    """Return the extent, spacing and centre of the mesh of a sea, as arguments of its `mesh`.

    Parameters
    ----------
    link, surface, meshing, reach, per_wave, few
        As for `mesh_for`.
    fine_patch : float
        Half-width of the fine part relative to that of `Link.lit_patch`; cells widen outside.
        Studies of many seas may choose less than 1.

    Raises
    ------
    Refused
        If the mesh would have too many facets.
    """
    # Three kinds of mesh: the plain footprint (reach is None); with infinite reach its crossings
    # are resolved; with a finite one the footprint is also cut to the reach.
    f = link.footprint() if reach is None else link.footprint(_ASIDE)
    if reach is not None and reach < math.inf:
        f = _within_reach(link, f, reach, fine_patch)
    is_given = meshing.spacing is not None or meshing.extent is not None
    if isinstance(surface, PlaneSurface):
        # all facets of a plane are alike: only as many as make the search for crossings fast
        if few and not is_given:
            f = f._replace(fine_extent=f.extent, spacing=f.extent / _PHOTON_CELLS)
        fine = max(f.spacing, f.fine_extent / _PLANE_CELLS)
        coarse = max(f.coarse_spacing, f.extent / _PLANE_CELLS, fine)
        f = f._replace(spacing=fine, coarse_spacing=coarse)
    elif isinstance(surface, SurfaceModel) and reach is not None and not is_given:
        if link.crossings():
            f = _resolving(link, surface, f, per_wave, meshing.time, fine_patch)
    spacing = meshing.spacing or f.spacing
    _require_size(f, meshing)
    if meshing.extent is not None:
        return {"extent": meshing.extent, "spacing": spacing, "center": link.origin}
    coarse = max(f.coarse_spacing, meshing.spacing or 0.0)
    return f._replace(spacing=spacing, coarse_spacing=coarse)._asdict()


def _within_reach(link: Link, f: Footprint, reach: float, fine_patch: float) -> Footprint:
    """Return the footprint `f` cut to where light can cross to a receiver.

    The half-width suffices for the reach, for the grading of the grid, and to cover all ends.
    """
    places = np.array([item.center[:2] for _, item in link.items()])
    aside = float(np.abs(places - f.center).max())
    coarse = 4.0 * f.spacing  # tuned
    if _is_narrow(link, f):
        # beams cross within a quarter of the fine part (`_is_narrow`): half of it stays fine, and
        # the mesh ends where the fine part did, unless it must reach farther to cover the ends
        extent = max(f.fine_extent, _COVER * aside)
        return f._replace(extent=extent, fine_extent=0.5 * f.fine_extent, coarse_spacing=coarse)
    # received light crosses within `reach` of the origin of the link; waves move it outwards
    margin = _MARGIN if fine_patch >= 1.0 else _MARGIN_OF_MANY
    crossed = min(reach + math.dist(f.center, link.origin) + margin * f.spacing, f.extent)
    # room for spacings to grow towards the coarse one
    extent = max(crossed, f.fine_extent + 10.0 * f.spacing)
    if aside > extent:  # light of a lamp close to the water crosses far from the receiver
        extent = _COVER * aside
    if link.direction == "over":  # a beam that looks aside enters far from both ends
        coarse = max(coarse, extent / _PLANE_CELLS)
    return f._replace(extent=extent, coarse_spacing=coarse)


def _is_narrow(link: Link, f: Footprint) -> bool:
    """Return whether all sources are beams in clear water that cross near the mesh's centre."""
    for t in link.transmitters:
        divergence = getattr(t, "divergence_deg", None)
        if divergence is None or not isinstance(t, WaterSource) or t.axis[2] <= 0.0:
            return False
        # the beam up to still water [m]: length, centre of its spot, radius at twice the divergence
        length = t.depth / t.axis[2]
        spot = np.array(t.center[:2]) + length * np.array(t.axis[:2])
        radius = t.size + 2.0 * length * math.tan(math.radians(divergence))
        _, b = link.water.profile(np.linspace(0.0, t.depth, 65))
        transport_depth = float(np.mean(b)) * (1.0 - link.water.phase.mean_cosine) * length
        if math.dist(spot, f.center) + radius > 0.25 * f.fine_extent or transport_depth > _CLEAR:
            return False
    return True


def _resolving(
    link: Link, surface: SurfaceModel, f: Footprint, per_wave: float, time: float, fine_patch: float
) -> Footprint:
    """Refine a footprint to resolve the waves where unscattered light crosses.

    Outside, each spacing is 10 % wider than the last (`triangulate.GROWTH`). A footprint that would
    need more than `_MOST_IN_PATCH` facets stays as it is.
    """
    k2, slopes = _slopes_by_wave(surface)
    shortest = math.sqrt(float(k2[slopes > 0.0].max(initial=0.0)))
    spacing = f.spacing if shortest * f.spacing <= per_wave else per_wave / shortest
    # studies of many surfaces average: the errors of single meshes cancel
    single = per_wave <= GAIN_SPACING
    if spacing == f.spacing and not single:
        return f
    # all slopes displace the crossings: those of the waves, and the random ones beyond the mesh
    unresolved = getattr(surface, "unresolved_slopes", lambda _: None)(spacing)
    # (along, across the wind)
    random = (0.0, 0.0) if unresolved is None else unresolved.vertex
    # half of the total variance: that of one component
    center, half = link.lit_patch(math.sqrt(0.5 * (float(slopes.sum()) + sum(random))))
    half *= fine_patch
    if single:
        # they blur: the smaller of both components is on the safe side
        tilts = math.sqrt(min(random)) if link.physics.unresolved == "tilt" else 0.0
        curvature, change = _curvature(surface, center, half, time)
        # with two facets a cell, the spacing at which the patch has `_MOST_FINER` of them
        finest = 2.0 * half * math.sqrt(2.0 / _MOST_FINER)
        spacing = min(spacing, max(_accurate_spacing(link, curvature, change, tilts), finest))
    if spacing == f.spacing:
        return f
    if 2.0 * (2.0 * half / spacing) ** 2 > _MOST_IN_PATCH:
        # Nyquist: lines resolve waves of k h <= pi
        short = float(slopes[np.sqrt(k2) * f.spacing > math.pi].sum() / slopes.sum())
        if short > _TOO_SHORT:
            warn(
                f"{100.0 * short:.2g} % of the slope variance is that of waves shorter than two "
                f"spacings of the mesh, {f.spacing:g} m: the gain is in doubt; a lower omega_max "
                "leaves short waves to random slopes",
                DomainWarning,
            )
        return f
    # the centre moves to that of the patch: widened, to cover the former footprint still
    extent = f.extent + math.dist(center, f.center)
    return Footprint(center, extent, spacing, half, f.coarse_spacing)


def _slopes_by_wave(surface: SurfaceModel) -> tuple[Floats, Floats]:
    """Return k^2 [m-2] and the slope variance of each wave of a sum, (waves,) each.

    A surface that is no sum counts as one wave of k = 0, which needs no finer mesh.
    """
    if not isinstance(surface, WaveSum):
        return np.zeros(1), np.array([_SLOPES_UNKNOWN])
    waves = surface.components
    k2 = np.square(waves.kx) + np.square(waves.ky)
    # variance of the slope of a wave, a^2 k^2 / 2
    return k2, 0.5 * np.square(waves.amplitude) * k2


def _curvature(
    surface: SurfaceModel, center: tuple[float, float], half: float, time: float
) -> tuple[float, float]:
    """Return the rms second and third derivatives of the height [m-1, m-2] where light crosses."""
    if isinstance(surface, WaveSum):
        k2, slopes = _slopes_by_wave(surface)
        return math.sqrt(float(np.sum(slopes * k2))), math.sqrt(float(np.sum(slopes * k2**2)))
    # differences of the exact slopes on a grid over the patch
    step = half / _NODES
    x, y = (middle + np.linspace(-half, half, 2 * _NODES + 1) for middle in center)
    slopes = np.stack(surface.slopes(*np.meshgrid(x, y, indexing="ij"), time))  # (2, x, y)
    along = [np.diff(slopes, axis=axis) for axis in (1, 2)]
    second = sum(float(np.mean(d**2)) for d in along)
    third = sum(float(np.mean(np.diff(d, axis=axis) ** 2)) for d in along for axis in (1, 2))
    # the mean runs over the two components of the slope as well: twice the mean is their sum
    return math.sqrt(2.0 * second) / step, math.sqrt(2.0 * third) / step**2


def _accurate_spacing(link: Link, curvature: float, curvature_change: float, tilts: float) -> float:
    r"""Return the spacing [m] that keeps the error of unscattered light below `_MESH_ERROR`.

    Parameters
    ----------
    link : Link
        The link.
    curvature, curvature_change : float
        Rms second and third derivatives of the surface [m-1, m-2], kappa and kappa'.
    tilts : float
        Standard deviation sigma of the random slopes, 0 without.

    Notes
    -----
    .. math:: \delta \approx 0.35 \beta \kappa' h / \sqrt{1 + (4 \rho / h)^2}, \quad
        \beta = \beta_0 / \sqrt{1 + (\beta_0 \kappa)^2}

    The curvature of a facet stands for that of places up to h / 2 away, h the spacing. Curvature
    focuses light by beta_0 kappa, beta_0 the displacement of a crossing by a unit of slope. The
    aperture as seen from the source and the random slopes average over a radius rho,
    rho^2 = seen^2 + (beta_0 sigma)^2. The formula is fitted to finer meshes: it is 0.7 to 4 times
    the rms error over sinusoids and seas of h = 0.03 to 0.1 m.
    """
    fine = math.inf
    # of each pair of ends: lever is beta_0, seen the radius of the aperture at the surface [m]
    for _, lever, seen, *_ in link.crossings():
        focus = lever / math.hypot(1.0, lever * curvature)
        q = _MESH_ERROR / max(0.35 * focus * curvature_change, 1e-300)
        eight_rho = 8.0 * math.hypot(seen, lever * tilts)
        # the equation of the notes solved for h: h^4 = q^2 (h^2 + 16 rho^2)
        fine = min(fine, math.sqrt(0.5 * q * (q + math.hypot(q, eight_rho))))
    return fine


def _require_size(f: Footprint, meshing: Meshing) -> None:
    """Refuse a mesh that would have too many facets, before its creation.

    The fine and the coarse part are counted as full squares of two facets a cell.
    """
    fine = meshing.spacing or f.spacing
    if meshing.extent is not None:
        facets = 2.0 * min(2.0 * meshing.extent / fine, _MOST_CELLS) ** 2
    else:
        coarse = max(f.coarse_spacing, fine)
        cells = (min(f.fine_extent / fine, _MOST_CELLS), min(f.extent / coarse, _MOST_CELLS))
        # 8: two facets a cell over full widths, twice the half-widths
        facets = 8.0 * (cells[0] ** 2 + cells[1] ** 2)
    if facets > _MOST_FACETS:
        # some 250 bytes a facet
        size = Described(f"{facets / 1e6:.3g} million facets, some {facets * 250e-9:.2g} GB")
        allowed = f"at most {_MOST_FACETS / 1e6:g} million facets; larger spacing or smaller extent"
        raise Refused("mesh", size, allowed)


def require_cover(link: Link, mesh: TriangleMesh) -> None:
    """Refuse a mesh that misses an end horizontally, or whose waves reach one."""
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
        # apertures in the water only count what passes; rays start or end at all others, and need
        # some room before the waves
        if isinstance(item, WaterAperture):
            continue
        least = link.least_distance
        if low[2] - least < z < 0.0:
            allowed = f"at least {least:g} m below the lowest trough at {low[2]:g} m"
            raise Refused(f"{path}.depth", Described(f"{-z:g} m"), allowed)
        if 0.0 < z < high[2] + least:
            allowed = f"at least {least:g} m above the highest crest at {high[2]:g} m"
            raise Refused(f"{path}.height", Described(f"{z:g} m"), allowed)
