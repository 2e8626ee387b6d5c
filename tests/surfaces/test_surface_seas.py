import copy
import json
import math
import os
import pickle
import subprocess
import sys
import tomllib

import numpy as np
import pytest
import tomli_w
from hypothesis import given, settings
from hypothesis import strategies as st

from meshtrace import SurfaceModel, TriangleMesh
from meshtrace.surfaces import (
    Band,
    Cos2sSpreading,
    Elfouhaily,
    FlatSea,
    Jonswap,
    JonswapSea,
    MeasuredSea,
    PiersonMoskowitz,
    SinusoidalSea,
    SpectralSea,
    TiltedPlane,
    Tma,
    bands,
    sea_from_config,
)
from meshtrace.surfaces.statistics import components_hs
from meshtrace.surfaces.waves import angular_frequency, phase_speed, wavenumber

modest = settings(max_examples=25, deadline=None, derandomize=True)

SEAS = [
    FlatSea(height=0.2),
    TiltedPlane(slope_x=0.1, slope_y=-0.3, height=1.0),
    SinusoidalSea(amplitude=0.2, wavelength=3.0, direction_deg=30.0, phase=0.4, depth=0.5),
    JonswapSea(wind_speed=5.0, seed=1),
    JonswapSea(wind_speed=13.0, seed=7, wind_direction_deg=40.0, depth=4.0, capillary=True),
    JonswapSea(wind_speed=9.0, waves="scaled", spreading="cos2s", omega_max=5.0),
    SpectralSea(spectrum=PiersonMoskowitz(wind_speed=7.0), seed=5),
    SpectralSea(spectrum=Elfouhaily(wind_speed=8.0), spreading="elfouhaily", seed=6),
    SpectralSea(spectrum=Tma(wind_speed=8.0, depth=6.0), spreading="mitsuyasu"),
    MeasuredSea(omega=[1.0, 2.0], theta=[0.0, 1.0], variance=[[0.02, 0.0], [0.005, 0.001]], seed=4),
]
WAVES = SEAS[2:]


def ids(sea):
    return f"{sea.kind}-{SEAS.index(sea)}"


every_sea = pytest.mark.parametrize("sea", SEAS, ids=ids)
every_wave = pytest.mark.parametrize("sea", WAVES, ids=ids)


@every_sea
def test_satisfies_the_protocol(sea):
    assert isinstance(sea, SurfaceModel)
    assert isinstance(sea.mesh(extent=1.0, spacing=0.5), TriangleMesh)


@every_sea
def test_slopes_and_second_derivatives_are_derivatives(sea):
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-20, 20, (2, 50))
    t, h = 3.7, 1e-5

    def difference(function, dx, dy):
        upper, lower = function(x + h * dx, y + h * dy, t), function(x - h * dx, y - h * dy, t)
        return (np.asarray(upper) - np.asarray(lower)) / (2 * h)

    sx, sy = sea.slopes(x, y, t)
    np.testing.assert_allclose(sx, difference(sea.elevation, 1, 0), atol=1e-9)
    np.testing.assert_allclose(sy, difference(sea.elevation, 0, 1), atol=1e-9)
    if sea not in WAVES:
        return
    zxx, zxy, zyy = sea.second_derivatives(x, y, t)
    np.testing.assert_allclose([zxx, zxy], difference(sea.slopes, 1, 0), atol=1e-8)
    np.testing.assert_allclose([zxy, zyy], difference(sea.slopes, 0, 1), atol=1e-8)


@every_wave
def test_tensor_grid_equals_the_direct_sum(sea):
    x, y, t = np.linspace(-30, 17, 37), np.linspace(-3, 50, 131), 12.3
    points = np.meshgrid(x, y, indexing="ij")
    fast = sea.grid(x, y, t)
    slow = sea.elevation(*points, t), *sea.slopes(*points, t)
    np.testing.assert_allclose(fast, slow, atol=1e-6, rtol=0.0)


def test_direct_sum_equals_the_written_out_formula():
    sea = JonswapSea(wind_speed=5.0, seed=9, waves="paper")
    x, y, t = 1.3, -2.1, 4.5
    omega = 1.2 + 0.2 * np.arange(15)
    theta = -math.pi / 2 + math.pi / 5 * np.arange(6)
    eps = 2 * math.pi * np.random.default_rng(9).random((15, 6))
    z = 0.0
    for i in range(15):
        for j in range(6):
            D = 2 / math.pi * math.cos(theta[j]) ** 2
            a = math.sqrt(2 * float(sea.spectrum(omega[i])) * D * 0.2 * math.pi / 5)
            k = omega[i] ** 2 / 9.81
            across = x * math.cos(theta[j]) + y * math.sin(theta[j])
            z += a * math.cos(omega[i] * t - k * across + eps[i, j])
    assert sea.elevation(x, y, t) == pytest.approx(z, abs=1e-13)


@every_sea
def test_mesh_carries_elevation_and_exact_normals(sea):
    t = 2.5
    mesh = sea.mesh(time=t, extent=2.0, spacing=0.25, center=(3.0, -1.0))
    x, y, z = mesh.vertices.T
    np.testing.assert_allclose(z, sea.elevation(x, y, t), atol=1e-6)
    sx, sy = sea.slopes(x, y, t)
    normals = np.stack([-sx, -sy, np.ones_like(sx)], axis=1)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    np.testing.assert_allclose(mesh.vertex_normals, normals, atol=1e-6)
    assert (mesh.face_normals[:, 2] > 0.0).all()
    np.testing.assert_array_equal(np.unique(x), np.linspace(1.0, 5.0, 17))
    np.testing.assert_array_equal(np.unique(y), np.linspace(-3.0, 1.0, 17))


def test_mesh_sizes():
    sea = FlatSea()
    assert len(sea.mesh().vertices) == 401**2
    assert len(sea.mesh(extent=1.0, spacing=0.3).vertices) == 8**2
    graded = sea.mesh(extent=20.0, spacing=0.1, fine_extent=2.0, coarse_spacing=2.0)
    assert len(graded.vertices) < 110**2
    np.testing.assert_array_equal(graded.bounds[:, :2], [[-20, -20], [20, 20]])


@pytest.mark.parametrize(
    ("wind_speed", "count", "limits"),
    [
        (5.0, 15 * 6, (1.2, 4.0, 0.2, math.pi / 5)),
        (13.0, 22 * 21, (0.9, 3.0, 0.1, math.pi / 20)),
    ],
)
def test_paper_bands(wind_speed, count, limits):
    sea = JonswapSea(wind_speed=wind_speed, waves="paper")
    low, high, d_omega, d_theta = limits
    assert sea.band == Band(
        omega_min=low, omega_max=high, d_omega=d_omega, d_theta=d_theta, drawn=False
    )
    assert len(sea.components.amplitude) == count
    assert sea.components.omega.min() == limits[0]
    assert sea.components.omega.max() == pytest.approx(limits[1], rel=1e-14)
    assert JonswapSea(wind_speed=wind_speed) != sea
    scaled = JonswapSea(wind_speed=wind_speed, waves="scaled")
    assert scaled.band == scaled_band(sea.spectrum.omega_p)


def scaled_band(peak):
    steps = {"d_omega": 0.075 * peak, "d_theta": math.pi / 20}
    return Band(omega_min=0.6 * peak, omega_max=2.1 * peak, drawn=False, **steps)


def test_scaled_bands_follow_the_peak():
    scaled = {"waves": "scaled"}
    for sea in (JonswapSea(wind_speed=8.0, **scaled), JonswapSea(fetch=5e3, **scaled)):
        assert sea.band == scaled_band(sea.spectrum.omega_p)
        assert len(sea.components.amplitude) == 21 * 21
    assert JonswapSea(fetch=5e3, waves="paper").band.omega_max == 4.0


@pytest.mark.parametrize("wind_speed", [5.0, 13.0])
def test_scaled_band_does_not_jump_at_the_paper_winds(wind_speed):
    paper = JonswapSea(wind_speed=wind_speed, waves="paper").components
    scaled = JonswapSea(wind_speed=wind_speed, waves="scaled").components
    assert components_hs(scaled) == pytest.approx(components_hs(paper), rel=0.005)
    slopes = [np.sum(w.amplitude**2 * (w.kx**2 + w.ky**2)) / 2 for w in (paper, scaled)]
    assert slopes[1] == pytest.approx(slopes[0], rel=0.04)


def test_the_cut_of_the_spectrum_replaces_that_of_the_band():
    given = bands.PAPER_BANDS[13.0].replace(d_theta=math.pi / 10)
    sea = JonswapSea(wind_speed=13.0, waves=given, omega_max=6.0)
    assert sea.band == given.replace(omega_max=6.0)
    assert len(sea.components.amplitude) == 52 * 11


def test_one_component_travels_at_its_phase_speed():
    for depth, capillary in ((None, False), (0.3, False), (None, True)):
        sea = SinusoidalSea(
            amplitude=0.1, wavelength=0.8, direction_deg=25.0, depth=depth, capillary=capillary
        )
        c = float(phase_speed(2 * math.pi / 0.8, depth, capillary))
        x, y = np.random.default_rng(1).uniform(-5, 5, (2, 200))
        dt, d = 0.7, math.radians(25.0)
        moved = sea.elevation(x + c * dt * math.cos(d), y + c * dt * math.sin(d), 2.0 + dt)
        np.testing.assert_allclose(moved, sea.elevation(x, y, 2.0), atol=1e-13)
        assert sea.components.omega[0] == angular_frequency(2 * math.pi / 0.8, depth, capillary)


@every_wave
def test_time_advances_every_component_by_its_own_phase(sea):
    x, y, dt = np.linspace(-5, 5, 11), np.linspace(-4, 4, 9), 1.7
    waves = sea.components
    later = waves._replace(phase=waves.phase + waves.omega * dt)
    points = np.meshgrid(x, y, indexing="ij")
    phase = later.phase - points[0][..., None] * later.kx - points[1][..., None] * later.ky
    expected = np.cos(phase) @ later.amplitude
    np.testing.assert_allclose(sea.grid(x, y, dt)[0], expected, atol=1e-6)
    # Going back to time 0 on the same grid gives the first mesh again.
    before = sea.grid(x, y, 0.0)[0].copy()
    sea.grid(x, y, 55.0)
    np.testing.assert_array_equal(sea.grid(x, y, 0.0)[0], before)


def test_seeds():
    x, y = np.linspace(-5, 5, 21), np.linspace(-5, 5, 21)
    one, same, other = (JonswapSea(wind_speed=13.0, seed=s) for s in (7, 7, 8))
    np.testing.assert_array_equal(one.grid(x, y), same.grid(x, y))
    assert np.abs(one.grid(x, y)[0] - other.grid(x, y)[0]).max() > 0.1
    expected = 2 * math.pi * np.random.default_rng(7).random((29, 37))
    np.testing.assert_array_equal(one.components.phase, expected.ravel())


def test_with_seed_shares_the_grid_but_not_the_phases():
    sea = JonswapSea(wind_speed=13.0, seed=7)
    before = sea.mesh(extent=2.0, spacing=0.2).vertices
    other = sea.with_seed(8)
    assert other._grids is sea._grids
    np.testing.assert_array_equal(
        other.mesh(extent=2.0, spacing=0.2).vertices,
        JonswapSea(wind_speed=13.0, seed=8).mesh(extent=2.0, spacing=0.2).vertices,
    )
    np.testing.assert_array_equal(sea.mesh(extent=2.0, spacing=0.2).vertices, before)


def test_equal_spacing_repeats_and_drawn_waves_do_not():
    x = np.linspace(-3, 3, 7)
    period = 2 * math.pi / 0.2
    sea = JonswapSea(wind_speed=5.0, seed=3, waves="paper")
    np.testing.assert_allclose(sea.grid(x, x, period), sea.grid(x, x, 0.0), atol=1e-6)
    drawn = sea.replace(waves=sea.band.replace(drawn=True))
    assert np.abs(drawn.grid(x, x, period)[0] - drawn.grid(x, x, 0.0)[0]).max() > 0.05
    bins = np.floor((drawn.components.omega - 1.2) / 0.2).reshape(14, 6)
    np.testing.assert_array_equal(bins, np.broadcast_to(np.arange(14.0)[:, None], (14, 6)))
    assert len(np.unique(drawn.components.omega)) == 84


def test_wind_direction_rotates_the_sea():
    turned = JonswapSea(wind_speed=13.0, seed=7, wind_direction_deg=90.0)
    straight = JonswapSea(wind_speed=13.0, seed=7)
    x, y = np.random.default_rng(2).uniform(-10, 10, (2, 100))
    np.testing.assert_allclose(
        turned.elevation(-y, x, 1.0), straight.elevation(x, y, 1.0), atol=1e-12
    )
    w = turned.components
    along = np.sum(w.amplitude**2 * w.ky) / np.sum(w.amplitude**2 * np.hypot(w.kx, w.ky))
    assert along == pytest.approx(8 / (3 * math.pi), rel=1e-3)  # mean of cos over cos^2


def test_spectral_sea_with_jonswap_is_the_jonswap_sea():
    sea = JonswapSea(wind_speed=8.0, seed=4)
    general = SpectralSea(spectrum=Jonswap(wind_speed=8.0), seed=4, capillary=False)
    np.testing.assert_array_equal(general.components, sea.components)
    named = JonswapSea(wind_speed=8.0, seed=4, spreading={"kind": "cos2s", "s": 10.0})
    assert named == JonswapSea(wind_speed=8.0, seed=4, spreading=Cos2sSpreading())


def test_depth_reaches_the_dispersion():
    for sea in (
        JonswapSea(wind_speed=8.0, depth=2.0),
        SpectralSea(spectrum=Tma(wind_speed=8.0, depth=2.0), capillary=False),
        MeasuredSea(omega=[1.0], theta=[0.0], variance=[[1.0]], depth=2.0, capillary=False),
    ):
        w = sea.components
        np.testing.assert_allclose(np.hypot(w.kx, w.ky), wavenumber(w.omega, 2.0), rtol=1e-14)


@every_sea
def test_config_round_trip(sea):
    config = sea.to_config()
    assert config["kind"] == sea.kind
    through_json = sea_from_config(json.loads(json.dumps(config)))
    through_toml = sea_from_config(tomllib.loads(tomli_w.dumps(config)))
    for loaded in (through_json, through_toml, pickle.loads(pickle.dumps(sea)), copy.deepcopy(sea)):
        assert type(loaded) is type(sea)
        assert loaded == sea
        np.testing.assert_array_equal(
            loaded.mesh(time=1.5, extent=3.0, spacing=0.3).vertices,
            sea.mesh(time=1.5, extent=3.0, spacing=0.3).vertices,
        )


@given(
    wind_speed=st.floats(0.5, 30.0),
    fetch=st.floats(1e3, 1e6),
    seed=st.integers(0, 2**63 - 1),
    direction=st.floats(-360.0, 360.0),
    name=st.sampled_from(["mean", "scaled"]),
)
@modest
def test_any_sea_state_round_trips_and_has_the_height_of_its_band(
    wind_speed, fetch, seed, direction, name
):
    state = {"wind_speed": wind_speed, "fetch": fetch, "waves": name}
    sea = JonswapSea(**state, seed=seed, wind_direction_deg=direction)
    loaded = sea_from_config(json.loads(json.dumps(sea.to_config())))
    np.testing.assert_array_equal(loaded.components, sea.components)
    energy = components_hs(sea.components) ** 2
    still = JonswapSea(**state)
    assert energy == pytest.approx(components_hs(still.components) ** 2, rel=0.01)


def test_pickle_stays_small():
    sea = JonswapSea(wind_speed=13.0)
    sea.mesh(extent=10.0, spacing=0.5)
    assert len(pickle.dumps(sea)) < 2000


def test_copies_are_validated_and_carry_nothing_stale():
    sea = JonswapSea(wind_speed=13.0, seed=1)
    first = sea.components.phase
    moved = sea.model_copy(update={"seed": 2})
    assert (moved.components.phase != first).any()
    with pytest.raises(ValueError, match=r"wind_speed: 99\.0, allowed: 0 < wind_speed <= 60 m/s"):
        sea.model_copy(update={"wind_speed": 99.0})


def test_numpy_scalars_are_welcome():
    sea = JonswapSea(wind_speed=np.float64(13.0), seed=np.int64(7))
    assert sea == JonswapSea(wind_speed=13.0, seed=7)


def test_shapes_broadcast():
    sea = JonswapSea(wind_speed=5.0)
    assert sea.elevation(0.0, 0.0).shape == ()
    assert sea.elevation(np.zeros((4, 1)), np.zeros(3)).shape == (4, 3)
    assert [s.shape for s in sea.slopes([1.0, 2.0], 0.0)] == [(2,), (2,)]
    assert FlatSea().elevation(np.zeros((4, 1)), np.zeros(3)).shape == (4, 3)


def test_many_points_are_summed_in_blocks():
    sea = JonswapSea(wind_speed=13.0, seed=2)
    x = np.linspace(-50, 50, 7001)
    whole = sea.elevation(x, 1.0)
    np.testing.assert_allclose(whole[::1000], sea.elevation(x[::1000], 1.0), atol=1e-13)


def test_old_grids_leave_the_cache():
    sea = JonswapSea(wind_speed=5.0)
    for n in range(3, 12):
        sea.grid(np.linspace(0, 1, n), np.linspace(0, 1, n))
    assert sea._grids.cache_info().currsize == 4


def test_grids_that_share_one_axis_are_distinguished():
    sea = JonswapSea(wind_speed=5.0)
    x, y, other = np.linspace(0, 1, 5), np.linspace(0, 1, 4), np.linspace(2, 3, 4)
    sea.grid(x, y)
    np.testing.assert_array_equal(sea.grid(x, other), JonswapSea(wind_speed=5.0).grid(x, other))
    np.testing.assert_array_equal(sea.grid(other, y), JonswapSea(wind_speed=5.0).grid(other, y))


@pytest.mark.process
@pytest.mark.thorough
def test_digits_do_not_depend_on_the_number_of_threads():
    code = (
        "import hashlib, meshtrace.surfaces as s, numpy as np\n"
        "sea = s.JonswapSea(wind_speed=13.0, seed=7)\n"
        "mesh = sea.mesh(time=1.3, extent=5.0, spacing=0.17)\n"
        "z = sea.elevation(np.linspace(0, 9, 5000), 1.0)\n"
        "print(hashlib.sha256(mesh.vertices.tobytes() + z.tobytes()).hexdigest())\n"
    )
    digests = set()
    for threads in ("1", "2"):
        names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
        env = {**os.environ, **dict.fromkeys(names, threads)}
        run = subprocess.run(
            [sys.executable, "-c", code], env=env, check=True, capture_output=True, text=True
        )
        digests.add(run.stdout)
    assert len(digests) == 1


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: JonswapSea(wind_speed=-3.0),
            "wind_speed: -3.0, allowed: 0 < wind_speed <= 60 m/s",
        ),
        (lambda: JonswapSea(wind_speed=0.0), "wind_speed: 0.0"),
        (lambda: JonswapSea(wind_speed=math.nan), "wind_speed: nan"),
        (lambda: JonswapSea(fetch=math.inf), "fetch: inf, allowed: 0 < fetch < inf m"),
        (lambda: JonswapSea(seed=-1), "seed"),
        (lambda: JonswapSea(seed=1.5), "seed"),
        (lambda: JonswapSea(winds=5.0), "winds"),
        (
            lambda: JonswapSea(wind_speed=8.0, waves="paper"),
            "waves: 'paper', allowed: JONSWAP seas at 5 and 13",
        ),
        (lambda: JonswapSea(waves="narrow"), "paper, scaled"),
        (lambda: JonswapSea(omega_max=1.0), "omega_max: 1.0, allowed: > 1.175 rad/s"),
        (
            lambda: JonswapSea(waves=bands.PAPER_BANDS[5.0].replace(d_theta=2.0)),
            "d_theta: 2.0, allowed: 0 < d_theta <= 1.57",
        ),
        (
            lambda: JonswapSea(waves=bands.PAPER_BANDS[5.0].replace(d_omega=1e-6)),
            "waves: 16800006 waves, allowed: a band of at most 1000000",
        ),
        (lambda: JonswapSea(spreading="round"), "spreading"),
        (lambda: JonswapSea(depth=0.0), "depth: 0.0"),
        (lambda: SpectralSea(spectrum=Tma(depth=5.0), depth=6.0), "depth: 6.0, allowed: 5 m"),
        (lambda: MeasuredSea(omega=[1.0], theta=[0.0], variance=[[1.0, 2.0]]), "variance: .1 rows"),
        (lambda: MeasuredSea(omega=[1.0], theta=[0.0], variance=[[-1.0]]), "variance"),
        (lambda: SinusoidalSea(amplitude=-0.1, wavelength=1.0), "amplitude"),
        (lambda: SinusoidalSea(amplitude=0.1, wavelength=0.0), "wavelength"),
        (lambda: TiltedPlane(slope_x=math.inf), "slope_x"),
        (lambda: JonswapSea().elevation(math.nan, 0.0), "x: nan"),
        (lambda: JonswapSea().slopes(0.0, math.inf), "y: inf"),
        (lambda: JonswapSea().elevation(0.0, 0.0, math.nan), "time: nan"),
        (lambda: FlatSea().slopes(0.0, 0.0, math.inf), "time: inf"),
        (lambda: JonswapSea().mesh(time=math.inf), "time: inf"),
        (lambda: JonswapSea().mesh(extent=-1.0), "extent: -1.0, allowed: 0 < extent < inf m"),
        (
            lambda: JonswapSea().mesh(coarse_spacing=1.0),
            "coarse_spacing: 1.0, allowed: only with fine_extent",
        ),
        (lambda: sea_from_config({"kind": "tsunami"}), "tsunami"),
        (lambda: sea_from_config({"height": 1.0}), "kind"),
    ],
)
def test_refuses(call, message):
    with pytest.raises(ValueError, match=message):
        call()
