"""Coverage maps whose scattered light is that of chains: against photons, and the scatter of seeds.

Cells of a tile have their chains in common, so that their errors are correlated; tiles have chains
of their own.
"""

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak, z_test
from scipy import stats

import meshtrace as mt
from meshtrace.engine import cell_chains
from meshtrace.engine.photons import analog
from meshtrace.engine.setup import meshing
from meshtrace.stored import SHIFTS
from meshtrace.studies import coverage as room
from meshtrace.surfaces import JonswapSea

SEA = JonswapSea(wind_speed=13.0, seed=7)
LAYERS = ((0.0, 0.05, 0.1), (4.0, 0.1, 0.02), (12.0, 0.1, 0.02))
LINKS = {
    "default": mt.Link(),
    "two lamps": mt.Link(
        transmitter=(
            mt.Led(position=(1.0, 0.5)),
            mt.Led(position=(-2.0, -1.0), depth=6.0, power_mw=2000.0),
        )
    ),
    "layers": mt.Link(water=mt.Water(layers=LAYERS)),
    "bubbles": mt.Link(bubbles=mt.HallNovarini(wind_speed=10.0)),
    "no return": mt.Link(physics=mt.Physics(reflected="kill")),
}
HALF, STEP = 2.0, 0.25


def chains_of(link, seed=1, step=STEP, extent=HALF, **options):
    mesh, _ = meshing.mesh_for(link, SEA, reach=np.inf)
    grid = mt.IrradianceMap(height=link.receivers[0].height, extent=extent, step=step)
    return cell_chains.CellChains(link, [mesh], grid, seed, **options)


@pytest.mark.thorough
@pytest.mark.slow_but("two lamps")  # the default link is in the map below
@pytest.mark.parametrize("name", LINKS)
def test_tiles_have_the_scattered_light_of_photons(name):
    """Chi-square over the tiles; cells of a tile are added up with errors that add, too."""
    link = LINKS[name]
    mesh, _ = meshing.mesh_for(link, SEA, reach=np.inf)
    grid = mt.IrradianceMap(height=5.0, extent=HALF, step=STEP)
    chains = chains_of(link)
    found = analog.run_analog(
        link,
        mt.EmbreeIntersector(mesh, 1),
        photons=6_000_000,
        seed=2,
        unscattered=False,
        record=[grid],
    )
    scale = np.pi * link.receivers[0].radius ** 2 / STEP**2
    gain, error = (scale * values[:, :, 0] for values in found.map_mean())
    z = []
    for k, tile in enumerate(chains.tiles):
        light = chains.sums(0, k, 2048, 0).gain.sum(axis=1)
        square = light.var(ddof=1) / SHIFTS + np.square(error[tile]).sum()
        z.append((light.mean() - gain[tile].sum()) / np.sqrt(square))
    assert stats.chi2.sf(np.sum(np.square(z)), len(z)) > sidak(ALPHA, 2 * len(LINKS))
    mean = np.sum(z) / np.sqrt(len(z))  # of independent tiles
    assert 2.0 * stats.norm.sf(abs(mean)) > sidak(ALPHA, 2 * len(LINKS))


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning")
def test_a_map_by_chains_is_that_by_photons():
    """One cell of each tile, and the sum of the map, at the significance of the other maps."""
    options = {"extent": 4.0, "step": STEP, "threads": 1}
    chains = mt.coverage_map(mt.Link(), SEA, rtol=0.01, seed=1, **options)
    photons = mt.coverage_map(mt.Link(), SEA, photons=8_000_000, seed=2, **options)
    assert chains.provenance["scattered"] == "chains"
    assert (room.relative_errors(chains.gain, chains.gain_stderr) <= 0.01).all()
    z = (chains.gain - photons.gain) / np.hypot(chains.gain_stderr, photons.gain_stderr)
    one = z[1::3, 1::3]
    assert stats.chi2.sf(np.sum(one**2), one.size) > sidak(ALPHA, 2)
    # nine cells of a tile with one error at most
    error = np.hypot(3.0 * np.linalg.norm(chains.gain_stderr), np.linalg.norm(photons.gain_stderr))
    assert z_test(chains.gain.sum(), error, photons.gain.sum()) > sidak(ALPHA, 2)


@pytest.mark.thorough
@pytest.mark.parametrize("place", ["corner", "middle"])
def test_errors_of_chains_are_true(place):
    """Scatter of the cells of a tile over 48 seeds by their root mean square errors."""
    tiles, seeds = None, range(48)
    gains, errors = [], []
    for seed in seeds:
        chains = chains_of(mt.Link(), seed, extent=4.5, stride=5)
        tiles = tiles or chains.pilots
        chains.pilots = tiles  # the same numbers of chains of all orders
        number = 0 if place == "corner" else len(chains.tiles) // 2
        found = chains.sums(0, number, 1024, 0)
        gains.append(found.mean)
        errors.append(found.stderr)
    ratio = np.var(gains, axis=0, ddof=1) / np.mean(np.square(errors), axis=0)
    # chi-square of 47 degrees over the variance of the mean of 48 errors of 31 degrees
    p = stats.f.sf(ratio, len(seeds) - 1, len(seeds) * (SHIFTS - 1))
    assert np.minimum(p, 1.0 - p).min() > sidak(ALPHA, 2 * ratio.size) / 2.0


def test_results_depend_on_no_thread_and_no_round():
    one, two = (
        mt.coverage_map(mt.Link(), SEA, 2.0, 0.1, rtol=0.02, seed=3, threads=n, photons=2**15)
        for n in (1, 2)
    )
    assert one.provenance["scattered"] == "chains"
    np.testing.assert_array_equal(one.gain, two.gain)
    np.testing.assert_array_equal(one.gain_stderr, two.gain_stderr)


@pytest.mark.thorough
def test_a_store_keeps_the_chains_of_tiles(tmp_path):
    options = {"extent": 2.0, "step": 0.1, "seed": 3, "threads": 1, "photons": 2**15}
    store = tmp_path / "map.store"
    mt.coverage_map(mt.Link(), SEA, rtol=0.02, store=store, **options)
    calls, sums = [], cell_chains.CellChains.sums

    def counted(self, *inputs):
        calls.append(inputs)
        return sums(self, *inputs)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cell_chains.CellChains, "sums", counted)
        kept = mt.coverage_map(mt.Link(), SEA, rtol=0.01, store=store, **options)
    fresh = mt.coverage_map(mt.Link(), SEA, rtol=0.01, **options)
    np.testing.assert_array_equal(kept.gain, fresh.gain)
    # of all tiles the first chains are kept: a probe of a few comes before them
    assert sum(first == 0 for _, _, _, first in calls) < len(chains_of(mt.Link(), step=0.1).tiles)


@pytest.mark.parametrize(
    "link",
    [
        mt.Link(water=mt.Water(a=0.1, b=1.0)),
        mt.Link(water=mt.Water(a=0.1, b=0.0)),
        mt.Link(physics=mt.Physics(unresolved="none")),
    ],
    ids=["turbid", "no scattering", "smooth facets"],
)
def test_photons_follow_what_chains_do_not(link):
    assert chains_of(mt.Link()).serves
    assert not chains_of(link).serves


@pytest.mark.parametrize("reflected", ["trace", "kill"])
def test_light_that_is_reflected_first_counts(reflected):
    """It is 10 % of the gain here, 1.3e-4 as photons tell."""
    link = mt.Link(
        transmitter=mt.Led(depth=3.0),
        water=mt.Water(a=0.1, b=0.5, phase=mt.HenyeyGreenstein(g=0.0)),
        receiver=mt.Receiver(fov_deg=170.0),
        physics=mt.Physics(reflected=reflected),
    )
    chains = chains_of(link, extent=0.5)
    assert chains.omits(np.full((4, 4), 1.3e-4)) == (reflected == "trace")


def test_chains_that_miss_light_are_not_trusted():
    """A third of the light of a region, which photons show."""
    chains = chains_of(mt.Link(), extent=1.0)
    found = [chains.sums(0, k, cell_chains.FIRST, 0) for k in range(len(chains.tiles))]
    gain, stderr = chains.scattered(found)
    assert chains.agree(found, gain, stderr)
    gain[: len(gain) // chains.n] *= 1.5
    assert not chains.agree(found, gain, stderr)


def test_tiles_cover_every_cell_once():
    for step, extent in ((0.1, 1.7), (0.35, 2.0), (3.0, 4.0)):
        chains, n = chains_of(mt.Link(), step=step, extent=extent), 0
        cells = np.zeros((chains.cells, chains.cells), int)
        for tile in chains.tiles:
            cells[tile] += 1
            n += cells[tile].size
        assert (cells == 1).all()
        assert n == cells.size
        assert chains.n**2 == len(chains.tiles)


def test_sums_of_two_sets_weigh_by_their_chains():
    rng = np.random.default_rng(1)
    one, two = (cell_chains.TileSums(n, rng.random((SHIFTS, 3)), rng.random(3)) for n in (100, 300))
    both = one + two
    assert both.chains == 400
    np.testing.assert_allclose(both.mean, 0.25 * one.mean + 0.75 * two.mean)
    np.testing.assert_allclose(both.square, one.square / 16.0 + two.square * 9.0 / 16.0)
    back = cell_chains.TileSums.of_row(both.to_row())
    np.testing.assert_array_equal(back.gain, both.gain)
    np.testing.assert_array_equal(back.square, both.square)
    assert cell_chains.further([one, two], np.array([0.9, 3.0])) == {1: 780}
