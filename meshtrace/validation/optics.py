"""Interface, phase functions, bubbles and waves against closed forms and published tables."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np
from scipy.integrate import quad

from meshtrace.optics import mie
from meshtrace.optics.bubbles import HallNovarini
from meshtrace.optics.fresnel import fresnel_reflectance, hemispheric_reflectance
from meshtrace.optics.phase import FournierForand
from meshtrace.validation.check import Check, exact, printed

WISCOMBE = (
    (0.75, 10.0, "2.232265", "0.896473"),
    (0.75, 1000.0, "1.997908", "0.844944"),
    (1.5, 10.0, "2.881999", "0.742913"),
    (1.5, 100.0, "2.094388", "0.818246"),
    (1.5, 1000.0, "2.013945", "0.827882"),
)
"""Real index m, size parameter x, Q_sca, g: Wiscombe 1979, NCAR/TN-140+STR."""

BACKSCATTER = (
    (1.021, 3.0742, 1e-4),
    (1.04, 3.201, 1e-3),
    (1.08, 3.483, 1e-2),
    (1.175, 4.065, 0.1),
    (1.15, 4.874, 0.4),
)
"""Index n, slope mu, backscatter fraction of Fournier-Forand: Mobley et al. 2002, Appl. Opt. 41."""


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


def optics_checks(photons: int) -> Iterator[Check]:
    """Yield the checks without transport; `photons` scattering angles are drawn."""
    yield from (*_interface_checks(), *_phase_checks(photons), *_mie_checks())
    yield from (*_bubble_checks(), *_wave_checks())


def _interface_checks() -> Iterator[Check]:
    n = 1.33
    air, normal = walsh_reflectance(n), ((n - 1.0) / (n + 1.0)) ** 2
    water = 1.0 - (1.0 - air) / n**2
    for name, source, expected, got, tolerance in (
        ("reflectance, normal incidence", "((n - 1) / (n + 1))^2",
         normal, fresnel_reflectance(1.0, n, 1.0), 1e-12),
        ("diffuse reflectance, from the air", "Walsh 1926",
         air, hemispheric_reflectance(1.0, n), 1e-9),
        ("diffuse reflectance, from the water", "1 - (1 - Walsh) / n^2",
         water, hemispheric_reflectance(n, 1.0), 1e-9),
    ):  # fmt: skip
        yield Check(name, source, expected, float(got), tolerance=tolerance)


def _phase_checks(samples: int) -> Iterator[Check]:
    for n, mu, fraction in BACKSCATTER:
        got = FournierForand(n=n, mu=mu).backscatter_fraction
        label = f"Fournier-Forand {n:g}, {mu:g}: b_b / b"
        yield exact(label, "Mobley et al. 2002, table", fraction, got, 0.02)
    cosine = np.cos(FournierForand().sample(np.random.default_rng(51).random(samples)))
    mean, stderr = float(cosine.mean()), float(cosine.std() / math.sqrt(samples))
    yield Check("Fournier-Forand, drawn: g", "closed form", 0.929963058, mean, stderr)


def _mie_checks() -> Iterator[Check]:
    for m, x, q_sca, g in WISCOMBE:
        found = mie.efficiencies(m, x)
        for name, text, got in (("Q_sca", q_sca, found.q_sca), ("g", g, found.g)):
            label = f"Mie, m {m:g}, x {x:g}: {name}"
            yield printed(label, "Wiscombe 1979, NCAR/TN-140", text, float(got))


def _bubble_checks() -> Iterator[Check]:
    for wind_speed in (5.0, 13.0):
        bubbles = HallNovarini(wind_speed=wind_speed, q=2.0)
        options = {"epsabs": 0.0, "epsrel": 1e-8, "limit": 200}
        expected, _ = quad(_cross_section, 0.0, 10.0, (bubbles,), **options)
        label = f"bubbles, {wind_speed:g} m/s: depth 0 to 10 m"
        got = bubbles.optical_depth(0.0, 10.0)
        yield exact(label, "quadrature of sizes, depths", expected, got, 1e-6)


def _cross_section(depth: float, bubbles: HallNovarini) -> float:
    """Return the scattering cross section of the bubbles in a volume at a depth [m-1]."""

    def density(r: float) -> float:
        return 2.0 * math.pi * r**2 * float(bubbles.size_distribution(r, depth))

    # split at the kink of the size distribution
    cuts = (bubbles.r_min, float(bubbles.r_ref(depth)), bubbles.r_max)
    parts = itertools.pairwise(cuts)
    return sum(quad(density, low, high, epsabs=0.0, epsrel=1e-10)[0] for low, high in parts)


def _wave_checks() -> Iterator[Check]:
    from meshtrace.surfaces import Jonswap
    from meshtrace.surfaces.statistics import hs

    fetch, g = 30e3, 9.81
    for wind_speed in (5.0, 13.0):
        omega_p = Jonswap(wind_speed=wind_speed, fetch=fetch).omega_p
        alpha = 0.075 * (g * fetch / wind_speed**2) ** -0.22
        expected = 4.0 * math.sqrt(alpha * g**2 / (5.0 * omega_p**4))
        got = hs(Jonswap(wind_speed=wind_speed, fetch=fetch, gamma=1.0))
        label = f"gamma 1, {wind_speed:g} m/s: wave height"
        yield exact(label, "4 sqrt(alpha g^2 / 5) / omega_p^2", expected, got, 1e-5)
