"""Choppy seas against closed forms of Gerstner's wave, finite differences and root searches."""

import json
import math
import pickle

import numpy as np
import pytest
from scipy.optimize import brentq

from meshtrace.errors import Refused
from meshtrace.surfaces import (
    Elfouhaily,
    JonswapSea,
    MeasuredSea,
    SinusoidalSea,
    SpectralSea,
    sea_from_config,
)

GERSTNER = SinusoidalSea(amplitude=0.1, wavelength=2.0, choppy=True)
SEAS = [
    SinusoidalSea(amplitude=0.2, wavelength=3.0, direction_deg=30.0, phase=0.4, choppy=True),
    SinusoidalSea(amplitude=0.05, wavelength=3.0, depth=0.4, choppy=True),
    JonswapSea(waves="paper", wind_speed=5.0, seed=1, choppy=True),
    JonswapSea(waves="paper", wind_speed=13.0, seed=7, wind_direction_deg=40.0, choppy=True),
    SpectralSea(spectrum=Elfouhaily(wind_speed=8.0), spreading="elfouhaily", choppy=True),
    MeasuredSea(omega=[1.0, 2.0], theta=[0.0, 1.0], variance=[[0.02, 0], [0.005, 0]], choppy=True),
]
every_sea = pytest.mark.parametrize("sea", SEAS, ids=lambda sea: f"{sea.kind}-{SEAS.index(sea)}")


def gradient(function, x, y, h=1e-5):
    """Return the central differences of a function of x and y."""
    along = np.asarray(function(x + h, y)) - np.asarray(function(x - h, y))
    across = np.asarray(function(x, y + h)) - np.asarray(function(x, y - h))
    return along / (2 * h), across / (2 * h)


def test_gerstners_wave_against_its_parametric_form():
    a, k = 0.1, math.pi
    x = np.linspace(-1.0, 1.0, 41)
    z = GERSTNER.elevation(x, 0.0)
    for place, height in zip(x, z, strict=True):
        label = brentq(lambda r, p=place: r - a * math.sin(k * r) - p, -1.2, 1.2, xtol=1e-14)
        assert height == pytest.approx(a * math.cos(k * label) + 0.01570796, abs=1e-8)


def test_crests_are_sharp_and_troughs_flat():
    crest = GERSTNER.second_derivatives(0.0, 0.0)[0]
    trough = GERSTNER.second_derivatives(1.0, 0.0)[0]
    h = 1e-4
    z = GERSTNER.elevation([-h, 0.0, h], 0.0)
    assert crest == pytest.approx(-2.09823049, rel=1e-8)
    assert (z[0] - 2 * z[1] + z[2]) / h**2 == pytest.approx(-2.09823049, rel=1e-5)
    assert trough == pytest.approx(0.1 * math.pi**2 / (1.0 + 0.1 * math.pi) ** 2, rel=1e-8)


def test_steepest_slope_and_level_of_gerstners_wave():
    x = -1.0 + 2.0 * (np.arange(4000) + 0.5) / 4000
    z = GERSTNER.elevation(x, 0.0)
    assert np.abs(np.gradient(z, x)).max() == pytest.approx(0.33091331, rel=1e-5)
    assert np.mean(z) == pytest.approx(0.0, abs=1e-10)  # periodic: exact but for rounding
    assert GERSTNER.elevation(0.0, 0.0) == pytest.approx(0.1 + 0.01570796, abs=1e-8)


def test_gerstners_wave_travels_unchanged_at_the_linear_speed():
    x, t = np.linspace(0.0, 2.0, 9), 3.3
    speed = math.sqrt(9.81 / math.pi)
    np.testing.assert_allclose(
        GERSTNER.elevation(x + speed * t, 0.0, t), GERSTNER.elevation(x, 0.0), atol=1e-12
    )


def test_steep_waves_up_to_the_cusp():
    wave = SinusoidalSea(amplitude=0.99 / math.pi, wavelength=2.0, choppy=True)
    x = np.linspace(-1.0, 1.0, 201)
    k = math.pi
    labels = [
        brentq(lambda r, p=p: r - 0.99 / k * math.sin(k * r) - p, -1.5, 1.5, xtol=1e-15) for p in x
    ]
    expected = 0.99 / k * np.cos(k * np.array(labels)) + 0.5 * 0.99**2 / k
    np.testing.assert_allclose(wave.elevation(x, 0.0), expected, atol=1e-11)


@every_sea
def test_slopes_and_second_derivatives_at_fixed_points(sea):
    x, y = np.random.default_rng(0).uniform(-20, 20, (2, 30))
    t = 3.7
    zx, zy = gradient(lambda p, q: sea.elevation(p, q, t), x, y)
    np.testing.assert_allclose(sea.slopes(x, y, t), [zx, zy], atol=2e-9)
    along, across = gradient(lambda p, q: sea.slopes(p, q, t), x, y)
    zxx, zxy, zyy = sea.second_derivatives(x, y, t)
    np.testing.assert_allclose([zxx, zxy], along, atol=2e-8)
    np.testing.assert_allclose([zxy, zyy], across, atol=2e-8)


@every_sea
def test_sheet_lies_on_the_surface(sea):
    t, axes = 2.5, (np.linspace(-3, 9, 25), np.linspace(2, 7, 11))
    points, normals = sea.sheet(*axes, t)
    assert points.shape == normals.shape == (25, 11, 3)
    x, y, z = np.moveaxis(points, -1, 0)
    np.testing.assert_allclose(z, sea.elevation(x, y, t), atol=1e-6)
    np.testing.assert_allclose(
        -normals[..., :2] / normals[..., 2:], np.stack(sea.slopes(x, y, t), -1), atol=1e-6
    )
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1.0, atol=1e-14)
    grid = sea.grid(*axes, t)
    np.testing.assert_array_equal(grid[0], sea.elevation(*np.meshgrid(*axes, indexing="ij"), t))


def test_sheet_of_a_height_field_is_its_grid():
    sea, axes = JonswapSea(waves="paper", seed=3), (np.linspace(-2, 2, 5), np.linspace(0, 1, 4))
    points, normals = sea.sheet(*axes, 1.0)
    z, sx, sy = sea.grid(*axes, 1.0)
    np.testing.assert_array_equal(points, np.stack([*np.meshgrid(*axes, indexing="ij"), z], -1))
    expected = np.stack([-sx, -sy, np.ones_like(z)], -1)
    np.testing.assert_allclose(normals, expected / np.linalg.norm(expected, axis=-1)[..., None])


@every_sea
@pytest.mark.parametrize("graded", [{}, {"fine_extent": 2.0, "coarse_spacing": 1.0}])
def test_mesh_covers_the_extent_up_to_its_bounds(sea, graded):
    mesh = sea.mesh(1.0, 6.0, 0.25, center=(5.0, -3.0), **graded)
    low, high = mesh.bounds[:, :2]
    assert (low <= [-1.0, -9.0]).all()
    assert (high >= [11.0, 3.0]).all()
    assert (mesh.face_normals[:, 2] > 0.0).all()
    a, b, c = (mesh.vertices[mesh.faces[:, i], :2] for i in range(3))
    (ux, uy), (vx, vy) = (b - a).T, (c - a).T
    area = 0.5 * np.sum(ux * vy - uy * vx)
    assert area == pytest.approx(np.prod(high - low), rel=1e-12)  # a rectangle without gaps
    inside = (np.abs(mesh.vertices[:, :2] - [5.0, -3.0]) <= 6.0).all(axis=1)
    x, y, z = mesh.vertices[inside].T
    np.testing.assert_allclose(z, sea.elevation(x, y, 1.0), atol=1e-6)
    if graded:
        fine = (np.abs(mesh.vertices[:, :2] - [5.0, -3.0]) <= 2.0).all(axis=1)
        assert fine.sum() > 0.8 * (4.0 / 0.25) ** 2 / (1.0 + 0.4) ** 2


def test_meshes_of_half_the_spacing_nest():
    sea = SEAS[2]
    coarse, fine = (sea.mesh(0.0, 4.0, h).vertices for h in (0.5, 0.25))
    inner = (np.abs(coarse[:, :2]) < 3.0).all(axis=1)
    gap = np.abs(coarse[inner, None, :] - fine[None]).max(axis=2).min(axis=1)
    assert gap.max() < 1e-6


def cells(sea, rng, n, h=1e-3):
    """Return positions, slopes and areas over those of the labels, at random cells of labels."""
    axes = [(np.sort(rng.uniform(0.0, 400.0, n))[:, None] + [0.0, h]).ravel() for _ in range(2)]
    points, normals = sea.sheet(*axes)
    corner = points.reshape(n, 2, n, 2, 3)
    along, across = corner[:, 1, :, 0] - corner[:, 0, :, 0], corner[:, 0, :, 1] - corner[:, 0, :, 0]
    area = (along[..., 0] * across[..., 1] - along[..., 1] * across[..., 0]) / h**2
    slopes = (-normals[..., :2] / normals[..., 2:])[::2, ::2]
    return [axis[::2] for axis in axes], corner[:, 0, :, 0, 2], slopes, area


@pytest.mark.parametrize(
    ("wind", "omega_max", "ratio", "spread"),
    [
        (5.0, None, 1.004, 0.0797),
        (13.0, None, None, 0.1006),
        pytest.param(13.0, 9.0, 1.022, None, marks=pytest.mark.thorough),
    ],
)
def test_area_and_slope_variance(wind, omega_max, ratio, spread):
    areas, means, ratios = [], [], []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        options = {"waves": "paper", "wind_speed": wind, "seed": seed, "omega_max": omega_max}
        axes, _, slopes, area = cells(JonswapSea(choppy=True, **options), rng, 60)
        _, zx, zy = JonswapSea(**options).grid(*axes)
        areas.append(area.std())
        means.append(area.mean())
        ratios.append(np.sum(area[..., None] * slopes**2) / np.sum(zx**2 + zy**2))
    error = np.std(ratios) / math.sqrt(len(ratios))
    assert np.mean(means) == pytest.approx(1.0, abs=0.005)
    if spread:
        assert np.mean(areas) == pytest.approx(spread, rel=0.03)
    if ratio:
        assert error < 0.003
        assert np.mean(ratios) == pytest.approx(ratio, abs=0.0005 + 4.0 * error)


def test_elevation_at_fixed_points_has_mean_zero_linear_variance_and_no_skewness():
    moments = []
    for seed in range(40):
        sea = JonswapSea(waves="paper", wind_speed=5.0, seed=seed, choppy=True)
        x, y = np.random.default_rng(seed).uniform(-500.0, 500.0, (2, 800))
        z = sea.elevation(x, y)
        moments.append([z.mean(), np.mean(z**2), np.mean(z**3)])
    sigma2 = 0.5 * np.sum(JonswapSea(waves="paper", wind_speed=5.0).components.amplitude ** 2)
    mean, square, cube = np.mean(moments, axis=0)
    error = np.std(moments, axis=0) / math.sqrt(len(moments))
    assert abs(mean) < 4.0 * error[0]
    assert square == pytest.approx(sigma2, abs=4.0 * error[1])
    assert error[2] / sigma2**1.5 < 0.02  # the skewness of second order is 0.138
    assert abs(cube) < 4.0 * error[2]


def test_shift_is_the_published_one():
    for wind, shift in ((5.0, 0.0095818), (13.0, 0.028444)):
        sea = JonswapSea(waves="paper", wind_speed=wind)
        waves = sea.components
        k = np.hypot(waves.kx, waves.ky)
        assert 0.5 * np.sum(waves.amplitude**2 * k) == pytest.approx(shift, rel=1e-4)
        z = sea.model_copy(update={"choppy": True}).sheet([0.0, 1.0], [0.0, 1.0])[0][..., 2]
        np.testing.assert_allclose(z - sea.grid([0.0, 1.0], [0.0, 1.0])[0], shift, rtol=1e-4)


def test_orbits_in_finite_depth_are_wider():
    shallow = SinusoidalSea(amplitude=0.02, wavelength=2.0, depth=0.3, choppy=True)
    k = math.pi
    points, _ = shallow.sheet([0.0, 0.5], [0.0, 1.0])
    assert points[1, 0, 0] == pytest.approx(0.5 - 0.02 / math.tanh(k * 0.3), abs=1e-12)
    x = (np.arange(2000) + 0.5) / 1000
    assert shallow.elevation(x, 0.0).mean() == pytest.approx(0.0, abs=1e-10)
    deep = SinusoidalSea(amplitude=0.1, wavelength=2.0, depth=100.0, choppy=True)
    np.testing.assert_allclose(deep.elevation(x, 0.0), GERSTNER.elevation(x, 0.0), atol=1e-12)


def test_sheets_that_pass_through_themselves_are_refused_with_the_place():
    wave = SinusoidalSea(amplitude=0.35, wavelength=2.0, choppy=True)
    text = r"choppy: J = -0.09\d+ at \({}\) m, allowed: J > 0: the waves are too steep; lower"
    with pytest.raises(Refused, match=text.format("0, 0")):
        wave.elevation(0.0, 0.0)
    with pytest.raises(Refused, match=text.format("-?2, -3.4")):
        wave.mesh(extent=3.0, spacing=0.1)
    assert wave.elevation(1.0, 0.0) < 0.0  # the sheet is single in the troughs


def test_facets_that_face_down_between_labels_with_positive_area_ask_for_less_spacing():
    # labels 0.2 m to both sides of each crest, J = 0.034; the fold lies between them
    wave = SinusoidalSea(amplitude=0.38, wavelength=2.0, phase=0.2 * math.pi, choppy=True)
    with pytest.raises(Refused, match=r"^spacing: 0.4 m, allowed: less than 0.4 m: facets of this"):
        wave.mesh(extent=4.0, spacing=0.4)
    with pytest.raises(Refused, match=r"^choppy: J = "):
        wave.mesh(extent=4.0, spacing=0.1)


@every_sea
def test_round_trips(sea):
    again = sea_from_config(json.loads(json.dumps(sea.to_config())))
    assert again == sea
    assert "choppy=True" in repr(again)
    assert pickle.loads(pickle.dumps(sea)) == sea
    assert sea != sea.model_copy(update={"choppy": False})
    np.testing.assert_array_equal(
        again.mesh(0.3, 1.0, 0.5).vertices, sea.mesh(0.3, 1.0, 0.5).vertices
    )


def test_other_seeds_share_the_grid_factors():
    sea = JonswapSea(waves="paper", seed=1, choppy=True)
    sea.mesh(extent=2.0, spacing=0.5)
    other = sea.with_seed(2)
    assert other._grids is sea._grids
    expected = JonswapSea(waves="paper", seed=2, choppy=True).mesh(extent=2.0, spacing=0.5)
    np.testing.assert_array_equal(other.mesh(extent=2.0, spacing=0.5).vertices, expected.vertices)
