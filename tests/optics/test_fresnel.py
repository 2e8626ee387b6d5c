"""Fresnel and Snell: reference values, reciprocity, energy, total internal reflection."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meshtrace.optics import fresnel_reflectance
from meshtrace.optics.fresnel import (
    hemispheric_reflectance,
    polarised_reflectances,
    reflect,
    refract,
)

N = 1.33
UP = np.array([0.0, 0.0, 1.0])

# angle of incidence in water, of refraction in air [deg], reflectance, transmittance (n 1.33)
REFERENCE = np.array(
    [
        (0.0, 0.0, 0.02005931, 0.97994069),
        (10.0, 13.353131, 0.02009301, 0.97990699),
        (20.0, 27.057650, 0.02072333, 0.97927667),
        (30.0, 41.682325, 0.02508987, 0.97491013),
        (40.0, 58.749520, 0.05424741, 0.94575259),
        (45.0, 70.127606, 0.13418672, 0.86581328),
        (48.0, 81.257953, 0.39445633, 0.60554367),
    ]
)


def direction(theta, phi=0.0):
    return np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])


def test_reference_table():
    theta = np.radians(REFERENCE[:, 0])
    rho = fresnel_reflectance(np.cos(theta), N, 1.0)
    np.testing.assert_allclose(rho, REFERENCE[:, 2], atol=5.1e-9)
    np.testing.assert_allclose(1.0 - rho, REFERENCE[:, 3], atol=5.1e-9)
    refracted = refract(np.array([direction(t) for t in theta]), UP, N, 1.0)
    angle = np.degrees(np.arctan2(refracted[:, 0], refracted[:, 2]))
    np.testing.assert_allclose(angle, REFERENCE[:, 1], atol=5.1e-7)


def test_brewster_angle():
    theta = np.arctan(1.0 / N)
    assert np.degrees(theta) == pytest.approx(36.94, abs=5e-3)
    rho = fresnel_reflectance(np.cos(np.radians(36.94)), N, 1.0)
    assert rho == pytest.approx(0.03856072, abs=5.1e-9)
    cos_t = refract(direction(theta), UP, N, 1.0)[2]
    r_s = (N * np.cos(theta) - cos_t) / (N * np.cos(theta) + cos_t)
    assert fresnel_reflectance(np.cos(theta), N, 1.0) == pytest.approx(0.5 * r_s**2, rel=1e-12)


def test_the_printed_transmittances_away_from_normal_incidence():
    # T_s and T_p of the paper, whose mean is 1 - rho
    theta_i = np.radians([5.0, 25.0, 45.0])
    theta_t = np.arcsin(N * np.sin(theta_i))
    t_s = np.sin(2 * theta_i) * np.sin(2 * theta_t) / np.sin(theta_i + theta_t) ** 2
    t_p = t_s / np.cos(theta_i - theta_t) ** 2
    rho = fresnel_reflectance(np.cos(theta_i), N, 1.0)
    np.testing.assert_allclose(1.0 - rho, 0.5 * (t_s + t_p), rtol=1e-13)


def test_total_internal_reflection():
    critical = np.arcsin(1.0 / N)
    assert np.degrees(critical) == pytest.approx(48.7535, abs=5e-5)
    theta = critical + np.array([1e-9, 0.1, np.pi / 2.0 - critical])
    np.testing.assert_array_equal(fresnel_reflectance(np.cos(theta), N, 1.0), 1.0)
    assert np.all(np.isnan(refract(np.array([direction(t) for t in theta]), UP, N, 1.0)))
    assert fresnel_reflectance(np.cos(critical - 1e-9), N, 1.0) < 1.0
    assert fresnel_reflectance(0.0, 1.0, N) == pytest.approx(1.0, abs=1e-15)


def test_equal_indices_change_nothing():
    d = np.array([direction(t, 1.0) for t in (0.0, 0.7, 1.5)])
    np.testing.assert_allclose(refract(d, UP, N, N), d, atol=1e-15)
    np.testing.assert_allclose(fresnel_reflectance(d[:, 2], N, N), 0.0, atol=1e-20)


@settings(max_examples=200, deadline=None)
@given(
    theta=st.floats(0.0, 1.55),
    phi=st.floats(0.0, 6.28),
    tilt=st.floats(0.0, 1.0),
    n1=st.floats(1.0, 2.0),
    n2=st.floats(1.0, 2.0),
)
def test_refraction_keeps_the_plane_obeys_snell_and_is_reversible(theta, phi, tilt, n1, n2):
    d, n = direction(theta, phi), direction(tilt, 0.4)
    t = refract(d, n, n1, n2)
    sin_i = np.linalg.norm(np.cross(d, n))
    if n1 * sin_i > n2 * (1.0 - 1e-6):
        return
    assert np.linalg.norm(t) == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(n1 * np.cross(d, n), n2 * np.cross(t, n), atol=1e-12)
    assert np.sign(t @ n) == np.sign(d @ n)
    np.testing.assert_allclose(refract(-t, n, n2, n1), -d, atol=1e-8)
    cos_i, cos_t = min(abs(d @ n), 1.0), min(abs(t @ n), 1.0)
    there, back = fresnel_reflectance(cos_i, n1, n2), fresnel_reflectance(cos_t, n2, n1)
    assert there == pytest.approx(back, abs=1e-7)
    np.testing.assert_array_equal(refract(d, -n, n1, n2), t)


def test_reflection_mirrors_at_the_plane():
    d = np.array([direction(0.3, 0.2), direction(1.2, 4.0)])
    n = np.array([direction(0.1), -direction(0.5, 1.0)])
    r = reflect(d, n)
    np.testing.assert_allclose(np.linalg.norm(r, axis=1), 1.0, atol=1e-15)
    np.testing.assert_allclose(np.sum(r * n, axis=1), -np.sum(d * n, axis=1), atol=1e-15)
    np.testing.assert_allclose(np.cross(r, n), np.cross(d, n), atol=1e-15)
    np.testing.assert_allclose(reflect(r, n), d, atol=1e-15)


def walsh_reflectance(n):
    """Return the reflectance of diffuse light from the side of the lower index, in closed form.

    Walsh 1926, as in Duntley 1942, J. Opt. Soc. Am. 32, 61.
    """
    q = n * n
    return (
        0.5
        + (n - 1.0) * (3.0 * n + 1.0) / (6.0 * (n + 1.0) ** 2)
        + q * (q - 1.0) ** 2 / (q + 1.0) ** 3 * math.log((n - 1.0) / (n + 1.0))
        - 2.0 * n**3 * (q + 2.0 * n - 1.0) / ((q + 1.0) * (q * q - 1.0))
        + 8.0 * q**2 * (q * q + 1.0) / ((q + 1.0) * (q * q - 1.0) ** 2) * math.log(n)
    )


def test_hemispheric_reflectance():
    for n in (1.2, N, 1.5):
        wanted = walsh_reflectance(n)
        assert hemispheric_reflectance(1.0, n) == pytest.approx(wanted, rel=1e-8)
        back = 1.0 - (1.0 - wanted) / n**2
        assert hemispheric_reflectance(n, 1.0) == pytest.approx(back, rel=1e-9)
    root = Path(__file__).parents[2]
    whole = json.loads((root / "tests/data/daylight_downlink_reference.json").read_text())
    for place, ends in (("air", (1.0, N)), ("water", (N, 1.0))):
        wanted = whole["uniform_sky_still_water"][f"reflected_from_{place}"]
        assert hemispheric_reflectance(*ends) == pytest.approx(wanted, abs=1e-6)
    # by brute force, from the water side, over its kink
    cos_i = (np.arange(400_000) + 0.5) / 400_000
    mean = 2.0 * np.mean(cos_i * fresnel_reflectance(cos_i, N, 1.0))
    assert hemispheric_reflectance(N, 1.0) == pytest.approx(mean, abs=1e-6)


def test_polarised_light_of_the_reference_and_of_the_page_of_limits():
    root = Path(__file__).parents[2]
    whole = json.loads((root / "tests/data/daylight_downlink_reference.json").read_text())
    wanted = whole["polarisation"]
    cos_i = np.cos(np.radians(wanted["air_incidence_deg"]))
    rho_s, rho_p = polarised_reflectances(cos_i, 1.0, N)
    through = (1.0 - rho_s) / (1.0 - fresnel_reflectance(cos_i, 1.0, N))
    np.testing.assert_allclose(through, wanted["Ts_over_T"], atol=1e-6)
    other = (1.0 - rho_p) / (1.0 - fresnel_reflectance(cos_i, 1.0, N))
    np.testing.assert_allclose(through + other, 2.0, atol=1e-15)
    contrast = (rho_s - rho_p) / (rho_s + rho_p)
    np.testing.assert_allclose(contrast, wanted["reflection_contrast"], atol=6e-5)
    page = (root / "docs/limits.md").read_text()
    for name, values, digits in (("T_s / T", through, 4), ("contrast", contrast, 2)):
        row = " | ".join(f"{v:.{digits}f}" for v in values)
        assert f"| {name} | {row} |" in page
    # Brewster's angle, and total reflection
    rho_s, rho_p = polarised_reflectances(np.cos(np.arctan(N)), 1.0, N)
    assert rho_p < 1e-30 < rho_s
    np.testing.assert_array_equal(polarised_reflectances(0.1, N, 1.0), (1.0, 1.0))


def test_errors():
    with pytest.raises(ValueError, match=r"cos_i: .* allowed: 0 <= cos_i <= 1"):
        fresnel_reflectance(-0.1, N, 1.0)
    with pytest.raises(ValueError, match=r"cos_i: .* allowed"):
        fresnel_reflectance(float("nan"), N, 1.0)
    with pytest.raises(ValueError, match=r"n2: 0\.0, allowed"):
        refract(UP, UP, N, 0.0)
    with pytest.raises(ValueError, match=r"n1: nan, allowed"):
        hemispheric_reflectance(float("nan"), 1.0)
