"""Points of a smooth mesh that mirror the sun to a receiver.

A mesh without unresolved slopes mirrors a point sun at separate points. On a facet the slope s_m
of its interpolated normal and the slope s_r that mirrors the sun to the receiver are equal there;
the irradiance of the receiver is

    E_r = E sum rho cos(theta_y) / (4 cos^4(b) R^2 |det d(s_m - s_r) / d(x, y)|).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from meshtrace.bvh import EmbreeIntersector
from meshtrace.daylight.glint import slopes_of
from meshtrace.kernels.facets import Surface
from meshtrace.models import Floats
from meshtrace.optics.fresnel import fresnel_reflectance
from meshtrace.stored import SHIFTS

if TYPE_CHECKING:
    from meshtrace.transport.backward import View

_POINTS = 4  # of the aperture in each shift
_STEPS = 6  # of Newton's method
_CURVED = 0.5  # largest bend of a gap over a facet, in units of its range
_STEP = 1e-4  # of the derivatives, in barycentrics


def mirrored_sun(
    intersector: EmbreeIntersector, surface: Surface, sun: Floats, view: View, n: float
) -> Floats:
    """Return the mean radiance of mirrored sun over the irradiance of the sun, by shift (shifts,).

    Shadows of the sun by other waves are left out, and so is light mirrored twice.
    """
    per_shift = len(view.uniforms) // SHIFTS
    chosen = (per_shift * np.arange(SHIFTS)[:, None] + np.arange(min(_POINTS, per_shift))).ravel()
    every = np.arange(len(surface.faces))
    nearest = np.linalg.norm(surface.vertices - view.center, axis=1).min()
    slack = 2.0 * view.radius / nearest  # the slope s_r turns by less across the aperture
    near = np.flatnonzero(_may_vanish(_corner_gaps(surface, every, sun, view.center), slack))
    found = [_irradiance(intersector, surface, near, sun, view, view.origins()[i], n)
             for i in chosen]  # fmt: skip
    return np.array(found).reshape(SHIFTS, -1).mean(axis=1) / (math.pi * view.sin2_psi)


def _corner_gaps(surface: Surface, facets: Any, sun: Floats, point: Floats) -> Floats:
    """Return s_m - s_r at the corners of facets (facets, 3, 2) for a point of the aperture."""
    corner = surface.vertices[surface.faces[facets]]
    away = point - corner
    away /= np.linalg.norm(away, axis=-1, keepdims=True)
    return slopes_of(_normals(surface, facets)) - slopes_of(away + sun)


def _normals(surface: Surface, facets: Any) -> Floats:
    """Return the normals at the corners of facets (facets, 3, 3)."""
    if surface.interpolate:
        return surface.vertex_normals[surface.faces[facets]]
    return np.repeat(surface.face_normals[facets][:, None], 3, axis=1)


def _may_vanish(gaps: Floats, slack: Floats | float) -> NDArray[np.bool_]:
    """Return whether both components of gaps at the corners may vanish on a facet."""
    low, high = gaps.min(axis=1), gaps.max(axis=1)
    margin = _CURVED * (high - low) + slack
    return np.asarray(((low <= margin) & (high >= -margin)).all(axis=1))


def _irradiance(
    intersector: EmbreeIntersector, surface: Surface, facets: NDArray[np.int64], sun: Floats,
    view: View, point: Floats, n: float,
) -> float:  # fmt: skip
    """Return the irradiance of mirrored sun at a point of the aperture, over that of the sun."""
    facets = facets[_may_vanish(_corner_gaps(surface, facets, sun, point), 0.0)]
    corner, normals = surface.vertices[surface.faces[facets]], _normals(surface, facets)

    def place(u: Floats) -> Floats:
        return _blend(u, corner)

    def gap(u: Floats) -> Floats:
        away = point - place(u)
        away /= np.linalg.norm(away, axis=-1, keepdims=True)
        return slopes_of(_blend(u, normals)) - slopes_of(away + sun)

    u = np.full((len(facets), 2), 1.0 / 3.0)
    with np.errstate(all="ignore"):
        for _ in range(_STEPS):
            u = u - np.einsum("nij,nj->ni", _inverse(_jacobian(gap, u)), gap(u))
        inside = (u >= 0.0).all(axis=1) & (u.sum(axis=1) < 1.0)
        inside &= np.abs(gap(u)).max(axis=1) < 1e-9
        det = np.abs(np.linalg.det(_jacobian(gap, u)[inside]))
    if not inside.any():
        return 0.0
    edges = corner[inside][:, 1:, :2] - corner[inside][:, :1, :2]
    det = det / np.abs(np.linalg.det(edges))
    away = point - place(u)[inside]
    distance = np.linalg.norm(away, axis=1)
    light = away / distance[:, None]
    mirror = light + sun
    mirror /= np.linalg.norm(mirror, axis=1, keepdims=True)
    cosine = -light @ view.axis
    seen = (cosine > 0.0) & (1.0 - cosine**2 <= view.sin2_psi)
    seen &= intersector.intersect(
        np.broadcast_to(point, light.shape), -light
    ).distance > distance * (1.0 - 1e-3)
    rho = fresnel_reflectance(np.clip(np.einsum("ij,ij->i", light, mirror), 0.0, 1.0), 1.0, n)
    light_in = rho * cosine / (4.0 * mirror[:, 2] ** 4 * distance**2 * det)
    return float(light_in[seen].sum())


def _blend(u: Floats, corners: Floats) -> Floats:
    share = np.concatenate([1.0 - u.sum(axis=1, keepdims=True), u], axis=1)
    return np.asarray(np.einsum("ni,nij->nj", share, corners))


def _jacobian(gap: Callable[[Floats], Floats], u: Floats) -> Floats:
    steps = _STEP * np.eye(2)
    return np.stack([(gap(u + s) - gap(u - s)) / (2.0 * _STEP) for s in steps], axis=-1)


def _inverse(m: Floats) -> Floats:
    det = m[:, 0, 0] * m[:, 1, 1] - m[:, 0, 1] * m[:, 1, 0]
    out = np.empty_like(m)
    out[:, 0, 0], out[:, 1, 1] = m[:, 1, 1], m[:, 0, 0]
    out[:, 0, 1], out[:, 1, 0] = -m[:, 0, 1], -m[:, 1, 0]
    return out / det[:, None, None]
