"""Aiming: rotations, landings, derivatives and roots against rotation matrices and brute force."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import meshtrace as mt
from meshtrace.engine import crossing
from meshtrace.kernels import jit, vectors
from meshtrace.kernels.scene import FLAT_SEA, locate
from meshtrace.optics import fresnel_reflectance
from meshtrace.optics.fresnel import refract
from meshtrace.surfaces import JonswapSea, SinusoidalSea

N_WATER = 1.33


def minimal_rotation(w):
    """Return R(w), the rotation about a horizontal axis that takes e_z to w."""
    axis = np.array([-w[1], w[0], 0.0])
    sine = np.linalg.norm(axis)
    if sine < 1e-300:
        return np.eye(3)
    return Rotation.from_rotvec(axis / sine * math.atan2(sine, w[2])).as_matrix()


# ---- emission_through ------------------------------------------------------------------------


@jit.entry
def _through(q, v, p, branch, out):
    for i in range(len(q)):
        ok, out[i, 1], w, d = crossing.emission_through(
            vectors.row(q, i), vectors.row(v, i), vectors.row(p, i), branch
        )
        out[i, 0] = 1.0 if ok else 0.0
        vectors.write(out[i, 2:5], w)
        vectors.write(out[i, 5:8], d)


def through(q, v, p, branch=1.0):
    q, v, p = (np.atleast_2d(np.asarray(a, float)) for a in (q, v, p))
    out = np.empty((len(q), 8))
    _through(q, v, p, branch, out)
    return out[:, 0] > 0.0, out[:, 1], out[:, 2:5], out[:, 5:]


def unit(rng, n):
    v = rng.normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1)[:, None]


@pytest.mark.parametrize("branch", [1.0, -1.0])
def test_turned_chain_passes_through_the_point(branch):
    rng = np.random.default_rng(3)
    n = 4000
    q, v, p = rng.normal(size=(n, 3)), unit(rng, n), 1.5 * rng.normal(size=(n, 3))
    ok, t, w, d = through(q, v, p, branch)
    assert ok.sum() > (1500 if branch > 0 else 100)
    for i in np.flatnonzero(ok):
        r = minimal_rotation(w[i])
        assert t[i] > 0.0
        # near w = -e_z the minimal rotation is ill-conditioned
        loose = 1e-10 / max(1.0 + w[i, 2], 1e-6)
        np.testing.assert_allclose(r @ (q[i] + t[i] * v[i]), p[i], atol=1e-10 + loose)
        np.testing.assert_allclose(r @ v[i], d[i], atol=1e-10 + loose)
        assert np.linalg.norm(w[i]) == pytest.approx(1.0, abs=1e-12)


def test_branches_exist_exactly_when_the_sphere_is_met():
    rng = np.random.default_rng(4)
    n = 5000
    q, v, p = rng.normal(size=(n, 3)), unit(rng, n), rng.normal(size=(n, 3))
    qv = (q * v).sum(1)
    disc = qv**2 - (q**2).sum(1) + (p**2).sum(1)
    far, near = -qv + np.sqrt(np.maximum(disc, 0)), -qv - np.sqrt(np.maximum(disc, 0))
    np.testing.assert_array_equal(through(q, v, p, 1.0)[0], (disc >= 0) & (far > 0))
    np.testing.assert_array_equal(through(q, v, p, -1.0)[0], (disc >= 0) & (near > 0))


def test_unscattered_light_goes_straight():
    rng = np.random.default_rng(5)
    p = rng.normal(size=(500, 3))
    ok, t, w, d = through(np.zeros((500, 3)), np.tile([0.0, 0.0, 1.0], (500, 1)), p)
    assert ok.all()
    np.testing.assert_allclose(t, np.linalg.norm(p, axis=1))
    np.testing.assert_allclose(w, p / t[:, None], atol=1e-13)
    np.testing.assert_allclose(d, w, atol=1e-15)


def test_straight_up_is_no_singular_case():
    ok, t, w, d = through([0, 0, 1.0], [0, 0, 1.0], [0, 0, 10.0])
    assert ok[0]
    assert t[0] == 9.0
    np.testing.assert_array_equal(w[0], [0, 0, 1])
    np.testing.assert_array_equal(d[0], [0, 0, 1])
    # a scattered chain that is already aimed at the point
    q, v = np.array([0.0, 0.0, 2.0]), np.array([0.6, 0.0, 0.8])
    ok, t, w, d = through(q, v, q + 5.0 * v)
    assert ok[0]
    assert t[0] == pytest.approx(5.0)
    np.testing.assert_allclose(w[0], [0, 0, 1], atol=1e-12)
    for tiny in (1e-15, 1e-12, 1e-9, 1e-6):
        _, _, w, d = through([0, 0, 1.0], [0, 0, 1.0], [tiny, 0, 10.0])
        np.testing.assert_allclose(w[0], [tiny / 10.0, 0, 1], atol=1e-13)
        np.testing.assert_allclose(d[0], w[0], atol=1e-13)


def test_light_that_leads_away_has_no_forward_crossing():
    assert not through([0, 0, 5.0], [0, 0, 1.0], [0, 0, 3.0])[0][0]  # already beyond
    assert not through([0, 0, 5.0], [1.0, 0, 0], [0, 0, 3.0], -1.0)[0][0]  # passes the sphere
    ok, t, _, _ = through([0, 0, 5.0], [0, 0, -1.0], [0, 0, 3.0], -1.0)
    assert ok[0]
    assert t[0] == pytest.approx(2.0)


# ---- land, jacobian --------------------------------------------------------------------------


@jit.inlined
def shot_at(q, v, x, y, branch, scene):
    none, goal = vectors.Vec2(0.0, 0.0), vectors.Vec2(x, y)
    start = scene.emitter.position
    return crossing.Shot(
        start, vectors.Vec3(q[0], q[1], q[2]), vectors.Vec3(v[0], v[1], v[2]), goal, branch, none
    )


@jit.entry
def _aims(points, facets, q, v, branch, scene, out):
    for i in range(len(points)):
        shot = shot_at(q, v, 0.0, 0.0, branch, scene)
        m = crossing.aim_at(points[i, 0], points[i, 1], facets[i], shot, scene)
        out[i, 0] = 1.0 if m.ok else 0.0
        out[i, 1], out[i, 2] = m.at.x, m.at.y
        vectors.write(out[i, 3:6], m.w)
        vectors.write(out[i, 6:9], m.r)
        out[i, 9], out[i, 10], out[i, 11] = m.rho, m.length, m.flight


def aims(points, facets, q, v, scene, branch=1.0):
    points = np.atleast_2d(np.asarray(points, float))
    out = np.empty((len(points), 12))
    _aims(points, np.asarray(facets, np.int64), q, v, branch, scene, out)
    return out


@jit.entry
def _locate(scene, points, out):
    for i in range(len(points)):
        out[i] = locate(scene.locator, scene.surface, points[i, 0], points[i, 1])


def located(scene, points):
    out = np.empty(len(points), np.int64)
    _locate(scene, np.ascontiguousarray(points), out)
    return out


Q, V = np.array([0.3, -0.2, 6.0]), np.array([0.12, 0.05, 0.9])
V = V / np.linalg.norm(V)
LINK = mt.Link(receiver=mt.Receiver(position=(0.4, -0.3), tilt_deg=15.0, tilt_azimuth_deg=40.0))
SEA = SinusoidalSea(amplitude=0.1, wavelength=2.0, phase=0.4, direction_deg=30.0)


@pytest.fixture(scope="module")
def wave_mesh():
    return SEA.mesh(extent=6.0, spacing=0.05)


@pytest.mark.parametrize("normals", ["vertex", "facet"])
def test_landing_is_the_ray_traced_forwards(wave_mesh, normals, scene_of):
    """Turn the chain by R(w), meet the mesh, refract, fly to the plane: same point."""
    mesh = wave_mesh
    scene = scene_of(LINK, mesh, normals)
    rng = np.random.default_rng(6)
    points = rng.uniform(-1.5, 1.5, (300, 2))
    facets = located(scene, points)
    out = aims(points, facets, Q, V, scene)
    assert (out[:, 0] > 0).all()
    source = np.array(scene.emitter.position)
    rotation = np.array([minimal_rotation(w) for w in out[:, 3:6]])
    origin = source + rotation @ Q
    direction = rotation @ V
    hits = mt.BruteForceIntersector(mesh).intersect(origin, direction)
    np.testing.assert_allclose(hits.distance, out[:, 10], atol=1e-9)
    p = origin + hits.distance[:, None] * direction
    np.testing.assert_allclose(p[:, :2], points, atol=1e-9)
    if normals == "facet":
        normal = mesh.face_normals[hits.facet]
    else:
        corners = mesh.faces[hits.facet]
        weight = np.stack([1 - hits.u - hits.v, hits.u, hits.v], axis=1)
        normal = (weight[..., None] * mesh.vertex_normals[corners]).sum(1)
        normal /= np.linalg.norm(normal, axis=1)[:, None]
    bent = refract(direction, normal, N_WATER, 1.0)
    np.testing.assert_allclose(bent, out[:, 6:9], atol=1e-9)
    cos_i = (direction * normal).sum(1)
    np.testing.assert_allclose(fresnel_reflectance(cos_i, N_WATER, 1.0), out[:, 9], atol=1e-10)
    center, axis = np.array(scene.target.center), np.array(scene.target.axis)
    flight = ((center - p) @ axis) / (bent @ axis)
    np.testing.assert_allclose(flight, out[:, 11], atol=1e-9)
    off = p + flight[:, None] * bent - center
    np.testing.assert_allclose(off @ scene.target.e1, out[:, 1], atol=1e-8)
    np.testing.assert_allclose(off @ scene.target.e2, out[:, 2], atol=1e-8)
    np.testing.assert_allclose(off @ axis, 0.0, atol=1e-9)


def test_light_beyond_the_critical_angle_does_not_leave(scene):
    straight = np.zeros(3), np.array([0.0, 0.0, 1.0])
    critical = math.asin(1 / N_WATER)
    for angle, ok in ((critical - 1e-3, True), (critical + 1e-3, False)):
        out = aims([[10.0 * math.tan(angle), 0.0]], [-1], *straight, scene)
        assert bool(out[0, 0]) is ok


@jit.entry
def _jacobians(points, facets, q, v, scene, out):
    for i in range(len(points)):
        shot = shot_at(q, v, 0.0, 0.0, 1.0, scene)
        j = crossing.jacobian(points[i, 0], points[i, 1], facets[i], shot, scene)
        out[i, 0] = 1.0 if j.ok else 0.0
        out[i, 1], out[i, 2], out[i, 3], out[i, 4] = j.a, j.b, j.c, j.d
        out[i, 5], out[i, 6], out[i, 7], out[i, 8] = j.turns


@pytest.mark.parametrize("normals", ["vertex", "facet"])
def test_jacobian_against_central_differences(wave_mesh, normals, scene_of):
    scene = scene_of(LINK, wave_mesh, normals)
    points = np.random.default_rng(7).uniform(-1.5, 1.5, (200, 2))
    facets = located(scene, points)
    out = np.empty((len(points), 9))
    _jacobians(points, facets, Q, V, scene, out)
    assert (out[:, 0] > 0).all()
    h = 1e-4
    expected = np.empty((len(points), 8))
    for axis in range(2):
        step = np.zeros(2)
        step[axis] = h
        plus, minus = (aims(points + s * step, facets, Q, V, scene) for s in (1, -1))
        d = (plus - minus) / (2 * h)
        expected[:, [axis, 2 + axis, 4 + axis, 6 + axis]] = d[:, [1, 2, 3, 4]]
    np.testing.assert_allclose(out[:, 1:5], expected[:, :4], atol=2e-4)
    np.testing.assert_allclose(out[:, 5:], expected[:, 4:], atol=2e-5)
    # and the density that the estimator takes from it
    got = np.abs(out[:, 5] * out[:, 8] - out[:, 6] * out[:, 7])
    e = expected
    np.testing.assert_allclose(got, np.abs(e[:, 4] * e[:, 7] - e[:, 5] * e[:, 6]), rtol=2e-3)


@jit.entry
def _flats(points, q, v, scene, out):
    for i in range(len(points)):
        shot = shot_at(q, v, 0.0, 0.0, 1.0, scene)
        crossing.flat_crossing(out[i], points[i, 0], points[i, 1], shot, scene)


def test_flat_crossing_of_unscattered_light_has_closed_forms(scene):
    """Upright on the axis: dX/dP = 1 + n h / d, dX/dslope = (n - 1) h."""
    d, h = 10.0, 5.0
    out = np.zeros(1, crossing.FLAT)
    _flats(np.zeros((1, 2)), np.zeros(3), np.array([0.0, 0.0, 1.0]), scene, out)
    low, high, lever, lift = out[["low", "high", "lever", "lift"]][0]
    stretch = 1.0 + N_WATER * h / d
    assert low == pytest.approx(stretch, rel=1e-4)
    assert high == pytest.approx(stretch, rel=1e-4)
    assert lever == pytest.approx(math.sqrt(2) * (N_WATER - 1.0) * h, rel=1e-4)
    assert lift == pytest.approx(0.0, abs=1e-4)
    beta = (N_WATER - 1.0) * h / stretch
    # water that rises towards +x bends light to +x: the crossing moves to -x
    moves = list(out[["m11", "m12", "m21", "m22"]][0])
    np.testing.assert_allclose(moves, [-beta, 0.0, 0.0, -beta], rtol=1e-3, atol=1e-4)


# ---- locate, roots ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("extent", "spacing", "fine"), [(9.0, 0.13, None), (12.0, 0.1, 3.0), (15.0, 4.0, None)]
)
def test_locate_against_vertical_rays(extent, spacing, fine, scene_of):
    sea = JonswapSea(wind_speed=13.0, seed=1, waves="paper")
    coarse = 0.9 if fine else None
    mesh = sea.mesh(extent=extent, spacing=spacing, fine_extent=fine, coarse_spacing=coarse)
    scene = scene_of(mt.Link(), mesh)
    rng = np.random.default_rng(8)
    points = rng.uniform(-4.0, 4.0, (2000, 2))
    origins = np.column_stack([points, np.full(len(points), 10.0)])
    down = np.broadcast_to((0.0, 0.0, -1.0), origins.shape)
    hits = mt.BruteForceIntersector(mesh).intersect(origins, down)
    np.testing.assert_array_equal(located(scene, points), hits.facet)
    outside = np.array([[extent + 1.0, 0.0], [0.0, -extent - 1.0], [1e6, 1e6]])
    assert (located(scene, outside) == -1).all()


def test_every_vertex_and_edge_belongs_to_a_facet(scene_of):
    mesh = SEA.mesh(extent=3.0, spacing=0.3)
    scene = scene_of(mt.Link(), mesh)
    a, b = mesh.vertices[mesh.faces[:, 0], :2], mesh.vertices[mesh.faces[:, 1], :2]
    inner = (np.abs(np.concatenate([a, b])) < 2.9).all(axis=1)
    assert (located(scene, np.concatenate([a, b])[inner]) >= 0).all()
    middle = 0.5 * (a + b)
    lost = located(scene, middle) < 0
    # rounding may leave a point between two facets: a hair of the edges, never an area
    assert lost.mean() < 0.05


@jit.entry
def _roots(flat_at, radius, q, v, target, scene, flat, roots):
    shot = shot_at(q, v, target[0], target[1], 1.0, scene)
    crossing.flat_crossing(flat[0], flat_at[0], flat_at[1], shot, scene)
    return crossing.enumerate_roots(roots, 0, flat[0], radius, False, shot, scene)


def roots_near(flat_at, radius, q, v, target, scene):
    """Return the crossings near a crossing of the flat sea."""
    roots = np.zeros(64, crossing.ROOT)
    flat = np.zeros(1, crossing.FLAT)
    return roots[: _roots(flat_at, radius, q, v, np.array(target), scene, flat, roots)]


@jit.entry
def _newton_flat(q, v, target, start, scene, out):
    shot = shot_at(q, v, target[0], target[1], 1.0, scene)
    found, x, y, _ = crossing.newton(start[0], start[1], FLAT_SEA, True, 1.0, shot, scene)
    out[0], out[1], out[2] = 1.0 if found else 0.0, x, y


def analytic_landing(sea, p, q, v, scene):
    """Return where the chain lands that crosses the exact sea over points (n, 2); nan if not."""
    x, y = p.T
    slopes = np.stack(sea.slopes(x, y), axis=1)
    point = np.column_stack([p, sea.elevation(x, y)])
    n = len(p)
    ok, _, _, d = through(np.tile(q, (n, 1)), np.tile(v, (n, 1)), point - scene.emitter.position)
    normal = np.column_stack([-slopes, np.ones(n)])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    cos_i = (d * normal).sum(1)
    cos2_t = 1.0 - N_WATER**2 * (1.0 - cos_i**2)
    ok &= (cos_i > 0.0) & (cos2_t > 0.0)
    bent = N_WATER * d + (np.sqrt(np.maximum(cos2_t, 0.0)) - N_WATER * cos_i)[:, None] * normal
    center, axis = np.array(scene.target.center), np.array(scene.target.axis)
    off = point + (((center - point) @ axis) / (bent @ axis))[:, None] * bent - center
    off[~ok] = np.nan
    return off @ np.array([scene.target.e1, scene.target.e2]).T


def dense_roots(sea, q, v, target, scene, half):
    """Return all roots of the exact sea that Newton finds from a dense grid of starts."""
    gx, gy = np.meshgrid(np.linspace(-half, half, 81), np.linspace(-half, half, 11))
    p = np.column_stack([gx.ravel(), gy.ravel()])
    h = 1e-6
    for _ in range(30):
        f = analytic_landing(sea, p, q, v, scene) - target
        dx = (analytic_landing(sea, p + np.array([h, 0.0]), q, v, scene) - target - f) / h
        dy = (analytic_landing(sea, p + np.array([0.0, h]), q, v, scene) - target - f) / h
        det = dx[:, 0] * dy[:, 1] - dy[:, 0] * dx[:, 1]
        step = np.column_stack(
            [dy[:, 1] * f[:, 0] - dy[:, 0] * f[:, 1], dx[:, 0] * f[:, 1] - dx[:, 1] * f[:, 0]]
        )
        step /= np.where(det == 0.0, 1.0, det)[:, None]
        size = np.linalg.norm(step, axis=1)
        step *= np.minimum(1.0, 0.1 / np.maximum(size, 1e-30))[:, None]
        keep = np.isfinite(step).all(axis=1) & (np.abs(p) < 2 * half).all(axis=1)
        p, size = (p - step)[keep], size[keep]
    p = p[(size < 1e-7) & (np.abs(p) < half).all(axis=1)]
    found = []
    for r in p:
        if all(np.linalg.norm(r - f) > 1e-4 for f in found):
            found.append(r)
    return np.array(found).reshape(-1, 2)


CHAINS = {
    "unscattered": (np.zeros(3), np.array([0.0, 0.0, 1.0])),
    "forward": (np.array([0.0, 0.0, 5.0]), np.array([0.05, -0.03, 0.99821])),
    "aside": (np.array([0.4, 0.3, 8.0]), np.array([-0.35, 0.1, 0.93])),
}


@pytest.mark.parametrize("name", CHAINS)
@pytest.mark.parametrize("amplitude", [0.05, 0.1, 0.15])
def test_roots_of_a_focusing_sinusoid(name, amplitude, scene_of):
    """Dense search on the exact sea against the facets: same number, same places."""
    sea = SinusoidalSea(amplitude=amplitude, wavelength=2.0, phase=0.4)
    q, v = CHAINS[name]
    v = v / np.linalg.norm(v)
    scene = scene_of(mt.Link(), sea.mesh(extent=6.0, spacing=0.02))
    several = 0
    along = np.linspace(-1.0, 1.0, 3) + (
        0.21 if amplitude == 0.15 else 0.013
    )  # a fold at x = 0.21 m
    to_plane = np.array([scene.target.e1, scene.target.e2])[:, :2]
    for target in np.column_stack([along, np.full(len(along), 0.017)]) @ to_plane.T:
        flat = np.zeros(3)
        _newton_flat(q, v, np.array(target), np.zeros(2), scene, flat)
        assert flat[0] > 0
        roots = roots_near(flat[1:], 4.0, q, v, target, scene)
        expected = dense_roots(sea, q, v, np.array(target), scene, 3.0)
        got = np.stack([roots["x"], roots["y"]], axis=1)
        got = got[(np.abs(got) < 3.0).all(axis=1)]
        distance = np.linalg.norm(got[:, None] - expected[None], axis=2)
        assert len(got) == len(expected), (got, expected)
        assert (distance.min(axis=0) < 0.01).all()
        several += len(got) > 1
    if amplitude == 0.15 and name == "unscattered":
        assert several > 0, "the sea does not focus: the test shows nothing"


def test_roots_of_facets_against_every_facet(scene_of):
    """With faceted normals the roots are those of all planes that hold their own crossing."""
    sea = JonswapSea(wind_speed=13.0, seed=3, omega_max=8.0, waves="paper")
    mesh = sea.mesh(extent=5.0, spacing=0.2)
    scene = scene_of(mt.Link(), mesh, "facet")
    counts = []
    for name in CHAINS:
        q, v = CHAINS[name]
        v = v / np.linalg.norm(v)
        for target in ((0.0, 0.0), (0.03, 0.02), (-0.02, 0.04)):
            flat = np.zeros(3)
            _newton_flat(q, v, np.array(target), np.zeros(2), scene, flat)
            roots = roots_near(flat[1:], 5.0, q, v, target, scene)
            assert set(roots["facet"]) == brute_facets(q, v, target, mesh, scene), name
            counts.append(len(roots))
    assert max(counts) > 1
    assert len(set(counts)) > 1


def brute_facets(q, v, target, mesh, scene):
    """Return the facets whose own plane holds a root inside the facet, by Newton on each."""
    lo, hi = mesh.vertices[mesh.faces].min(axis=1), mesh.vertices[mesh.faces].max(axis=1)
    near = np.flatnonzero((np.abs(0.5 * (lo + hi)[:, :2]) < 4.0).all(axis=1))
    point = mesh.vertices[mesh.faces[near]].mean(axis=1)[:, :2]
    h = 1e-4
    for _ in range(12):
        at = aims(point, near, q, v, scene)
        dx = (aims(point + np.array([h, 0.0]), near, q, v, scene) - at)[:, 1:3] / h
        dy = (aims(point + np.array([0.0, h]), near, q, v, scene) - at)[:, 1:3] / h
        f = at[:, 1:3] - target
        det = dx[:, 0] * dy[:, 1] - dy[:, 0] * dx[:, 1]
        with np.errstate(all="ignore"):
            step = np.stack(
                [
                    (dy[:, 1] * f[:, 0] - dy[:, 0] * f[:, 1]) / det,
                    (dx[:, 0] * f[:, 1] - dx[:, 1] * f[:, 0]) / det,
                ],
                axis=1,
            )
        point = point - np.clip(np.nan_to_num(step), -1.0, 1.0)
    at = aims(point, near, q, v, scene)
    a, b, c = (mesh.vertices[mesh.faces[near, k], :2] for k in range(3))

    def side(p, r):
        return (r - p)[:, 0] * (point - p)[:, 1] - (r - p)[:, 1] * (point - p)[:, 0]

    inside = (side(a, b) > 0) & (side(b, c) > 0) & (side(c, a) > 0)
    landed = (np.abs(at[:, 1:3] - target) < 1e-6).all(axis=1) & (at[:, 0] > 0)
    return set(near[inside & landed])
