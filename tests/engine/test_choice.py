"""Choice between chains and joined photons, from their pilots."""

import warnings

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.engine import choice
from meshtrace.engine.forced import ForcedDetection
from meshtrace.engine.plan import Planner
from meshtrace.surfaces import FlatSea


def pilot(mean, relative_error, samples):
    error = relative_error * mean
    return choice.ScatteredPilot(
        np.array([mean]), np.array([error**2 * samples]), np.array([error])
    )


@pytest.mark.parametrize(
    ("expected", "error_of_photons", "method"),
    [(20.0, 0.6, "chains"), (20.0, 0.1, "joined"), (0.4, 0.6, "joined")],
    ids=["one heavy photon", "certain", "clear water"],
)
def test_twice_the_light_of_photons_in_turbid_water_must_be_certain(
    expected, error_of_photons, method
):
    chains, photons = pilot(1.0, 0.1, 500), pilot(2.3, error_of_photons, 2048)
    assert choice.choose(chains, photons, expected) == [method]


def test_chains_may_vary_more_where_photons_scatter_often():
    chains, photons = pilot(1.0, 0.05, 4000), pilot(1.0, 0.05, 2048)
    assert choice.choose(chains, photons, 0.4) == ["joined"]
    assert choice.choose(chains, photons, 20.0) == ["chains"]
    assert choice.chain_cost(20.0) == pytest.approx(0.1)
    assert choice.chain_cost(10.0) == pytest.approx(0.2)


def test_wavelengths_share_chains_where_their_time_and_light_suffice():
    """Less sure chains of a tenth of the time once gave way to photons, eight to a chain."""
    chains, photons = [pilot(1.0, error, 2400) for error in (0.12, 0.09)], pilot(1.0, 0.08, 2048)
    expected = np.array([18.0, 12.0])
    assert choice.choose_common(chains, [photons] * 2, expected, 0.1)[0] == ["chains"]
    # light that chains miss at one wavelength
    bright = pilot(2.3, 0.06, 2048)
    assert choice.choose_common(chains, [photons, bright], expected, 0.1)[0] == ["joined"]
    # in clear water a chain takes three times as long as a photon
    assert choice.choose_common(chains, [photons] * 2, np.ones(2), 0.1)[0] == ["joined"]
    assert choice.pilot_photons(18.0, 0.1, wavelengths=31) < choice.pilot_photons(18.0, 0.1)


def test_photons_take_longest_where_many_scatterings_turn_light_little():
    chains, photons = pilot(1.0, 0.05, 4000), pilot(1.0, 0.05, 512)
    assert choice.choose(chains, photons, 10.0) == ["joined"]  # isotropic scattering
    assert choice.choose(chains, photons, 10.0, turn=0.1) == ["chains"]  # b (1 - g) z = 1
    assert choice.chain_cost(20.0, turn=0.1) == choice.chain_cost(20.0)  # diffuse light
    assert choice.pilot_photons(10.0, 0.1) < choice.pilot_photons(20.0, 0.1)


def relative(gain, variance, error):
    """Return a pilot by its gain, relative variance and relative standard error."""
    square = np.square(gain)
    return choice.ScatteredPilot(
        np.array([gain]), np.array([variance * square]), np.array([error * gain])
    )


def test_the_error_of_a_pilot_is_no_measure_of_its_estimator():
    """Pilots at b z = 20: of 1300 chains in .1 s, of 8192 photons in 2 s and with a small error."""
    chains, photons = relative(3.07e-6, 25.9, 0.108), relative(2.28e-6, 52.4, 0.074)
    assert choice.choose(chains, photons, 20.0, 0.07) == ["chains"]
    # heavier tails, g = 0.9: chains take 40 CPU s to 1 % in long runs, photons 11
    chains, photons = relative(1.27e-6, 44.51, 0.1425), relative(1.21e-6, 53.28, 0.0757)
    assert choice.choose(chains, photons, 21.6, 0.1) == ["joined"]
    # one chain brings all of the light that these see
    chains, photons = relative(1.54e-10, 2040.0, 1.0), relative(4.75e-6, 1150.0, 0.74)
    assert choice.choose(chains, photons, 15.0) == ["joined"]


def test_every_seed_takes_chains_in_very_turbid_water():
    """The second and the eighth took joined photons: 90 CPU s to 1 % in place of 7."""
    for seed in (2, 8):
        planner = Planner(mt.Link(water=mt.Water(a=0.1, b=2.0)), seed=seed)
        assert planner.compare().method == ["chains"]


def test_reflected_light_has_as_many_photons_as_its_error_is_worth():
    """It is 0.4 % of this gain; 1.6 photons a chain once took four fifths of the time."""
    planner = Planner(mt.Link(water=mt.Water(a=0.1, b=2.0)), seed=3)
    comparison = planner.compare()
    assert comparison.method == ["chains"]
    plan = planner.plan(60_000, comparison)
    assert plan.reflects
    assert choice.FEWEST_REFLECTED < plan.joined.photons < 0.2 * 60_000
    # few chains keep the number of photons by the share of the light
    assert planner.plan(512, comparison).joined.photons > 512
    # a quarter of the error of the chains
    variance, returned = np.array([4e-12]), np.array([1e-8])
    assert choice.reflected_per_chain(returned, variance) == pytest.approx(0.2)


def test_tails_too_small_to_be_squared_are_no_clear_light():
    """Their variance of 0 once was that of certain light: a gain of 1.7e-207 +- 0 for 5e-11."""
    assert choice.is_clear(pilot(1e-9, 0.01, 1000)).all()
    assert not choice.is_clear(pilot(1e-207, 0.5, 1000)).any()
    assert not choice.is_clear(pilot(1e-160, 0.5, 1000)).any()


@pytest.mark.slow
def test_every_seed_finds_light_that_scattering_alone_brings():
    """Chains reach the aperture by tails only, and the third seed once took their word."""
    water = mt.Water.from_type("jerlov-IB", 500.0)
    lamp = mt.Led(depth=3.062, half_angle_deg=3.72, wavelength_nm=500.0)
    receiver = mt.Receiver(
        height=25.165, position=(-4.3826, -10.1764), radius=0.16, fov_deg=74.7, tilt_deg=35.9,
        tilt_azimuth_deg=231.6,
    )  # fmt: skip
    link = mt.Link(transmitter=lamp, receiver=receiver, water=water)
    for seed in range(1, 9):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            run = mt.simulate(link, FlatSea(), photons=2048, seed=seed)
        assert run.scattered[0].estimator == "joined photons"
        assert 1e-11 < run.gain < 1e-9


@pytest.mark.parametrize(
    ("variance", "gain", "method"),
    [(4.0, 1e-3, "chains"), (60.0, 1e-3, "analog"), (60.0, 1e-4, "chains"), (60.0, 1.0, "analog")],
)
def test_analog_photons_serve_where_many_hit(variance, gain, method):
    """A score up to w of mean h varies by w / h - 1; 24 times the variance of a pilot beats it."""
    found = pilot(gain, (variance / 4000) ** 0.5, 4000)
    assert choice.prefer_analog(found, 1.0, ["chains"]) == [method]


def test_a_pilot_that_rests_on_one_heavy_sample_prefers_no_analog_photons():
    assert choice.prefer_analog(pilot(1e-2, 1.0, 4000), 1.0, ["joined"]) == ["joined"]


def turbid(b, radius=1.0):
    """Return a lamp of 20 deg in very turbid water, on the axis of an aperture."""
    return mt.Link(
        water=mt.Water(a=0.05, b=b, phase=mt.FournierForand()),
        transmitter=mt.Led(half_angle_deg=20.0),
        receiver=mt.Receiver(height=5.0, radius=radius, fov_deg=120.0),
    )


@pytest.mark.thorough
def test_very_turbid_light_into_a_wide_aperture_is_that_of_analog_photons():
    link = turbid(2.0)
    runs = [mt.simulate(link, FlatSea(), photons=2048, seed=1, threads=n) for n in (1, 2)]
    assert runs[0].gain == runs[1].gain
    (by,) = runs[0].scattered
    assert by.estimator == "analog photons"
    assert by.samples == 32 * 2048
    assert "analog photons" in runs[0].summary()
    found = mt.simulate(link, FlatSea(), photons=2048, seed=1, record=[mt.Arrivals()])
    assert found.arrivals.weight.sum() == pytest.approx(runs[0].gain, rel=1e-9)
    assert ForcedDetection(turbid(2.0, 0.05), 32, 1).method == ["chains"]


@pytest.mark.parametrize("rtol", [0.02, 0.01])
def test_a_relative_error_is_met_by_few_chains(rtol):
    """10 000 chains, once the first number, bring 0.1 %."""
    for seed in range(1, 5):
        found = mt.simulate(mt.Link(), FlatSea(), rtol=rtol, seed=seed)
        assert found.gain_stderr <= rtol * found.gain
        assert found.photons < 1000
    assert found.gain_stderr > 0.25 * rtol * found.gain
