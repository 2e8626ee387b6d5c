"""Discretization error of a gain, from meshes of every second grid line.

Heights are linear and normals interpolated over a facet. A grid of every second line needs no new
heights. The change of the unscattered gain, which has no Monte Carlo noise, from the mesh to such
grids tells the error; scattered light crosses at many places and angles, which average it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from meshtrace.engine.chains.aimed import AimedChains
from meshtrace.engine.outcome import per_receiver
from meshtrace.engine.setup.arrays import grid_shape
from meshtrace.engine.setup.ends import ForcedLink, forced_link
from meshtrace.errors import Refused
from meshtrace.kernels.medium import DepthMode
from meshtrace.kernels.scene import Emitter, Target
from meshtrace.kernels.sources import SourceKind
from meshtrace.kernels.tally import MIRRORED
from meshtrace.kernels.vectors import Vec3
from meshtrace.link import Link
from meshtrace.mesh import TriangleMesh, UnresolvedSlopes
from meshtrace.models import Floats
from meshtrace.results.gain import GainResult
from meshtrace.surfaces.triangulate import mesh_of_sheet

_DIVISOR = 2.5
"""Change of the gain by every second line, over its error: between two laws in the spacing h.

3 for errors in proportion to h^2 (change of 4 - 1 errors); 5^(1/2) for independent random errors in
proportion to h (variances of 4 and 1 add).
"""

_SCATTERED = 0.1  # relative error of scattered light over that of unscattered light, at least
_STARTS = (0, 0), (1, 1), (0, 1), (1, 0)  # first lines (x, y) of the coarse grids
_BLURRED = 5e-4  # relative error below which one coarse grid suffices where light is blurred, tuned
_LITTLE = 3e-3  # relative error below which two coarse grids suffice, tuned
_RANDOM_SLOPES = 4.0  # standard deviations of random slopes; a Gaussian of two components has
# exp(-4^2 / 2) = 3e-4 of the light beyond
_LIT_SLOPES = 4.5  # standard deviations of slopes that `Link.lit_patch` covers
_MARGIN = 2  # lines of margin beyond the light
_PLANE = 1e-12  # largest difference of the normals of a plane: rounding


def with_mesh_errors(
    results: list[GainResult], links: list[Link], first: int, relative: tuple[Floats, Floats] | None
) -> list[GainResult]:
    """Return results of shared paths with the errors of their gains by the mesh.

    `relative` is `relative_mesh_error` of links[first]; the error over the gain that follows for
    that link is taken for all.
    """
    if relative is None:
        return results
    direct, unscattered = relative
    result = results[first]
    gain = result.gains
    # analog results do not part unscattered light: that of the integral stands in
    ballistic = np.minimum(unscattered, gain)
    if result.gain_ballistic is not None:
        ballistic = np.atleast_1d(result.gain_ballistic)
    # Tuned: relative error of scattered light over that of unscattered light, a third in clear
    # water and less in turbid water, where the share of the latter in the gain is small.
    share = np.divide(ballistic, gain, out=np.zeros_like(gain), where=gain > 0.0)
    scattered = np.maximum(0.5 * share, _SCATTERED)
    error = direct * (ballistic + scattered * np.maximum(gain - ballistic, 0.0))
    if result.gain_part is not None:
        # ends on one side: the mesh bends nothing but what it mirrors
        mirrored = result.gain_part[:, MIRRORED]
        error = np.where(mirrored > 0.0, direct * mirrored, np.nan)
    if np.isnan(error).all():
        return results
    # the relative error is that of the mesh, common to the wavelengths
    errors = [error / np.maximum(gain, 1e-300) * result.gains for result in results]
    errors[first] = error  # without the rounding of a quotient times its divisor
    return [
        replace(result, mesh_error=per_receiver(link, absolute))
        for result, link, absolute in zip(results, links, errors, strict=True)
    ]


def relative_mesh_error(
    link: Link, mesh: TriangleMesh, normals: str = "vertex"
) -> tuple[Floats, Floats] | None:
    r"""Estimate the relative error of unscattered light by a mesh.

    Parameters
    ----------
    link : Link
        The link.
    mesh : TriangleMesh
        The mesh of a surface.
    normals : {"vertex", "facet"}
        Normals interpolated from the corners, or those of the facets.

    Returns
    -------
    tuple of ndarray, shape (receivers,), or None
        Relative error, nan where no light arrives even from an isotropic source in view, and the
        unscattered gain. None for a mesh that is no grid or overhangs, and for a link that forced
        detection does not follow.

    Notes
    -----
    .. math:: \epsilon = \frac{1}{2.5 G} \sqrt{\overline{(G_i - G)^2}}

    over the gains :math:`G_i` of one, two or four grids of every second line. The truth is the
    smooth surface through the lines with the same random slopes; all meshes have those of the
    given one. For surfaces that are smooth on the scale of a facet the change is 3 errors
    (Richardson's extrapolation), for an aperture or blur smaller than a facet the errors of both
    meshes are independent, proportional to the spacing, and the change is 5^(1/2) errors.

    For a receiver without unscattered light the source is replaced by an isotropic one where the
    axis of the receiver points to.
    """
    receivers = len(link.receivers)
    # a plane is the same at any spacing
    if float(np.ptp(mesh.vertex_normals, axis=0).max()) < _PLANE:
        return np.zeros(receivers), np.zeros(receivers)
    shape = grid_shape(mesh)
    # every second of four lines leaves two, one cell
    if shape is None or min(shape) < 4:
        return None
    # points and normals of a mesh by `triangulate`
    sheet = np.stack([mesh.vertices, mesh.vertex_normals]).reshape(2, *shape, 3)
    try:
        arrays = forced_link(link)
    except Refused:
        return None
    # a depth below the local surface needs a raster of heights, which costs more than the light
    if arrays.medium.depth_mode == DepthMode.LOCAL:
        clamped = arrays.medium._replace(depth_mode=int(DepthMode.CLAMPED))
        arrays = arrays._replace(medium=clamped)
    physics = link.physics.unresolved  # name of the use of random slopes
    unscattered = partial(_unscattered, slopes=mesh.unresolved, normals=normals, physics=physics)
    relative, gain = _compare(arrays, _patch(link, mesh, sheet), unscattered)
    # receivers close to each other see about the same mesh: one of them stands for the others
    representative = arrays.stands_for_receivers
    for r in np.flatnonzero(np.isnan(relative) & (representative == np.arange(receivers))):
        # `_facing` keeps all receivers of a downlink, but this one alone of an uplink
        changes, _ = _compare(_facing(arrays, int(r)), sheet, unscattered)
        relative[r] = changes[r if arrays.down else 0]
    return relative[representative], gain[representative]


def _compare(
    arrays: ForcedLink, sheet: Floats, gains: Callable[[ForcedLink, Floats], tuple[Floats, bool]]
) -> tuple[Floats, Floats]:
    """Return the relative change of unscattered light over `_DIVISOR`, and the light itself."""
    fine, blurred = gains(arrays, sheet)
    coarse = []
    # There are four grids of every second line. Further ones cost time, and are taken only while
    # the relative error exceeds that of `enough`: never after one grid without blur, whose sums may
    # agree by chance, nor after three (-1); always after four (inf).
    enough = (_BLURRED if blurred else -1.0), _LITTLE, -1.0, math.inf
    for (i, j), little in zip(_STARTS, enough, strict=True):
        coarse.append(gains(arrays, sheet[:, i::2, j::2])[0])
        # light that only the coarse meshes see counts too
        scale = np.maximum(fine, np.mean(coarse, axis=0))
        change = np.sqrt(np.mean(np.square(np.array(coarse) - fine), axis=0)) / _DIVISOR
        relative = np.divide(change, scale, out=np.full_like(scale, np.nan), where=scale > 0.0)
        if not (relative > little).any():
            break
    return relative, fine


def _unscattered(
    link: ForcedLink, sheet: Floats, slopes: UnresolvedSlopes | None, normals: str, physics: str
) -> tuple[Floats, bool]:
    """Return the unscattered gain of each receiver through a sheet, and whether slopes blur it.

    Light starts at the centres of the sources. `slopes` are the random ones, `physics` their use
    (`Physics.unresolved`). Random slopes too narrow to be integrated over are left out.
    """
    mesh = mesh_of_sheet(sheet[0], sheet[1], slopes)
    aimed = AimedChains(link, mesh, normals, physics)
    gains = np.zeros((len(link.emitters), len(link.targets)))
    for e, t in link.pairs:
        if link.stands_for[t] == t:
            aimed.take_points(e, t)
            gains[e, t] = aimed.direct_gains(e, t).sum()
    return link.by_receiver(gains), aimed.blurred


def _patch(link: Link, mesh: TriangleMesh, sheet: Floats) -> Floats:
    """Return the part of a sheet where unscattered light can cross to a receiver."""
    # `lit_patch` covers 4.5 standard deviations of the slope that it is given: a 4.5th of the
    # steepest slope makes it cover just that
    variance = max(mesh.unresolved.vertex) if mesh.unresolved is not None else 0.0
    steepest = mesh.max_slope + _RANDOM_SLOPES * math.sqrt(variance)
    center, half = link.lit_patch(steepest / _LIT_SLOPES)
    lines = []
    for axis in (0, 1):
        # lines of a turned or graded grid are not equally spaced: each one's own range decides
        values = sheet[0, ..., axis]
        low, high = values.min(axis=1 - axis), values.max(axis=1 - axis)
        inside = np.flatnonzero((high >= center[axis] - half) & (low <= center[axis] + half))
        first, last = (inside[0], inside[-1]) if len(inside) else (0, len(low) - 1)
        lines.append(slice(max(first - _MARGIN, 0), last + _MARGIN + 1))
    return sheet[:, lines[0], lines[1]]


def _facing(arrays: ForcedLink, receiver: int) -> ForcedLink:
    """Return a link with isotropic sources on the axis of a receiver."""
    # of a downlink: lamps are the emitters of `forwards`, which is turned upside down
    if arrays.forwards is not None:
        forwards = arrays.forwards
        emitters = [_moved(e, forwards.targets[receiver]) for e in forwards.emitters]
        return arrays._replace(forwards=forwards._replace(emitters=emitters))
    target = arrays.targets[receiver]
    emitters = [_moved(e, target) for e in arrays.emitters]
    return arrays._replace(emitters=emitters, targets=[target], stands_for=np.zeros(1, np.intp))


def _moved(emitter: Emitter, target: Target) -> Emitter:
    """Return an isotropic source where the axis of a receiver meets the height of an emitter."""
    axis, center = target.axis, target.center
    # Back along the axis, which has the direction of arriving light; 0.1 lets almost level axes end
    # within ten heights. Refraction is left out.
    reach = (center.z - emitter.position.z) / max(axis.z, 0.1)
    x, y = center.x - reach * axis.x, center.y - reach * axis.y
    position = Vec3(x, y, emitter.position.z)
    return emitter._replace(
        position=position, kind=int(SourceKind.ISOTROPIC), norm=1.0 / (4.0 * math.pi)
    )
