"""Closed forms and quadratures: interface, phase functions, bubbles, waves, still water, a slab."""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from typing import Any, Literal

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq

from meshtrace.engine.simulate import simulate
from meshtrace.errors import DomainWarning
from meshtrace.link import IrradiancePlanes, Led, Link, Physics, Receiver, Sun
from meshtrace.mesh import TriangleMesh
from meshtrace.optics.bubbles import HallNovarini
from meshtrace.optics.fresnel import fresnel_reflectance, hemispheric_reflectance
from meshtrace.optics.phase import FournierForand, HenyeyGreenstein
from meshtrace.optics.water import Water
from meshtrace.surfaces import FlatSea, Jonswap
from meshtrace.surfaces.statistics import hs
from meshtrace.validation.check import Check, exact


def walsh_reflectance(n: float) -> float:
    """Return the reflectance of diffuse light from the side of the lower index, in closed form.

    Parameters
    ----------
    n : float
        Relative refractive index, > 1.

    Returns
    -------
    float
        Walsh 1926, as in Duntley 1942, J. Opt. Soc. Am. 32, 61.
    """
    q = n * n
    return (
        0.5
        + (n - 1.0) * (3.0 * n + 1.0) / (6.0 * (n + 1.0) ** 2)
        + q * (q - 1.0) ** 2 / (q + 1.0) ** 3 * math.log((n - 1.0) / (n + 1.0))
        - 2.0 * n**3 * (q + 2.0 * n - 1.0) / ((q + 1.0) * (q * q - 1.0))
        + 8.0 * q**2 * (q * q + 1.0) / ((q + 1.0) * (q * q - 1.0) ** 2) * math.log(n)
    )


def unscattered_gain(
    depth: float = 10.0,
    height: float = 5.0,
    radius: float = 0.05,
    half_angle_deg: float = 10.0,
    n: float = 1.33,
    c: float = 0.151,
) -> float:
    r"""Return the gain of the light that reaches a level receiver on the axis unscattered.

    h = \int_0^{theta_r} (m + 1) cos^m(theta) sin(theta) T(theta) exp(-c d / cos(theta)) dtheta,
    where the ray at theta_r ends on the rim: d tan(theta) + h tan(theta_t) = r.

    Parameters
    ----------
    depth, height, radius : float
        Depth of the LED, height and radius of the aperture [m].
    half_angle_deg : float
        Half angle at half power of the LED [degrees].
    n : float
        Refractive index of the water; that of the air is 1.
    c : float
        Attenuation coefficient [m-1].

    Returns
    -------
    float
        Gain, for a field of view that takes all of this light.
    """

    def beyond(theta: float) -> float:
        theta_t = math.asin(n * math.sin(theta))
        return depth * math.tan(theta) + height * math.tan(theta_t) - radius

    m = -math.log(2.0) / math.log(math.cos(math.radians(half_angle_deg)))

    def density(theta: float) -> float:
        cosine = math.cos(theta)
        through = 1.0 - float(fresnel_reflectance(cosine, n, 1.0))
        return (m + 1.0) * cosine**m * math.sin(theta) * through * math.exp(-c * depth / cosine)

    rim = float(brentq(beyond, 0.0, math.asin(1.0 / n) - 1e-12, xtol=1e-15))
    return float(quad(density, 0.0, rim, epsabs=0.0, epsrel=1e-12)[0])


@cache
def wide_mesh() -> TriangleMesh:
    """Return still water wide enough for a negligible loss of light at its sides."""
    return FlatSea().mesh(extent=3000.0, spacing=1000.0)


def slab_link(
    thickness: float,
    albedo: float,
    g: float,
    n_water: float,
    n_air: float,
    absorption: Literal["continuous", "implicit", "analog"] = "continuous",
) -> Link:
    """Return a slab of attenuation 1 m-1 between the surface and a black floor, under a zenith sun.

    Parameters
    ----------
    thickness : float
        Thickness, which is the optical thickness [m].
    albedo : float
        Single-scattering albedo b / c.
    g : float
        Mean cosine of the Henyey-Greenstein phase function.
    n_water, n_air : float
        Refractive indices inside and outside.
    absorption : {"continuous", "implicit", "analog"}
        See `Physics`.

    Returns
    -------
    Link
        The receiver collects all light leaving upwards; the plane lies just above the floor.
    """
    medium: Any = {"a": 1.0 - albedo, "b": albedo, "n": n_water, "phase": HenyeyGreenstein(g=g)}
    return Link(
        water=Water(**medium, bottom_depth=thickness, bottom_albedo=0.0),
        n_air=n_air,
        transmitter=Sun(zenith_deg=0.0, half_width=1.0),
        receiver=Receiver(height=1.0, radius=1e7, fov_deg=180.0),
        planes=IrradiancePlanes(depths=(thickness * (1.0 - 1e-9),)),
        physics=Physics(absorption=absorption),
    )


def optics_checks(samples: int) -> Iterator[Check]:
    """Yield the checks of interface and phase function; `samples` scattering angles are drawn."""
    n = 1.33
    air, normal = walsh_reflectance(n), ((n - 1.0) / (n + 1.0)) ** 2
    water = 1.0 - (1.0 - air) / n**2
    for name, source, expected, got, rtol in (
        ("reflectance, normal incidence", "((n - 1) / (n + 1))^2",
         normal, fresnel_reflectance(1.0, n, 1.0), 1e-11),
        ("diffuse reflectance, from the air", "Walsh 1926",
         air, hemispheric_reflectance(1.0, n), 1e-8),
        ("diffuse reflectance, from the water", "1 - (1 - Walsh) / n^2",
         water, hemispheric_reflectance(n, 1.0), 1e-9),
    ):  # fmt: skip
        yield exact(name, source, expected, got, rtol)
    cosine = np.cos(FournierForand().sample(np.random.default_rng(51).random(samples)))
    mean, stderr = float(cosine.mean()), float(cosine.std() / math.sqrt(samples))
    yield Check("Fournier-Forand, drawn: g", "closed form", 0.929963058, mean, stderr)


def bubble_and_wave_checks(samples: int) -> Iterator[Check]:
    """Yield the checks of optical depth and wave height; nothing is drawn."""
    del samples
    fetch, g = 30e3, 9.81
    for wind_speed in (5.0, 13.0):
        bubbles = HallNovarini(wind_speed=wind_speed, q=2.0)
        options: Any = {"epsabs": 0.0, "epsrel": 1e-8, "limit": 200}
        expected, _ = quad(_cross_section, 0.0, 10.0, (bubbles,), **options)
        got, label = (
            bubbles.optical_depth(0.0, 10.0),
            f"bubbles, {wind_speed:g} m/s: depth 0 to 10 m",
        )
        yield exact(label, "quadrature of sizes, depths", expected, got, 1e-6)
    for wind_speed in (5.0, 13.0):
        spectrum = Jonswap(wind_speed=wind_speed, fetch=fetch, gamma=1.0)
        alpha = 0.075 * (g * fetch / wind_speed**2) ** -0.22
        expected = 4.0 * math.sqrt(alpha * g**2 / (5.0 * spectrum.omega_p**4))
        label, source = (
            f"gamma 1, {wind_speed:g} m/s: wave height",
            "4 sqrt(alpha g^2 / 5) / omega_p^2",
        )
        yield exact(label, source, expected, hs(spectrum), 1e-5)


def _cross_section(depth: float, bubbles: HallNovarini) -> float:
    """Return the scattering cross section of the bubbles in a volume at a depth [m-1]."""

    def density(r: float) -> float:
        return 2.0 * math.pi * r**2 * float(bubbles.size_distribution(r, depth))

    # split at the kink of the size distribution
    cuts = (bubbles.r_min, float(bubbles.r_ref(depth)), bubbles.r_max)
    parts = itertools.pairwise(cuts)
    return sum(quad(density, low, high, epsabs=0.0, epsrel=1e-10)[0] for low, high in parts)


def still_water_checks(photons: int) -> Iterator[Check]:
    """Yield the default link over still water; `photons` for the analog run."""
    source = "quadrature, exact for still water"
    for depth in (5.0, 10.0, 20.0, 30.0, 40.0, 47.0):
        r = simulate(Link(transmitter=Led(depth=depth)), FlatSea(), photons=64)
        label, got = f"unscattered gain, {depth:g} m", float(np.asarray(r.gain_ballistic))
        yield exact(label, source, unscattered_gain(depth=depth), got, 5e-6)
    clear = Link(water=Water(b=0.0), receiver=Receiver(radius=1.0))
    r = simulate(clear, FlatSea(), estimator="analog", photons=photons, seed=1)
    gain, stderr = float(r.gain), float(r.gain_stderr)
    expected = unscattered_gain(radius=1.0, c=clear.water.a)
    yield Check("b = 0, r = 1 m: gain, analog", source, expected, gain, stderr)


def slab_checks(photons: int) -> Iterator[Check]:
    """Yield the transmittance of a slab without scattering, and of a thick white one.

    T = (H(1) / sqrt 3) / (tau + 2 q) with Chandrasekhar's H(1) = 2.9078 and q = 0.7104.
    """
    for name, source, link, samples, expected, rtol in (
        # a ray starts 10 um off the facet that it leaves, and does not fly these
        ("black slab, tau 2: T", "Beer-Lambert", slab_link(2.0, 0.0, 0.0, 1.33, 1.33), 4096,
         math.exp(-2.0), 1.1e-5),
        ("white isotropic slab, tau 10: T", "asymptotic, Chandrasekhar 1950",
         slab_link(10.0, 1.0, 0.0, 1.33, 1.33), photons,
         2.9078 / math.sqrt(3.0) / (10.0 + 2.0 * 0.7104), 1e-3),
    ):  # fmt: skip
        options: Any = {"photons": samples, "seed": 34, "max_surface_events": 10_000}
        planes = simulate(link, wide_mesh(), estimator="analog", **options).planes
        assert planes is not None
        got, stderr = float(planes.e_d[0]), float(planes.e_d_stderr[0])
        yield Check(name, source, expected, got, stderr, rtol * expected)


SUITE: dict[str, tuple[Callable[[int], Iterable[Check]], int]] = {
    "optics": (optics_checks, 4_000_000),
    "bubbles and waves": (bubble_and_wave_checks, 0),
    "still water": (still_water_checks, 20_000_000),
    "slabs": (slab_checks, 1_000_000),
}
"""Families of checks by name, in the order in which they run, with their numbers of photons."""


def validate(
    quick: bool = False, progress: Callable[[str], None] | None = None
) -> tuple[Check, ...]:
    """Run every check of the engine against closed forms and quadratures.

    Parameters
    ----------
    quick : bool
        A twentieth of the photons: larger standard errors, the same checks.
    progress : callable, optional
        Called with the name of each family of checks before it runs.

    Returns
    -------
    tuple of Check
        Seeds are fixed: results on one machine are reproducible.

    Examples
    --------
    >>> checks = validate(quick=True)  # doctest: +SKIP
    >>> max(abs(check.z) for check in checks) < 4.0  # doctest: +SKIP
    True
    """
    found: list[Check] = []
    for name, (checks, photons) in SUITE.items():
        if progress is not None:
            progress(name)
        with warnings.catch_warnings():
            # slabs are infinite, meshes are not: the light that wanders off is negligible
            warnings.filterwarnings("ignore", "(?s).*left the meshed surface", DomainWarning)
            found += checks(photons // 20 if quick else photons)
    return tuple(found)
