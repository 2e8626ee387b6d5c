"""Directions of light, and their reflection and refraction at a plane interface."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from meshtrace.checks import Index, Shape, Unit, check_call
from meshtrace.models import Floats
from meshtrace.quadrature import gauss_legendre


def unit_vector(zenith_deg: float, azimuth_deg: float) -> tuple[float, float, float]:
    """Return the unit vector of a zenith angle and an azimuth [deg]."""
    zenith, azimuth = math.radians(zenith_deg), math.radians(azimuth_deg)
    s = math.sin(zenith)
    return s * math.cos(azimuth), s * math.sin(azimuth), math.cos(zenith)


Vectors = Annotated[ArrayLike, Shape("... 3"), Unit()]


@check_call
def fresnel_reflectance(
    cos_i: Annotated[ArrayLike, Field(ge=0.0, le=1.0)], n1: Index, n2: Index
) -> Floats:
    r"""Return the reflectance of unpolarised light from medium 1 to medium 2.

    .. math:: \rho = \tfrac12 (r_s^2 + r_p^2)

    with the squares of `polarised_reflectances`.

    Parameters
    ----------
    cos_i : array_like
        Cosine of the angle of incidence, 0 ... 1.
    n1, n2 : float
        Refractive indices of the medium of incidence and of the other one.

    Returns
    -------
    ndarray
        Reflectance; 1 under total internal reflection.

    Raises
    ------
    Refused
        If a cos_i lies outside 0 ... 1 or an index is not a positive number.

    Notes
    -----
    The amplitude form has no 0/0 at normal incidence, where the paper's tan and sin form of T_s and
    T_p breaks down; elsewhere 1 - rho equals its T_f.

    References
    ----------
    Born and Wolf 1999, Principles of Optics, 7th edition, section 1.5.2.

    Examples
    --------
    >>> round(float(fresnel_reflectance(1.0, 1.33, 1.0)), 8)
    0.02005931
    """
    rho_s, rho_p = polarised_reflectances(cos_i, n1, n2)
    return np.asarray(0.5 * (rho_s + rho_p))


@check_call
def polarised_reflectances(
    cos_i: Annotated[ArrayLike, Field(ge=0.0, le=1.0)], n1: Index, n2: Index
) -> tuple[Floats, Floats]:
    r"""Return the reflectances for s- and p-polarised light.

    .. math::
        \rho_s = r_s^2, \quad \rho_p = r_p^2, \quad
        r_s = \frac{n_1 c_i - n_2 c_t}{n_1 c_i + n_2 c_t}, \quad
        r_p = \frac{n_2 c_i - n_1 c_t}{n_2 c_i + n_1 c_t}

    Parameters
    ----------
    cos_i : array_like
        Cosine of the angle of incidence, 0 ... 1.
    n1, n2 : float
        Refractive indices of the medium of incidence and of the other one.

    Returns
    -------
    tuple of ndarray
        rho_s and rho_p; 1 under total internal reflection.

    Raises
    ------
    Refused
        If a cos_i lies outside 0 ... 1 or an index is not a positive number.

    Notes
    -----
    All simulations take their mean, `fresnel_reflectance`: light is unpolarised.

    References
    ----------
    Born and Wolf 1999, Principles of Optics, 7th edition, section 1.5.2.

    Examples
    --------
    >>> rho_s, rho_p = polarised_reflectances(np.cos(np.radians(30.0)), 1.0, 1.33)
    >>> round(float((rho_s - rho_p) / (rho_s + rho_p)), 4)
    0.4441
    """
    cos_i = np.asarray(cos_i)
    sin2_t = (n1 / n2) ** 2 * (1.0 - cos_i**2)
    total = sin2_t >= 1.0
    # 1 keeps the quotients finite where there is no refracted light
    cos_t = np.sqrt(np.where(total, 1.0, 1.0 - sin2_t))
    r_s = (n1 * cos_i - n2 * cos_t) / (n1 * cos_i + n2 * cos_t)
    r_p = (n2 * cos_i - n1 * cos_t) / (n2 * cos_i + n1 * cos_t)
    return np.where(total, 1.0, r_s**2), np.where(total, 1.0, r_p**2)


@check_call
def reflect(d: Vectors, n: Vectors) -> Floats:
    """Mirror directions at a plane, d' = d - 2 (d . n) n.

    Parameters
    ----------
    d : array_like, shape (..., 3)
        Unit directions.
    n : array_like, shape (..., 3)
        Unit normals; their sign does not matter.

    Returns
    -------
    ndarray, shape (..., 3)
        Unit directions after reflection.

    Examples
    --------
    >>> reflect([0.6, 0.0, 0.8], [0.0, 0.0, 1.0])
    array([ 0.6,  0. , -0.8])
    """
    d, n = np.asarray(d, dtype=np.float64), np.asarray(n, dtype=np.float64)
    return d - 2.0 * np.sum(d * n, axis=-1, keepdims=True) * n


@check_call
def refract(d: Vectors, n: Vectors, n1: Index, n2: Index) -> Floats:
    r"""Refract directions by Snell's law in vector form.

    .. math:: d' = \eta d + (c_t - \eta c_i) n, \quad
        \eta = n_1 / n_2, \; c_i = d \cdot n, \; c_t = \sqrt{1 - \eta^2 (1 - c_i^2)}

    Parameters
    ----------
    d : array_like, shape (..., 3)
        Unit directions in medium 1.
    n : array_like, shape (..., 3)
        Unit normals; they are turned to the side to which the light goes.
    n1, n2 : float
        Refractive indices of the medium of incidence and of the other one.

    Returns
    -------
    ndarray, shape (..., 3)
        Unit directions in medium 2; NaN under total internal reflection.

    Raises
    ------
    Refused
        If an index is not a positive number.

    Notes
    -----
    The paper's Snell's law, sin(theta_r) = (n2 / n1) sin(theta_i), is upside-down against its own
    critical angle arcsin(n2 / n1), and the bracket of its refracted direction is misplaced, so that
    the published vector is not a unit vector. This is the correct form.

    References
    ----------
    Glassner (editor) 1989, An Introduction to Ray Tracing, chapter 4.

    Examples
    --------
    >>> refract([0.0, 0.6, 0.8], [0.0, 0.0, 1.0], 1.33, 1.0).round(4)
    array([0.    , 0.798 , 0.6027])
    """
    d, n = np.asarray(d, dtype=np.float64), np.asarray(n, dtype=np.float64)
    cos_i = np.sum(d * n, axis=-1, keepdims=True)
    n, cos_i = np.where(cos_i < 0.0, -n, n), np.abs(cos_i)
    eta = n1 / n2
    cos2_t = 1.0 - eta**2 * (1.0 - cos_i**2)
    cos_t = np.sqrt(np.where(cos2_t < 0.0, np.nan, cos2_t))
    return eta * d + (cos_t - eta * cos_i) * n


@check_call
def hemispheric_reflectance(n1: Index, n2: Index) -> float:
    r"""Return the reflectance for a uniform (Lambertian) radiance from medium 1.

    .. math:: r = 2 \int_0^1 \rho(c_i)\, c_i\, dc_i

    Parameters
    ----------
    n1, n2 : float
        Refractive indices of the medium of incidence and of the other one.

    Returns
    -------
    float
        Share of the irradiance that is reflected.

    Raises
    ------
    Refused
        If an index is not a positive number.

    Notes
    -----
    From the denser side it follows from the other one by reciprocity,
    1 - r_water = (1 - r_air) / n^2, which spares the integral its kink at the critical angle.

    References
    ----------
    Duntley 1942, J. Opt. Soc. Am. 32:61, doi:10.1364/JOSA.32.000061.

    Examples
    --------
    >>> round(hemispheric_reflectance(1.0, 1.33), 5), round(hemispheric_reflectance(1.33, 1.0), 5)
    (0.06593, 0.47195)
    """
    if n1 > n2:
        # reciprocity, see Notes
        return 1.0 - (1.0 - hemispheric_reflectance(n2, n1)) * (n2 / n1) ** 2
    x, weight = gauss_legendre(64)
    cos_i = (x + 1.0) / 2.0
    return float(np.sum(weight * cos_i * fresnel_reflectance(cos_i, n1, n2)))
