"""The default link over still water: quadrature of the unscattered light, and reference gains."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from meshtrace.link import Led, Link, Physics, Receiver
from meshtrace.optics.fresnel import fresnel_reflectance
from meshtrace.optics.water import Water
from meshtrace.transport.simulate import simulate
from meshtrace.validation.check import Check, exact, simulated

REFERENCE_ERROR = 1e-4
"""Relative standard error of the reference gains with scattering."""


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
    from scipy.integrate import quad
    from scipy.optimize import brentq

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


def flat_sea_checks(photons: int) -> Iterator[Check]:
    """Yield the default link over still water; `photons` for the analog run."""
    from meshtrace.surfaces import FlatSea

    sea, quadrature = FlatSea(), "quadrature, exact for still water"
    for depth in (5.0, 10.0, 20.0, 47.0):
        got = simulate(Link(transmitter=Led(depth=depth)), sea, photons=64).gain_ballistic
        name = f"unscattered gain, {depth:g} m"
        yield exact(name, quadrature, unscattered_gain(depth=depth), np.asarray(got), 1e-5)
    clear = Link(water=Water(b=0.0), receiver=Receiver(radius=1.0))
    r = simulate(clear, sea, estimator="analog", photons=photons, seed=1)
    expected = unscattered_gain(radius=1.0, c=clear.water.a)
    yield simulated("b = 0, r = 1 m: gain, analog", quadrature, expected, r)
    kill, source = Physics(reflected="kill"), "forced and adjoint prototypes"
    for radius, expected in ((0.05, 5.9731e-5), (0.25, 1.488835e-3)):
        link = Link(receiver=Receiver(radius=radius), physics=kill)
        r = simulate(link, sea, photons=max(20_000, photons // 200), seed=2)
        name = f"gain, r = {radius:g} m, forced"
        yield simulated(name, source, expected, r, REFERENCE_ERROR * expected)
