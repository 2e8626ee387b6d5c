"""Canonical problems of Mobley et al. (1993), Appl. Opt. 32, 7484, doi:10.1364/AO.32.007484.

Flat surface, n = 1.34, sun at 60 degrees that gives E_d(air) = 0.5 on a level plane, black sky,
infinitely deep homogeneous water; depths are optical depths. Problem 1 has the phase function
3/(16 pi) (1 + cos^2); 2 and 6 that of Petzold's particles, and 6 a floor.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshtrace.link import IrradiancePlanes, Link, Sun
from meshtrace.optics.phase import AnyPhase, Rayleigh
from meshtrace.optics.water import Water
from meshtrace.results.gain import GainResult
from meshtrace.transport.simulate import simulate
from meshtrace.validation.check import Check, printed
from meshtrace.validation.slabs import wide_mesh

E_AIR = 0.5
"""Irradiance just above the surface."""

PROBLEM_1 = {
    0.2: {1.0: ("0.141", "1.34e-2"), 5.0: ("1.07e-3", "1.00e-4")},
    0.9: {1.0: ("0.366", "0.372"), 5.0: ("4.33e-2", "4.35e-2"), 10.0: ("3.16e-3", "3.20e-3")},
}
"""Albedo and optical depth: downwelling irradiance E_d, upwelling scalar irradiance E_ou."""

SPREAD = {1.0: (0.01, 0.03), 5.0: (0.02, 0.03), 10.0: (0.03, 0.04)}
"""Relative spread of the models that the paper averages: optical depth: E_d, E_ou."""


def canonical_problem(
    albedo: float, phase: AnyPhase, depths: Sequence[float], **water: Any
) -> Link:
    """Return a sun over water of c = 1 m-1.

    Parameters
    ----------
    albedo : float
        Single-scattering albedo b / c.
    phase : phase function
        Of the water.
    depths : sequence of float
        Where irradiance is scored [m].
    **water
        Further fields of `Water`, such as `bottom_depth`.

    Returns
    -------
    Link
    """
    return Link(
        water=Water(a=1.0 - albedo, b=albedo, n=1.34, phase=phase, **water),
        transmitter=Sun(zenith_deg=60.0, half_width=1.0),
        receiver=(),
        planes=IrradiancePlanes(depths=tuple(depths)),
    )


def light_field(
    link: Link, photons: int, seed: int = 41, threads: int | None = None
) -> tuple[dict[str, NDArray[np.float64]], GainResult]:
    """Return irradiances of a canonical problem at its planes, and the result they come from."""
    options: Any = {"photons": photons, "seed": seed, "threads": threads}
    r = simulate(link, wide_mesh(), estimator="analog", max_surface_events=1000, **options)
    assert r.planes is not None
    names = [name + error for name in ("e_d", "e_u", "e_od", "e_ou") for error in ("", "_stderr")]
    return {name: E_AIR * getattr(r.planes, name) for name in names}, r


def mobley_checks(photons: int) -> Iterator[Check]:
    """Yield problem 1 against its table; the spread of the models is part of the tolerance."""
    for albedo, table in PROBLEM_1.items():
        field, _ = light_field(canonical_problem(albedo, Rayleigh(), tuple(table)), photons)
        for i, (depth, row) in enumerate(table.items()):
            for name, text, spread in zip(("e_d", "e_ou"), row, SPREAD[depth], strict=True):
                label = f"problem 1, albedo {albedo:g}, tau {depth:g}: {name}"
                got, stderr = (float(field[key][i]) for key in (name, f"{name}_stderr"))
                one = printed(label, "Mobley et al. 1993", text, got, stderr)
                tolerance = math.hypot(one.tolerance, spread * one.expected)
                yield replace(one, tolerance=tolerance)
