"""Convergence studies: exact surface, fit, recommendation, and their findings for real meshes."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
import xarray as xr
from typer.testing import CliRunner

import meshtrace as mt
from meshtrace import cli
from meshtrace.engine.chains import wave_sum
from meshtrace.errors import Refused
from meshtrace.kernels import jit
from meshtrace.optics import fresnel_reflectance
from meshtrace.optics.fresnel import refract
from meshtrace.scenario import Scenario
from meshtrace.stored import SHIFTS
from meshtrace.studies import (
    ConvergenceStudy,
    band_limit_study,
    convergence_study,
    refinement,
    time_step_study,
)
from meshtrace.studies.campaign import campaign_of
from meshtrace.surfaces import FlatSea, JonswapSea, SinusoidalSea

LINK = mt.Link()
WAVE = SinusoidalSea(amplitude=0.06, wavelength=4.0, direction_deg=30.0, phase=3.0)


def common(link, sea, photons=256, normals="vertex", time=0.0):
    campaign = campaign_of(link, sea, run={"photons": photons, "mesh": mt.Meshing(time=time)})
    return refinement.CommonChains(campaign, (normals,), 0)


def exact(link, sea, photons=256, spacing=0.125, time=0.0):
    return common(link, sea, photons, time=time).exact(sea, spacing)


@jit.allocating_entry
def shapes(waves, x, y):
    return [wave_sum.shape_at(waves, x[i], y[i]) for i in range(len(x))]


def test_crossings_that_meet_count_once_in_any_order():
    """The exact surface has each crossing once, also if another lies between two that meet."""
    sea = SinusoidalSea(amplitude=0.25, wavelength=3.0, direction_deg=30.0)
    chains = common(LINK, sea)._chains("vertex")
    mesh = refinement.nested_mesh(LINK, sea, 0.0, 0.125, np.zeros(2))
    aimed, waves = chains.planner.aim_over(mesh), refinement.waves_at(sea, 0.0, chains.arrays.frame)
    scene = aimed.scene(chains.arrays.emitters[0], chains.arrays.targets[0])
    repeated = 0
    for drawn in map(chains.drawer.whole, chains.scattered_sets[0]):
        _, arrivals = aimed.aim(0, 0, drawn, keep=True)
        for i in np.unique(arrivals["chain"]):
            crossings = arrivals[arrivals["chain"] == i]
            if len(crossings) < 2:
                continue
            scores, counts = np.zeros((2, drawn.number)), np.zeros((2, 3), np.int64)
            for k, order in enumerate(([0, 1], [0, 1, 0, 1, 0])):
                wave_sum.move_crossings(
                    drawn.chains, crossings[order], waves, scene, scores[k], counts[k]
                )
            if counts[0].tolist() == [2, 0, 0]:  # both stay apart
                repeated += 1
                assert counts[1].tolist() == [2, 0, 3]
                np.testing.assert_array_equal(scores[1], scores[0])
    assert repeated > 20


def test_shape_is_that_of_the_sea():
    sea = JonswapSea(wind_speed=13.0, seed=3, waves="paper")
    x, y = np.random.default_rng(1).uniform(-5.0, 5.0, (2, 20))
    found = np.array(shapes(refinement.waves_at(sea, 2.5), x, y)).T
    expected = (
        sea.elevation(x, y, 2.5),
        *sea.slopes(x, y, 2.5),
        *sea.second_derivatives(x, y, 2.5),
    )
    np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.thorough
def test_exact_flat_sea_is_the_closed_form():
    # physics.md, section 6: exact disk, default link
    reference = exact(LINK, SinusoidalSea(amplitude=0.0, wavelength=4.0))
    assert reference.ballistic == pytest.approx(4.5166617e-5, rel=1e-7)
    assert reference.quadrature_error < 1e-9 * reference.ballistic
    assert reference.slope_variance == 0.0


def test_exact_flat_sea_scatters_as_a_flat_mesh():
    reference = exact(LINK, SinusoidalSea(amplitude=0.0, wavelength=4.0))
    chains = common(LINK, FlatSea())
    (meshed,) = chains.measure(lambda: FlatSea().mesh(extent=8.0, spacing=1.0))
    np.testing.assert_allclose(reference.samples, meshed[:SHIFTS], rtol=1e-5)


def traced_gain(link, sea, half_width, n):
    """Unscattered gain by rays through points of the surface, n by n over a square."""
    lamp, receiver, water = link.transmitter, link.receiver, link.water
    axis = half_width * ((2.0 * np.arange(n) + 1.0) / n - 1.0)
    x, y = (v.ravel() for v in np.meshgrid(axis, axis, indexing="ij"))
    z, (slope_x, slope_y) = sea.elevation(x, y), sea.slopes(x, y)
    stretch = np.sqrt(1.0 + slope_x**2 + slope_y**2)
    normal = np.stack([-slope_x, -slope_y, np.ones_like(x)], axis=1) / stretch[:, None]
    way = np.stack([x, y, z + lamp.depth], axis=1)
    length = np.linalg.norm(way, axis=1)
    way /= length[:, None]
    cos_i = (way * normal).sum(axis=1)
    out = refract(way, normal, water.n, link.n_air)
    flight = (receiver.height - z) / out[:, 2]
    miss = np.hypot(x + flight * out[:, 0], y + flight * out[:, 1])
    inside = (miss <= receiver.radius) & (out[:, 2] >= math.cos(math.radians(receiver.fov_deg / 2)))
    light = (lamp.order + 1.0) / (2.0 * math.pi) * way[:, 2] ** lamp.order
    light = light * np.exp(-(water.a + water.b) * length) * cos_i * stretch / length**2
    light = light * (1.0 - fresnel_reflectance(cos_i, water.n, link.n_air))
    return float((light * inside).sum() * (2.0 * half_width / n) ** 2)


@pytest.mark.thorough
def test_exact_unscattered_gain_is_that_of_traced_rays():
    # the rays of some 1e5 cells inside err by less than 1e-4
    link = LINK.model_copy(update={"receiver": mt.Receiver(radius=0.25)})
    reference = exact(link, WAVE)
    assert reference.ballistic == pytest.approx(traced_gain(link, WAVE, 0.5, 1200), rel=3e-4)


def test_exact_surface_adds_up_at_a_caustic():
    # a wave that focuses shows the lamp several times, and a caustic crosses the aperture
    link = LINK.model_copy(update={"receiver": mt.Receiver(radius=0.25, height=8.0)})
    wave = SinusoidalSea(amplitude=0.12, wavelength=2.0, phase=0.4)
    reference = exact(link, wave, photons=64)
    assert reference.ballistic == pytest.approx(traced_gain(link, wave, 1.5, 1200), rel=1e-3)
    assert reference.quadrature_error < 1e-3 * reference.ballistic


def law(h, order, spread=0.0, noise=0.0, rng=None, shifts=32):
    """Differences 0.02 h^p by shift, with a misfit in proportion to h^2 and noise of shifts."""
    y = 0.02 * h**order
    if rng is None:
        return np.repeat(y[:, None], shifts, axis=1)
    y = y + spread * h**2 * rng.standard_normal(len(h))
    return y[:, None] + noise * h[:, None] * rng.standard_normal((len(h), shifts))


@pytest.mark.parametrize("order", [1.0, 1.7, 2.0, 3.2])
def test_fit_finds_a_power_law(order):
    h = np.array([2.0, 1.0, 0.5, 0.25])
    fit = refinement.fit_law(h, law(h, order), 5.0)
    assert fit.order.value == pytest.approx(order, abs=0.005)
    assert fit.gain.value == pytest.approx(5.0, abs=1e-5)
    assert fit.coefficient == pytest.approx(0.02, rel=0.01)
    assert fit.order.low <= fit.order.value <= fit.order.high


@pytest.mark.thorough
def test_fitted_intervals_hold_the_truth():
    # 95 % intervals: fewer than 85 hits in 100 have a probability below 1e-4
    rng = np.random.default_rng(5)
    h = np.array([2.0, 1.0, 0.5, 0.25, 0.125, 0.0625])
    fits = [refinement.fit_law(h, law(h, 2.0, 2e-3, 1e-3, rng), 5.0) for _ in range(100)]
    assert sum(fit.gain.low <= 5.0 <= fit.gain.high for fit in fits) >= 85
    assert sum(fit.order.low <= 2.0 <= fit.order.high for fit in fits) >= 85


@pytest.mark.slow
def test_fitted_intervals_hold_the_truth_under_noise_of_placements():
    # as meshes give it: all steps err by a share of their scatter, far above Monte Carlo noise
    rng = np.random.default_rng(6)
    h = np.array([2.0, 1.0, 0.5, 0.25, 0.125, 0.0625])
    spread = 2e-3 * h**1.5
    hits = np.zeros(2, int)
    for _ in range(100):
        noise = spread * rng.standard_normal(6)
        fit = refinement.fit_law(h, law(h, 2.0) + noise[:, None], 5.0, spread)
        hits += [fit.gain.low <= 5.0 <= fit.gain.high, fit.order.low <= 2.0 <= fit.order.high]
    assert (hits >= 85).all()


def test_noise_is_not_taken_for_misfit():
    # a floor of noise at fine steps leaves the order as sure as the coarse steps make it
    h = np.array([2.0, 1.0, 0.5, 0.25, 0.125, 0.0625])
    rng = np.random.default_rng(7)
    fit = refinement.fit_law(h, law(h, 2.0) + 1e-3 * rng.standard_normal((6, 32)), 5.0)
    assert fit.order.low <= 2.0 <= fit.order.high
    assert fit.order.high - fit.order.low < 0.2


@pytest.mark.parametrize("n", [2, 13, 34])
def test_placements_fill_a_cell_evenly(n):
    # two cells by two hold each placement of the triangles twice
    shifts = refinement.placement_shifts(n)
    assert (abs(shifts) <= 0.5).all()
    along, across = shifts.sum(axis=1), shifts[:, 0] - shifts[:, 1]
    for axis in (along, across):
        np.testing.assert_allclose(np.diff(np.sort(axis)), 1.0 / n)


def test_shift_by_a_cell_along_both_axes_is_the_same_mesh():
    meshes = [
        refinement.nested_mesh(LINK, WAVE, 0.0, 0.5, np.array(shift))
        for shift in ((0.1, 0.2), (0.6, 0.7))
    ]
    chains = common(LINK, WAVE, 64)
    first, second = (chains.measure(lambda mesh=mesh: mesh)[0] for mesh in meshes)
    np.testing.assert_allclose(first[:SHIFTS], second[:SHIFTS], rtol=1e-9)


def study_of_law(h, order, scatter=0.0):
    samples = 1.0 + law(h, order)[None, :, None, :]
    flat = np.zeros((1, len(h)))
    return ConvergenceStudy(
        "spacing", h, ("vertex",), samples, samples.mean(axis=3), flat + scatter * h, flat, flat,
        *(flat, flat, flat),
    )  # fmt: skip


def test_recommended_spacing_meets_the_tolerance():
    h = np.array([2.0, 1.0, 0.5, 0.25])
    study = study_of_law(h, 2.0)
    # 0.02 h^2 = tolerance; errors are interpolated as power laws, relative to g(h_min)
    assert study.recommended(5e-3)["vertex"] == pytest.approx(0.5, rel=2e-3)
    assert study.recommended(1e-2)["vertex"] == pytest.approx(math.sqrt(0.5), rel=2e-3)
    assert study.recommended(0.1)["vertex"] == 2.0
    assert math.isnan(study.recommended(1e-4)["vertex"])


def test_scatter_counts_as_error_of_one_mesh():
    h = np.array([2.0, 1.0, 0.5, 0.25])
    assert study_of_law(h, 2.0, 0.01).error[0, 1] == pytest.approx(math.hypot(0.02, 0.01), rel=1e-3)


@pytest.fixture(scope="module")
def study():
    spacings = (1.0, 0.5, 0.25, 0.125, 0.0625)
    return convergence_study(LINK, WAVE, spacings, photons=64, placements=13)


@pytest.mark.thorough
def test_interpolated_normals_converge_as_the_square(study):
    order, gain, _ = study.fits["vertex"]
    assert 1.6 < order.value < 2.2
    assert gain.low <= study.reference.gain <= gain.high
    assert abs(gain.value / study.reference.gain - 1.0) < 5e-4


def test_unscattered_light_converges_to_the_exact(study):
    error = study.ballistic.mean(axis=2)[0] / study.reference.ballistic - 1.0
    assert (abs(error[1:]) < 0.5 * abs(error[:-1])).all()
    assert abs(error[-1]) < 1e-3


def test_common_chains_leave_differences_a_tenth_of_the_error(study):
    assert (study.difference_stderr[0, 1:] < 0.1 * study.gain_stderr[0, 1:]).all()


def test_facet_normals_scatter_more(study):
    assert (study.scatter[1] > 3.0 * study.scatter[0]).all()


def test_slope_variance_is_approached(study):
    k2 = (2.0 * math.pi / 4.0) ** 2 * 0.06**2  # (a k)^2, half of it over a whole wave
    assert 0.3 * k2 < study.reference.slope_variance < 0.7 * k2
    short = 1.0 - study.slope_variance[0] / study.reference.slope_variance
    assert (short > 0.0).all()
    assert short[-1] < 1e-2


def test_random_slopes_stand_for_waves_left_out():
    # long waves alone bend light little: the slopes that they lack spread it out of the aperture
    bands, few = (
        (1.0, 1.2, 1.4, 1.6),
        {"photons": 2048, "realizations": 1, "mesh": mt.Meshing(spacing=0.5)},
    )
    sea = JonswapSea(wind_speed=13.0, waves="paper")
    bare, rough = (
        band_limit_study(LINK, sea, bands, unresolved=word, **few) for word in ("none", "tilt")
    )
    assert (bare.gain - rough.gain > 4.0 * np.hypot(bare.gain_stderr, rough.gain_stderr)).all()
    assert rough.provenance["run"]["unresolved"] == "tilt"


def test_result_does_not_depend_on_threads():
    options = {"normals": ("vertex",), "photons": 64, "placements": 2}
    one, two = (
        convergence_study(LINK, WAVE, (2.0, 1.5, 1.0, 0.5), threads=n, **options) for n in (1, 2)
    )
    np.testing.assert_array_equal(one.samples, two.samples)
    np.testing.assert_array_equal(one.total_reflection, two.total_reflection)


@pytest.mark.thorough
def test_total_reflection_is_that_of_steep_waves():
    # from a plane tilted by 60 degrees light that goes straight up is totally reflected
    chains = common(LINK, FlatSea(), 64, "facet")
    steep = SinusoidalSea(amplitude=0.3, wavelength=0.5).mesh(extent=8.0, spacing=0.0625)
    flat = FlatSea().mesh(extent=8.0, spacing=1.0)
    rows = [chains.measure(lambda mesh=mesh: mesh, photons=4096)[0] for mesh in (flat, steep)]
    share = [row[SHIFTS + 2] for row in rows]
    assert share[0] < 0.05
    assert share[1] > 0.4


def test_dataset_and_summary_tell_all(study, tmp_path):
    study.save(tmp_path / "study.nc")
    with xr.open_dataset(tmp_path / "study.nc", engine="h5netcdf") as data:
        assert data.attrs["kind"] == "convergence"
        assert data["gain"].dims == ("normals", "spacing")
        np.testing.assert_array_equal(data["gain"], study.gain)
        order = data["fitted_order"].sel(normals="vertex", limit="value")
        assert float(order) == study.fits["vertex"].order.value
        assert float(data["exact_gain"]) == study.reference.gain
    text = study.summary()
    for word in ("vertex normals", "facet normals", "order", "Richardson", "exact surface"):
        assert word in text
    assert all(len(line) <= 120 for line in text.splitlines())


@pytest.mark.thorough
def test_time_steps_converge():
    # a trapezoidal mean over a whole period of a smooth function leaves nothing
    period = 2.0 * math.pi / float(WAVE.components.omega[0])
    steps = [period / n for n in (4, 8, 16, 32)]
    study = time_step_study(
        LINK, WAVE, steps, duration=period, photons=64, mesh=mt.Meshing(spacing=0.1)
    )
    assert study.gain.shape == (1, 4)
    assert abs(study.gain[0, -2] / study.gain[0, -1] - 1.0) < 1e-4
    ratio = study.scatter[0, 1:-1] / study.scatter[0, 2:]
    assert (ratio > 3.0).all()  # linear interpolation: second order
    assert "time_step" in study.to_dataset().dims


def test_wider_bands_add_to_the_same_waves():
    sea = JonswapSea(wind_speed=5.0, waves="paper")
    study = band_limit_study(
        LINK, sea, (2.0, 3.0, 4.0, 5.0), realizations=2, photons=64, mesh=mt.Meshing(spacing=0.5)
    )
    assert study.values.tolist() == [2.0, 3.0, 4.0, 5.0]
    assert (np.diff(study.slope_variance[0]) > 0.0).all()
    assert study.difference[0, -1] == 0.0
    assert study.scatter[0, -1] == 0.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"spacings": (1.0, 0.5, 0.25)}, "spacings: .*allowed: at least four"),
        ({"spacings": (1.0, 0.5, 0.25, -1.0)}, "spacings: -1.0, allowed"),
        ({"spacings": (1.0, 0.5, 0.25, math.nan)}, r"spacings\[3\]: nan, allowed"),
        ({"normals": ("smooth",)}, r"normals\[0\]: .*allowed: vertex, facet"),
        ({"tolerance": 0.0}, "tolerance: 0.0, allowed"),
        ({"placements": 0}, "placements: 0, allowed"),
        ({"reference": "exact"}, "reference: 'exact', allowed"),
        ({"receiver": 1}, "receiver: 1, allowed"),
        ({"photons": 0}, "photons: 0, allowed"),
        ({"unresolved": "some"}, "unresolved: 'some', allowed: tilt, none"),
        ({"unresolved": "tilt", "reference": "analytic"}, "reference: .*allowed: 'auto' or None"),
    ],
)
def test_wrong_options_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        convergence_study(LINK, WAVE, **options)


def test_only_waves_have_an_exact_surface():
    with pytest.raises(ValueError, match="reference: 'analytic for FlatSea', allowed: None"):
        convergence_study(LINK, FlatSea(), reference="analytic")


def test_a_surface_that_is_no_sum_of_waves_needs_no_option():
    study = convergence_study(
        LINK, FlatSea(), (1.0, 0.7, 0.5, 0.35), ("vertex",), photons=64, placements=1
    )
    assert study.reference is None
    assert study.gain.mean() == pytest.approx(6e-5, rel=0.1)


def test_steps_must_nest():
    with pytest.raises(ValueError, match=r"duration: 5.0, allowed: multiples"):
        time_step_study(LINK, WAVE, (4.0, 2.0, 1.0, 0.5), duration=5.0)
    with pytest.raises(ValueError, match=r"steps: .*allowed: multiples"):
        time_step_study(LINK, WAVE, (4.0, 2.0, 1.3, 0.5), duration=4.0)


def test_scenario_sets_seed_and_time():
    scenario = Scenario.from_config(
        {
            "sea": {"spectrum": "sinusoid", "amplitude": 0.05, "wavelength": 4.0, "time": 1.0},
            "bubbles": "none",
            "run": {"seed": 9},
        }
    )
    options = {"normals": ("vertex",), "photons": 64, "placements": 1, "threads": 1}
    spacings = (2.0, 1.5, 1.0, 0.5)
    study = convergence_study(scenario, None, spacings, **options)
    run = study.provenance["run"]
    assert (run["seed"], run["time"]) == (9, 1.0)
    assert math.isnan(study.scatter[0, 0])
    with pytest.raises(ValueError, match="placements: 0, allowed"):
        convergence_study(scenario, None, spacings, placements=0)


def converge_command(*arguments):
    return CliRunner().invoke(cli.app, ["converge", *map(str, arguments)])


FEW = ["--photons", "64", "--threads", "1", "--set", "bubbles=none"]


@pytest.mark.thorough
def test_command_prints_writes_and_draws(tmp_path):
    pytest.importorskip("matplotlib").use("Agg")
    table, picture = tmp_path / "study.nc", tmp_path / "study.png"
    few = ["--spacings", "2,1.5,1,0.5", "--placements", "2", "--normals", "vertex", *FEW]
    result = converge_command(*few, "-o", table, "--plot", picture)
    assert result.exit_code == 0, result.stderr
    for word in ("vertex normals", "order", "Richardson", "exact surface", "for an error of"):
        assert word in result.stdout
    assert picture.stat().st_size > 10_000
    with xr.open_dataset(table, engine="h5netcdf") as data:
        assert data.sizes["spacing"] == 4


@pytest.mark.thorough
def test_command_studies_bands_and_time_steps():
    bands = converge_command("--omega-max", "2,3,4,5", "--realizations", "2", *FEW)
    assert bands.exit_code == 0, bands.stderr
    assert "omega_max [rad s-1]" in bands.stdout
    steps = converge_command("--time-steps", "0.8,0.4,0.2,0.1", "--duration", "0.8", *FEW)
    assert steps.exit_code == 0, steps.stderr
    assert "time_step [s]" in steps.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--spacings", "1,2"], "--spacings: [1.0, 2.0], allowed: at least four different values"),
        (["--spacings", "x"], "--spacings: 'x', allowed: numbers"),
        (["--spacings", "2,1", "--omega-max", "2"], "--omega-max: [2.0], allowed: not beside"),
        (["--realizations", "3"], "--realizations: 3, allowed: only with --omega-max"),
        (["--plot", "study.xyz"], "--plot: 'study.xyz', allowed: a file ."),
        (["--normals", "smooth"], "--normals: 'smooth', allowed: vertex, facet"),
        (
            ["--set", "sea.spectrum=flat", "--omega-max", "1,2,3,4"],
            "surface: FlatSea, allowed: a rand",
        ),
    ],
)
def test_command_refuses_in_one_line(arguments, message):
    result = converge_command(*arguments, *FEW)
    assert result.exit_code == 2
    assert f"error: {message}" in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.slow
@pytest.mark.parametrize("wind_speed", [5.0, 13.0])
def test_default_link_is_of_second_order(wind_speed):
    study = convergence_study(
        LINK, JonswapSea(wind_speed=wind_speed, waves="paper"), normals=("vertex",)
    )
    order, gain, _ = study.fits["vertex"]
    assert 1.6 < order.value < 2.2
    assert gain.low <= study.reference.gain <= gain.high


def test_shadow_of_a_sphere_by_its_facets():
    """Inscribed polyhedra lack a share ~ h^2 of the shadow; the limit is that of the sphere."""
    balls = [
        mt.TriangleMesh(ball.vertices, ball.faces, overhangs=True)
        for ball in (trimesh.creation.icosphere(k, radius=0.5) for k in (4, 1, 3, 2))
    ]
    body = mt.Body(balls[0], reflection="black", position=(0.0, 0.0, -5.0))
    lamp = mt.TopHatBeam(depth=10.0, divergence_deg=10.0)
    end = mt.Receiver(height=1.0, radius=5.0, fov_deg=180.0)
    clear = mt.Link(water=mt.Water(a=0.0, b=0.0), transmitter=lamp, receiver=end)
    analog = Scenario.from_toml('[run]\nestimator = "analog"').replace(link=clear)
    few = {"photons": 32 * 2048, "seed": 1}
    study = mt.body_study(analog.replace(link=clear.replace(objects=body)), FlatSea(), balls, **few)
    assert (np.diff(study.values) < 0.0).all()
    fit = study.fits["vertex"]
    assert 1.7 < fit.order.value < 2.3
    without = mt.simulate(clear, FlatSea(), estimator="analog", **few)
    # the cone that touches the sphere, over the cone of the lamp
    share = (1.0 - math.cos(math.asin(0.1))) / (1.0 - math.cos(math.radians(10.0)))
    error = 3.9 * math.hypot(study.gain_stderr[0, -1], without.gain_stderr)  # alpha 1e-4
    assert fit.gain.low - error < without.gain * (1.0 - share) < fit.gain.high + error
    assert "facet_size" in str(study)
    with pytest.raises(Refused, match="four different"):
        mt.body_study(analog.replace(link=clear.replace(objects=body)), FlatSea(), balls[:3], **few)
    with pytest.raises(Refused, match="body"):
        mt.body_study(analog, FlatSea(), balls, **few)
