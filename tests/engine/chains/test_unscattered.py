"""Images of facets: overlaps, solid angles and emitters against closed forms and Monte Carlo."""

import math

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak, z_test
from scipy import integrate

import meshtrace as mt
from meshtrace.engine.chains import unscattered as image
from meshtrace.engine.forced import ForcedDetection, TypicalSea
from meshtrace.engine.setup import ends
from meshtrace.kernels import jit, sources, vectors
from meshtrace.surfaces import FlatSea, TiltedPlane


@jit.entry
def _overlaps(triangles, r, out):
    for i in range(len(triangles)):
        t = triangles[i]
        a, b, c = vectors.Vec2(t[0], t[1]), vectors.Vec2(t[2], t[3]), vectors.Vec2(t[4], t[5])
        out[i, 0], center = image.disk_overlap(a, b, c, r)
        out[i, 1], out[i, 2] = center.x, center.y


@jit.entry
def _areas_in_view(margins, out):
    """Write the area inside the view of the triangle (0, 0), (1, 0), (0, 1) by its margins."""
    o, p = vectors.Vec3(0.0, 0.0, 0.0), vectors.Vec2
    for i in range(len(margins)):
        m = margins[i]
        a = image.Corner(True, o, p(0.0, 0.0), m[0])
        b = image.Corner(True, o, p(1.0, 0.0), m[1])
        c = image.Corner(True, o, p(0.0, 1.0), m[2])
        triangles, (a, b, c), (d, e, g) = image.in_view(a, b, c)
        out[i] = 0.0
        if triangles > 0:
            ab, ac = vectors.minus2(b.at, a.at), vectors.minus2(c.at, a.at)
            out[i] += 0.5 * abs(vectors.cross2(ab, ac))
        if triangles > 1:
            de, dg = vectors.minus2(e.at, d.at), vectors.minus2(g.at, d.at)
            out[i] += 0.5 * abs(vectors.cross2(de, dg))


def test_parts_are_cut_at_the_edge_of_the_view(rng):
    """Margins that are linear over a triangle, against its random points."""
    n, margins = 20_000, rng.normal(size=(200, 3))
    areas = np.empty(len(margins))
    _areas_in_view(margins, areas)
    u, v = rng.random((2, n))
    u, v = np.where(u + v > 1.0, (1.0 - u, 1.0 - v), (u, v))
    cut = 0
    for (a, b, c), area in zip(margins, areas, strict=True):
        share = np.mean(a + (b - a) * u + (c - a) * v >= 0.0)
        if 0.0 < area < 0.5:
            cut += 1
            stderr = math.sqrt(2.0 * area * (1.0 - 2.0 * area) / n)
            assert abs(share - 2.0 * area) < 5.0 * stderr + 1.0 / n
        else:
            assert share == 2.0 * area
    assert cut > 100


def overlap(triangles, r=1.0):
    t = np.asarray(triangles, float).reshape(-1, 6)
    out = np.empty((len(t), 3))
    _overlaps(t, r, out)
    return out


def area_of(t):
    t = np.reshape(t, (-1, 3, 2))
    (ax, ay), (bx, by) = (t[:, 1] - t[:, 0]).T, (t[:, 2] - t[:, 0]).T
    return 0.5 * np.abs(ax * by - ay * bx)


def test_overlap_against_monte_carlo(rng):
    """Triangles of all sizes and places: area and centroid within the error of counting."""
    n, cases = 20_000, 300
    size = 10.0 ** rng.uniform(-1, 1, (cases, 1, 1))
    triangles = rng.uniform(-1.5, 1.5, (cases, 1, 2)) + size * rng.normal(size=(cases, 3, 2))
    got = overlap(triangles)
    r, phi = np.sqrt(rng.random(n)), 2 * np.pi * rng.random(n)
    disk = np.column_stack([r * np.cos(phi), r * np.sin(phi)])
    alpha, partly = sidak(ALPHA, 3 * cases), 0
    for t, (area, x, y) in zip(triangles, got, strict=True):
        edge = np.roll(t, -1, axis=0) - t
        away = disk[:, None] - t[None]
        side = edge[None, :, 0] * away[..., 1] - edge[None, :, 1] * away[..., 0]
        inside = (side > 0).all(axis=1) | (side < 0).all(axis=1)
        share = area / math.pi
        assert -1e-12 <= share <= 1.0 + 1e-12
        stderr = math.sqrt(max(share * (1 - share), 1e-12) / n)
        if share * n > 20 and (1 - share) * n > 20:
            partly += 1
            assert z_test(inside.mean(), stderr, share) > alpha, t
            for got_c, values in ((x, disk[inside, 0]), (y, disk[inside, 1])):
                error = values.std() / math.sqrt(len(values))
                assert z_test(values.mean(), error, got_c) > alpha, t
        else:
            assert inside.mean() == pytest.approx(share, abs=25 / n)
    assert partly > 100


def test_overlap_of_special_triangles():
    big = overlap([[-50, -40, 50, -40, 0, 70]])[0]
    np.testing.assert_allclose(big, [math.pi, 0, 0], atol=1e-12)
    np.testing.assert_allclose(overlap([[3, 3, 4, 3, 3, 4]])[0], 0, atol=1e-13)
    small = overlap([[0.1, 0.1, 0.3, 0.1, 0.1, 0.4]])[0]
    np.testing.assert_allclose(small, [0.03, 0.5 / 3, 0.6 / 3], rtol=1e-12)
    half = overlap([[0, -9, 0, 9, 9, 0]])[0]  # a half disk: centroid 4 / (3 pi)
    np.testing.assert_allclose(half, [math.pi / 2, 4 / (3 * math.pi), 0], atol=1e-12)
    quarter = overlap([[0, 0, 9, 0, 0, 9]])[0]
    c = 4 / (3 * math.pi)
    np.testing.assert_allclose(quarter, [math.pi / 4, c, c], rtol=1e-12)
    # a corner on the rim, an edge that touches the rim, and no area at all
    assert overlap([[1, 0, 2, 1, 2, -1]])[0, 0] == pytest.approx(0.0, abs=1e-12)
    assert overlap([[-5, 1, 5, 1, 0, 9]])[0, 0] == pytest.approx(0.0, abs=1e-12)
    assert overlap([[0, 0, 1, 1, 2, 2]])[0, 0] == 0.0


def test_overlap_does_not_know_the_orientation_and_scales():
    rng = np.random.default_rng(2)
    t = rng.normal(size=(500, 3, 2))

    def moments(triangles, r=1.0):
        out = overlap(triangles, r)
        return np.column_stack([out[:, 0], out[:, :1] * out[:, 1:]])

    first = moments(t)
    np.testing.assert_allclose(moments(t[:, ::-1]), first, atol=1e-12)
    np.testing.assert_allclose(moments(np.roll(t, 1, axis=1)), first, atol=1e-12)
    np.testing.assert_allclose(moments(0.05 * t, 0.05), first * 0.05 ** np.array([2, 3, 3]),
                               atol=1e-14)  # fmt: skip


def test_centroid_lies_in_the_disk():
    """Also where nothing is shared but the last digits."""
    t = np.random.default_rng(2).normal(size=(3000, 3, 2))
    out = overlap(t)
    assert (np.hypot(out[:, 1], out[:, 2]) <= 1.0 + 1e-9).all()


def test_overlaps_of_a_tiling_add_up_to_the_disk():
    g = np.linspace(-1.7, 1.9, 14)
    tiles = []
    for i in range(13):
        for j in range(13):
            a, b, c, d = (g[i], g[j]), (g[i + 1], g[j]), (g[i + 1], g[j + 1]), (g[i], g[j + 1])
            tiles += [(*a, *b, *c), (*a, *c, *d)]
    out = overlap(tiles)
    assert out[:, 0].sum() == pytest.approx(math.pi, rel=1e-12)
    np.testing.assert_allclose((out[:, :1] * out[:, 1:]).sum(axis=0), 0.0, atol=1e-12)


@jit.entry
def _angles(triangles, out):
    for i in range(len(triangles)):
        t = triangles[i].reshape(3, 3)
        out[i] = image.solid_angle(vectors.row(t, 0), vectors.row(t, 1), vectors.row(t, 2))


def solid_angle(triangles):
    t = np.asarray(triangles, float).reshape(-1, 9)
    out = np.empty(len(t))
    _angles(t, out)
    return out


def test_solid_angles():
    octant = [[1, 0, 0, 0, 1, 0, 0, 0, 1], [5, 0, 0, 0, 0.2, 0, 0, 0, 3]]
    np.testing.assert_allclose(solid_angle(octant), math.pi / 2, rtol=1e-14)
    # a face of a cube is split into two triangles: 2 pi / 3 together
    face = [[1, -1, -1, 1, 1, -1, 1, 1, 1], [1, -1, -1, 1, 1, 1, 1, -1, 1]]
    assert solid_angle(face).sum() == pytest.approx(2 * math.pi / 3, rel=1e-14)
    # small and far: area cos / r^2
    tiny = solid_angle([[0, 0, 10, 1e-3, 0, 10, 0, 1e-3, 10]])[0]
    assert tiny == pytest.approx(0.5e-6 / 100, rel=1e-7)
    # more than a hemisphere's half, seen from close below
    rng = np.random.default_rng(3)
    t = np.array([4.0, 0, 0.1, -3, 3, 0.1, -3, -3, 0.1])
    v = rng.normal(size=(400_000, 3))
    p = v * (0.1 / v[:, 2:])
    a, b, c = t.reshape(3, 3)[:, :2]
    side = [(q - o)[0] * (p[:, 1] - o[1]) - (q - o)[1] * (p[:, 0] - o[0]) for o, q in
            ((a, b), (b, c), (c, a))]  # fmt: skip
    share = ((np.array(side) > 0).all(axis=0) & (v[:, 2] > 0)).mean()
    expected = solid_angle([t])[0] / (4 * math.pi)
    stderr = math.sqrt(expected * (1 - expected) / len(v))
    assert z_test(share, stderr, expected) > ALPHA


@jit.entry
def _intensities(emitter, w, out):
    for i in range(len(w)):
        out[i] = sources.intensity(emitter, vectors.row(w, i))


SOURCES = [
    mt.Led(half_angle_deg=5.0),
    mt.Led(half_angle_deg=60.0, zenith_deg=35.0, azimuth_deg=70.0),
    mt.GaussianBeam(divergence_deg=3.0),
    mt.GaussianBeam(divergence_deg=20.0, zenith_deg=120.0),
    mt.TopHatBeam(divergence_deg=1.0),
    mt.TopHatBeam(divergence_deg=90.0),
    mt.IsotropicSource(),
]


def intensity_at(source, theta, phi=0.4):
    """Return the intensity at an angle from the axis of the source."""
    emitter = ends.emitter_of(source)
    axis = np.array(emitter.axis)
    e1 = np.cross(axis, (0.3, 0.9, 0.1))
    e1 /= np.linalg.norm(e1)
    e2 = np.cross(axis, e1)
    theta = np.atleast_1d(np.asarray(theta, float))[:, None]
    w = np.cos(theta) * axis + np.sin(theta) * (np.cos(phi) * e1 + np.sin(phi) * e2)
    out = np.empty(len(w))
    _intensities(emitter, np.ascontiguousarray(w), out)
    return out


@pytest.mark.parametrize("source", SOURCES, ids=lambda s: f"{s.kind}-{s.zenith_deg:g}")
def test_intensity_integrates_to_one(source):
    kink = math.radians(getattr(source, "divergence_deg", 90.0))

    def ring(theta):
        return 2 * math.pi * math.sin(theta) * intensity_at(source, theta)[0]

    total = sum(
        integrate.quad(ring, a, b, limit=200, epsabs=1e-11)[0]
        for a, b in zip((0, kink, math.pi / 2), (kink, math.pi / 2, math.pi), strict=True)
    )
    # the tail of a Gaussian beyond 180 deg is what the sampler folds back
    assert total == pytest.approx(1.0, rel=2e-6)


@pytest.mark.parametrize("source", SOURCES, ids=lambda s: f"{s.kind}-{s.zenith_deg:g}")
def test_intensity_is_even_around_the_axis(source):
    theta = np.linspace(0.0, 1.5, 40)
    first = intensity_at(source, theta, 0.0)
    for phi in (1.0, 2.0, 4.0):
        np.testing.assert_allclose(intensity_at(source, theta, phi), first, rtol=1e-6, atol=1e-12)


# ---- the whole image -------------------------------------------------------------------------


def ballistic(link, mesh, normals="vertex"):
    forced = ForcedDetection(link, 32, 1, normals, sea=TypicalSea(float(mesh.bounds[1, 2])))
    return forced.evaluate(mesh).ballistic


@pytest.mark.parametrize("spacing", [0.05, 0.37, 1.0, 5.0])
@pytest.mark.parametrize("normals", ["vertex", "facet"])
def test_a_plane_may_be_cut_into_any_facets(spacing, normals):
    sea = TiltedPlane(slope_x=0.1, slope_y=-0.05)
    link = mt.Link(
        receiver=(mt.Receiver(radius=0.3), mt.Receiver(position=(0.4, 0.2), tilt_deg=10.0))
    )
    extent = 3.0 if spacing < 0.1 else 10.0
    fine = ballistic(link, sea.mesh(extent=3.0, spacing=0.1), normals)
    coarse = ballistic(link, sea.mesh(extent=extent, spacing=spacing), normals)
    np.testing.assert_allclose(coarse, fine, rtol=5e-5)


@pytest.mark.parametrize("normals", ["vertex", "facet"])
def test_facets_whose_centre_is_beyond_the_critical_angle_still_let_light_out(normals):
    """Still water in triangles of 35 m: the centroids are dark, the corners are not."""
    expected = ballistic(mt.Link(), FlatSea().mesh(extent=5.0, spacing=0.5), normals)
    got = ballistic(mt.Link(), FlatSea().mesh(extent=70.0, spacing=35.0), normals)
    np.testing.assert_allclose(got, expected, rtol=1e-4)


def test_field_of_view_that_cuts_through_the_aperture():
    """Wide disk, narrow field of view: the light inside the cone is that of a smaller disk."""
    n, h, d = 1.33, 5.0, 10.0
    half = math.radians(3.0)
    inside = d * math.tan(math.asin(math.sin(half) / n)) + h * math.tan(half)
    mesh = FlatSea().mesh(extent=5.0, spacing=0.1)
    wide = mt.Receiver(radius=2.0, fov_deg=6.0)
    got = ballistic(mt.Link(receiver=wide), mesh)
    expected = ballistic(mt.Link(receiver=mt.Receiver(radius=inside, fov_deg=90.0)), mesh)
    # the edge of the field of view is resolved to one part of a facet
    np.testing.assert_allclose(got, expected, rtol=5e-3)
