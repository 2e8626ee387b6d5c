"""Chains that are drawn block by block are those that are kept, for any number of blocks."""

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.engine.chains import sets
from meshtrace.engine.forced import ForcedDetection
from meshtrace.stored import SHIFTS
from meshtrace.surfaces import FlatSea, JonswapSea

TWO = (mt.Receiver(position=(0.2, 0.0), radius=0.5), mt.Receiver(position=(1.0, 0.5)))
ROUGH = JonswapSea(wind_speed=5.0, seed=3, waves="paper")


def parts_of(sea, threads=1):
    link = mt.Link(receiver=TWO, water=mt.Water(b=0.1))
    mesh = sea.mesh(extent=30.0, spacing=2.0)
    forced = ForcedDetection(link, 16 * SHIFTS, seed=5, threads=threads, scattered="chains")
    (gains,) = forced.at_wavelengths(mesh, record=True)
    return gains, gains.table[0]


@pytest.mark.parametrize("sea", [FlatSea(), ROUGH], ids=["flat", "rough"])
@pytest.mark.parametrize("largest", [8192, 5])  # whole shifts, parts of one
@pytest.mark.thorough_but("5-flat", "8192-flat")
def test_kept_and_drawn_chains_are_the_same(sea, largest, monkeypatch):
    kept, light = parts_of(sea)
    monkeypatch.setattr(sets, "_CHAIN_BYTES", 0)
    monkeypatch.setattr(sets, "_LARGEST", largest)
    for threads in (1, 2):
        drawn, arrivals = parts_of(sea, threads)
        assert drawn.counts == kept.counts
        for one, other in zip(drawn.samples_of(1), kept.samples_of(1), strict=True):
            assert (one.samples, one.scored) == (other.samples, other.scored)
            assert one.effective == pytest.approx(other.effective, rel=1e-12)
        np.testing.assert_allclose(drawn.scattered, kept.scattered, rtol=1e-14)
        np.testing.assert_allclose(drawn.direct, kept.direct, rtol=1e-14)
        np.testing.assert_array_equal(np.sort(arrivals.weight), np.sort(light.weight))
        np.testing.assert_array_equal(
            np.bincount(arrivals.group[arrivals.group >= 0]),
            np.bincount(light.group[light.group >= 0]),
        )
    if largest > 16:
        np.testing.assert_array_equal(drawn.scattered, kept.scattered)


def test_many_chains_are_not_kept():
    link = mt.Link()
    many = ForcedDetection(link, 2**18, seed=1, scattered="chains").scattered_sets
    assert all(chains is None for row in many for _, chains in row)
    few = ForcedDetection(link, 2**10, seed=1, scattered="chains").scattered_sets
    assert all(chains is not None for row in few for _, chains in row)


def test_blocks_hold_each_chain_once():
    for per_shift in (2, 100, 1500, 20_000):
        request = sets.Request(0, 1, per_shift, ())
        rows = np.concatenate([np.r_[rows] for rows in request.spans()])
        np.testing.assert_array_equal(rows, np.arange(request.number))
