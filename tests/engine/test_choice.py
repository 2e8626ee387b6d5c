"""Choice between chains and joined photons, from their pilots."""

import warnings

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.engine.choice import ScatteredPilot, chain_cost, choose, is_clear
from meshtrace.surfaces import FlatSea


def pilot(mean, relative_error, samples):
    error = relative_error * mean
    return ScatteredPilot(np.array([mean]), np.array([error**2 * samples]), np.array([error]))


@pytest.mark.parametrize(
    ("expected", "error_of_photons", "method"),
    [(20.0, 0.6, "chains"), (20.0, 0.1, "joined"), (0.4, 0.6, "joined")],
    ids=["one heavy photon", "certain", "clear water"],
)
def test_twice_the_light_of_photons_in_turbid_water_must_be_certain(
    expected, error_of_photons, method
):
    chains, photons = pilot(1.0, 0.1, 500), pilot(2.3, error_of_photons, 2048)
    assert choose(chains, photons, expected) == [method]


def test_chains_may_vary_more_where_photons_scatter_often():
    chains, photons = pilot(1.0, 0.05, 4000), pilot(1.0, 0.05, 2048)
    assert choose(chains, photons, 0.4) == ["joined"]
    assert choose(chains, photons, 20.0) == ["chains"]
    assert chain_cost(20.0) == pytest.approx(0.1)
    assert chain_cost(10.0) == pytest.approx(0.2)


def test_tails_too_small_to_be_squared_are_no_clear_light():
    """Their variance of 0 once was that of certain light: a gain of 1.7e-207 +- 0 for 5e-11."""
    assert is_clear(pilot(1e-9, 0.01, 1000)).all()
    assert not is_clear(pilot(1e-207, 0.5, 1000)).any()
    assert not is_clear(pilot(1e-160, 0.5, 1000)).any()


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
