"""The plain tracer is the same physics: its gain agrees with the engine's."""

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak, z_test
from plain_loop import plain_loop
from plain_tracer import plain_gain, turn

import meshtrace as mt
from meshtrace.surfaces import FlatSea, JonswapSea

SEAS = [FlatSea(), JonswapSea(wind_speed=13.0, seed=7, waves="paper")]


@pytest.mark.parametrize("sea", SEAS, ids=["flat", "jonswap"])
@pytest.mark.slow
def test_gains_agree(sea):
    link = mt.Link(
        physics=mt.Physics(unresolved="none"),
        water=mt.Water(b=0.1),
        receiver=mt.Receiver(radius=1.0, position=(0.4, -0.2), tilt_deg=10.0),
    )
    mesh = sea.mesh(extent=40.0, spacing=0.5)
    gain, stderr, ledger = plain_gain(link, mesh, 200_000, seed=3)
    r = mt.simulate(link, mesh, estimator="analog", photons=1_000_000, seed=4)
    assert stderr / gain < 0.02
    assert sum(ledger.values()) == pytest.approx(1.0, abs=1e-12)
    assert ledger["landed"] == pytest.approx(r.fates["landed"].weight, rel=0.01)
    assert z_test(gain, stderr, r.gain, r.gain_stderr) > sidak(ALPHA, len(SEAS))


def test_turn_keeps_length_and_angle():
    rng = np.random.default_rng(1)
    d = rng.normal(size=(500, 3))
    d /= np.linalg.norm(d, axis=1)[:, None]
    d[0] = (0.0, 0.0, 1.0)
    cos_theta = rng.uniform(-1.0, 1.0, 500)
    out = turn(d, cos_theta, rng)
    np.testing.assert_allclose(np.linalg.norm(out, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(np.einsum("ij,ij->i", out, d), cos_theta, atol=1e-12)


@pytest.mark.thorough
def test_the_plain_loop_agrees():
    water = mt.Water(b=0.2, phase=mt.optics.HenyeyGreenstein(g=0.9))
    link = mt.Link(water=water, receiver=mt.Receiver(radius=2.0, fov_deg=150.0))
    gain, stderr, _ = plain_loop(link, 200_000, seed=1)
    r = mt.simulate(link, FlatSea(), estimator="analog", photons=200_000, seed=2)
    assert stderr / gain < 0.01
    assert z_test(gain, stderr, r.gain, r.gain_stderr) > ALPHA
