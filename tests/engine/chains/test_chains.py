"""Scattering chains: densities, weights and scatterers against closed forms and quadrature."""

import itertools
import math

import numpy as np
import pytest
from mc_statistics import ALPHA, chi2_test, sidak, z_test
from scipy import integrate, stats

import meshtrace as mt
from meshtrace.engine import crossing
from meshtrace.engine.chains import gain, sets
from meshtrace.engine.chains import sampling as kernel
from meshtrace.engine.setup import arrays
from meshtrace.engine.setup.ends import emitter_of, forced_link, target_of
from meshtrace.kernels import jit, vectors
from meshtrace.kernels.medium import absorption_path, scattering_path
from meshtrace.kernels.vectors import row
from meshtrace.stored import SHIFTS
from meshtrace.surfaces import FlatSea, JonswapSea

N = 200_000


def make(link, order, n=N, seed=1, crest=0.0, free=None):
    """Return nominal, chains and their components; `free`: all free paths, or all unstretched."""
    medium = arrays.medium_arrays(link, crest=5.0)
    nominal = sets.nominal(medium, emitter_of(link.transmitter), [target_of(link.receiver)], crest)
    rng = np.random.default_rng([seed, order])
    u = rng.random((n, 3 * order + 4))
    if free is None:
        component = np.searchsorted(np.cumsum(nominal.mixture)[:-1], rng.random(n))
    else:
        component = np.full(n, 0 if free else 1)
    out = kernel.Chains.zeros(n, order)
    kernel.make_chains(out, nominal, medium, u, component)
    return nominal, out, component


def steps(chains):
    """Return the lengths between the vertices, the first from the source."""
    origin = np.zeros((len(chains.last), 1, 3))
    return np.linalg.norm(np.diff(np.concatenate([origin, chains.vertex], axis=1), axis=1), axis=2)


@pytest.mark.parametrize("order", [1, 2, 5])
def test_path_is_the_sum_of_the_steps(order):
    _, chains, _ = make(mt.Link(), order, n=2000)
    np.testing.assert_allclose(steps(chains).sum(axis=1), chains.path, rtol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(chains.last, axis=1), 1.0, rtol=1e-14)
    assert (chains.vertex[:, 0, :2] == 0.0).all()
    np.testing.assert_array_equal(chains.tail, chains.vertex[:, -1])


def test_a_chain_without_scatterings_starts_at_the_source():
    _, chains, _ = make(mt.Link(), 0, n=2000)
    assert (chains.tail == 0.0).all()
    assert (chains.last == (0.0, 0.0, 1.0)).all()
    assert (chains.weight == 1.0).all()
    assert (chains.path == 0.0).all()


def test_tilts_are_two_standard_normal_numbers():
    _, chains, _ = make(mt.Link(), 1)
    edges = np.append(np.linspace(-3.0, 3.0, 31), np.inf)
    law = np.diff(stats.norm.cdf(np.append(-np.inf, edges)))
    for column in chains.tilt.T:
        counts = np.histogram(column, np.append(-np.inf, edges))[0]
        assert chi2_test(counts, law) > sidak(ALPHA, 3)
    correlation = (chains.tilt[:, 0] * chains.tilt[:, 1]).mean() * math.sqrt(N)
    assert 2.0 * stats.norm.sf(abs(correlation)) > sidak(ALPHA, 3)


@pytest.mark.parametrize("turbid", [False, True], ids=["clear", "turbid"])
@pytest.mark.parametrize("order", [1, 2, 3, 6])
def test_orders_have_poisson_probabilities(order, turbid):
    """E[weight b^K exp(-c s); s < L] = (b/c)^K P(Gamma(K) < c L), below and above the depth."""
    water = mt.Water(a=0.05, b=0.6 if turbid else 0.3)
    nominal, chains, component = make(mt.Link(water=water), order)
    assert (nominal.mixture[-1] > 0.0) == turbid
    assert (component == len(nominal.mixture) - 1).any() == turbid
    for length in (4.0, 10.0, 25.0):
        w = np.where(
            chains.path < length, chains.weight * water.b**order * np.exp(-water.c * chains.path), 0
        )
        expected = water.albedo**order * stats.gamma.cdf(water.c * length, order)
        p = z_test(w.mean(), w.std() / math.sqrt(N), expected)
        assert p > sidak(ALPHA, 24), (length, w.mean() / expected)


def test_probability_of_no_more_than_so_many_scatterings():
    """Conservative water: P(K scatterings before L) = (bL)^K exp(-bL) / K!."""
    b, length = 0.15, 9.0
    for order in range(1, 5):
        _, chains, _ = make(mt.Link(water=mt.Water(a=0.0, b=b)), order)
        w = np.where(chains.path < length, chains.weight * b**order * math.exp(-b * length), 0.0)
        expected = stats.poisson.pmf(order, b * length)
        assert z_test(w.mean(), w.std() / math.sqrt(N), expected) > sidak(ALPHA, 4)


@pytest.mark.parametrize("order", [1, 2, 4])
def test_weight_is_one_over_the_mixture_density(order):
    nominal, chains, component = make(mt.Link(), order, n=5000)
    d, c = nominal.distance, nominal.c
    assert c == pytest.approx(0.151)
    assert d == pytest.approx(10.0)
    s = chains.path
    density = nominal.mixture[0] * c**order * np.exp(-c * s)
    for share, stretch in zip(nominal.mixture[1:-1], nominal.stretch, strict=True):
        length = stretch * d
        density += np.where(s < length, share * math.factorial(order) / length**order, 0.0)
    np.testing.assert_allclose(chains.weight, 1.0 / density, rtol=1e-9)
    counts = np.bincount(component, minlength=len(nominal.mixture))
    assert chi2_test(counts, nominal.mixture) > ALPHA


def test_fitted_chains_end_on_spheres_about_the_source():
    """The open segments of fitted chains meet a sphere behind a free path."""
    nominal, chains, component = make(mt.Link(water=mt.Water(a=0.1, b=1.0)), 8, n=20_000)
    fitted = component == len(nominal.mixture) - 1
    q, v = chains.tail[fitted], chains.last[fitted]
    qv, square = (q * v).sum(axis=1), (q * q).sum(axis=1)
    radii = nominal.distance * nominal.stretch[1:, None]
    root = np.sqrt(np.maximum(qv**2 - square + radii**2, 0.0))
    ways = np.concatenate([root - qv, -root - qv])
    # of a segment with many chances one is the free path: the law holds on average
    share = np.exp(-nominal.c * ways) * (ways > 0.0)
    assert (share.sum(axis=0) > 0.0).all()
    near = np.where(ways > 0.0, ways, np.inf).min(axis=0)
    assert np.mean(near) < 1.0 / nominal.c


def test_no_chain_of_the_length_of_a_slanted_way_is_heavy():
    """Ways that are longer than the vertical one once had the density of free paths alone."""
    shallow = mt.Link(
        transmitter=mt.Led(depth=0.3, half_angle_deg=60.0), receiver=mt.Receiver(fov_deg=179.0)
    )
    for order in (1, 2):
        nominal, chains, _ = make(shallow, order)
        near = chains.path < 1.3 * nominal.distance
        typical = np.median(chains.weight[near])
        assert chains.weight[near].max() < 20.0 * typical


def test_free_paths_are_exponential_and_sorted_ones_uniform():
    alpha = sidak(ALPHA, 3)
    nominal, free, _ = make(mt.Link(), 2, free=True)
    s = steps(free)
    edges = np.append(stats.expon.ppf(np.linspace(0, 1, 51)[:-1], scale=1 / nominal.c), np.inf)
    for column in s.T:
        counts = np.histogram(column, np.where(np.isinf(edges), 1e9, edges))[0]
        assert chi2_test(counts, np.full(50, 0.02)) > alpha
    _, sorted_, _ = make(mt.Link(), 3, free=False)
    at = np.cumsum(steps(sorted_), axis=1)
    middle = stats.beta.cdf(at[:, 1] / nominal.distance, 2, 2)
    assert chi2_test(np.histogram(middle, 50, (0, 1))[0], np.full(50, 0.02)) > alpha


def test_profile_draws_follow_the_density_they_are_divided_by():
    """With bubbles the density is a table: histogram against its integral."""
    bubbles = mt.HallNovarini(wind_speed=13.0)
    nominal, chains, _ = make(mt.Link(bubbles=bubbles), 1, free=False, crest=0.6)
    nodes = nominal.step * np.arange(len(nominal.share))
    assert np.trapezoid(nominal.density, nodes) == pytest.approx(1.0, rel=1e-12)
    edges = nodes[::8]
    counts = np.histogram(chains.path, edges)[0]
    probabilities = np.diff(np.interp(edges, nodes, nominal.share))
    assert chi2_test(counts, probabilities) > ALPHA


@pytest.mark.parametrize("crest", [0.0, 1.5])
def test_scatterers_have_the_share_that_the_weight_divides_by(crest):
    """E[weight; kind, s in a cell] is the integral of 1 over the cell for both kinds."""
    nominal, chains, _ = make(mt.Link(bubbles=mt.HallNovarini(wind_speed=13.0)), 1, crest=crest)
    edges = np.linspace(nominal.distance - 6.0, nominal.distance, 13)
    for kind in (0, 1):
        for a, b in itertools.pairwise(edges):
            mine = (chains.kind[:, 0] == kind) & (chains.path >= a) & (chains.path < b)
            w = np.where(mine, chains.weight, 0.0)
            stderr = w.std() / math.sqrt(N)
            assert z_test(w.mean(), stderr, b - a) > sidak(ALPHA, 48), (kind, a, w.mean())


def test_scatterers_turn_by_their_own_phase_function():
    link = mt.Link(
        water=mt.Water(phase=mt.HenyeyGreenstein(g=0.9)), bubbles=mt.HallNovarini(wind_speed=13.0)
    )
    _, chains, _ = make(link, 1)
    for kind, phase in ((0, link.water.phase), (1, link.bubbles.phase_function())):
        theta = np.arccos(np.clip(chains.last[chains.kind[:, 0] == kind, 2], -1.0, 1.0))
        edges = np.radians([0, 0.5, 1, 2, 5, 10, 20, 40, 60, 90, 120, 180])
        counts = np.histogram(theta, edges)[0]
        assert chi2_test(counts, np.diff(phase.cdf(edges))) > sidak(ALPHA, 4)
    azimuth = np.arctan2(chains.last[:, 1], chains.last[:, 0])
    counts = np.histogram(azimuth, 36, (-math.pi, math.pi))[0]
    assert chi2_test(counts, np.full(36, 1 / 36)) > sidak(ALPHA, 4)


def test_second_turn_is_independent_of_the_first():
    """Mean cosine after K turns is g^K."""
    g = 0.8
    link = mt.Link(water=mt.Water(phase=mt.HenyeyGreenstein(g=g)))
    for order in (1, 2, 4):
        _, chains, _ = make(link, order)
        z = chains.last[:, 2]
        assert z_test(z.mean(), z.std() / math.sqrt(N), g**order) > sidak(ALPHA, 3)


def test_points_fill_the_disk():
    _, chains, _ = make(mt.Link(), 1)
    r2 = (chains.disk**2).sum(axis=1)
    counts = np.histogram(r2, 50, (0, 1))[0]
    assert chi2_test(counts, np.full(50, 0.02)) > sidak(ALPHA, 2)
    phi = np.arctan2(chains.disk[:, 1], chains.disk[:, 0])
    counts = np.histogram(phi, 50, (-math.pi, math.pi))[0]
    assert chi2_test(counts, np.full(50, 0.02)) > sidak(ALPHA, 2)


# ---- optical paths ---------------------------------------------------------------------------


@jit.entry
def _paths(medium, ends, out):
    for i in range(len(ends)):
        ray = ends[i].reshape(2, 3)
        p, q = row(ray, 0), row(ray, 1)
        length = vectors.norm(vectors.minus(q, p))
        out[i, 0] = absorption_path(medium, p.z, q.z, length)
        out[i, 1] = scattering_path(medium, p, q, length)


def paths(medium, ends):
    ends = np.asarray(ends, float)
    out = np.empty((len(ends), 2))
    _paths(medium, ends, out)
    return out


ENDS = [
    (0.0, 0.0, -10.0, 0.2, 0.1, -0.5),
    (0.0, 0.0, -9.0, 3.0, -2.0, -4.0),
    (1.0, 1.0, -0.4, -2.0, 0.0, -6.0),
    (1.0, 1.0, -2.0, 2.0, 5.0, -2.0),
    (0.0, 0.0, -3.0, 1.0, 0.0, -3.0 + 1e-8),
    (0.0, 0.0, -30.0, 1.0, 1.0, -12.0),
]
LAYERS = ((0.0, 0.1, 0.5), (3.0, 0.3, 0.1), (8.0, 0.05, 0.02))


def quad(function, row):
    a, b = np.array(row[:3]), np.array(row[3:])
    length = np.linalg.norm(b - a)
    return length * integrate.quad(lambda t: function(a + t * (b - a)), 0, 1, limit=400)[0]


def test_paths_in_homogeneous_water(medium):
    water = mt.Water()
    got = paths(medium, ENDS)
    length = [np.linalg.norm(np.subtract(r[3:], r[:3])) for r in ENDS]
    np.testing.assert_allclose(got, np.outer(length, (water.a, water.b)), rtol=1e-14)


def test_paths_in_layers():
    water = mt.Water(layers=LAYERS)
    got = paths(arrays.medium_arrays(mt.Link(water=water)), ENDS)
    expected = [[quad(lambda p, k=k: water.profile(-p[2])[k], r) for k in (0, 1)] for r in ENDS]
    np.testing.assert_allclose(got, expected, rtol=2e-5)


@pytest.mark.parametrize("wind_speed", [5.0, 13.0])
@pytest.mark.parametrize("mode", ["clamped", "mean_level"])
def test_paths_through_bubbles_below_still_water(wind_speed, mode):
    bubbles = mt.HallNovarini(wind_speed=wind_speed, depth=mode)
    water = mt.Water(layers=LAYERS)
    medium = arrays.medium_arrays(mt.Link(water=water, bubbles=bubbles), crest=1.0)
    rows = [*ENDS, (0.0, 0.0, -4.0, 0.5, 0.0, 0.7)]

    def scatter(p):
        depth = max(-p[2], 0.0) if mode == "clamped" else -p[2]
        b = mt.HallNovarini(wind_speed=wind_speed, depth="mean_level").b(depth)
        return water.profile(max(-p[2], 0.0))[1] + float(b)

    got = paths(medium, rows)[:, 1]
    np.testing.assert_allclose(got, [quad(scatter, r) for r in rows], rtol=3e-4)


def test_paths_through_bubbles_below_waves():
    """Depths are taken as linear over quarters of a path: some per cent of the bubbles' part."""
    bubbles = mt.HallNovarini(wind_speed=13.0, depth="local")
    sea = JonswapSea(wind_speed=13.0, seed=2, waves="paper")
    mesh = sea.mesh(extent=12.0, spacing=0.1)
    link = mt.Link(bubbles=bubbles)
    medium = arrays.with_raster(arrays.medium_arrays(link), mt.EmbreeIntersector(mesh, 1))
    ends = []
    rng = np.random.default_rng(1)
    for x, y, dx, dy in rng.uniform(-2.0, 2.0, (12, 4)):
        ends.append((x, y, -10.0, x + dx, y + dy, float(sea.elevation(x + dx, y + dy))))

    def scatter(p):
        depth = float(sea.elevation(p[0], p[1])) - p[2]
        return link.water.b + float(bubbles.b(max(depth, 0.0)))

    got = paths(medium, ends)[:, 1]
    expected = np.array([quad(scatter, r) for r in ends])
    length = np.array([np.linalg.norm(np.subtract(r[3:], r[:3])) for r in ends])
    water = link.water.b * length
    # transmittance good to 0.2 %
    np.testing.assert_allclose(got, expected, atol=2e-3)
    assert (expected - water > 0.05).all()


def test_local_depth_on_a_flat_sea_is_the_clamped_depth():
    for height in (0.0, 0.8):
        mesh = FlatSea(height=height).mesh(extent=12.0, spacing=1.0)
        rows = np.array(ENDS)
        rows[:, [2, 5]] += height
        media = [
            arrays.medium_arrays(mt.Link(bubbles=mt.HallNovarini(wind_speed=13.0, depth=mode)))
            for mode in ("local", "clamped")
        ]
        local = paths(arrays.with_raster(media[0], mt.EmbreeIntersector(mesh, 1)), rows)
        clamped = paths(media[1], ENDS)
        np.testing.assert_allclose(local, clamped, rtol=1e-6)


@pytest.mark.parametrize(
    ("lamp", "receiver"),
    [({}, {}), ({}, {"height": 2.0, "position": (10.0, 0.0)}), ({"depth": 1.0}, {"height": 100.0})],
    ids=["above", "aside", "far above"],
)
def test_chains_that_turn_gently_cross_a_flat_sea_once(lamp, receiver):
    """All starts of the search find the same crossing, so that the first one is enough."""
    n, rng = 3200, np.random.default_rng(11)
    link = forced_link(mt.Link(transmitter=mt.Led(**lamp), receiver=mt.Receiver(**receiver)))
    drawer = sets.ChainDrawer(link, 0.0, 0.0)
    (starts, scene, raised), depth = drawer._still_water(0, 0), -link.emitters[0].position.z
    chains = drawer.empty(sets.Request(source=0, order=1, per_shift=n // SHIFTS, key=())).chains
    for part in chains:
        part[:] = 0
    way, side = rng.normal(size=(2, n, 3))
    way *= np.where(way[:, 2:] < 0.0, -1.0, 1.0) / np.linalg.norm(way, axis=1, keepdims=True)
    side = np.cross(way, side)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    turn = np.arccos(rng.uniform(0.4, 1.0, (n, 1)))
    chains.tail[:] = 0.95 * depth * rng.random((n, 1)) ** (1.0 / 3.0) * way
    chains.last[:] = np.cos(turn) * way + np.sin(turn) * side
    chains.disk[:] = rng.uniform(-0.7, 0.7, (n, 2))
    found = np.full((len(starts), n, 2), np.nan)
    for k, point in enumerate(found):
        flat = np.zeros((n, sets.CROSSINGS), crossing.FLAT)
        gain.flat_crossings(chains, flat[:, :0], starts[k : k + 1], scene, raised, flat)
        lit = flat["branch"][:, 0] > 0.0
        point[lit] = np.stack([flat["x"], flat["y"]], axis=-1)[lit, 0]
    found = found[:, ~np.isnan(found).all(axis=(0, 2))]
    assert found.shape[1] > 0.9 * n
    assert (np.nanmax(found, axis=0) - np.nanmin(found, axis=0)).max() < 1e-4
