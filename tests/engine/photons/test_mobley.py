"""Canonical problems of Mobley et al. (1993), Appl. Opt. 32, 7484, doi:10.1364/AO.32.007484.

Flat surface, n = 1.34, sun at 60 degrees that gives E_d(air) = 0.5 on a level plane, black sky,
infinitely deep homogeneous water; depths are optical depths. Problem 1 has the phase function
3/(16 pi) (1 + cos^2); 2 and 6 that of Petzold's particles, and 6 a floor.
"""

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.optics import Petzold, Rayleigh
from meshtrace.validation import closed_forms

pytestmark = [
    pytest.mark.external,
    pytest.mark.filterwarnings("ignore:.*left the meshed surface:meshtrace.DomainWarning"),
]


E_AIR = 0.5  # irradiance just above the surface

# albedo, optical depth: downwelling irradiance E_d, upwelling scalar irradiance E_ou, with half a
# unit of their last digits
PROBLEM_1 = {
    0.2: {1.0: ((0.141, 5e-4), (1.34e-2, 5e-5)), 5.0: ((1.07e-3, 5e-6), (1.00e-4, 5e-7))},
    0.9: {
        1.0: ((0.366, 5e-4), (0.372, 5e-4)),
        5.0: ((4.33e-2, 5e-5), (4.35e-2, 5e-5)),
        10.0: ((3.16e-3, 5e-6), (3.20e-3, 5e-6)),
    },
}
# relative spread of the models that the paper averages, by optical depth: E_d, E_ou
SPREAD = {1.0: (0.01, 0.03), 5.0: (0.02, 0.03), 10.0: (0.03, 0.04)}


def canonical_problem(albedo, phase, depths, **water):
    """Return a sun over water of c = 1 m-1, with irradiance scored at depths [m]."""
    return mt.Link(
        water=mt.Water(a=1.0 - albedo, b=albedo, n=1.34, phase=phase, **water),
        transmitter=mt.Sun(zenith_deg=60.0, half_width=1.0),
        receiver=(),
        planes=mt.IrradiancePlanes(depths=tuple(depths)),
    )


def light_of(link, photons, seed=41):
    """Return the irradiances of a problem at its planes; the ledger must close."""
    options = {"photons": photons, "seed": seed, "max_surface_events": 1000}
    r = mt.simulate(link, closed_forms.wide_mesh(), estimator="analog", **options)
    assert sum(f.weight for f in r.fates.values()) == pytest.approx(1.0, abs=1e-12)
    names = [name + error for name in ("e_d", "e_u", "e_od", "e_ou") for error in ("", "_stderr")]
    return {name: E_AIR * getattr(r.planes, name) for name in names}


@pytest.mark.parametrize("albedo", PROBLEM_1)
def test_problem_1(albedo):
    table = PROBLEM_1[albedo]
    field = light_of(canonical_problem(albedo, Rayleigh(), tuple(table)), 2_500_000)
    for k, (depth, row) in enumerate(table.items()):
        for name, (expected, digit), spread in zip(
            ("e_d", "e_ou"), row, SPREAD[depth], strict=True
        ):
            value, stderr = field[name][k], field[f"{name}_stderr"][k]
            limit = spread * expected
            assert stderr < limit, f"{name} at {depth}: too noisy"
            assert abs(value - expected) < max(limit, 3.0 * stderr + digit), (
                f"{name} at tau {depth}: {value:.4g} +- {stderr:.2g}, published {expected}"
            )


@pytest.mark.parametrize("albedo", PROBLEM_1)
def test_absorption_closes_the_energy_balance(albedo):
    """Gershun: the net flux through a plane is what is absorbed below it, a E_o dz."""
    depths = tuple(float(d) for d in np.linspace(0.25, 6.0, 24))
    field = light_of(canonical_problem(albedo, Rayleigh(), depths), 300_000, seed=42)
    net = field["e_d"] - field["e_u"]
    scalar = field["e_od"] + field["e_ou"]
    step = depths[1] - depths[0]
    # Simpson over pairs of steps; trapezoids are too coarse for exp(-1.3 z)
    absorbed = (1.0 - albedo) * step / 3.0 * (scalar[:-2:2] + 4.0 * scalar[1:-1:2] + scalar[2::2])
    lost = net[:-2:2] - net[2::2]
    noise = 0.02 * lost + 4.5 * step * np.hypot(field["e_od_stderr"][1:-1:2], 0.0)
    assert (np.abs(lost - absorbed) < noise).all()


def test_problems_2_and_6_run_with_the_same_objects():
    """Petzold's particles, and a Lambertian floor of albedo 0.5 at tau = 5."""
    depths = (1.0, 4.9)
    deep = light_of(canonical_problem(0.9, Petzold(), depths), 200_000)
    floor = {"bottom_depth": 5.0, "bottom_albedo": 0.5}
    shallow = light_of(canonical_problem(0.9, Petzold(), depths, **floor), 200_000)
    # forward peaked: less comes back than in problem 1, and the floor sends more of it
    assert deep["e_ou"][0] < 0.4 * PROBLEM_1[0.9][1.0][1][0]
    assert shallow["e_u"][1] > 3.0 * deep["e_u"][1]
    # a Lambertian floor reflects half of what reaches it
    assert shallow["e_u"][1] == pytest.approx(0.5 * shallow["e_d"][1], rel=0.1)
