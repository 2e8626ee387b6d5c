"""Canonical problems of Mobley et al. (1993) through the mesh engine.

The problems are those of `meshtrace validate`, which takes fewer photons.
"""

import numpy as np
import pytest

from meshtrace.optics.phase import Petzold, Rayleigh
from meshtrace.validation.check import half_digit
from meshtrace.validation.mobley import PROBLEM_1, SPREAD, canonical_problem, light_field

pytestmark = [
    pytest.mark.external,
    pytest.mark.filterwarnings("ignore:.*left the meshed surface:meshtrace.DomainWarning"),
]


def light_of(link, photons, seed=41):
    field, result = light_field(link, photons, seed)
    assert sum(f.weight for f in result.fates.values()) == pytest.approx(1.0, abs=1e-12)
    return field


@pytest.mark.parametrize("albedo", PROBLEM_1)
def test_problem_1(albedo):
    table = PROBLEM_1[albedo]
    field = light_of(canonical_problem(albedo, Rayleigh(), tuple(table)), 2_500_000)
    for k, (depth, row) in enumerate(table.items()):
        for name, text, spread in zip(("e_d", "e_ou"), row, SPREAD[depth], strict=True):
            value, stderr, expected = field[name][k], field[f"{name}_stderr"][k], float(text)
            limit = spread * expected
            assert stderr < limit, f"{name} at {depth}: too noisy"
            assert abs(value - expected) < max(limit, 3.0 * stderr + half_digit(text)), (
                f"{name} at tau {depth}: {value:.4g} +- {stderr:.2g}, published {text}"
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
    assert deep["e_ou"][0] < 0.4 * float(PROBLEM_1[0.9][1.0][1])
    assert shallow["e_u"][1] > 3.0 * deep["e_u"][1]
    # a Lambertian floor reflects half of what reaches it
    assert shallow["e_u"][1] == pytest.approx(0.5 * shallow["e_d"][1], rel=0.1)
