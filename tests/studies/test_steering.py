"""Tracked beams: steered by what was seen before, against closed forms and simple surfaces."""

from __future__ import annotations

import math

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak, z_test

import meshtrace as mt
from meshtrace.errors import Refused
from meshtrace.fading.pointing import Wander
from meshtrace.studies import steer
from meshtrace.surfaces import Band, FlatSea, TiltedPlane, resolved_sea

TIMES = 0.3 * np.arange(6)
HEIGHT, N = 10.0, 1.33
LOW, HIGH = 8.0, 60.0  # [rad s-1]: waves of a centimetre's height, under which a lamp can lie


def link_of(depth=0.05, waist=0.005, receiver=(0.0, 0.0), **tracker):
    beam = mt.GaussianBeam(
        depth=depth, divergence_deg=0.0, waist=waist, tracker=mt.Tracker(**tracker)
    )
    end = mt.Receiver(height=HEIGHT, radius=0.3, position=receiver, fov_deg=60.0)
    return mt.Link(transmitter=beam, receiver=end)


def choppy_patch(wind_speed):
    sea = resolved_sea(wind_speed)
    step = (HIGH - LOW) / 120.0
    return sea.replace(
        waves=Band(omega_min=LOW, omega_max=HIGH, d_omega=step, d_theta=sea.band.d_theta)
    )


def residual(sea, link, seas):
    """Return the share of the variance that is left by seas, its error, and the closed form."""
    beam, tracker = link.transmitter, link.transmitter.tracker
    waves = sea.components
    k = np.stack([waves.kx, waves.ky])
    seen = np.exp(-0.25 * (k**2).sum(axis=0) * beam.waist**2)  # of the footprint
    wander = Wander(waves.omega, 0.5 * (waves.amplitude * k) ** 2 * seen)
    variance = float(wander.variance.sum())
    noise = math.tan(math.radians(tracker.noise_deg)) / (N - 1.0 if tracker.sees == "spot" else 1.0)
    left = wander.left(tracker.latency, tracker.predictor, tracker.sample, 2 * noise**2 / variance)
    spots = [steer(link, sea.with_seed(i), TIMES, i).spot for i in range(seas)]
    shares = (np.array(spots) ** 2).sum(axis=-1).mean(axis=1) / ((N - 1) * HEIGHT) ** 2 / variance
    return shares.mean(), shares.std(ddof=1) / math.sqrt(seas), float(left.sum()) / variance


def meets(sea, link, seas, tests=1):
    share, stderr, closed = residual(sea, link, seas)
    # refraction is linear in the slopes to some 5 % here
    return z_test(share, stderr, closed, 0.05 * closed) > sidak(ALPHA, tests)


@pytest.mark.parametrize("sees", ["spot", "slope"])
def test_a_held_beam_leaves_the_closed_form(sees):
    assert meets(choppy_patch(5.0), link_of(sees=sees), 6)


def test_a_predicted_beam_leaves_the_closed_form():
    link = link_of(latency=0.03, predictor="linear", sees="slope", noise_deg=0.3)
    assert meets(choppy_patch(5.0), link, 6)


@pytest.mark.slow
def test_a_deep_lamp_loses_a_narrow_spot_but_not_the_surface():
    by_spot, _, closed = residual(choppy_patch(5.0), link_of(depth=3.0), 3)
    by_slope, *_ = residual(choppy_patch(5.0), link_of(depth=3.0, sees="slope"), 2)
    assert by_spot > 1.0 > 0.2 > by_slope > closed


@pytest.mark.slow
@pytest.mark.parametrize("wind_speed", [3.0, 5.0, 10.0])
@pytest.mark.parametrize("waist", [0.001, 0.005, 0.02])
@pytest.mark.parametrize("predictor", ["hold", "linear"])
def test_series_of_winds_and_spots_leave_the_closed_form(wind_speed, waist, predictor):
    noise_deg = 0.3 if predictor == "linear" else 0.0
    link = link_of(
        waist=waist, latency=0.02, predictor=predictor, sees="slope", noise_deg=noise_deg
    )
    assert meets(choppy_patch(wind_speed), link, 40, 18)


def test_without_latency_a_seen_surface_leaves_nothing():
    spots = steer(link_of(latency=0.0, sees="slope"), choppy_patch(5.0), TIMES).spot
    assert np.abs(spots).max() < 2e-5 * HEIGHT


def test_a_beam_finds_a_receiver_aside_and_below_a_tilted_plane():
    for sea in (FlatSea(), TiltedPlane(slope_x=0.06, slope_y=-0.03)):
        spot = steer(link_of(depth=3.0, receiver=(1.0, -2.0)), sea, [0.0]).spot
        assert np.abs(spot).max() < 1e-5


def test_a_lamp_in_the_air_finds_a_receiver_in_the_water():
    link = link_of(depth=3.0, receiver=(0.5, 0.0)).mirrored()
    assert link.transmitter.tracker is not None
    assert np.abs(steer(link, TiltedPlane(slope_x=0.06), [0.0]).spot).max() < 1e-5


def test_a_tracked_lamp_follows_the_tilts_of_its_aircraft():
    lamp = mt.AirBeam(height=10.0, divergence_deg=0.5, tracker=mt.Tracker(latency=0.05))
    end = mt.WaterReceiver(depth=2.0, radius=0.3)
    link = mt.Link(water=mt.Water(b=0.0), transmitter=lamp, receiver=end)
    flight = mt.Flight(mt.Uav(), mt.Dryden(wind_speed=8.0))
    times, level = 0.1 * np.arange(4), mt.simulate(link, FlatSea(), photons=64).gain
    series = mt.time_series(link, FlatSea(), times, photons=64, flight=flight)
    assert series.gain == pytest.approx(np.full(4, level), rel=1e-3)
    fixed = link.replace("transmitter.tracker", None)
    assert mt.time_series(fixed, FlatSea(), times, photons=64, flight=flight).gain.max() < 0.1


def test_range_and_rate_limit_the_axis():
    sea = choppy_patch(5.0)
    times = 0.01 * np.arange(20)
    free = steer(link_of(), sea, times).axis
    near = steer(link_of(range_deg=0.5), sea, times).axis
    slow = steer(link_of(rate_deg_s=10.0), sea, times).axis
    assert (
        np.degrees(np.arccos(near[:, 2])).max()
        < 0.5 + 1e-9
        < np.degrees(np.arccos(free[:, 2])).max()
    )
    turns = np.degrees(np.linalg.norm(np.diff(slow, axis=0), axis=1))
    assert turns.max() < 0.1 * (1.0 + 1e-3)
    assert turns.max() == pytest.approx(0.1, rel=1e-2)


def test_a_seed_gives_its_own_noise():
    link, sea = link_of(noise_deg=0.2, sees="slope"), choppy_patch(5.0)
    assert np.array_equal(steer(link, sea, TIMES, 3).axis, steer(link, sea, TIMES, 3).axis)
    assert not np.array_equal(steer(link, sea, TIMES, 3).axis, steer(link, sea, TIMES, 4).axis)


@pytest.mark.thorough
def test_a_tracked_beam_regains_the_light_of_still_water():
    sea = resolved_sea(5.0).replace(omega_max=4.0)
    water, physics = mt.Water(a=0.05, b=0.0), mt.Physics(unresolved="none")
    link = (
        link_of(depth=2.0, waist=0.0, latency=0.02, sees="slope")
        .replace(water=water, physics=physics)
        .replace("transmitter.divergence_deg", 0.3)
    )
    run = {"photons": 64, "spacing": 0.1, "extent": 4.0}
    times = 0.5 * np.arange(3)
    fixed = mt.time_series(link.replace("transmitter.tracker", None), sea, times, **run)
    series = mt.time_series(link, sea, times, **run)
    still = mt.simulate(link, FlatSea(), photons=64).gain
    assert fixed.gain.min() < 0.5 * still
    assert series.gain == pytest.approx(np.full(3, still), rel=0.02)
    trace = mt.channel_trace(link, sea, hours=1.0 / 3600.0, rate=2.0, down=None, **run)
    assert trace.gain == pytest.approx(series.gain[:2], rel=1e-6)


def test_link_files_have_a_tracker():
    text = """
    wind_speed = 5.0
    [transmitter]
    kind = "gaussian-beam"
    [transmitter.tracker]
    latency = 0.03
    predictor = "linear"
    """
    scenario = mt.Scenario.from_toml(text)
    assert scenario.link.transmitter.tracker == mt.Tracker(latency=0.03, predictor="linear")
    assert mt.Scenario.from_toml(scenario.to_toml()) == scenario


def test_refusals():
    sea = choppy_patch(5.0)
    two = link_of().replace("transmitter", (link_of().transmitter,) * 2)
    with pytest.raises(Refused, match=r"^transmitter: 2 sources, allowed: one"):
        steer(two, sea, TIMES)
    with pytest.raises(Refused, match=r"^times: .*allowed: increasing"):
        steer(link_of(), sea, [1.0, 0.0])
    with pytest.raises(Refused, match=r"^tracker.predictor: 'linear', allowed: hold"):
        steer(link_of(predictor="linear"), FlatSea(), TIMES)
    with pytest.raises(Refused, match=r"^transmitter: an axis away"):
        steer(link_of().replace("transmitter.zenith_deg", 120.0), sea, TIMES)
    with pytest.raises(Refused, match=r"^range_deg"):
        mt.Tracker(range_deg=0.0)
