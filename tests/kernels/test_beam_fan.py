"""Directions and distances towards the beam of a narrow source: densities against their draws."""

import math

import numpy as np
import pytest
from numba import njit

import meshtrace as mt
from meshtrace.bvh import EmbreeIntersector
from meshtrace.kernels.beam_fan import (
    distance_density,
    drawn_in_beam,
    drawn_in_fan,
    fan_density,
    fan_of,
    pass_of,
)
from meshtrace.kernels.vectors import Vec3, minus, unit
from meshtrace.surfaces import FlatSea
from meshtrace.transport.adjoint import AdjointPaths, _Over

LAMPS = {
    "led": mt.Led(half_angle_deg=10.0),
    "slanted beam": mt.GaussianBeam(divergence_deg=2.0, zenith_deg=30.0, azimuth_deg=70.0),
    "top hat": mt.TopHatBeam(divergence_deg=5.0),
}
POINTS = ((4.0, 1.0, -3.0), (0.3, 0.0, -7.0), (-2.0, 0.5, -12.0))


def world_of(lamp):
    mesh = FlatSea().mesh(extent=20.0, spacing=5.0)
    paths = AdjointPaths(mt.Link(transmitter=lamp), 64, 1)
    return _Over(paths, mesh, EmbreeIntersector(mesh, 1), False)._world(0, 0, 0)


@njit
def fan_at(at, lamp, width, optics):
    return fan_of(at, unit(minus(lamp, at)), lamp, width, optics)


@njit
def densities(fan, directions, optics):
    out = np.empty(len(directions))
    for i in range(len(directions)):
        w = Vec3(directions[i, 0], directions[i, 1], directions[i, 2])
        out[i] = fan_density(fan, w, optics)
    return out


@njit
def draws(fan, u, v, optics):
    out = np.empty((len(u), 3))
    for i in range(len(u)):
        w = drawn_in_fan(fan, u[i], v[i], optics)
        out[i, 0], out[i, 1], out[i, 2] = w.x, w.y, w.z
    return out


@njit
def line_at(p, d, longest, lamp, width, optics):
    return pass_of(p, d, longest, lamp, width, optics)


@njit
def distances(line, longest, u):
    out = np.empty(len(u))
    for i in range(len(u)):
        out[i] = drawn_in_beam(line, longest, u[i])
    return out


@njit
def distance_densities(line, t):
    out = np.empty(len(t))
    for i in range(len(t)):
        out[i] = distance_density(line, t[i])
    return out


@pytest.mark.parametrize("name", LAMPS)
@pytest.mark.parametrize("point", POINTS, ids=str)
@pytest.mark.thorough
def test_directions_of_a_fan(name, point):
    """The mean of f over drawn directions is the integral of f times their density.

    By quadrature in the angle beside the source and the tilt, for f of 1 and of the axes.
    """
    world = world_of(LAMPS[name])
    lamp, optics = world.optics.emitter.position, world.optics
    fan = fan_at(Vec3(*point), lamp, world.beam, optics)
    assert fan.visible
    e1, e2, e3 = (np.array(a) for a in (fan.to_lamp, fan.along, fan.across))
    np.testing.assert_allclose(
        np.array([e1, e2, e3]) @ np.array([e1, e2, e3]).T, np.eye(3), atol=1e-12
    )
    u = (np.arange(2000) + 0.5) / 2000
    grid = np.array(np.meshgrid(u, u)).reshape(2, -1)
    drawn = draws(fan, *grid, optics)
    np.testing.assert_allclose(np.linalg.norm(drawn, axis=1), 1.0, rtol=1e-12)
    edge = np.geomspace(1e-7, fan.last - fan.alpha, 1501)
    phi, d_phi = 0.5 * (edge[1:] + edge[:-1]), np.diff(edge)
    edge = np.sinh(np.linspace(-np.arcsinh(1e5), np.arcsinh(1e5), 601)) / 1e5
    x, d_x = 0.5 * (edge[1:] + edge[:-1]), np.diff(edge)
    phi, x, area = phi[:, None], x[None], d_phi[:, None] * d_x
    flat = np.sqrt(1.0 - x * x)
    w = (flat * np.cos(phi))[..., None] * e1 + (flat * np.sin(phi))[..., None] * e2
    w = (w + (x + 0.0 * phi)[..., None] * e3).reshape(-1, 3)
    weight = densities(fan, w, optics) * area.ravel()
    assert weight.sum() == pytest.approx(1.0, abs=3e-3)
    np.testing.assert_allclose(weight @ w, drawn.mean(axis=0), atol=3e-3)
    np.testing.assert_allclose(weight @ w**2, (drawn**2).mean(axis=0), atol=3e-3)


@pytest.mark.parametrize("name", LAMPS)
@pytest.mark.parametrize("point", POINTS, ids=str)
@pytest.mark.parametrize("longest", [math.inf, 8.0])
def test_distances_about_the_beam(name, point, longest):
    world = world_of(LAMPS[name])
    lamp = world.optics.emitter.position
    d = np.array([-0.7, 0.1, -0.5])
    d /= np.linalg.norm(d)
    line = line_at(Vec3(*point), Vec3(*d), longest, lamp, world.beam, world.optics)
    t = distances(line, longest, (np.arange(20_000) + 0.5) / 20_000)
    assert (np.diff(t) >= 0.0).all()
    assert 0.0 <= t[0] <= t[-1] < longest
    edge = np.linspace(0.0, min(longest, 30.0), 50_001)
    middle = 0.5 * (edge[1:] + edge[:-1])
    share = np.cumsum(distance_densities(line, middle) * np.diff(edge))
    found = np.searchsorted(t, edge[1:]) / len(t)
    np.testing.assert_allclose(share, found, atol=1e-3)


def test_wide_patterns_have_no_fan():
    for lamp in (mt.Led(half_angle_deg=60.0), mt.IsotropicSource()):
        world = world_of(lamp)
        assert world.beam == world.fan == world.lit == 0.0
        assert not fan_at(
            Vec3(4.0, 1.0, -3.0), world.optics.emitter.position, 0.0, world.optics
        ).visible
