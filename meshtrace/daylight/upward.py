"""Daylight that comes up from the sea, in closed form: glint, and light scattered back once."""

from __future__ import annotations

import math

import numpy as np

from meshtrace.daylight.light import Daylight, sky_radiance
from meshtrace.kernels.interface import Roughness, over_gaussian
from meshtrace.models import Floats
from meshtrace.optics.bubbles import BubblePopulation
from meshtrace.optics.fresnel import fresnel_reflectance
from meshtrace.optics.water import Water
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


_ZENITHS, _AZIMUTHS = 14, 20  # directions that stand for the sky
_DEPTHS = 6000
_DEEPEST = 20.0  # optical depths of k
_ANGLES = 2048


class QuasiSingle:
    """Upwelling radiance under still water by single scattering with k = a + b_b.

    L_u = sum E_w int sum_j b_j beta_j(Theta) exp(-K(z) m) dz / mu_v,  m = 1 / mu' + 1 / mu_v

    over beams of irradiance E_w across themselves with cosine mu', those of the sun and of the
    refracted sky; scatterers j are water and bubbles, K is the integral of k from the surface. In
    uniform water the integral is b beta / (k (1 + mu_v / mu')). A bottom adds albedo / pi times
    its irradiance.

    Parameters
    ----------
    water : Water
        Water.
    bubbles : BubblePopulation or None
        Bubbles.
    n_air : float
        Refractive index of the air.
    day : Daylight
        Light above the sea.

    References
    ----------
    Gordon (1973), Appl. Opt. 12, 2803, quasi-single scattering.
    """

    def __init__(
        self, water: Water, bubbles: BubblePopulation | None, n_air: float, day: Daylight
    ) -> None:
        self.n = water.n / n_air
        self._travel, self._irradiance = _beams(day, self.n)
        fractions, phases = [water.phase.backscatter_fraction], [water.phase]
        if bubbles is not None:
            phases.append(bubbles.phase_function())
            fractions.append(phases[-1].backscatter_fraction)
        self._theta = np.linspace(0.0, math.pi, _ANGLES)[1:]
        self._beta = [phase.pdf(self._theta) for phase in phases]
        self._depth, a, b = _profile(water, bubbles)
        k = a + np.array(fractions) @ b
        steps = np.diff(self._depth)
        path = np.concatenate([[0.0], np.cumsum(0.5 * steps * (k[1:] + k[:-1]))])
        # extinction of beam and view: 1 / mu runs from 1 to the horizon under water
        self._m = np.geomspace(1.9, 60.0, 400)
        decay = np.exp(-np.outer(self._m, path))
        self._depth_integral = [
            np.sum(0.5 * steps * (decay[:, 1:] * bj[1:] + decay[:, :-1] * bj[:-1]), axis=1)
            for bj in b
        ]
        self._bottom = None
        if water.bottom_depth is not None:
            self._bottom = water.bottom_albedo * decay[:, -1] / math.pi

    def upwelling(self, directions: Floats) -> Floats:
        """Return the radiance L_u below the surface [W m-2 sr-1 nm-1].

        Parameters
        ----------
        directions : ndarray, shape (n, 3)
            Unit vectors along which the light travels up.
        """
        mu_v = np.maximum(directions[:, 2], 1e-3)
        total = np.zeros(len(directions))
        for travel, irradiance in zip(self._travel, self._irradiance, strict=True):
            theta = np.arccos(np.clip(directions @ travel, -1.0, 1.0))
            m = 1.0 / -travel[2] + 1.0 / mu_v
            for beta, integral in zip(self._beta, self._depth_integral, strict=True):
                scattered = np.interp(theta, self._theta, beta) * np.interp(m, self._m, integral)
                total += irradiance * scattered / mu_v
            if self._bottom is not None:
                total += irradiance * -travel[2] * np.interp(m, self._m, self._bottom)
        return total


def _beams(day: Daylight, n: float) -> tuple[Floats, Floats]:
    """Return directions of travel under water, and irradiances across them, of sun and sky."""
    x, w = np.polynomial.legendre.leggauss(_ZENITHS)
    sin2, weight = 0.5 * (x + 1.0), 0.5 * w  # cos dOmega = d(sin^2) d(azimuth) / 2
    azimuth = 2.0 * math.pi * (np.arange(_AZIMUTHS) + 0.5) / _AZIMUTHS
    s, phi = np.meshgrid(np.sqrt(sin2), azimuth, indexing="ij")
    towards = np.stack([s * np.cos(phi), s * np.sin(phi), np.sqrt(1.0 - s**2)], -1).reshape(-1, 3)
    flux = sky_radiance(day.sky, towards) * np.repeat(weight, _AZIMUTHS)
    if (total := flux.sum()) > 0.0:
        flux *= day.diffuse / total
    towards = np.concatenate([towards, [day.sun]])
    flux = np.append(flux, day.direct * day.sun[2])
    flux = flux * (1.0 - fresnel_reflectance(np.clip(towards[:, 2], 0.0, 1.0), 1.0, n))
    travel = -towards / n
    travel[:, 2] = -np.sqrt(1.0 - travel[:, 0] ** 2 - travel[:, 1] ** 2)
    lit = flux > 0.0
    return travel[lit], flux[lit] / -travel[lit, 2]


def _profile(water: Water, bubbles: BubblePopulation | None) -> tuple[Floats, Floats, Floats]:
    """Return depths [m], absorption and scattering of water and bubbles over depth."""
    surface = np.array([0.0])
    a0, b0 = (float(v[0]) for v in water.profile(surface))
    k0 = a0 + b0 * water.phase.backscatter_fraction
    deepest = _DEEPEST / k0 if k0 > 0.0 else 1e3
    if water.layers is not None:
        deepest = max(deepest, 3.0 * water.layers[-1][0])
    if water.bottom_depth is not None:
        deepest = min(deepest, water.bottom_depth)
    depth = np.concatenate([surface, np.geomspace(1e-4 * deepest, deepest, _DEPTHS)])
    a, b = water.profile(depth)
    scatterers = [b]
    if bubbles is not None:
        scatterers.append(bubbles.b(depth))
    return depth, a, np.array(scatterers)
