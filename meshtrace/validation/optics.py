"""Interface, phase functions, bubbles and waves against closed forms and published tables."""

from __future__ import annotations

import itertools
import math

import numpy as np

from meshtrace.optics import mie
from meshtrace.optics.bubbles import HallNovarini
from meshtrace.optics.fresnel import fresnel_reflectance, hemispheric_reflectance
from meshtrace.optics.phase import FournierForand
from meshtrace.validation.check import Check, printed

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


def optics_checks(photons: int) -> list[Check]:
    """Return the checks without transport; `photons` scattering angles are drawn."""
    return [
        *_interface_checks(),
        *_phase_checks(photons),
        *_mie_checks(),
        *_bubble_checks(),
        *_wave_checks(),
    ]


def _interface_checks() -> list[Check]:
    n = 1.33
    air = walsh_reflectance(n)
    water = 1.0 - (1.0 - air) / n**2
    normal = ((n - 1.0) / (n + 1.0)) ** 2
    return [
        Check("reflectance, normal incidence", "((n - 1) / (n + 1))^2", normal,
              float(fresnel_reflectance(1.0, n, 1.0)), tolerance=1e-12),
        Check("diffuse reflectance, from the air", "Walsh 1926", air,
              hemispheric_reflectance(1.0, n), tolerance=1e-9),
        Check("diffuse reflectance, from the water", "1 - (1 - Walsh) / n^2", water,
              hemispheric_reflectance(n, 1.0), tolerance=1e-9),
    ]  # fmt: skip


def _phase_checks(samples: int) -> list[Check]:
    checks = [
        Check(f"Fournier-Forand {n:g}, {mu:g}: b_b / b", "Mobley et al. 2002, table", fraction,
              FournierForand(n=n, mu=mu).backscatter_fraction, tolerance=0.02 * fraction)
        for n, mu, fraction in BACKSCATTER
    ]  # fmt: skip
    phase = FournierForand()
    cosine = np.cos(phase.sample(np.random.default_rng(51).random(samples)))
    stderr = float(cosine.std() / math.sqrt(samples))
    checks.append(
        Check("Fournier-Forand, drawn: g", "closed form", 0.929963058, float(cosine.mean()), stderr)
    )
    return checks


def _mie_checks() -> list[Check]:
    checks = []
    for m, x, q_sca, g in WISCOMBE:
        found = mie.efficiencies(m, x)
        for name, text, got in (("Q_sca", q_sca, found.q_sca), ("g", g, found.g)):
            label = f"Mie, m {m:g}, x {x:g}: {name}"
            checks.append(printed(label, "Wiscombe 1979, NCAR/TN-140", text, float(got)))
    return checks


def _bubble_checks() -> list[Check]:
    from scipy.integrate import quad

    checks = []
    for wind_speed in (5.0, 13.0):
        bubbles = HallNovarini(wind_speed=wind_speed, q=2.0)

        def cross_section(depth: float, bubbles: HallNovarini = bubbles) -> float:
            # split at the kink of the size distribution
            cuts = (bubbles.r_min, float(bubbles.r_ref(depth)), bubbles.r_max)
            return sum(
                quad(
                    lambda r: 2.0 * math.pi * r**2 * float(bubbles.size_distribution(r, depth)),
                    low, high, epsabs=0.0, epsrel=1e-10,
                )[0]
                for low, high in itertools.pairwise(cuts)
            )  # fmt: skip

        expected = quad(cross_section, 0.0, 10.0, epsabs=0.0, epsrel=1e-8, limit=200)[0]
        checks.append(
            Check(f"bubbles, {wind_speed:g} m/s: depth 0 to 10 m", "quadrature of sizes, depths",
                  expected, float(bubbles.optical_depth(0.0, 10.0)), tolerance=1e-6 * expected)
        )  # fmt: skip
    return checks


def _wave_checks() -> list[Check]:
    from meshtrace.surfaces import Jonswap
    from meshtrace.surfaces.statistics import hs

    checks = []
    for wind_speed in (5.0, 13.0):
        fetch, g = 30e3, 9.81
        omega_p = Jonswap(wind_speed=wind_speed, fetch=fetch).omega_p
        alpha = 0.075 * (g * fetch / wind_speed**2) ** -0.22
        expected = 4.0 * math.sqrt(alpha * g**2 / (5.0 * omega_p**4))
        got = hs(Jonswap(wind_speed=wind_speed, fetch=fetch, gamma=1.0))
        checks.append(
            Check(f"gamma 1, {wind_speed:g} m/s: wave height", "4 sqrt(alpha g^2 / 5) / omega_p^2",
                  expected, got, tolerance=1e-5 * expected)
        )  # fmt: skip
    return checks
