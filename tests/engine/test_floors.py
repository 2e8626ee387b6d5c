"""Links over a sea floor: chains for light that misses it, photons for its own."""

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak, z_test

import meshtrace as mt
from meshtrace.surfaces import SinusoidalSea

pytestmark = [
    pytest.mark.filterwarnings("ignore:.*left the meshed surface:meshtrace.DomainWarning"),
    pytest.mark.filterwarnings("ignore:.*the mesh cuts off:meshtrace.DomainWarning"),
    pytest.mark.filterwarnings("ignore:.*error of about:meshtrace.DomainWarning"),
]

SEA = SinusoidalSea(amplitude=0.0875, wavelength=2.33, phase=4.247)
WATER = mt.Water(a=0.18, b=0.19, n=1.33, phase=mt.FournierForand(n=1.15, mu=3.5))
LINKS = {
    "down": mt.Link(
        water=WATER,
        transmitter=mt.AirLed(height=4.4, half_angle_deg=5.0),
        receiver=mt.WaterReceiver(depth=7.4, radius=0.7, fov_deg=80.0),
    ),
    "up": mt.Link(
        water=WATER,
        transmitter=mt.Led(depth=7.4, half_angle_deg=5.0),
        receiver=mt.Receiver(height=4.4, radius=0.7, fov_deg=80.0),
    ),
}


def over(link, depth, albedo):
    return link.replace(water=link.water.replace(bottom_depth=depth, bottom_albedo=albedo))


@pytest.mark.parametrize("name", LINKS)
def test_a_black_floor_below_the_light_changes_no_digit(name):
    """Joined photons through smooth waves, to which floors once led, were 4 % low."""
    bare = mt.simulate(LINKS[name], SEA, photons=1024, seed=2)
    black = mt.simulate(over(LINKS[name], 40.0, 0.0), SEA, photons=1024, seed=2)
    assert black.scattered == bare.scattered
    assert black.scattered[0].estimator == "chains"
    assert black.gain == bare.gain
    assert black.gain_stderr == bare.gain_stderr


@pytest.mark.thorough
@pytest.mark.statistical
@pytest.mark.slow_but("up-0.8")
@pytest.mark.parametrize("albedo", [0.0, 0.8])
@pytest.mark.parametrize("name", LINKS)
def test_analog_photons_agree_over_smooth_waves(name, albedo):
    link = over(LINKS[name].replace(water=WATER.replace(b=1.0)), 7.6, albedo)
    runs = [mt.simulate(link, SEA, photons=2048, seed=s) for s in range(1, 9)]
    gain, error = (np.array([getattr(r, k) for r in runs]) for k in ("gain", "gain_stderr"))
    analog = mt.simulate(link, SEA, "analog", photons=2_000_000, seed=3)
    whole = np.hypot.reduce(error) / len(runs)
    p = z_test(gain.mean(), whole, analog.gain, analog.gain_stderr)
    print(name, albedo, gain.mean(), whole, analog.gain, analog.gain_stderr, runs[0].scattered)
    assert p > sidak(ALPHA, 2 * len(LINKS))
    assert whole < 0.02 * analog.gain
