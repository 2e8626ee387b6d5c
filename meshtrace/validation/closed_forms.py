"""Checks against closed forms and quadratures of whole links: still water and slabs."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass
from functools import cache
from typing import Any, Literal, SupportsFloat

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq

from meshtrace.checks import check_call
from meshtrace.engine.simulate import simulate
from meshtrace.errors import DomainWarning
from meshtrace.link import IrradiancePlanes, Led, Link, Physics, Receiver, Sun
from meshtrace.mesh import TriangleMesh
from meshtrace.optics.fresnel import fresnel_reflectance
from meshtrace.optics.phase import HenyeyGreenstein
from meshtrace.optics.water import Water
from meshtrace.surfaces import FlatSea
from meshtrace.tables import text_table

LIMIT = 4.0
"""Largest |z| with which a check passes: 6e-5 of right estimates are beyond."""


@dataclass(frozen=True)
class Check:
    """A computed quantity and its reference.

    Parameters
    ----------
    quantity : str
        Quantity compared.
    source : str
        Source of the reference.
    expected, got : float
        Reference, and the value found.
    stderr : float
        Monte Carlo standard error of the difference, 0 for deterministic quantities.
    tolerance : float
        Uncertainty of the reference, or, for deterministic quantities, the claimed accuracy.
    """

    quantity: str
    source: str
    expected: float
    got: float
    stderr: float = 0.0
    tolerance: float = 0.0

    @property
    def z(self) -> float:
        """(got - expected) / hypot(stderr, tolerance), infinite if either is not finite."""
        error = math.hypot(self.stderr, self.tolerance)
        difference = self.got - self.expected
        return difference / error if math.isfinite(difference) and error > 0.0 else math.inf

    @property
    def passed(self) -> bool:
        """True if |z| <= LIMIT."""
        return abs(self.z) <= LIMIT

    def as_data(self) -> dict[str, Any]:
        """Return the check as plain data."""
        return asdict(self) | {"z": self.z, "passed": self.passed}


def exact(quantity: str, source: str, expected: float, got: SupportsFloat, rtol: float) -> Check:
    """Return the check of a deterministic value against a reference of a relative accuracy."""
    return Check(quantity, source, expected, float(got), tolerance=rtol * expected)


@check_call
def format_table(checks: Iterable[Check]) -> str:
    """Return checks as a table in text; `|z| > 4` is marked.

    Parameters
    ----------
    checks : iterable of Check
        Rows of the table.

    Returns
    -------
    str
    """
    head = ("quantity", "source", "expected", "got", "std. error", "tolerance", "z")
    return text_table(map(_row, checks), head)


def _row(check: Check) -> tuple[str, ...]:
    mark = "" if check.passed else "  FAILED"
    return (
        check.quantity,
        check.source,
        f"{check.expected:.6g}",
        f"{check.got:.6g}",
        f"{check.stderr:.1e}" if check.stderr else "-",
        f"{check.tolerance:.1e}" if check.tolerance else "-",
        f"{check.z:+.2f}{mark}",
    )


def unscattered_gain(
    depth: float = 10.0,
    height: float = 5.0,
    radius: float = 0.05,
    half_angle_deg: float = 10.0,
    n: float = 1.33,
    c: float = 0.151,
) -> float:
    r"""Return the gain of unscattered light at a level receiver on the axis of the lamp.

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

    # Lambertian order: cos^m falls to half at the half angle
    m = -math.log(2.0) / math.log(math.cos(math.radians(half_angle_deg)))

    def density(theta: float) -> float:
        cosine = math.cos(theta)
        through = 1.0 - float(fresnel_reflectance(cosine, n, 1.0))
        return (m + 1.0) * cosine**m * math.sin(theta) * through * math.exp(-c * depth / cosine)

    # total reflection bounds the angle of the ray that lands on the rim
    rim = float(brentq(beyond, 0.0, math.asin(1.0 / n) - 1e-12, xtol=1e-15))
    return float(quad(density, 0.0, rim, epsabs=0.0, epsrel=1e-12)[0])


@cache
def wide_mesh() -> TriangleMesh:
    """Return still water, wide enough to lose negligible light at its sides."""
    return FlatSea().mesh(extent=3000.0, spacing=1000.0)


def slab_link(
    thickness: float, albedo: float, g: float, n_water: float, n_air: float,
    absorption: Literal["continuous", "implicit", "analog"] = "continuous",
) -> Link:  # fmt: skip
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
    # 1 m-1 of attenuation: the thickness is the optical one
    water = Water(
        a=1.0 - albedo, b=albedo, n=n_water, phase=HenyeyGreenstein(g=g),
        bottom_depth=thickness, bottom_albedo=0.0,
    )  # fmt: skip
    return Link(
        water=water,
        n_air=n_air,
        transmitter=Sun(zenith_deg=0.0, half_width=1.0),
        receiver=Receiver(height=1.0, radius=1e7, fov_deg=180.0),
        planes=IrradiancePlanes(depths=(thickness * (1.0 - 1e-9),)),
        physics=Physics(absorption=absorption),
    )


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
    asymptotic = 2.9078 / math.sqrt(3.0) / (10.0 + 2.0 * 0.7104)
    for name, source, tau, albedo, samples, expected, rtol in (
        # a ray starts 10 um off the facet that it leaves, and does not fly these
        ("black slab, tau 2: T", "Beer-Lambert", 2.0, 0.0, 4096, math.exp(-2.0), 1.1e-5),
        ("white isotropic slab, tau 10: T", "asymptotic, Chandrasekhar 1950",
         10.0, 1.0, photons, asymptotic, 1e-3),
    ):  # fmt: skip
        # light in a slab without absorption meets its sides for long
        planes = simulate(
            slab_link(tau, albedo, 0.0, 1.33, 1.33), wide_mesh(), estimator="analog",
            photons=samples, seed=34, max_surface_events=10_000,
        ).planes  # fmt: skip
        assert planes is not None
        got, stderr = float(planes.e_d[0]), float(planes.e_d_stderr[0])
        yield Check(name, source, expected, got, stderr, rtol * expected)


SUITE: dict[str, tuple[Callable[[int], Iterable[Check]], int]] = {
    "still water": (still_water_checks, 20_000_000),
    "slabs": (slab_checks, 1_000_000),
}
"""Families of checks by name, in the order in which they run, with their numbers of photons."""


@check_call
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
    results: list[Check] = []
    for name, (checks, photons) in SUITE.items():
        if progress is not None:
            progress(name)
        with warnings.catch_warnings():
            # slabs are infinite, meshes are not: the light that wanders off is negligible
            warnings.filterwarnings("ignore", "(?s).*left the meshed surface", DomainWarning)
            results += checks(photons // 20 if quick else photons)
    return tuple(results)
