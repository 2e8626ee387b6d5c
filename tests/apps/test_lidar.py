"""Lidar through waves: energies and delays of closed forms, depths, refusals."""

import math

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.surfaces import FlatSea, JonswapSea

LINK = mt.Link(
    water=mt.Water(a=0.114, b=0.037, n=1.33, bottom_depth=10.0, bottom_albedo=0.15),
    transmitter=mt.AirTopHatBeam(height=300.0, divergence_deg=math.degrees(5e-4)),
    receiver=mt.Receiver(height=300.0, radius=0.1, fov_deg=math.degrees(5e-3)),
)


def test_without_scattering_the_echo_is_a_closed_form():
    # (rho / pi) T^2 A exp(-2 a D) / (n H + D)^2, 2 n D / c after the surface
    result = mt.lidar(LINK.replace("water.b", 0.0), FlatSea(), photons=256, bin_width=1e-10)
    assert result.energy[2] == pytest.approx(8.8075e-10, rel=1e-4)
    assert result.echo[2].sum() == pytest.approx(result.energy[2], rel=1e-9)
    bright = np.flatnonzero(result.echo[2])
    assert result.delay_edges[bright[0]] <= 88.728e-9 <= result.delay_edges[bright[-1] + 1]
    assert not result.echo[1].any()
    assert result.bias("peak")[0] == pytest.approx(0.0, abs=2e-3)
    assert result.bias("centroid")[0] == pytest.approx(0.0, abs=2e-3)


def test_a_beam_that_looks_aside_enters_at_its_own_spot():
    """E = (rho / pi) cos(w) T^2 exp(-2 a D / cos w) A dOmega/dA, w the angle of refraction."""
    high, deep, tilt, n = 400.0, 5.0, math.radians(20.0), 1.33
    link = mt.Link(
        water=mt.Water(a=0.114, b=0.0, n=n, bottom_depth=deep, bottom_albedo=0.15),
        transmitter=mt.AirTopHatBeam(height=high, divergence_deg=0.005, tilt_deg=20.0),
        receiver=mt.Receiver(height=high, radius=0.1, fov_deg=1.0, tilt_deg=20.0),
    )
    result = mt.lidar(link, FlatSea(), photons=256)
    below = math.asin(math.sin(tilt) / n)
    cos_t, cos_w = math.cos(tilt), math.cos(below)
    # area at the telescope per solid angle in the water: widths across and in the plane
    across = high * math.tan(tilt) + deep * math.tan(below)
    within = high * n * cos_w / cos_t**3 + deep / cos_w**2
    spread = across * within * cos_t / math.sin(below)
    perpendicular = (cos_t - n * cos_w) / (cos_t + n * cos_w)
    parallel = (n * cos_t - cos_w) / (n * cos_t + cos_w)
    passed = 1.0 - 0.5 * (perpendicular**2 + parallel**2)
    echo = 0.15 / math.pi * cos_w * passed**2 * math.exp(-0.228 * deep / cos_w) * math.pi * 0.01
    assert result.energy[2] == pytest.approx(echo / spread, rel=1e-3)
    assert result.bias("centroid")[0] == pytest.approx(0.0, abs=5e-3)


@pytest.mark.thorough
def test_the_reference_with_scattering():
    # an own code: 5.470(1)e-10, of light joined from the bottom itself
    result = mt.lidar(LINK, FlatSea(), photons=40_000, bin_width=1e-10, seed=1)
    echo, error = result.energy[2], result.energy_stderr[2]
    # 3.9 standard errors: 1e-4, two-sided
    assert abs(echo - 5.470e-10) < 3.9 * math.hypot(error, 1e-13)
    time = 0.5 * (result.delay_edges[1:] + result.delay_edges[:-1])
    mean = (time * result.echo[2]).sum() / result.echo[2].sum()
    assert mean == pytest.approx(88.741e-9, abs=0.03e-9)
    assert abs(result.bias("centroid")[0]) < 0.01


@pytest.mark.thorough
def test_single_backscatter_by_depth():
    # b beta(180) T^2 A exp(-2 c z) / (n H + z)^2 per metre, of light scattered once
    water = LINK.water.replace(phase=mt.FournierForand(n=1.10, mu=3.5835), bottom_albedo=0.0)
    link = LINK.replace(water=water)
    run = mt.simulate(link, FlatSea(), photons=60_000, seed=2, record=[mt.Arrivals()])
    rows = run.arrivals.to_dataframe()
    once = rows[(rows.part == 1) & (rows.order == 1)]
    depth = 0.5 * (once.time - 600.0 / 299792458.0) * 299792458.0 / 1.33
    groups = np.array([
        np.histogram(depth[once.group == g], [0.75, 1.25, 4.5, 5.5], weights=once.weight[once.group == g])[0]
        for g in range(32)
    ])  # fmt: skip
    per_metre = 32.0 * groups[:, [0, 2]] / [0.5, 1.0]
    error = per_metre.std(axis=0, ddof=1) / math.sqrt(32.0)
    # 4.1 errors: 1e-4 for two tests; 1 % for the width of the bins
    expected = np.array([1.474e-11, 4.317e-12])
    assert (abs(per_metre.mean(axis=0) - expected) < 4.1 * error + 0.01 * expected).all()


def test_waves_scatter_the_depth():
    result = mt.lidar(LINK, JonswapSea(wind_speed=5.0), seas=6, photons=256, seed=3)
    assert len(result.depth_by_peak) == 6
    bias, error = result.bias("peak")
    assert abs(bias) < 0.2
    assert 0.0 < error < 0.1
    assert 0.0 < result.scatter("peak") < 0.2
    # surface, column and bottom by the part of their arrivals, over a rough sea, too
    assert all(energy.any() for energy in result.echo)
    assert "bias" in result.summary()


@pytest.mark.thorough
def test_the_error_of_an_echo_is_that_of_other_seeds():
    # over one surface: the groups of samples; the bins of an echo scatter together
    results = [mt.lidar(LINK, FlatSea(), photons=200, seed=k) for k in range(64)]
    energy = np.array([result.energy for result in results])
    stated = np.array([result.energy_stderr for result in results])
    for k in (1, 2):
        # 64 seeds know a standard deviation to 9 %, and the stated errors scatter, too
        assert 0.6 < energy[:, k].std(ddof=1) / np.sqrt((stated[:, k] ** 2).mean()) < 1.6


def test_troughs_and_turbid_water_hide_no_bottom():
    # waves of 10 m/s lift the echo of the surface by metres, and most light is lost on the way
    sea = JonswapSea(wind_speed=10.0, seed=4)
    result = mt.lidar(LINK, sea, seas=8, photons=512, seed=4)
    assert np.isfinite(result.depth_by_peak).all()
    assert abs(result.depth_by_peak - 10.0).max() < 1.0
    turbid = LINK.replace("water.b", 0.3)
    depth = mt.lidar(turbid, FlatSea(), photons=1024, seed=1).depth_by_peak[0]
    assert depth == pytest.approx(10.0, abs=0.2)


def test_waves_are_as_short_as_the_spot_unless_the_sea_names_them():
    free = mt.lidar(LINK, JonswapSea(wind_speed=5.0), seas=1, photons=64)
    own = mt.lidar(LINK, JonswapSea(wind_speed=5.0, omega_max=4.0), seas=1, photons=64)
    surface = free.provenance["surface"], own.provenance["surface"]
    # a spot of 2.5 times the half-angle: omega^2 = 2 pi g / radius in deep water
    assert surface[0]["omega_max"] == pytest.approx(math.sqrt(2 * math.pi * 9.81 / 0.375), rel=0.01)
    assert surface[1]["omega_max"] == 4.0


def test_other_readings_are_refused():
    result = mt.lidar(LINK, FlatSea(), photons=64)
    with pytest.raises(mt.Refused, match=r"^reading: 'mode', allowed: peak, centroid"):
        result.bias("mode")
    assert "nan" not in result.summary()


def test_results_load_again(tmp_path):
    result = mt.lidar(LINK, FlatSea(), photons=64)
    result.save(tmp_path / "lidar.nc")
    again = mt.LidarResult.load(tmp_path / "lidar.nc")
    np.testing.assert_array_equal(again.echo, result.echo)
    assert again.summary() == result.summary()


@pytest.mark.parametrize(
    ("link", "text"),
    [
        (mt.Link(), r"^link: led, receiver, allowed: one lamp and one receiver in the air"),
        (LINK.replace(water=mt.Water()), r"^water\.bottom_depth: None"),
        (LINK.replace("transmitter.tilt_deg", 120.0), "^transmitter: an axis that leads up"),
    ],
)
def test_other_links_are_refused(link, text):
    with pytest.raises(mt.Refused, match=text):
        mt.lidar(link, FlatSea())
