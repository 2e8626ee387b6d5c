"""Resolved seas against the explicit meshes of an independent program."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak, z_test

import meshtrace as mt
from meshtrace.engine.forced import ForcedDetection, TypicalSea
from meshtrace.surfaces import FlatSea, resolved_sea

REFERENCE = json.loads(
    (Path(__file__).parents[1] / "data" / "real_seas_reference.json").read_text()
)
SEAS = 150

pytestmark = [pytest.mark.slow, pytest.mark.statistical]


def sea_up_to(omega_max, **options):
    sea = resolved_sea(5.0, fetch=30e3, seed=options.pop("seed", 0))
    return sea.model_copy(update={"omega_max": omega_max, **options})


def index(gain):
    """Return the scintillation index and its standard error by the bootstrap."""
    drawn = np.random.default_rng(1).choice(gain, (1000, len(gain)))
    found = drawn.var(axis=1, ddof=1) / drawn.mean(axis=1) ** 2
    return float(gain.var(ddof=1) / gain.mean() ** 2), float(found.std())


@pytest.mark.filterwarnings("ignore:waves")  # short bands on purpose
@pytest.mark.parametrize(
    ("name", "omega_max"),
    [("nothing_beyond", w) for w in ("4", "8", "16")]
    + [("with_tilts", w) for w in ("8", "16", "24")],
)
def test_scintillation_over_meshes(name, omega_max):
    expected, stderr = REFERENCE["mc_si_U5_fetch30km"][name][omega_max]
    sea = sea_up_to(float(omega_max), mss="band" if name == "nothing_beyond" else "elfouhaily")
    found, error = index(mt.ensemble(mt.Link(), SEAS, sea, photons=32, seed=2).gain_ballistic)
    # the height of the crests takes 2 % at 8 rad/s and a seventh at 4 rad/s
    heights = {"4": 0.14, "8": 0.02}.get(omega_max, 0.0) * expected
    assert z_test(found, math.hypot(error, stderr, heights), expected) > sidak(ALPHA, 6)


def test_distribution_of_resolved_seas():
    """Mean gain, and shares below the quantiles of 10 240 gains."""
    gain = mt.ensemble(mt.Link(), 400, sea_up_to(24.0), photons=32, seed=4).gain_ballistic
    mean = REFERENCE["mc_si_U5_fetch30km"]["mean_gain"]
    stderr = float(gain.std(ddof=1)) / math.sqrt(gain.size)
    assert z_test(float(gain.mean()), math.hypot(stderr, 0.01 * mean), mean) > ALPHA
    table = REFERENCE["distribution_tilts_U5_omega24"]
    quantiles = {float(p): q for p, q in table["quantiles_over_mean"].items()}
    relative = gain / gain.mean()
    for p, q in [*quantiles.items(), (table["p_below_half"], 0.5)]:
        share, low, high = ((relative < f * q).mean() for f in (1.0, 0.95, 1.05))
        stderr = math.hypot(math.sqrt(p * (1.0 - p) / gain.size), 0.5 * (high - low))
        assert z_test(float(share), stderr, p) > sidak(ALPHA, 6)


def test_convergence_of_a_gain_with_the_mesh():
    """Hard aperture, waves up to 24 rad/s: second order until k_max h = 0.9."""
    table = REFERENCE["mesh_convergence_omega24_hard_aperture"]
    spacing = table["spacing_m"]
    link = mt.Link(physics={"unresolved": "none"})
    forced = ForcedDetection(link, 64, 1, sea=TypicalSea(0.6))
    gains = []
    for seed in range(24):
        sea = sea_up_to(24.0, seed=seed)
        gains.append(
            [
                forced.planner.aim_over(
                    sea.mesh(extent=4.0, spacing=h, fine_extent=0.75, coarse_spacing=0.1)
                ).direct_gains(0, 0).sum()
                for h in spacing
            ]
        )  # fmt: skip
    finest, *coarser = np.array(gains).T
    errors = [np.sqrt(np.mean((g - finest) ** 2)) / finest.mean() for g in coarser]
    # interpolated normals: less than half of the published errors up to k_max h = 1.8
    assert (np.array(errors) < 1.3 * np.array(table["rms_relative_error"][1:])).all()
    order = math.log2(errors[1] / errors[0])
    assert order == pytest.approx(2.0, abs=0.5)


@pytest.mark.parametrize(("omega_max", "seas"), [("8", 8), ("16", 6)])
def test_choppy_seas_fade_as_published(omega_max, seas):
    """Ratio of the indices over a patch of receivers, with the same phases."""
    expected, stderr = REFERENCE["choppy"]["si_ratio_choppy_over_linear_U5_tilts"][omega_max]
    flat = mt.light_pattern(mt.Link(), FlatSea(), 4.0, 0.05).gain
    moments = np.empty((seas, 2, 2))
    for i, j in np.ndindex(seas, 2):
        sea = sea_up_to(float(omega_max), seed=i, choppy=bool(j))
        light = mt.light_pattern(mt.Link(), sea, 4.0, 0.05).gain / flat
        moments[i, j] = light.mean(), np.square(light).mean()

    def ratio(some):
        mean, square = np.moveaxis(some.mean(axis=0), -1, 0)
        linear, choppy = square / mean**2 - 1.0
        return choppy / linear

    left = np.array([ratio(np.delete(moments, i, axis=0)) for i in range(seas)])
    error = math.sqrt((seas - 1) * left.var())
    assert error < 0.05
    assert z_test(ratio(moments), math.hypot(error, stderr), expected) > sidak(ALPHA, 2)
