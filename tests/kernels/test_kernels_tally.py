"""Apertures, planes, maps and the ledger against plain numpy."""

import math
from typing import NamedTuple

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.engine.photons import analog
from meshtrace.engine.photons.state import PHOTON, heading
from meshtrace.engine.setup import arrays
from meshtrace.kernels import jit, vectors
from meshtrace.kernels import tally as kernel
from meshtrace.kernels.interface import FieldOfView, Interface
from meshtrace.kernels.medium import Medium
from meshtrace.kernels.tints import ALONE, NO_TINTS
from meshtrace.kernels.vectors import row


class Sea(NamedTuple):
    """What the scores of apertures need of a `World`."""

    first: int
    apertures: kernel.Apertures
    interface: Interface
    tallies: kernel.Tallies
    medium: Medium
    tints: None


LINK = mt.Link()  # one aperture: the scores of planes start in the second column


@jit.allocating_entry
def distances(apertures, i, origins, directions, length, fov):
    out = np.empty(len(origins))
    for k in range(len(origins)):
        p, d = row(origins, k), row(directions, k)
        out[k] = kernel.crosses_aperture(apertures, i, p, d, length, fov)
    return out


@jit.allocating_entry
def scored_on_planes(world, photons, length):
    for k in range(len(photons)):
        kernel.score_planes(photons[k], length[k], world)


@jit.allocating_entry
def scored_on_map(world, photons):
    for k in range(len(photons)):
        q = photons[k]
        kernel.score_map(q, heading(q), q.weight, math.inf, world)


@jit.allocating_entry
def deposits(tallies, weights):
    for w in weights:
        kernel.deposit(tallies, kernel.Fate.LANDED.value, w)


@jit.allocating_entry
def scored(world, photons, length):
    hit = np.zeros(len(photons), np.bool_)
    for k in range(len(photons)):
        q = photons[k]
        hit[k] = kernel.score_apertures(q, True, heading(q), q.weight, length, world)
    return hit


def photons_along(origins, directions, weight):
    """Return the photons 0, 1, ... under way, after 100 m in the water and 7 m in the air."""
    photons = np.zeros(len(origins), PHOTON)
    photons["id"] = np.arange(len(origins))
    photons["weight"], photons["water"], photons["air"] = weight, 100.0, 7.0
    for name, values in zip(("x", "y", "z"), np.transpose(origins), strict=True):
        photons[name] = values
    for name, values in zip(("dx", "dy", "dz"), np.transpose(directions), strict=True):
        photons[name] = values
    return photons


def sea_of(tallies, medium, link=LINK):
    apertures, interface = arrays.aperture_arrays(link), arrays.interface_arrays(link)
    return Sea(0, apertures, interface, tallies, medium, NO_TINTS)


def planes(tallies, origins, directions, length, weight, medium):
    photons = photons_along(origins, directions, weight)
    scored_on_planes(sea_of(tallies, medium), photons, length)


def mapped(tallies, origins, directions, weight, medium):
    scored_on_map(sea_of(tallies, medium), photons_along(origins, directions, weight))


def scores_in_water(link, tallies, medium, origins, directions, length, weight):
    """Score paths of photons on the apertures of a link."""
    world = sea_of(tallies, medium, link)
    return scored(world, photons_along(origins, directions, weight), length)


def absorbing(a):
    return arrays.medium_arrays(mt.Link(water=mt.Water(a=a)))


def tallies_of(
    rows=1,
    scores=1,
    depths=(),
    bins=(0, 1),
    groups=3,
    cells=0,
    extent=1.0,
    arrivals=0,
    axis=vectors.UP,
    cos=1e-12,
):
    return kernel.Tallies(
        score=np.zeros((rows, scores)),
        ledger=np.zeros(len(kernel.Fate), np.int64),
        n_photons=np.zeros(len(kernel.Fate), np.int64),
        misses=np.zeros(2, np.int64),
        planes=-np.array(depths, float),
        radiance=np.zeros((groups, len(depths), *bins), np.int64),
        grid=kernel.MapGrid(
            n=cells,
            z=5.0,
            x=-extent,
            y=-extent,
            step=2.0 * extent / cells if cells else 1.0,
            axis=vectors.Vec3(*axis),
            cos=cos,
            mixture=ALONE._replace(shares=np.zeros((0, 2))),
            scale=np.array([1.0, 4.0]),
        ),
        map_tint=np.zeros(0),
        map_factors=np.empty((2, 2)),
        map=np.zeros((cells, cells, 2), np.int64),
        map_squared=np.zeros((cells, cells, 2), np.int64),
        arrivals=np.zeros(arrivals, kernel.ARRIVAL),
        n_arrivals=np.zeros(1, np.int64),
    )


def random_directions(rng, n):
    d = rng.normal(size=(n, 3))
    return d / np.linalg.norm(d, axis=1)[:, None]


def disk_twin(center, axis, radius, cos_half, origins, directions, length):
    """Return the distance to a disk within its field of view, -1 outside, in numpy."""
    along = directions @ axis
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (center - origins) @ axis / along
        point = origins + t[:, None] * directions
        off = np.linalg.norm(point - center, axis=1)
        good = (along > 0) & (t > 0) & (t <= length) & (off <= radius) & (along >= cos_half)
    return np.where(good, t, -1.0)


RECEIVERS = [
    mt.Receiver(height=5.0, radius=2.0, fov_deg=180.0),
    mt.Receiver(height=5.0, radius=2.0, fov_deg=60.0, position=(1.0, -0.5)),
    mt.Receiver(height=3.0, radius=1.5, fov_deg=90.0, tilt_deg=35.0, tilt_azimuth_deg=120.0),
    mt.WaterAperture(depth=2.0, radius=3.0, zenith_deg=180.0),
    mt.WaterAperture(depth=2.0, radius=3.0, fov_deg=40.0, zenith_deg=70.0, azimuth_deg=-30.0),
]


@pytest.mark.parametrize("receiver", RECEIVERS, ids=lambda r: f"{r.kind} {r.fov_deg:g}")
@pytest.mark.parametrize("length", [4.0, math.inf])
def test_disk_and_field_of_view(receiver, length, rng):
    n = 200_000
    apertures = arrays.aperture_arrays(mt.Link(receiver=receiver))
    origins = np.array(receiver.center) + rng.uniform(-4.0, 4.0, (n, 3))
    directions = random_directions(rng, n)
    got = distances(apertures, 0, origins, directions, length, FieldOfView.ANGLE)
    half = math.radians(receiver.fov_deg) / 2.0
    cos_half = 0.0 if receiver.fov_deg == 180.0 else math.cos(half)
    expected = disk_twin(
        np.array(receiver.center),
        np.array(receiver.axis),
        receiver.radius,
        cos_half,
        origins,
        directions,
        length,
    )
    assert (expected > 0.0).sum() > 200
    np.testing.assert_allclose(got, expected, atol=1e-12)


def test_receiver_looks_down_and_leans_towards_its_azimuth():
    """A line of sight that leans to +x takes light that travels to -x."""
    apertures = arrays.aperture_arrays(mt.Link(receiver=mt.Receiver(tilt_deg=40.0, fov_deg=20.0)))
    for zenith_deg, expected in ((-40.0, True), (40.0, False), (0.0, False), (-51.0, False)):
        zenith = math.radians(zenith_deg)
        d = np.array([[math.sin(zenith), 0.0, math.cos(zenith)]])
        o = np.array([[0.0, 0.0, 5.0]]) - 3.0 * d
        assert (distances(apertures, 0, o, d, math.inf, FieldOfView.ANGLE)[0] > 0.0) == expected


@pytest.mark.parametrize("fov_deg", [20.0, 60.0, 179.0])
def test_field_of_view_is_the_full_angle(fov_deg):
    apertures = arrays.aperture_arrays(mt.Link(receiver=mt.Receiver(fov_deg=fov_deg)))
    for off, expected in ((-1e-6, True), (1e-6, False)):
        half = math.radians(fov_deg / 2.0) + off
        d = np.array([[math.sin(half), 0.0, math.cos(half)]])
        o = np.array([[0.0, 0.0, 5.0]]) - 4.0 * d
        assert (distances(apertures, 0, o, d, math.inf, FieldOfView.ANGLE)[0] > 0.0) == expected


def test_hemisphere_takes_light_that_grazes():
    apertures = arrays.aperture_arrays(mt.Link(receiver=mt.Receiver(fov_deg=180.0, radius=1.0)))
    d = np.array([[1.0, 0.0, 1e-9]])
    o = np.array([[0.0, 0.0, 5.0]]) - 2.0 * d
    assert distances(apertures, 0, o, d, math.inf, FieldOfView.ANGLE)[0] == pytest.approx(
        2.0, rel=1e-5
    )


def test_light_from_behind_and_short_paths_miss():
    apertures = arrays.aperture_arrays(mt.Link())
    o = np.array([[0.0, 0.0, 7.0], [0.0, 0.0, 4.0], [0.0, 0.0, 4.0]])
    d = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    assert (distances(apertures, 0, o, d, 0.99, FieldOfView.ANGLE) < 0.0).all()
    assert distances(apertures, 0, o, d, 1.0, FieldOfView.ANGLE).tolist() == [-1.0, 1.0, -1.0]


def test_length_of_the_direction_does_not_matter_to_the_angle():
    """The printed direction is not a unit vector."""
    apertures = arrays.aperture_arrays(mt.Link(receiver=mt.Receiver(fov_deg=40.0, radius=5.0)))
    rng = np.random.default_rng(2)
    d = random_directions(rng, 5000) * (1, 1, 5)
    o = np.zeros((5000, 3))
    unit = d / np.linalg.norm(d, axis=1)[:, None]
    a = distances(apertures, 0, o, d, math.inf, FieldOfView.ANGLE) > 0.0
    b = distances(apertures, 0, o, unit, math.inf, FieldOfView.ANGLE) > 0.0
    assert a.sum() > 100
    np.testing.assert_array_equal(a, b)


def test_printed_field_of_view_tests_the_crossing():
    """E11: |x_p - x_rx| < r + (h - z_p) tan(fov / 2): a superset of the angle test."""
    receiver = mt.Receiver(height=5.0, radius=0.5, fov_deg=60.0)
    apertures = arrays.aperture_arrays(mt.Link(receiver=receiver))
    rng = np.random.default_rng(3)
    n = 100_000
    crossing = np.column_stack([rng.uniform(-5, 5, (n, 2)), rng.uniform(-0.5, 0.5, n)])
    on_disk = np.column_stack([rng.uniform(-0.5, 0.5, (n, 2)), np.full(n, 5.0)])
    d = on_disk - crossing
    d /= np.linalg.norm(d, axis=1)[:, None]
    reach = 0.5 + (5.0 - crossing[:, 2]) * math.tan(math.radians(30.0))
    expected = (np.hypot(*crossing[:, :2].T) < reach) & (np.hypot(*on_disk[:, :2].T) <= 0.5)
    paper = distances(apertures, 0, crossing, d, math.inf, FieldOfView.PAPER_POSITION) > 0.0
    angle = distances(apertures, 0, crossing, d, math.inf, FieldOfView.ANGLE) > 0.0
    np.testing.assert_array_equal(paper, expected)
    assert (paper | ~angle).all()
    assert (paper & ~angle).any()


def test_printed_field_of_view_of_a_receiver_that_looks_up_is_the_mirror_image():
    rng = np.random.default_rng(4)
    n = 100_000
    crossing = np.column_stack([rng.uniform(-5, 5, (n, 2)), rng.uniform(-0.5, 0.5, n)])
    on_disk = np.column_stack([rng.uniform(-0.5, 0.5, (n, 2)), np.full(n, 5.0)])
    seen = []
    for sign, kind in ((1.0, mt.Receiver(height=5.0)), (-1.0, mt.WaterReceiver(depth=5.0))):
        receiver = kind.replace(radius=0.5, fov_deg=60.0)
        apertures = arrays.aperture_arrays(mt.Link(receiver=receiver))
        mirror = np.array([1.0, 1.0, sign])
        o, d = crossing * mirror, (on_disk - crossing) * mirror
        args = (apertures, 0, o, d, math.inf, FieldOfView.PAPER_POSITION)
        seen.append(distances(*args) > 0.0)
    np.testing.assert_array_equal(*seen)
    assert 0.2 < seen[0].mean() < 0.8


def test_printed_field_of_view_ends_behind_the_receiver():
    """Light that starts above a tilted receiver has passed its cone: r + (h - z_p) tan < 0."""
    receiver = mt.Receiver(height=5.0, radius=0.05, fov_deg=170.0, tilt_deg=80.0)
    apertures = arrays.aperture_arrays(mt.Link(receiver=receiver))
    start = np.array([[1.0, 0.0, 4.7], [1.0, 0.0, 5.3]])
    way = np.array([0.0, 0.0, 5.0]) - start
    seen = distances(apertures, 0, start, way, math.inf, FieldOfView.PAPER_POSITION)
    assert seen.tolist() == [1.0, -1.0]


def test_score_is_weight_times_absorption_up_to_the_disk():
    link = mt.Link(receiver=mt.WaterAperture(depth=2.0, radius=1.0))
    tallies = tallies_of(rows=2, arrivals=2)
    o = np.array([[0.0, 0.0, -5.0], [3.0, 0.0, -5.0]])
    d = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]])
    hit = scores_in_water(link, tallies, absorbing(0.2), o, d, 4.0, 0.5)
    assert hit.tolist() == [True, False]
    expected = 0.5 * math.exp(-0.2 * 3.0)
    np.testing.assert_allclose(tallies.score[:, 0], [expected, 0.0], rtol=1e-14)
    assert tallies.n_arrivals[0] == 1
    names = ["photon", "receiver", "weight", "water", "air"]
    row = tallies.arrivals[names][0].tolist()
    np.testing.assert_allclose(row, [0.0, 0.0, expected, 103.0, 7.0])


def test_planes_take_down_and_up_light_plane_and_scalar():
    depths = (1.0, 2.0, 4.0)
    rng = np.random.default_rng(4)
    n = 3000
    tallies = tallies_of(rows=n, scores=1 + 4 * 3, depths=depths, bins=(10, 8))
    origins = rng.uniform(-6.0, 0.0, (n, 3))
    directions = random_directions(rng, n)
    length = rng.uniform(0.0, 4.0, n)
    planes(tallies, origins, directions, length, 0.7, absorbing(0.3))
    dz = directions[:, 2]
    expected = np.zeros((n, 13))
    total = np.zeros((3, 3, 10, 8))
    for k, depth in enumerate(depths):
        z = -depth
        t = (z - origins[:, 2]) / dz
        on = (t >= 0.0) & (t < length)
        w = np.where(on, 0.7 * np.exp(-0.3 * np.where(on, t, 0.0)), 0.0)
        up = dz > 0
        columns = (w * ~up, w * up, w / abs(dz) * ~up, w / abs(dz) * up)
        expected[:, 1 + 4 * k : 5 + 4 * k] = np.column_stack(columns)
        phi = np.arctan2(directions[:, 1], directions[:, 0]) % (2 * np.pi)
        for group in range(3):  # rows modulo the number of groups
            mine = slice(group, None, 3)
            total[group, k] = np.histogram2d(
                -dz[mine],
                phi[mine],
                bins=(np.linspace(-1, 1, 11), np.linspace(0, 2 * np.pi, 9)),
                weights=w[mine],
            )[0]
    np.testing.assert_allclose(tallies.score, expected, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(tallies.radiance * kernel.UNIT, total, atol=1e-9)


def test_a_path_that_ends_on_a_plane_is_counted_by_the_next_one():
    tallies = tallies_of(rows=1, scores=5, depths=(2.0,))
    down = np.array([[0.0, 0.0, -1.0]])
    for z in (-1.0, -2.0):
        planes(tallies, np.array([[0.0, 0.0, z]]), down, np.ones(1), 1.0, absorbing(0.0))
    assert tallies.score[0].tolist() == [0.0, 1.0, 0.0, 1.0, 0.0]


def test_layers_absorb_up_to_the_plane_and_to_the_disk():
    """A layer of 0.5 m-1 between 1 and 2 m: light on the way up has met what lies below."""
    layers = ((0.0, 0.1, 0.0), (1.0, 0.1, 0.0), (1.01, 0.5, 0.0), (2.0, 0.5, 0.0))
    aperture = mt.WaterAperture(depth=1.5, radius=1.0)
    link = mt.Link(water=mt.Water(layers=layers), receiver=aperture)
    tallies = tallies_of(rows=1, scores=5, depths=(1.5,))
    o, up = np.array([[0.0, 0.0, -1.9]]), np.array([[0.0, 0.0, 1.0]])
    medium = arrays.medium_arrays(link)
    planes(tallies, o, up, np.array([1.8]), 1.0, medium)
    scores_in_water(link, tallies, medium, o, up, 1.8, 1.0)
    expected = math.exp(-0.5 * 0.4)
    np.testing.assert_allclose(tallies.score[0, [0, 2, 4]], expected, rtol=1e-3)


@pytest.mark.parametrize(("tilt_deg", "fov_deg"), [(0.0, 180.0), (0.0, 60.0), (30.0, 80.0)])
def test_map_is_a_histogram(tilt_deg, fov_deg, medium):
    """What level cells take, as apertures with this axis and field of view see it."""
    axis = mt.Receiver(tilt_deg=tilt_deg, tilt_azimuth_deg=25.0).axis
    cos = max(math.cos(math.radians(fov_deg / 2.0)), 1e-12)
    rng = np.random.default_rng(5)
    n = 20_000
    tallies = tallies_of(cells=16, extent=4.0, axis=axis, cos=cos)
    origins = rng.uniform(-3, 3, (n, 3)) * (1, 1, 0.1)
    directions = random_directions(rng, n)
    weight = rng.random(n)
    mapped(tallies, origins, directions, weight, medium)
    seen = (directions[:, 2] > 0) & (directions @ np.array(axis) >= cos)
    d = directions[seen]
    t = (5.0 - origins[seen, 2]) / d[:, 2]
    x, y = (origins[seen] + t[:, None] * d)[:, :2].T
    w = weight[seen] * (d @ np.array(axis)) / d[:, 2]
    edges = np.linspace(-4, 4, 17)
    for got, power in ((tallies.map, 1), (tallies.map_squared, 2)):
        expected = np.histogram2d(x, y, bins=(edges, edges), weights=w**power)[0]
        assert expected.sum() > 100
        scaled = np.multiply.outer(expected, tallies.grid.scale**power)
        np.testing.assert_allclose(got * kernel.UNIT, scaled, atol=1e-8)


def test_ledger_rounds_to_half_a_unit_and_does_not_depend_on_order():
    rng = np.random.default_rng(6)
    weights = np.concatenate([rng.random(2000), -rng.random(500)])
    sums = []
    for order in (np.arange(2500), rng.permutation(2500)):
        tallies = tallies_of()
        deposits(tallies, weights[order])
        sums.append(int(tallies.ledger[kernel.Fate.LANDED]))
    assert sums[0] == sums[1]
    assert sums[0] * kernel.UNIT == pytest.approx(math.fsum(weights), abs=2500 * kernel.UNIT / 2)


def test_fixed_point_sum_neither_overflows_nor_rounds():
    total = analog.FixedPointSum((2,))
    chunk = np.array([2**62 - 1, -(2**61) - 5], np.int64)
    for _ in range(1000):
        total.add(chunk)
    exact = [1000 * int(c) / 2**44 for c in chunk]
    np.testing.assert_allclose(total.value(), exact, rtol=1e-15)
