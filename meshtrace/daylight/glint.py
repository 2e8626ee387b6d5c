"""Glint: sunlight mirrored by the slopes of the sea, in closed form."""

from __future__ import annotations

import math

import numpy as np

from meshtrace.kernels.interface import Roughness, over_gaussian
from meshtrace.models import Floats
from meshtrace.optics.fresnel import fresnel_reflectance
from meshtrace.surfaces.gram_charlier import GramCharlier

_over_gaussian = getattr(over_gaussian, "py_func", over_gaussian)  # as it is without the JIT


def slope_density(slopes: Floats, roughness: Roughness) -> Floats:
    """Return the density of slopes (..., 2); `roughness` has both deviations, > 0."""
    along = (roughness.cos * slopes[..., 0] + roughness.sin * slopes[..., 1]) / roughness.along
    across = (roughness.cos * slopes[..., 1] - roughness.sin * slopes[..., 0]) / roughness.across
    density = np.exp(-0.5 * (along**2 + across**2))
    density /= 2.0 * math.pi * roughness.along * roughness.across
    return np.asarray(density * _over_gaussian(roughness.series, along, across))


def slopes_of(normals: Floats) -> Floats:
    """Return the slopes (..., 2) of upward normals (..., 3)."""
    return -normals[..., :2] / normals[..., 2:]


def connected_glint(
    view: Floats, sun: Floats, normal: Floats, facet_normal: Floats, roughness: Roughness, n: float
) -> Floats:
    """Return the radiance of glint over the irradiance of the sun [sr-1].

    L / E = rho(v . h) p(s_r - s_m) cos(b_g) / (4 cos^4(b) v . n_g),  h = (v + s) / |v + s|

    with the slope s_r of the mirror h, the slope s_m of the mesh, the density p of the slopes that
    the mesh leaves out, cos(b) = h_z and cos(b_g) = n_g,z.

    Parameters
    ----------
    view : ndarray, shape (..., 3)
        Unit vectors from the sea to the receiver.
    sun : ndarray, shape (3,)
        Unit vector to the sun.
    normal, facet_normal : ndarray, shape (..., 3)
        Normal for the bending of light, and that of the facet.
    roughness : Roughness
        Slopes left out by the mesh.
    n : float
        Index of the water over that of the air.

    Notes
    -----
    For s_m = 0 and the slopes of the whole sea this is the law of Cox and Munk (1954),
    L = rho E p / (4 cos(theta_v) cos^4 b).
    """
    mirror = view + sun
    mirror = mirror / np.linalg.norm(mirror, axis=-1, keepdims=True)
    cos_i = np.clip(np.einsum("...i,...i", view, mirror), 0.0, 1.0)
    density = slope_density(slopes_of(mirror) - slopes_of(normal), roughness)
    facing = np.einsum("...i,...i", view, facet_normal)
    area = facet_normal[..., 2] / (4.0 * mirror[..., 2] ** 4 * np.maximum(facing, 1e-12))
    return np.where(facing > 0.0, fresnel_reflectance(cos_i, 1.0, n) * density * area, 0.0)


def glint_radiance(
    view: Floats,
    sun: Floats,
    slope_variances: tuple[float, float],
    wind_direction_deg: float = 0.0,
    n: float = 1.33,
    slope_law: GramCharlier | None = None,
) -> Floats:
    """Return the glint of a level sea over the sun's irradiance [sr-1].

    Parameters
    ----------
    view : ndarray, shape (..., 3)
        Unit vectors from the sea to the receiver.
    sun : ndarray, shape (3,)
        Unit vector to the sun.
    slope_variances : tuple of float
        Along and across the wind, as of `surfaces.cox_munk`.
    wind_direction_deg : float
        Direction the wind blows to [deg].
    n : float
        Index of the water over that of the air.
    slope_law : GramCharlier, optional
        Skewness and peakedness of the slopes, Gaussian without.

    Examples
    --------
    >>> sun = np.array([np.sin(np.pi / 6), 0.0, np.cos(np.pi / 6)])
    >>> f"{float(glint_radiance(np.array([0.0, 0.0, 1.0]), sun, (0.0158, 0.0126))):.6e}"
    '6.717751e-03'
    """
    wind = math.radians(wind_direction_deg)
    along, across = map(math.sqrt, slope_variances)
    roughness = Roughness(along, across, math.cos(wind), math.sin(wind))
    if slope_law is not None:
        roughness = roughness._replace(series=slope_law.series)
    up = np.broadcast_to((0.0, 0.0, 1.0), np.shape(view))
    return connected_glint(np.asarray(view), np.asarray(sun), up, up, roughness, n)
