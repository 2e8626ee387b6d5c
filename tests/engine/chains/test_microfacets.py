"""Light through random slopes: refraction backwards, the quadrature of the disk."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import ncx2
from scipy.stats import norm as normal

import meshtrace as mt
from meshtrace.engine import crossing
from meshtrace.engine.chains import aimed, pencils, random_slopes
from meshtrace.kernels import interface, jit, vectors
from meshtrace.mesh import UnresolvedSlopes
from meshtrace.surfaces import FlatSea

ROUGH = UnresolvedSlopes((0.02, 0.01), (0.02, 0.01), 40.0)


@jit.allocating_entry
def towards(p, mesh_slope, goal, scene):
    """Return tilt, density, reflectance and flight of the slope that sends light to a point."""
    at = vectors.Vec3(p[0], p[1], p[2])
    way = vectors.minus(at, scene.emitter.position)
    w = vectors.scaled(1.0 / vectors.norm(way), way)
    size = math.sqrt(1.0 + mesh_slope[0] ** 2 + mesh_slope[1] ** 2)
    n = vectors.scaled(1.0 / size, vectors.Vec3(-mesh_slope[0], -mesh_slope[1], 1.0))
    s = random_slopes.slope_towards(
        at, n, w, w, vectors.norm(way), vectors.Vec2(goal[0], goal[1]), scene
    )
    return s.tilt.x, s.tilt.y, s.density, s.aim.rho, s.aim.flight


@jit.allocating_entry
def landing(p, slope_x, slope_y, scene):
    """Return where light crosses to through a slope, its reflectance and flight."""
    m = crossing.land_sloped(
        vectors.Vec3(p[0], p[1], p[2]),
        slope_x,
        slope_y,
        crossing.straight_shot(0.0, 0.0, scene),
        scene,
    )
    return m.at.x, m.at.y, m.rho, m.flight


@jit.allocating_entry
def there_and_back(roughness, x, y):
    """Return a slope after `slope_tilt` and `whitened`."""
    u = random_slopes.whitened(roughness, interface.slope_tilt(roughness, x, y))
    return u.x, u.y


@pytest.fixture
def rough_mesh():
    """Return level water with random slopes."""
    mesh = FlatSea().mesh(extent=20.0, spacing=5.0)
    return mt.TriangleMesh(mesh.vertices, mesh.faces, mesh.vertex_normals, ROUGH)


@pytest.mark.parametrize("receiver", [{}, {"position": (0.8, -0.5), "tilt_deg": 20.0}])
def test_the_slope_sends_light_to_the_point(receiver, rough_mesh, scene_of):
    """Forward refraction by the slope lands on the point; its density by finite differences."""
    scene = scene_of(mt.Link(receiver=mt.Receiver(**receiver)), rough_mesh)
    rng = np.random.default_rng(3)
    wind, variances = math.radians(ROUGH.direction_deg), np.array(ROUGH.vertex)
    seen = 0
    for _ in range(400):
        p = np.array([*rng.normal(0.3, 0.5, 2), rng.normal(0.0, 0.2)])
        mesh_slope, goal = rng.normal(0.0, 0.1, 2), rng.normal(0.0, 0.1, 2)
        tx, ty, density, rho, flight = towards(p, mesh_slope, goal, scene)
        if density == 0.0:
            continue
        seen += 1
        slope = mesh_slope + np.array([tx, ty])
        x, y, r, way = landing(p, *slope, scene)
        np.testing.assert_allclose((x, y, r, way), (*goal, rho, flight), rtol=1e-9, atol=1e-12)
        h = 1e-5
        columns = [
            np.subtract(landing(p, *(slope + d), scene)[:2], landing(p, *(slope - d), scene)[:2])
            for d in np.eye(2) * h
        ]
        jacobian = abs(np.linalg.det(np.array(columns) / (2.0 * h)))
        turned = np.array([[math.cos(wind), math.sin(wind)], [-math.sin(wind), math.cos(wind)]])
        u = turned @ (tx, ty)
        law = math.exp(-0.5 * float(np.sum(u**2 / variances)))
        law /= 2.0 * math.pi * math.sqrt(float(np.prod(variances)))
        assert density == pytest.approx(law / jacobian, rel=1e-6)
    assert seen > 50


def test_whitened_slopes():
    x, y = there_and_back(interface.Roughness(0.2, 0.1, math.cos(0.3), math.sin(0.3)), 1.3, -0.4)
    assert (x, y) == pytest.approx((1.3, -0.4), rel=1e-12)


@pytest.mark.parametrize("blur", [0.1, 0.49, 0.51, 1.0, 2.5, 6.0, 20.0])
def test_a_gaussian_spot_anywhere_on_the_disk(blur):
    """Share of a Gaussian within the disk: the noncentral chi-square law."""
    points, shares, *_ = aimed._rule(aimed._disk_nodes(blur), False)
    assert shares.sum() == pytest.approx(1.0, rel=1e-12)
    center = np.linspace(0.0, 1.0 + 3.0 / blur, 50)
    expected = ncx2.cdf(blur**2, 2, (center * blur) ** 2)
    off = points[:, None] - center[:, None] * (math.cos(0.3), math.sin(0.3))
    spot = np.exp(-0.5 * blur**2 * (off**2).sum(axis=2)) * blur**2 / 2.0
    np.testing.assert_allclose(shares @ spot, expected, rtol=0.0, atol=1e-3 * expected.max())


@pytest.mark.parametrize("length", [0.1, 1.0, 3.0, 6.25, 12.5])
@pytest.mark.parametrize("rooted", [False, True])
def test_a_gaussian_profile_anywhere_on_a_line(length, rooted):
    """Share of a Gaussian on an interval, by Gauss nodes of it or of the square root."""
    rule = aimed._rule(None, False)
    n = pencils._number_of_nodes.py_func(length, 1.0, rule)
    v, weights = rule.nodes[n - 1, :n], rule.weights[n - 1, :n]
    x, weights = (v * v, 2.0 * v * weights) if rooted else (v, weights)
    center = np.linspace(-3.0, length + 3.0, 60)
    found = length * weights @ normal.pdf(length * x[:, None] - center)
    expected = normal.cdf(length - center) - normal.cdf(-center)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-3 * expected.max())
