"""Bitwise equal results for any threads, batches and recorders; photons own their numbers."""

import itertools

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.engine.photons import analog
from meshtrace.surfaces import JonswapSea

pytestmark = pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning")

PHOTONS = 30_011  # no multiple of anything
LINKS = {
    "default": mt.Link(receiver=mt.Receiver(radius=1.0)),
    "everything": mt.Link(
        water=mt.Water(
            a=0.08, b=0.3, phase=mt.HenyeyGreenstein(g=0.8), bottom_depth=7.0, bottom_albedo=0.4
        ),
        bubbles=mt.HallNovarini(wind_speed=13.0),
        transmitter=(mt.Led(depth=5.0, half_angle_deg=30.0), mt.UniformSky(half_width=4.0)),
        receiver=(mt.Receiver(radius=1.0), mt.WaterAperture(depth=3.0, radius=2.0)),
        whitecaps=mt.Whitecaps(wind_speed=13.0),
        planes=mt.IrradiancePlanes(depths=(2.0, 4.0), n_cosines=6, n_azimuths=4),
    ),
    "paper": mt.Link(
        transmitter=mt.Led(depth=5.0), receiver=mt.Receiver(radius=1.0), physics="paper"
    ),
}


@pytest.fixture(scope="module")
def mesh():
    return JonswapSea(wind_speed=13.0, seed=4, waves="paper").mesh(extent=20.0, spacing=0.4)


def simulate(link, mesh, **options):
    options = {"photons": PHOTONS, "seed": 77, "threads": 1, **options}
    return mt.simulate(
        link,
        mesh,
        estimator="analog",
        record=[mt.IrradianceMap(height=5.0, extent=3.0, step=0.5), mt.Arrivals()],
        **options,
    )


def assert_equal(a, b):
    """Every number of two results, bit for bit."""
    np.testing.assert_array_equal(a.gain, b.gain)
    np.testing.assert_array_equal(a.gain_stderr, b.gain_stderr)
    assert a.fates == b.fates
    assert (a.rays_recast, a.rays_lost) == (b.rays_recast, b.rays_lost)
    assert a.to_dataset().drop_attrs().identical(b.to_dataset().drop_attrs())


@pytest.fixture(scope="module")
def reference(mesh):
    return {name: simulate(link, mesh) for name, link in LINKS.items()}


@pytest.mark.parametrize("name", LINKS)
@pytest.mark.parametrize(
    "options",
    [
        {"threads": 2},
        {"threads": 3, "batch_size": 4096},
        {"batch_size": 4096},
        {"batch_size": 8192, "threads": 2},
        {"batch_size": 65536},
        {"batch_size": 2**18, "threads": 5},
    ],
    ids=str,
)
def test_threads_and_batches_do_not_matter(mesh, reference, name, options):
    assert np.all(np.asarray(reference[name].gain) > 0.0)
    assert_equal(simulate(LINKS[name], mesh, **options), reference[name])


@pytest.mark.parametrize("name", LINKS)
def test_same_again(mesh, reference, name):
    assert_equal(simulate(LINKS[name], mesh), reference[name])


@pytest.mark.parametrize("name", LINKS)
def test_another_seed_differs(mesh, reference, name):
    other = simulate(LINKS[name], mesh, seed=78)
    assert np.all(np.asarray(other.gain) != np.asarray(reference[name].gain))


@pytest.mark.parametrize("seed", [0, 2**32, 2**63 - 1, 2**63, 2**64 - 1])
def test_every_seed_of_64_bits_may_be_used(mesh, seed):
    r = simulate(LINKS["default"], mesh, seed=seed, photons=4096)
    assert r.photons == 4096
    assert r.provenance["run"]["seed"] == seed


def test_both_halves_of_the_seed_and_of_the_photon_id_count(mesh):
    gains = {
        simulate(LINKS["default"], mesh, photons=8192, seed=seed, first_photon=first).gain
        for seed, first in itertools.product((1, 1 + 2**32), (0, 2**32))
    }
    assert len(gains) == 4


@pytest.fixture(scope="module")
def intersector(mesh):
    return mt.EmbreeIntersector(mesh, 1)


@pytest.mark.parametrize("name", LINKS)
def test_recording_paths_changes_nothing(intersector, name):
    link = LINKS[name]
    plain = analog.run_analog(link, intersector, photons=9000, seed=5, record=[mt.Arrivals()])
    recorder = analog.new_recorder(500, 40)
    watched = analog.run_analog(
        link, intersector, photons=9000, seed=5, record=[mt.Arrivals()], recorder=recorder
    )
    assert recorder.length.min() >= 2
    for field in ("photons", "score", "score_squared", "count", "misses"):
        np.testing.assert_array_equal(getattr(plain, field), getattr(watched, field))
    np.testing.assert_array_equal(plain.ledger.value(), watched.ledger.value())
    np.testing.assert_array_equal(plain.arrivals[0], watched.arrivals[0])


@pytest.mark.parametrize("name", LINKS)
def test_recorded_paths_do_not_depend_on_batches(intersector, name):
    recorders = [analog.new_recorder(1000, 60) for _ in range(2)]
    for recorder, batch in zip(recorders, (4096, 65536), strict=True):
        analog.run_analog(
            LINKS[name],
            intersector,
            photons=9000,
            seed=6,
            threads=2,
            options=mt.Analog(batch_size=batch),
            recorder=recorder,
        )
    for a, b in zip(*recorders, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("name", LINKS)
def test_a_photon_alone_is_the_photon_in_the_run(intersector, name):
    """Alone its slot, its neighbours and its ray batches are others; its fate is the same."""
    link, first, n = LINKS[name], 10_000, 48
    ledger = analog.FixedPointSum((len(mt.Fate),))
    score = np.zeros(0)
    for photon in range(first, first + n):
        one = analog.run_analog(
            link, intersector, options=mt.Analog(first_photon=photon), photons=1, seed=8
        )
        score = np.vstack([score, one.score]) if score.size else one.score[None]
        assert one.count.sum() == 1
        ledger.add(np.round(one.ledger.value() * 2.0**44).astype(np.int64))
    whole = analog.run_analog(
        link, intersector, options=mt.Analog(first_photon=first), photons=n, seed=8
    )
    np.testing.assert_array_equal(score.sum(axis=0), whole.score)
    np.testing.assert_array_equal(ledger.value(), whole.ledger.value())
    # and in the middle of a long run: the arrivals carry the ids
    long = analog.run_analog(link, intersector, photons=30_000, seed=8, record=[mt.Arrivals()])
    rows = np.concatenate(long.arrivals)
    here = rows[(rows["photon"] >= first) & (rows["photon"] < first + n)]
    inside = np.zeros(score.shape)
    np.add.at(inside, (here["photon"] - first, here["receiver"]), here["weight"])
    receivers = len(link.receivers)
    np.testing.assert_array_equal(inside[:, :receivers], score[:, :receivers])


def test_tallies_of_disjoint_photons_add(intersector):
    """Those of all photons are the sum of those of their parts, also from rows of numbers."""
    link = mt.Link(planes=mt.IrradiancePlanes(depths=(1.0, 3.0), n_cosines=4))
    record = [mt.Arrivals(), mt.IrradianceMap(height=5.0, extent=2.0, step=1.0)]

    def tallies(first, photons):
        options = mt.Analog(first_photon=first)
        return analog.run_analog(link, intersector, options, photons=photons, seed=9, record=record)

    whole, parts = tallies(0, 8192), [tallies(0, 4096), tallies(4096, 4096)]
    rows = [parts[0].of_row(one.to_row()) for one in parts]
    for one, other in (parts, rows):
        both = one + other
        assert both.photons == 8192
        for name in ("ledger", "map", "map_squared", "radiance"):
            value = getattr(whole, name).value()
            assert value.any()
            np.testing.assert_array_equal(getattr(both, name).value(), value)
        for name in ("score", "score_squared", "count", "misses"):
            np.testing.assert_array_equal(getattr(both, name), getattr(whole, name))
    both = parts[0] + parts[1]
    np.testing.assert_array_equal(np.concatenate(both.arrivals), np.concatenate(whole.arrivals))


def merged_parts(link, mesh, cuts):
    """Return runs of disjoint photon ids, merged in the wrong order."""
    parts = [
        simulate(link, mesh, photons=b - a, first_photon=a)
        for a, b in itertools.pairwise((0, *cuts, PHOTONS))
    ]
    return mt.merge(parts[::-1])


@pytest.mark.parametrize("cuts", [(8192,), (1000, 4097, 20_000)], ids=str)
@pytest.mark.parametrize("name", LINKS)
def test_merged_runs_of_disjoint_photons_are_the_run(mesh, reference, name, cuts):
    merged, whole = merged_parts(LINKS[name], mesh, cuts), reference[name]
    assert merged.photons == PHOTONS
    np.testing.assert_allclose(merged.gain, whole.gain, rtol=1e-12)
    np.testing.assert_allclose(merged.gain_stderr, whole.gain_stderr, rtol=1e-12)
    for fate, tally in whole.fates.items():
        assert merged.fates[fate].photons == tally.photons
        assert merged.fates[fate].weight == pytest.approx(tally.weight, rel=1e-12, abs=1e-15)
    assert (merged.rays_recast, merged.rays_lost) == (whole.rays_recast, whole.rays_lost)


@pytest.mark.parametrize("name", LINKS)
def test_merged_tallies_are_those_of_the_run(mesh, reference, name):
    """Irradiances, map and arrivals, and their standard errors, as those of the gain."""
    merged, whole = merged_parts(LINKS[name], mesh, (1000, 20_000)), reference[name]
    merged, whole = (r.to_dataset() for r in (merged, whole))
    assert merged.variables.keys() == whole.variables.keys()
    different = [
        name
        for name, expected in whole.variables.items()
        # the error of the radiance comes from 32 groups, which the runs divide otherwise
        if name != "radiance_stderr"
        and not np.allclose(merged[name], expected, rtol=1e-10, atol=1e-15, equal_nan=True)
    ]
    assert different == []


@pytest.mark.parametrize("name", ["default", "everything"])
def test_a_run_of_one_photon_may_be_merged(mesh, reference, name):
    """One photon has no standard error of its own, but a square that counts."""
    merged, whole = merged_parts(LINKS[name], mesh, (1,)), reference[name]
    np.testing.assert_allclose(merged.gain, whole.gain, rtol=1e-12)
    np.testing.assert_allclose(merged.gain_stderr, whole.gain_stderr, rtol=1e-12)


def test_normals_and_intersector_leave_the_streams_alone(mesh):
    """Common random numbers: the first path of every photon is the same for both normals."""
    recorders = [analog.new_recorder(200, 3) for _ in range(2)]
    for recorder, normals in zip(recorders, ("vertex", "facet"), strict=True):
        analog.run_analog(
            LINKS["default"],
            mt.EmbreeIntersector(mesh, 1),
            photons=200,
            seed=9,
            normals=normals,
            recorder=recorder,
        )
    np.testing.assert_array_equal(recorders[0].vertex[:, :2], recorders[1].vertex[:, :2])


def test_arrivals_are_complete_however_often_light_passes():
    """In turbid water a photon crosses a wide disk many times; none of it may be dropped."""
    water = mt.Water(a=1e-4, b=20.0, phase=mt.HenyeyGreenstein(g=0.0), bottom_depth=5.0)
    link = mt.Link(
        water=water,
        transmitter=mt.Led(depth=1.0),
        receiver=mt.WaterAperture(depth=0.9, radius=50.0),
    )
    mesh = JonswapSea(wind_speed=5.0, seed=1, waves="paper").mesh(extent=20.0, spacing=2.0)
    r = mt.simulate(
        link, mesh, estimator="analog", photons=4096, record=[mt.Arrivals()], max_events=1000
    )
    assert r.arrivals.weight.sum() == pytest.approx(r.gain, rel=1e-12)
