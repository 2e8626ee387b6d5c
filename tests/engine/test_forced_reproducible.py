"""Forced detection: bitwise equal for any threads, lists equal single runs, seeds repeat."""

import itertools

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.engine.forced import ForcedDetection, TypicalSea
from meshtrace.surfaces import FlatSea, JonswapSea

LINKS = {
    "default": mt.Link(),
    "everything": mt.Link(
        water=mt.Water(layers=((0.0, 0.1, 0.2), (12.0, 0.2, 0.05))),
        bubbles=mt.HallNovarini(wind_speed=13.0),
        transmitter=(mt.Led(), mt.GaussianBeam(depth=8.0, divergence_deg=5.0, power_mw=30.0)),
        receiver=(mt.Receiver(), mt.Receiver(position=(1.0, 0.0), tilt_deg=10.0, radius=0.3)),
        whitecaps=mt.Whitecaps(wind_speed=13.0),
    ),
    "paper": mt.Link(physics="paper"),
}


@pytest.fixture(scope="module")
def mesh():
    return JonswapSea(wind_speed=13.0, seed=4, waves="paper").mesh(extent=9.0, spacing=0.2)


@pytest.fixture(scope="module")
def banded():
    """Return a sea without waves beyond the band: its unscattered light is deterministic."""
    return JonswapSea(wind_speed=13.0, seed=4, mss="band", waves="paper").mesh(
        extent=9.0, spacing=0.2
    )


def run(link, mesh, **options):
    return mt.simulate(
        link,
        mesh,
        **{"photons": 2000, "seed": 77, "threads": 1, "record": [mt.Arrivals()], **options},
    )


def assert_equal(a, b):
    for name in ("gain", "gain_stderr", "gain_ballistic", "gain_scattered"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    assert a.chains == b.chains
    assert a.to_dataset().drop_attrs().identical(b.to_dataset().drop_attrs())


@pytest.mark.parametrize("name", LINKS)
@pytest.mark.parametrize("normals", ["vertex", "facet"])
def test_threads_do_not_matter(mesh, name, normals):
    one, two = (run(LINKS[name], mesh, normals=normals, threads=t) for t in (1, 2))
    assert np.all(np.asarray(one.gain) > 0.0)
    assert_equal(one, two)


def test_kept_arrivals_change_nothing(mesh):
    kept, plain = (run(mt.Link(), mesh, record=r) for r in ([mt.Arrivals()], []))
    assert kept.gain == plain.gain
    assert kept.gain_stderr == plain.gain_stderr
    assert kept.chains == plain.chains


def test_another_seed_differs_in_what_is_random(mesh, banded):
    """Unscattered light has no noise, even where slopes that the mesh leaves out tilt it."""
    for over in (banded, mesh):
        a, b = run(mt.Link(), over), run(mt.Link(), over, seed=78)
        assert a.gain_ballistic == b.gain_ballistic
        assert a.gain_scattered != b.gain_scattered


@pytest.mark.parametrize("seed", [0, 2**32, 2**63, 2**64 - 1])
def test_every_seed_may_be_used(mesh, seed):
    assert run(mt.Link(), mesh, seed=seed, photons=64).gain > 0.0


@pytest.mark.thorough
def test_receivers_in_a_list_are_those_alone(banded):
    """The first receiver sets the expected collisions: with it in front the chains are the same."""
    rows = [mt.Receiver(), mt.Receiver(position=(0.6, 0.1), radius=0.2), mt.Receiver(tilt_deg=20.0)]
    together = run(mt.Link(receiver=tuple(rows)), banded)
    for i, row in enumerate(rows):
        pair = run(mt.Link(receiver=(rows[0], row)), banded)
        # bins of facets depend on all receivers, and with them the last digits
        assert pair.gain[1] == pytest.approx(together.gain[i], rel=1e-9)
        assert pair.gain_stderr[1] == pytest.approx(together.gain_stderr[i], rel=1e-6)
        alone = run(mt.Link(receiver=row), banded)
        assert alone.gain_ballistic == pytest.approx(together.gain_ballistic[i], rel=1e-12)
        error = np.hypot(alone.gain_stderr, together.gain_stderr[i])
        assert abs(alone.gain - together.gain[i]) < 5.0 * error


def test_transmitters_in_a_list_share_the_power(banded):
    lamps = [mt.Led(power_mw=10.0), mt.Led(depth=6.0, position=(0.5, 0.0), power_mw=30.0)]
    both = run(mt.Link(transmitter=tuple(lamps)), banded, photons=8000)
    alone = [run(mt.Link(transmitter=lamp), banded, photons=8000) for lamp in lamps]
    ballistic = 0.25 * alone[0].gain_ballistic + 0.75 * alone[1].gain_ballistic
    assert both.gain_ballistic == pytest.approx(ballistic, rel=1e-12)
    gain = 0.25 * alone[0].gain + 0.75 * alone[1].gain
    error = np.hypot(both.gain_stderr, np.hypot(*(a.gain_stderr for a in alone)))
    assert abs(both.gain - gain) < 5.0 * error


def test_one_set_of_chains_serves_every_surface_in_any_order(mesh):
    forced = ForcedDetection(mt.Link(), 1000, 3, sea=TypicalSea(1.5))
    meshes = [mesh, FlatSea().mesh(extent=9.0, spacing=0.5), mesh]
    first = [forced.evaluate(m) for m in meshes]
    again = [forced.evaluate(m) for m in meshes[::-1]][::-1]
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a.scattered, b.scattered)
        np.testing.assert_array_equal(a.ballistic, b.ballistic)
        assert a.counts == b.counts
    np.testing.assert_array_equal(first[0].scattered, first[2].scattered)


def test_chain_counts_add_up(mesh):
    for normals, link in itertools.product(("vertex", "facet"), (mt.Link(),)):
        r = run(link, mesh, normals=normals)
        c = r.chains
        assert c.drawn >= 2000
        assert 0 <= c.no_flat < c.drawn
        assert c.solved <= c.drawn - c.no_flat + c.extra_roots
        parts = r.gain_ballistic + r.gain_scattered
        assert parts == pytest.approx(r.gain, rel=1e-12)
        assert r.gain_order.sum() == pytest.approx(r.gain_scattered, rel=1e-9)
