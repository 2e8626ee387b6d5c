"""turn() against rotation matrices, at the poles above all."""

import math

import numpy as np
import pytest

from meshtrace.kernels import jit
from meshtrace.kernels.vectors import (
    UP,
    Vec3,
    along,
    blend,
    combine,
    cross,
    cross2,
    dot,
    dot2,
    minus,
    minus2,
    norm,
    plus,
    row,
    scaled,
    turn,
    unit,
    write,
)


@jit.allocating_entry
def turned(d, s, u):
    out = np.empty((len(s), 3))
    for i in range(len(s)):
        write(out[i], turn(Vec3(d[0], d[1], d[2]), s[i], u[i]))
    return out


@jit.allocating_entry
def walk(d, s, u):
    """Return |d|^2 - 1 after many turns in a row."""
    for i in range(len(s)):
        d = turn(d, s[i], u[i])
    return dot(d, d) - 1.0


def direction(theta, phi):
    return np.array(
        [math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)]
    )


def near_pole(dz):
    """Return a unit vector with this z, computed without cancellation of x and y."""
    rest = math.sqrt((1.0 - abs(dz)) * (1.0 + abs(dz)))
    return np.array([0.6 * rest, -0.8 * rest, dz])


AXES = {
    "up": np.array([0.0, 0.0, 1.0]),
    "down": np.array([0.0, 0.0, -1.0]),
    "almost up": near_pole(1.0 - 1e-12),
    "almost down": near_pole(-1.0 + 1e-12),
    "near up": near_pole(1.0 - 1e-5),
    "near down": near_pole(-1.0 + 1e-5),
    "level": np.array([1.0, 0.0, 0.0]),
    "level, minus zero": np.array([0.0, 1.0, -0.0]),
    "just below level": direction(math.pi / 2 + 1e-12, 1.0),
    "slanted": direction(0.7, 2.1),
    "slanted down": direction(2.6, -1.3),
}

axis = pytest.mark.parametrize("d", AXES.values(), ids=AXES.keys())


@axis
def test_polar_angle_and_length(d):
    rng = np.random.default_rng(1)
    s = np.concatenate([[0.0, 1.0, 0.5, 1e-16, 1e-12, 1e-6], rng.random(1000)])
    out = turned(d, s, rng.random(len(s)))
    np.testing.assert_allclose(np.linalg.norm(out, axis=1), 1.0, rtol=0, atol=4e-16)
    np.testing.assert_allclose(out @ d, 1.0 - 2.0 * s, rtol=0, atol=2e-15)


@axis
def test_small_angles_keep_their_digits(d):
    """sin(theta) = |d x d'| to a relative 1e-6 down to 1e-8 rad: the peak of sea water."""
    theta = np.geomspace(1e-8, 1e-2, 25)
    out = turned(d, np.sin(theta / 2) ** 2, np.linspace(0.05, 0.95, 25))
    sine = np.linalg.norm(np.cross(np.broadcast_to(d, out.shape), out), axis=1)
    np.testing.assert_allclose(sine, np.sin(theta), rtol=1e-6, atol=1e-16)


@axis
def test_azimuth_is_a_right_handed_circle(d):
    """At 90 degrees the turned vectors are e1 cos phi + e2 sin phi with e1 x e2 = d."""
    e1, e2 = turned(d, np.full(2, 0.5), np.array([0.0, 0.25]))
    np.testing.assert_allclose([e1 @ e2, e1 @ d, e2 @ d], 0.0, atol=1e-15)
    np.testing.assert_allclose(np.cross(e1, e2), d, atol=1e-15)
    u = np.linspace(0.0, 1.0, 33)
    phi = 2.0 * np.pi * u[:, None]
    out = turned(d, np.full(33, 0.2), u)
    expected = 0.6 * d + 0.8 * (np.cos(phi) * e1 + np.sin(phi) * e2)
    np.testing.assert_allclose(out, expected, atol=1e-15)


@axis
def test_opposite_azimuths_cancel(d):
    """No mean deflection: a pole branch would bend the beam (3-6 % too much gain on axis)."""
    u = (np.arange(64) + 0.37) / 64.0
    for s in (1e-14, 1e-9, 1e-5, 0.1):
        mean = turned(d, np.full(64, s), u).mean(axis=0)
        np.testing.assert_allclose(mean, (1.0 - 2.0 * s) * d, rtol=0, atol=1e-15)


def test_length_does_not_drift():
    rng = np.random.default_rng(2)
    n = 100_000
    assert abs(walk(UP, rng.random(n) ** 4, rng.random(n))) < 1e-15


@jit.allocating_entry
def algebra(a, b, c, s, t, out):
    p, q, r = row(a, 0), row(b, 0), row(c, 0)
    vectors = (
        cross(p, q),
        plus(p, q),
        minus(p, q),
        scaled(s, p),
        along(p, q, t),
        combine(s, p, t, q),
        blend(s, t, p, q, r),
        unit(p),
    )
    for i in range(len(vectors)):
        write(out[i], vectors[i])
    return dot(p, q), norm(p), dot2(p, q), cross2(p, q), minus2(p, q)


def test_algebra_against_numpy():
    a, b, c = np.random.default_rng(3).normal(size=(3, 1, 3))
    s, t = 0.3, 0.45
    out = np.empty((8, 3))
    scalars = algebra(a, b, c, s, t, out)
    a, b, c = a[0], b[0], c[0]
    expected = [
        np.cross(a, b),
        a + b,
        a - b,
        s * a,
        a + t * b,
        s * a + t * b,
        (1 - s - t) * a + s * b + t * c,
        a / np.linalg.norm(a),
    ]
    np.testing.assert_allclose(out, expected, atol=1e-15)
    area = np.linalg.det([a[:2], b[:2]])
    products = [a @ b, np.linalg.norm(a), a[:2] @ b[:2], area]
    np.testing.assert_allclose(scalars[:4], products, atol=1e-15, rtol=1e-15)
    np.testing.assert_array_equal(scalars[4], (a - b)[:2])
