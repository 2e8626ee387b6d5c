"""One crossing of the surface: Fresnel, Snell, printed forms, contradicting normals."""

import math

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.kernels import jit, vectors
from meshtrace.kernels.interface import (
    Direction,
    Interface,
    Snell,
    branches,
    reflectance,
    refract,
    refract_as_printed,
)
from meshtrace.optics import fresnel

N = 1.33


@jit.inlined
def vector(a):
    return vectors.Vec3(a[0], a[1], a[2])


@jit.allocating_entry
def _cross(d, n, cos_i, n1, n2):
    return refract(vector(d), vector(n), cos_i, n1, n2)


def cross(d, n, cos_i, n1, n2):
    cos_t, out = _cross(d, n, cos_i, n1, n2)
    return cos_t, *out


@jit.allocating_entry
def rho(cos_i, cos_t, n1, n2):
    return reflectance(cos_i, cos_t, n1, n2)


def switches(snell, direction):
    return Interface(int(snell), int(direction), 0, True, True, 1.0, 0)


@jit.allocating_entry
def _printed(d, n, cos_i, n1, n2, interface):
    return refract_as_printed(vector(d), vector(n), cos_i, n1, n2, interface)


def printed(d, n, cos_i, n1, n2, snell, direction):
    cos_t, loss, out = _printed(d, n, cos_i, n1, n2, switches(snell, direction))
    return cos_t, loss, *out


@jit.allocating_entry
def _branches(d, n, g, n1, n2, interface):
    return branches(vector(d), vector(n), vector(g), n1, n2, interface)


def unit(zenith, azimuth=0.0):
    s = math.sin(zenith)
    return np.array([s * math.cos(azimuth), s * math.sin(azimuth), math.cos(zenith)])


def branch(d, n, g, n1=N, n2=1.0):
    switch = switches(Snell.PHYSICAL, Direction.VECTOR)
    loss, transmitted, reflected = _branches(d, n, g, n1, n2, switch)
    return loss, np.array(transmitted), np.array(reflected)


@pytest.mark.parametrize(
    ("theta_i_deg", "theta_t_deg", "expected"),
    [
        (0.0, 0.0, 0.02005931),
        (10.0, 13.353131, 0.02009301),
        (20.0, 27.057650, 0.02072333),
        (30.0, 41.682325, 0.02508987),
        (36.94, 53.063426, 0.03856072),
        (40.0, 58.749520, 0.05424741),
        (45.0, 70.127606, 0.13418672),
        (48.0, 81.257953, 0.39445633),
    ],
)
def test_reference_table_water_to_air(theta_i_deg, theta_t_deg, expected):
    d = unit(math.radians(theta_i_deg))
    cos_t, x, y, z = cross(d, (0.0, 0.0, 1.0), d[2], N, 1.0)
    assert math.degrees(math.acos(cos_t)) == pytest.approx(theta_t_deg, abs=2e-6)
    assert (x, y, z) == pytest.approx(unit(math.acos(cos_t)), abs=1e-12)
    assert rho(d[2], cos_t, N, 1.0) == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize(("n1", "n2"), [(N, 1.0), (1.0, N), (1.33, 1.33), (1.0, 1.0)])
def test_agrees_with_the_array_twin(n1, n2):
    rng = np.random.default_rng(1)
    for _ in range(300):
        n = unit(*rng.uniform(0.0, 1.0, 2) * (0.6, 6.28))
        d = unit(rng.uniform(0.0, 1.2), rng.uniform(0.0, 6.28))
        cos_i = float(d @ n)
        if cos_i <= 0.0:
            continue
        cos_t, *out = cross(d, n, cos_i, n1, n2)
        expected = fresnel.refract(d, n, n1, n2)
        if np.isnan(expected).any():
            assert cos_t < 0.0
            continue
        np.testing.assert_allclose(out, expected, atol=2e-15)
        assert cos_t == pytest.approx(expected @ n, abs=1e-14)
        assert rho(cos_i, cos_t, n1, n2) == pytest.approx(
            float(fresnel.fresnel_reflectance(min(cos_i, 1.0), n1, n2)), abs=1e-13
        )


def test_path_is_reversible_and_so_is_the_reflectance():
    for theta in np.radians(np.linspace(0.0, 48.7, 30)):
        d = unit(theta, 0.3)
        cos_t, x, y, z = cross(d, (0.0, 0.0, 1.0), d[2], N, 1.0)
        back = cross((-x, -y, -z), (0.0, 0.0, -1.0), cos_t, 1.0, N)
        assert back[0] == pytest.approx(d[2], abs=1e-14)
        np.testing.assert_allclose(back[1:], -d, atol=1e-13)
        assert rho(d[2], cos_t, N, 1.0) == pytest.approx(rho(cos_t, d[2], 1.0, N), rel=1e-9)


def test_total_internal_reflection_begins_at_the_critical_angle():
    critical = math.asin(1.0 / N)
    n = np.array([0.0, 0.0, 1.0])
    below, above = unit(critical - 1e-9), unit(critical + 1e-9)
    assert cross(below, n, below[2], N, 1.0)[0] > 0.0
    assert cross(above, n, above[2], N, 1.0)[0] < 0.0
    total, _, reflected = branch(above, n, n)
    assert total == 1.0
    np.testing.assert_allclose(reflected, above * (1, 1, -1), atol=1e-15)


def test_grazing_light_from_the_air_is_reflected_and_bent_to_the_critical_angle():
    d = unit(math.pi / 2 - 1e-6) * (1, 1, -1)
    n = np.array([0.0, 0.0, -1.0])
    total, transmitted, reflected = branch(d, n, n, 1.0, N)
    assert total == pytest.approx(1.0, abs=1e-5)
    assert -transmitted[2] == pytest.approx(math.cos(math.asin(1 / N)), abs=1e-6)
    np.testing.assert_allclose(reflected, d * (1, 1, -1), atol=1e-15)


def test_printed_snell_is_upside_down():
    """E2: sin theta_r = n2/n1 sin theta_i, with the critical angle of the paper's text."""
    n = (0.0, 0.0, 1.0)
    d = unit(math.radians(30.0), 0.5)
    cos_t, loss, *out = printed(d, n, d[2], N, 1.0, Snell.PAPER, Direction.VECTOR)
    theta_t = math.asin(math.sin(math.radians(30.0)) / N)
    assert cos_t == pytest.approx(math.cos(theta_t), abs=1e-14)
    np.testing.assert_allclose(out, unit(theta_t, 0.5), atol=1e-14)
    # the printed Fresnel formula by angles, with the printed angle
    theta_i = math.radians(30.0)
    s = math.sin(theta_t - theta_i) / math.sin(theta_t + theta_i)
    p = math.tan(theta_t - theta_i) / math.tan(theta_t + theta_i)
    assert loss == pytest.approx(0.5 * (s * s + p * p), abs=1e-12)
    steep = unit(math.radians(48.8))
    assert printed(steep, n, steep[2], N, 1.0, Snell.PAPER, Direction.VECTOR)[0] < 0.0


def test_printed_direction_takes_the_sine_of_the_components():
    """E3: n cos theta_t + sin(theta_t t) by components; not of unit length."""
    n = (0.0, 0.0, 1.0)
    d = unit(math.radians(20.0), 0.7)
    cos_t, _, *out = printed(d, n, d[2], N, 1.0, Snell.PHYSICAL, Direction.PAPER)
    theta_t = math.radians(27.057650)
    expected = (
        math.sin(theta_t * math.cos(0.7)),
        math.sin(theta_t * math.sin(0.7)),
        math.cos(theta_t),
    )
    np.testing.assert_allclose(out, expected, atol=1e-8)
    assert cos_t == pytest.approx(math.cos(theta_t), abs=1e-8)
    assert abs(np.linalg.norm(out) - 1.0) > 1e-4


def test_printed_forms_with_right_switches_are_the_vector_form():
    d, n = unit(0.5, 1.0), unit(0.1, -2.0)
    cos_i = float(d @ n)
    right = cross(d, n, cos_i, N, 1.0)
    got = printed(d, n, cos_i, N, 1.0, Snell.PHYSICAL, Direction.VECTOR)
    np.testing.assert_allclose((got[0], *got[2:]), right, atol=1e-14)


def test_printed_snell_stays_finite_for_light_from_the_air():
    """Upside-down Snell, sin theta_t = 1.33 sin theta_i, has no solution past 48.75 degrees."""
    n = (0.0, 0.0, -1.0)
    for zenith_deg in (10.0, 48.0, 49.0, 60.0, 85.0):
        d = unit(math.radians(zenith_deg)) * (1, 1, -1)
        got = printed(d, n, -d[2], 1.0, N, Snell.PAPER, Direction.VECTOR)
        assert np.isfinite(got).all(), f"{zenith_deg} deg: {got}"


@pytest.mark.parametrize("lean_deg", [0.0, 10.0, 30.0, 60.0])
def test_light_leaves_on_its_own_side_whatever_the_vertex_normal(lean_deg):
    """Where the interpolated normal contradicts the facet, the facet's own normal decides."""
    g = np.array([0.0, 0.0, 1.0])
    rng = np.random.default_rng(5)
    for _ in range(500):
        d = unit(rng.uniform(0.0, math.pi / 2 - 1e-6), rng.uniform(0.0, 6.3))
        n = unit(math.radians(lean_deg), rng.uniform(0.0, 6.3))
        loss, transmitted, reflected = branch(d, n, g)
        assert 0.0 <= loss <= 1.0
        assert reflected @ g < 0.0
        assert np.linalg.norm(reflected) == pytest.approx(1.0, abs=1e-14)
        if loss < 1.0:
            assert transmitted @ g > 0.0
            assert np.linalg.norm(transmitted) == pytest.approx(1.0, abs=1e-14)
        axis = np.cross(d, reflected - d)
        turned = n if abs(axis @ n) < 1e-12 else g
        np.testing.assert_allclose(reflected, d - 2 * (d @ turned) * turned, atol=1e-12)


def test_sound_vertex_normals_are_used():
    g, n, d = np.array([0.0, 0.0, 1.0]), unit(0.1, 1.0), unit(0.3, 2.0)
    loss, transmitted, reflected = branch(d, n, g)
    np.testing.assert_allclose(transmitted, fresnel.refract(d, n, N, 1.0), atol=1e-14)
    np.testing.assert_allclose(reflected, fresnel.reflect(d, n), atol=1e-14)
    assert loss == pytest.approx(float(fresnel.fresnel_reflectance(d @ n, N, 1.0)), abs=1e-14)


@pytest.mark.parametrize(
    ("wind_speed", "model", "expected"),
    [
        (5.0, "w_0225", 0.99756902),
        (13.0, "w_0225", 0.88987770),
        (5.0, "paper_0255", 0.99756902),
        (13.0, "paper_0255", 0.86768251),
        (5.0, "monahan80", 0.99914848),
        (13.0, "monahan80", 0.97540184),
    ],
)
def test_whitecap_transmittance(wind_speed, model, expected):
    foam = mt.Whitecaps(wind_speed=wind_speed, model=model)
    assert foam.transmittance == pytest.approx(expected, abs=5e-9)
