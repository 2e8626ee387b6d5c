"""Plane-parallel slabs through mesh, Embree and the transport kernels, and published tables.

The slab is the water between a flat mesh and a black floor; light comes from the sun in the
zenith, that is at normal incidence.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cache
from typing import Any, Literal, NamedTuple

from meshtrace.link import IrradiancePlanes, Link, Physics, Receiver, Sun
from meshtrace.mesh import TriangleMesh
from meshtrace.optics.phase import HenyeyGreenstein
from meshtrace.optics.water import Water
from meshtrace.results.gain import GainResult
from meshtrace.transport.simulate import simulate
from meshtrace.validation.check import Check, printed

VAN_DE_HULST = {"R": "0.09739", "T": "0.66096"}
"""Tau 2, albedo 0.9, Henyey-Greenstein 0.75, index-matched: van de Hulst 1980, vol. 2, table 35."""

GIOVANELLI = "0.2600"
"""Reflectance, the specular 0.04 included, of semi-infinite isotropic scatterers of albedo 0.9
and index 1.5 at normal incidence: Giovanelli 1955, Opt. Acta 2, 153."""


class SlabLight(NamedTuple):
    """Reflected and transmitted light of a slab, relative to the incident light."""

    reflectance: float
    reflectance_stderr: float
    transmittance: float
    transmittance_stderr: float
    result: GainResult


@cache
def wide_mesh() -> TriangleMesh:
    """Return still water wide enough for a negligible loss of light at its sides."""
    from meshtrace.surfaces import FlatSea

    return FlatSea().mesh(extent=3000.0, spacing=1000.0)


def slab_link(
    thickness: float,
    albedo: float,
    g: float,
    n_water: float,
    n_air: float,
    absorption: Literal["continuous", "implicit", "analog"] = "continuous",
) -> Link:
    """Return a slab of attenuation 1 m-1 under the zenith sun.

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


def slab_light(link: Link, photons: int, seed: int, threads: int | None = None) -> SlabLight:
    """Return reflectance and transmittance of a slab.

    Parameters
    ----------
    link : Link
        From `slab_link`.
    photons, seed, threads
        See `meshtrace.transport.simulate`.

    Returns
    -------
    SlabLight
    """
    options: Any = {"photons": photons, "seed": seed, "threads": threads}
    r = simulate(link, wide_mesh(), estimator="analog", max_surface_events=10_000, **options)
    assert r.planes is not None
    transmitted, stderr = float(r.planes.e_d[0]), float(r.planes.e_d_stderr[0])
    return SlabLight(float(r.gain), float(r.gain_stderr), transmitted, stderr, r)


def slab_checks(photons: int) -> Iterator[Check]:
    """Yield the slabs against the tables; `photons` for the first one."""
    light = slab_light(slab_link(2.0, 0.9, 0.75, 1.33, 1.33), photons, seed=31)
    source, name = "van de Hulst 1980, table 35", "slab, tau 2, albedo 0.9, g 0.75"
    yield printed(f"{name}: R", source, VAN_DE_HULST["R"], *light[:2])
    yield printed(f"{name}: T", source, VAN_DE_HULST["T"], *light[2:4])
    thick = slab_light(slab_link(60.0, 0.9, 0.0, 1.5, 1.0), photons // 10, seed=35)
    name = "deep isotropic, albedo 0.9, n 1.5: R"
    yield printed(name, "Giovanelli 1955", GIOVANELLI, *thick[:2])
    white = slab_light(slab_link(10.0, 1.0, 0.0, 1.33, 1.33), photons // 50, seed=34)
    # Chandrasekhar's H(1) and the extrapolation length
    expected = 2.9078 / math.sqrt(3.0) / (10.0 + 2.0 * 0.7104)
    name, source = "white isotropic slab, tau 10: T", "asymptotic, Chandrasekhar 1950"
    yield Check(name, source, expected, *white[2:4], tolerance=1e-3 * expected)
