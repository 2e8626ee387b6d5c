"""Radiance of the sky by direction: the patterns of the CIE general sky and others."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Annotated

import numpy as np

from meshtrace.checks import Shape, check_call
from meshtrace.errors import require_word
from meshtrace.kernels.sources import LEAST_COS, Sky
from meshtrace.kernels.vectors import Vec3
from meshtrace.models import Floats
from meshtrace.optics.fresnel import unit_vector
from meshtrace.quadrature import gauss_legendre

_GRADATION = ((4.0, -0.70), (1.1, -0.80), (0.0, -1.00), (-1.0, -0.55), (-1.0, -0.32), (-1.0, -0.15))
_INDICATRIX = ((0.0, -1.0, 0.0), (2.0, -1.5, 0.15), (5.0, -2.5, 0.30), (10.0, -3.0, 0.45),
               (16.0, -3.0, 0.30), (24.0, -2.8, 0.15))  # fmt: skip
_TYPES = ((0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2), (2, 3), (3, 1), (3, 2), (3, 3),
          (4, 3), (4, 4), (5, 4), (5, 5))  # fmt: skip
_ALIASES = {"uniform": "cie-5", "overcast": "cie-1"}
_NODES = 64  # of each panel of a quadrature


PATTERNS = (*(f"cie-{i}" for i in range(1, 16)), "harrison-coombes", *_ALIASES)
"""Names of the patterns."""


@check_call
def sky(pattern: str, diffuse: float, sun_zenith_deg: float, sun_azimuth_deg: float) -> Sky:
    """Return a sky scaled to a horizontal irradiance, for the kernels and for `sky_radiance`.

    Parameters
    ----------
    pattern : str
        "cie-1" ... "cie-15" of the CIE general sky (ISO 15469: 12 clear, 13 polluted, 5 uniform,
        1 overcast), "uniform", "overcast", or "harrison-coombes".
    diffuse : float
        Horizontal irradiance of the sky [W m-2 nm-1].
    sun_zenith_deg, sun_azimuth_deg : float
        Position of the sun [deg].

    Returns
    -------
    Sky
        Coefficients scaled so that the integral of L cos z over the hemisphere is `diffuse`.

    Raises
    ------
    Refused
        If the pattern is unknown.

    References
    ----------
    ISO 15469:2004 / CIE S 011, "Spatial distribution of daylight: CIE standard general sky".
    Harrison and Coombes (1988), Solar Energy 41, 387, clear sky, coefficients as in the code of
    HydroLight.
    """
    require_word(pattern, PATTERNS, "pattern")
    # a key of the cache: directions of one sun differ in their last digits
    zenith = round(float(sun_zenith_deg), 9)
    scale = diffuse / _irradiance(pattern, zenith)
    bare, sun = _bare_sky(pattern, zenith), unit_vector(sun_zenith_deg, sun_azimuth_deg)
    # the radiance is linear in p and a
    return bare._replace(sun=Vec3(*sun), p=scale * bare.p, a=scale * bare.a)


@check_call
def sky_radiance(sky: Sky, directions: Annotated[Floats, Shape("... 3")]) -> Floats:
    """Return the radiance of the sky, array twin of `kernels.sources.radiance`.

    Parameters
    ----------
    sky : Sky
        Of `sky`.
    directions : ndarray, shape (..., 3)
        Unit vectors from the sea to the sky; the horizon stands for directions below it.

    Returns
    -------
    ndarray
        L [W m-2 sr-1 nm-1].
    """
    cos_z = np.maximum(directions[..., 2], LEAST_COS)
    cos_chi = np.clip(directions @ np.array(sky.sun), -1.0, 1.0)
    # ISO 15469: gradation by the zenith angle, indicatrix by the angle chi to the sun
    gradation = sky.p + sky.a * np.exp(sky.b / cos_z)
    glow = sky.f + sky.c * np.exp(sky.d * np.arccos(cos_chi)) + sky.e * cos_chi**2
    return np.asarray(gradation * glow)


@check_call
def hemisphere(sun_zenith_deg: float) -> tuple[Floats, Floats]:
    """Return directions (n, 3) and solid angles [sr] of a quadrature over the upper hemisphere.

    The sun stands at azimuth 0. Panels end at the sun, where the radiance has a cusp, and their
    nodes crowd there; the half of negative azimuths is the mirror image of the other.
    """
    x, w = gauss_legendre(_NODES)
    x, w = 0.5 * (x + 1.0), 0.5 * w
    # x -> x^2 crowds the nodes at the end 0 of a panel
    crowded, weight = x * x, 2.0 * x * w
    sun = math.radians(sun_zenith_deg)
    zenith = np.concatenate([sun * (1.0 - crowded), sun + (0.5 * math.pi - sun) * crowded])
    d_zenith = np.concatenate([sun * weight, (0.5 * math.pi - sun) * weight])
    azimuth, d_azimuth = math.pi * crowded, math.pi * weight
    z, phi = (v.ravel() for v in np.meshgrid(zenith, azimuth, indexing="ij"))
    solid = np.outer(d_zenith * np.sin(zenith), d_azimuth).ravel()
    directions = np.stack([np.sin(z) * np.cos(phi), np.sin(z) * np.sin(phi), np.cos(z)], axis=1)
    return np.concatenate([directions, directions * (1.0, -1.0, 1.0)]), np.tile(solid, 2)


@lru_cache(maxsize=256)
def _irradiance(pattern: str, sun_zenith_deg: float) -> float:
    """Return the horizontal irradiance of `_bare_sky`."""
    directions, solid = hemisphere(sun_zenith_deg)
    radiance = sky_radiance(_bare_sky(pattern, sun_zenith_deg), directions)
    return float(solid @ (radiance * directions[:, 2]))


def _bare_sky(pattern: str, sun_zenith_deg: float) -> Sky:
    """Return the sky of a pattern in relative units, with the sun at azimuth 0."""
    sun = Vec3(*unit_vector(sun_zenith_deg, 0.0))
    if pattern == "harrison-coombes":
        return Sky(sun, 1.0, -1.0, -0.19, 1.63, 53.7, -5.49, 2.04 * sun.z)
    gradation, indicatrix = _TYPES[int(_ALIASES.get(pattern, pattern)[4:]) - 1]
    a, b = _GRADATION[gradation]
    c, d, e = _INDICATRIX[indicatrix]
    # the standard's 1 + c (exp(d chi) - exp(d pi / 2)), its constant taken together
    return Sky(sun, 1.0, a, b, 1.0 - c * math.exp(0.5 * math.pi * d), c, d, e)
