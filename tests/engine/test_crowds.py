"""Lists of many receivers, in which one of each neighbourhood stands for the others."""

import numpy as np
import pytest
from mc_statistics import ALPHA
from scipy.stats import chi2

import meshtrace as mt
from meshtrace.engine import forced
from meshtrace.engine.chains import aimed
from meshtrace.engine.forced import ForcedDetection
from meshtrace.engine.setup import ends
from meshtrace.surfaces import JonswapSea

SEA = JonswapSea(wind_speed=5.0, seed=7)


def crowd(n=10, half=2.0):
    """Return receivers on a square of n x n places."""
    x = np.linspace(-half, half, n).tolist()
    return [mt.Receiver(position=(a, b)) for a in x for b in x]


def stands_for(receivers):
    return ends.forced_link(mt.Link(receiver=tuple(receivers))).stands_for


def test_few_receivers_stand_for_themselves():
    np.testing.assert_array_equal(stands_for(crowd(8)), np.arange(64))


def test_receivers_stand_for_those_close_by_that_are_alike():
    rows = crowd()
    rows = [r.replace(fov_deg=100.0) if i % 7 == 0 else r for i, r in enumerate(rows)]
    first = stands_for(rows)
    assert 10 < len(set(first.tolist())) < 60
    for r, i in zip(rows, first.tolist(), strict=True):
        assert first[i] == i
        assert r.fov_deg == rows[i].fov_deg
        assert np.abs(np.subtract(r.position, rows[i].position)).max() <= 0.06 * 15.0


def test_representatives_do_not_depend_on_the_order():
    rows = [*crowd(9), *crowd(4, 1.0)]  # places that are met twice, too
    order = np.random.default_rng(1).permutation(len(rows))
    first, again = stands_for(rows), stands_for([rows[i] for i in order])
    place = [rows[i].position for i in first]
    assert [rows[order[i]].position for i in again[np.argsort(order)]] == place


@pytest.mark.thorough
def test_the_order_of_many_receivers_changes_nothing():
    """Bit for bit, with receivers of two kinds, on chains and on photons, on 1 and 2 threads."""
    rows = crowd(9)
    rows = [r.replace(tilt_deg=60.0) if i % 9 == 0 else r for i, r in enumerate(rows)]
    order = np.random.default_rng(2).permutation(len(rows))
    mesh = SEA.mesh(extent=30.0, spacing=0.5)
    found = []
    for some, threads in ((np.arange(len(rows)), 1), (order, 2)):
        link = mt.Link(receiver=tuple(rows[i] for i in some))
        sea = forced.TypicalSea.of_meshes([mesh])
        parts = ForcedDetection(link, 512, 1, threads=threads, sea=sea).evaluate(mesh)
        assert {"chains", "joined"} == set(parts.method)
        back = np.argsort(some)
        samples = np.array([row[1:] for row in parts.samples_of(1)])
        found.append([values[back] for values in (parts.shifts, parts.orders, samples)])
    for value, first in zip(*found, strict=True):
        np.testing.assert_array_equal(value, first)


@pytest.mark.thorough
def test_many_receivers_have_the_gains_of_each_alone():
    """Those farthest from the ones that stand for them, of other seeds: chi-square."""
    rows = crowd()
    first = stands_for(rows)
    away = [
        np.hypot(*np.subtract(r.position, rows[i].position))
        for r, i in zip(rows, first, strict=True)
    ]
    some = np.argsort(away)[-8:]
    together = mt.simulate(mt.Link(receiver=tuple(rows)), SEA, photons=16_384, seed=1)
    alone = mt.simulate(mt.Link(receiver=tuple(rows[i] for i in some)), SEA, photons=16_384, seed=2)
    error = np.hypot(together.stderrs[some], alone.stderrs)
    z = (together.gains[some] - alone.gains) / error
    assert (error < 0.005 * alone.gains).all()
    assert chi2.sf(z @ z, len(z)) > ALPHA


@pytest.mark.slow
def test_errors_of_many_receivers_are_true():
    """Scatter over 64 seeds of receivers at the edge of the list, and in its middle."""
    rows, some = crowd(), [0, 9, 45, 55, 99]
    link, seeds = mt.Link(receiver=tuple(rows)), 64
    mesh = SEA.mesh(extent=25.0, spacing=0.25)
    parts = [
        ForcedDetection(link, 512, seed, sea=forced.TypicalSea.of_meshes([mesh])).evaluate(mesh)
        for seed in range(seeds)
    ]
    gain, error = (np.array([getattr(p, k)[some] for p in parts]) for k in ("gain", "stderr"))
    z = (gain - gain.mean(axis=0)) / np.sqrt(np.square(error).mean(axis=0))
    total = np.square(z).sum(axis=0)
    p = 2.0 * np.minimum(chi2.sf(total, seeds - 1), chi2.cdf(total, seeds - 1))
    assert (p > ALPHA / len(some)).all()


def test_blocks_of_facets_leave_out_no_light():
    """Bit for bit the light of all facets, which few receivers have."""
    rows, mesh = crowd(4, 4.0), SEA.mesh(extent=12.0, spacing=0.25)
    for some in (rows, [r.replace(tilt_deg=20.0, height=2.0) for r in rows]):
        many = aimed.AimedChains(
            ends.forced_link(mt.Link(receiver=tuple(some))), mesh, unresolved="tilt"
        )
        for i in (0, 5, 15):
            one = aimed.AimedChains(
                ends.forced_link(mt.Link(receiver=some[i])), mesh, unresolved="tilt"
            )
            assert many.blurred
            np.testing.assert_array_equal(many.direct_gains(0, i), one.direct_gains(0, 0))
