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
    assert result.echo[2].sum() == pytest.approx(8.8075e-10, rel=1e-4)
    bright = np.flatnonzero(result.echo[2])
    assert result.delay_edges[bright[0]] <= 88.728e-9 <= result.delay_edges[bright[-1] + 1]
    assert not result.echo[1].any()
    assert result.bias("peak")[0] == pytest.approx(0.0, abs=2e-3)
    assert result.bias("centroid")[0] == pytest.approx(0.0, abs=2e-3)


@pytest.mark.thorough
def test_the_reference_with_scattering():
    # an own code: 5.470(1)e-10, of light joined from the bottom itself
    result = mt.lidar(LINK, FlatSea(), photons=40_000, bin_width=1e-10, seed=1)
    echo, error = result.echo[2].sum(), math.sqrt((result.echo_stderr[2] ** 2).sum())
    # 3.9 standard errors: 1e-4, two-sided
    assert abs(echo - 5.470e-10) < 3.9 * math.hypot(error, 1e-13)
    time = 0.5 * (result.delay_edges[1:] + result.delay_edges[:-1])
    mean = (time * result.echo[2]).sum() / echo
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
