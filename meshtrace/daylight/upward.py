"""Closed forms of sunlight reflected and refracted by slopes, and of light leaving the water."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.checks import Directions, Index, Shape, check_call, check_methods
from meshtrace.daylight.light import Daylight
from meshtrace.daylight.patterns import sky_radiance
from meshtrace.kernels.interface import Roughness, over_gaussian
from meshtrace.kernels.sources import Beams, add_upwelling
from meshtrace.kernels.tints import common_functions
from meshtrace.models import Floats
from meshtrace.optics.bubbles import BubblePopulation
from meshtrace.optics.fresnel import fresnel_reflectance
from meshtrace.optics.phase import PhaseFunction
from meshtrace.optics.water import Water
from meshtrace.quadrature import gauss_legendre
from meshtrace.surfaces.gram_charlier import GramCharlier

# Ratio of the density of slopes to the Gaussian. The Python function of the kernel takes arrays;
# without the JIT the kernel is that function.
_over_gaussian = getattr(over_gaussian, "py_func", over_gaussian)


@check_call
def slope_density(slopes: Annotated[Floats, Shape("... 2")], roughness: Roughness) -> Floats:
    """Return the probability density of slopes (..., 2); both deviations of `roughness` are > 0."""
    along = (roughness.cos * slopes[..., 0] + roughness.sin * slopes[..., 1]) / roughness.along
    across = (roughness.cos * slopes[..., 1] - roughness.sin * slopes[..., 0]) / roughness.across
    density = np.exp(-0.5 * (along**2 + across**2))
    density /= 2.0 * math.pi * roughness.along * roughness.across
    return np.asarray(density * _over_gaussian(roughness.series, along, across))


def slopes_of(normals: Floats) -> Floats:
    """Return the slopes (..., 2) of upward normals (..., 3)."""
    return -normals[..., :2] / normals[..., 2:]


def slopes_to(required: Floats, normals: Floats) -> Floats:
    """Return the slopes (..., 2) that turn the given normals into the required ones.

    Normals are of any length; the required slope is 1e6 where its normal does not point upwards.
    """
    up = required[..., 2:]
    # no slope of a sea reaches 1e6: its density there is 0
    slopes = np.where(up > 1e-6, -required[..., :2] / np.maximum(up, 1e-6), 1e6)
    return np.asarray(slopes - slopes_of(normals))


class Reflection(NamedTuple):
    """Reflection of sunlight into the air, for several refractive indices at the same points.

    `view` is the unit vector from the sea to the receiver, here upwards.
    """

    sun: Floats  # (3,) unit vector to the sun
    n: tuple[float, ...]  # indices of the water over that of the air

    def normal(self, view: Floats) -> Floats:
        """Return view + sun, the normal of the mirror that reflects the sun into view."""
        return view + self.sun

    def strength(self, view: Floats, normal: Floats) -> Floats:
        """Return rho / (4 cos^4 b) at every index and point (indices, ...); b is the mirror's tilt.

        `normal` is that of the method `normal`, of any length.
        """
        length = np.sqrt(np.einsum("...i,...i", normal, normal))
        cos_i = np.clip(np.einsum("...i,...i", view, normal) / length, 0.0, 1.0)
        rho = np.array([fresnel_reflectance(cos_i, 1.0, n) for n in self.n])
        # Jacobian of slopes to directions of reflected light (Cox and Munk 1954)
        return rho / (4.0 * (normal[..., 2] / length) ** 4)


class Refraction(NamedTuple):
    """Refraction of sunlight into the water.

    `view` is the unit vector from the sea to the receiver, here downwards.
    """

    sun: Floats  # (3,) unit vector to the sun
    n: float  # index of the water over that of the air

    def normal(self, view: Floats) -> Floats:
        """Return -n view - sun, the upward normal of the slope that refracts the sun into view."""
        return -self.n * view - self.sun

    def strength(self, view: Floats, normal: Floats) -> Floats:
        """Return (1 - rho) n^2 cos cos / (cos^4 b (n cos - cos)^2), 0 beyond the critical angle.

        The cosines are those of theta_a in the air and theta_w in the water to the normal, and b is
        its tilt.
        """
        length = np.linalg.norm(normal, axis=-1)  # n cos(theta_w) - cos(theta_a)
        unit_normal = normal / length[..., None]
        cos_a, cos_w = unit_normal @ self.sun, -np.einsum("...i,...i", view, unit_normal)
        illuminated = (cos_a > 0.0) & (cos_w > 0.0) & (unit_normal[..., 2] > 0.0)
        through = 1.0 - fresnel_reflectance(np.clip(cos_a, 0.0, 1.0), 1.0, self.n)  # transmittance
        # cos^-4 b: facet per horizontal area, slopes per solid angle of normals (cos^-3 b);
        # n^2 cos(theta_w) / length^2: normals per view (Walter et al. 2007, EGSR, eq. 17)
        cos4 = np.where(illuminated, unit_normal[..., 2], 1.0) ** 4
        return np.where(illuminated, through * self.n**2 * cos_a * cos_w / (cos4 * length**2), 0.0)


Bending = Reflection | Refraction
"""Laws by which a facet of the sea sends sunlight into a direction."""


@check_call
def connected_glint(
    view: Directions,
    sun: Directions,
    normal: Directions,
    facet_normal: Directions,
    roughness: Roughness,
    n: Index,
) -> Floats:
    """Return the ratio of the radiance of glint to the irradiance of the sun [sr-1].

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
    radiance = by_slopes(Reflection(sun, (n,)), view, normal, facet_normal, roughness)
    return np.asarray(radiance[0])


def by_slopes(
    law: Bending, view: Floats, normal: Directions, facet_normal: Directions, roughness: Roughness
) -> Floats:
    """Return the radiance of sunlight off unresolved slopes, over the irradiance of the sun.

    In sr-1, as `connected_glint`; `facet_normal` points to the side of the receiver, into the
    water for `Refraction`.
    """
    required = law.normal(view)
    density = slope_density(slopes_to(required, normal), roughness)
    facing = np.einsum("...i,...i", view, facet_normal)
    # cos(b_g) / (v . n_g) of `connected_glint`: slopes count by area seen from above
    area = np.where(facing > 0.0, np.abs(facet_normal[..., 2]) / np.maximum(facing, 1e-12), 0.0)
    return law.strength(view, required) * (density * area)


@check_call
def glint_radiance(
    view: Directions,
    sun: Directions,
    slope_variances: tuple[float, float],
    wind_direction_deg: float = 0.0,
    n: Index = 1.33,
    slope_law: GramCharlier | None = None,
) -> Floats:
    """Return the ratio of the radiance of glint of a level sea to the sun's irradiance [sr-1].

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


# Tuned: the numbers of nodes trade accuracy for time.
_ZENITHS, _AZIMUTHS = 14, 20  # directions that stand for the sky
_DEPTHS = 6000  # nodes over the depth
_DEEPEST = 20.0  # depth of the last node, by the integral of k from the surface: exp(-40) is left
_ANGLES = 2048  # nodes of the scattering angle, 0 ... pi
_EXACT = 1e-7  # error of a phase function relative to the first of them
# Scattering angles below are left out. From a refracted beam, at most 49 deg from straight down, to
# light that travels up it is at least 41 deg.
_LEAST_ANGLE = math.radians(30.0)
_EXTINCTION = np.geomspace(1.9, 60.0, 400)
"""Nodes of m = 1 / mu' + 1 / mu_v: from both vertical (2) to a nearly horizontal view."""


@check_methods
class QuasiSingle:
    """Upwelling radiance under still water by single scattering with k = a + b_b.

    L_u = sum E_w int sum_j b_j beta_j(Theta) exp(-K(z) m) dz / mu_v,  m = 1 / mu' + 1 / mu_v

    over beams of irradiance E_w across themselves with cosine mu', those of the sun and of the
    refracted sky; scatterers j are water and bubbles, K is the integral of k from the surface. In
    uniform water the integral is b beta / (k (1 + mu_v / mu')). A bottom adds albedo / pi times
    its irradiance.

    Parameters
    ----------
    waters : sequence of Water
        Water at each wavelength.
    bubbles : sequence of BubblePopulation or None
        Bubbles at each wavelength.
    n : float
        Index of all waters over that of the air.
    days : sequence of Daylight
        Light above the sea at each wavelength, of one pattern and sun.

    References
    ----------
    Gordon (1973), Appl. Opt. 12, 2803, quasi-single scattering.
    """

    def __init__(
        self,
        waters: Sequence[Water],
        bubbles: Sequence[BubblePopulation | None],
        n: float,
        days: Sequence[Daylight],
    ) -> None:
        self.n = n
        travel, power, ring = _beams(days[0], n)
        # mu' of each ring, from its first beam
        slant = -travel[np.unique(ring, return_index=True)[1], 2]
        # (rings, wavelengths): the last ring is the sun, the others are the sky
        irradiance = np.empty((len(slant), len(days)))
        irradiance[:-1] = [day.diffuse for day in days]
        irradiance[-1] = [day.direct for day in days]
        contents = list(zip(waters, bubbles, strict=True))
        # phase functions that several wavelengths share are tabulated once
        index: dict[PhaseFunction, int] = {}
        scatterers = [_scatterers(*content) for content in contents]
        indices = [[index.setdefault(phase, len(index)) for phase in row] for row in scatterers]
        integrals = [_integrate_depth(*content) for content in contents]
        phase, mix = _common_functions(list(index))
        self._beams = Beams(
            travel, power, ring, slant, irradiance, phase, _EXTINCTION,
            np.stack([scattered for scattered, _ in integrals], axis=-1),
            np.stack([mix[row] for row in indices], axis=-1),
            np.stack([floor for _, floor in integrals], axis=-1),
        )  # fmt: skip

    def upwelling(self, directions: Directions) -> Floats:
        """Return the radiance L_u below the surface (n, wavelengths) [W m-2 sr-1 nm-1].

        Parameters
        ----------
        directions : ndarray, shape (n, 3)
            Unit vectors along which the light travels up.
        """
        beams = self._beams
        radiance = np.zeros((len(directions), beams.irradiance.shape[1]))
        # scratch of the kernel, see `add_upwelling`
        toward = np.empty((len(beams.slant), beams.phase.shape[1] + 1))
        work = np.zeros(radiance.shape[1])
        add_upwelling(np.ascontiguousarray(directions), beams, toward, work, radiance)
        return radiance


def _beams(day: Daylight, n: float) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Return directions, powers and rings of the beams of daylight under water, the sun last.

    Powers are irradiances across the beams under water: those of the sky for a horizontal
    irradiance of 1 in the air, that of the sun for an irradiance of 1 across its light.
    """
    x, w = gauss_legendre(_ZENITHS)
    sin2, weight = 0.5 * (x + 1.0), 0.5 * w  # cos dOmega = d(sin^2) d(azimuth) / 2
    azimuth = 2.0 * math.pi * (np.arange(_AZIMUTHS) + 0.5) / _AZIMUTHS
    s, phi = np.meshgrid(np.sqrt(sin2), azimuth, indexing="ij")
    towards = np.stack([s * np.cos(phi), s * np.sin(phi), np.sqrt(1.0 - s**2)], -1).reshape(-1, 3)
    unit_day = day.replace(diffuse=1.0)
    flux = sky_radiance(unit_day.sky, towards) * np.repeat(weight, _AZIMUTHS)
    towards = np.concatenate([towards, [day.sun]])
    # horizontal irradiances; those of the sky are divided by their sum, so that it is exactly 1
    flux = np.append(flux / flux.sum(), day.sun[2])
    flux = flux * (1.0 - fresnel_reflectance(np.clip(towards[:, 2], 0.0, 1.0), 1.0, n))
    # Snell's law: the index divides the horizontal components
    travel = -towards / n
    travel[:, 2] = -np.sqrt(1.0 - travel[:, 0] ** 2 - travel[:, 1] ** 2)
    return travel, flux / -travel[:, 2], np.arange(len(flux)) // _AZIMUTHS


def _common_functions(phases: Sequence[PhaseFunction]) -> tuple[Floats, Floats]:
    """Decompose phase functions into basis functions (angles, functions) and mixtures.

    The phase functions are mix @ functions.T; below `_LEAST_ANGLE` they are 0.
    """
    theta = np.linspace(0.0, math.pi, _ANGLES)
    wide = theta > _LEAST_ANGLE
    tables = np.array([phase.pdf(theta[wide]) for phase in phases])
    # divided by the first one: `_EXACT` bounds the error relative to it
    mix, functions = common_functions(tables / tables[0], _EXACT)
    source = np.zeros((_ANGLES, len(functions)))
    source[wide] = (functions * tables[0]).T
    return source, mix


def _scatterers(water: Water, bubbles: BubblePopulation | None) -> list[PhaseFunction]:
    """Return the phase functions of water and bubbles."""
    return [water.phase] if bubbles is None else [water.phase, bubbles.phase_function()]


@lru_cache(maxsize=256)
def _integrate_depth(water: Water, bubbles: BubblePopulation | None) -> tuple[Floats, Floats]:
    """Integrate scattering over depth, and return the radiance of the bottom, at the nodes of m.

    int b_j exp(-m int k dz) dz [1], shape (scatterers, nodes), and the radiance of the bottom over
    the horizontal irradiance below the surface [sr-1], shape (nodes,), empty without a bottom.
    """
    from scipy.special import exprel

    depth, a, b = _profile(water, bubbles)
    back = np.array([phase.backscatter_fraction for phase in _scatterers(water, bubbles)])
    # quasi-single scattering: light scattered forwards counts as not scattered
    k = a + back @ b
    if np.ptp(k) == 0.0 and not np.ptp(b, axis=1).any():  # in closed form
        tau = _EXTINCTION * (k[0] * depth[-1])
        last = np.exp(-tau)
        # int_0^D exp(-m k z) dz = D exprel(-m k D)
        integral = b[:, :1] * depth[-1] * exprel(-tau)
    else:
        # trapezoidal rule
        steps = np.diff(depth)
        path = np.concatenate([[0.0], np.cumsum(0.5 * steps * (k[1:] + k[:-1]))])
        decay = np.exp(-np.outer(_EXTINCTION, path))
        last = decay[:, -1]
        integral = 0.5 * (b[:, 1:] * steps @ decay[:, 1:].T + b[:, :-1] * steps @ decay[:, :-1].T)
    if water.bottom_depth is None:
        return integral, np.zeros(0)
    return integral, water.bottom_albedo * last / math.pi


def _profile(water: Water, bubbles: BubblePopulation | None) -> tuple[Floats, Floats, Floats]:
    """Return depths (n,) [m], absorption (n,) and scattering of water and bubbles (1 or 2, n)."""
    surface = np.array([0.0])
    a0, b0 = (float(v[0]) for v in water.profile(surface))
    k0 = a0 + b0 * water.phase.backscatter_fraction
    # tuned: 1 km for water that neither absorbs nor scatters
    deepest = _DEEPEST / k0 if k0 > 0.0 else 1e3
    if water.layers is not None:
        # k of the surface says little of layers: go well below the last node
        deepest = max(deepest, 3.0 * water.layers[-1][0])
    if water.bottom_depth is not None:
        deepest = min(deepest, water.bottom_depth)
    # dense near the surface, where the light is strong and the bubbles are
    depth = np.concatenate([surface, np.geomspace(1e-4 * deepest, deepest, _DEPTHS)])
    a, b = water.profile(depth)
    scattering = [b] if bubbles is None else [b, bubbles.b(depth)]
    return depth, a, np.array(scattering)
