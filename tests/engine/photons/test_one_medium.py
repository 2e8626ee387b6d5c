"""Analog photons between ends in one medium: straight, mirrored, scattered, from the bottom.

Figures of any-link.md are those of its own codes.
"""

import math

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak
from scipy import stats

import meshtrace as mt
from meshtrace.engine import straight
from meshtrace.engine.photons import analog
from meshtrace.engine.setup import ends
from meshtrace.kernels import tally
from meshtrace.surfaces import FlatSea

LIMIT = stats.norm.isf(sidak(ALPHA, 10) / 2.0)
CLEAR = mt.Water(a=0.114, b=0.037, n=1.33)
PARTS = (tally.DIRECT, tally.MIRRORED, tally.SCATTERED, tally.BOTTOM)


def gains_of(link, photons, seed=1, extent=200.0):
    """Return (gain, standard error) of each of `PARTS`, and of all light."""
    mesh = FlatSea().mesh(extent=extent, spacing=extent / 2.0)
    options = {"photons": photons, "seed": seed, "record": ["arrivals"]}
    sums = analog.run_analog(link, mt.EmbreeIntersector(mesh, 1), **options)
    hits, scores = sums.all_arrivals, []
    assert set(hits["part"]) <= set(PARTS)
    for parts in (*((p,) for p in PARTS), PARTS):
        chosen = hits[np.isin(hits["part"], parts)]
        # a photon may arrive more than once
        score = np.bincount(chosen["photon"], chosen["weight"], photons)
        scores.append((score.mean(), score.std() / math.sqrt(photons)))
    assert scores[-1][0] == pytest.approx(sums.score[0] / photons, rel=1e-12)
    return np.array(scores)


def z_of(score, expected, error=0.0):
    return (score[0] - expected) / math.hypot(score[1], error)


def straight_gain(link):
    forced = ends.forced_link(link)
    return straight.straight_gains(forced, None, forced.medium, 0, 0)[0]


@pytest.mark.thorough
def test_all_light_under_water():
    """A wide lens far from surface and bottom: 1.2713(65)e-3, of which one part is straight."""
    link = mt.Link(
        water=CLEAR,
        transmitter=mt.Led(depth=100.0, zenith_deg=90.0, half_angle_deg=10.0),
        receiver=mt.WaterReceiver(
            depth=100.0, position=(20.0, 0.0), radius=0.5, fov_deg=180.0, tilt_deg=90.0,
            tilt_azimuth_deg=180.0,
        ),
    )  # fmt: skip
    scores = gains_of(link, 400_000)
    print(scores, straight_gain(link))
    assert abs(z_of(scores[0], straight_gain(link))) < LIMIT
    assert abs(z_of(scores[4], 1.2713e-3, 6.5e-6)) < LIMIT
    assert scores[1, 0] == scores[3, 0] == 0.0
    assert scores[2, 0] > 0.0


@pytest.mark.thorough
def test_all_light_back_to_the_air():
    """A laser over a bright bottom: all returns out of the water 1.777(35)e-4 and 1.766(9)e-4."""
    link = mt.Link(
        water=CLEAR.replace(bottom_depth=10.0, bottom_albedo=0.5),
        transmitter=mt.AirTopHatBeam(height=30.0, divergence_deg=0.03),
        receiver=mt.Receiver(height=30.0, radius=3.0, fov_deg=180.0),
    )
    scores = gains_of(link, 600_000)
    print(scores)
    # the telescope surrounds the laser: nothing is straight, the level sea mirrors at nadir
    mirror = ((1.33 - 1.0) / (1.33 + 1.0)) ** 2
    assert scores[0, 0] == 0.0
    assert scores[1, 0] == pytest.approx(mirror, rel=1e-3)
    returned = scores[2:4].sum(axis=0)[0], math.hypot(*scores[2:4, 1])
    assert abs(z_of(returned, 1.777e-4, 3.5e-6)) < LIMIT
    assert abs(z_of(returned, 1.766e-4, 0.9e-6)) < LIMIT
    assert scores[3, 0] > scores[2, 0] > 0.0


@pytest.mark.parametrize("aim", [60.0, 90.0, 110.0])
def test_straight_in_the_air(aim):
    """Light that goes down, level or up to a receiver in the air."""
    height = 10.0 - 8.0 / math.tan(math.radians(aim))
    link = mt.Link(
        water=CLEAR,
        transmitter=mt.AirLed(height=10.0, half_angle_deg=20.0, tilt_deg=aim),
        receiver=mt.Receiver(
            height=height, position=(8.0, 0.0), radius=1.5, fov_deg=180.0, tilt_deg=180.0 - aim,
            tilt_azimuth_deg=180.0,
        ),
    )  # fmt: skip
    # most light leaves a mesh of 40 m, beyond the receiver
    scores = gains_of(link, 60_000, extent=40.0)
    print(scores, straight_gain(link))
    assert abs(z_of(scores[0], straight_gain(link))) < LIMIT


def test_mirror_image_in_the_air():
    """A level sea of R(theta) shows a lamp to a small receiver as its image."""
    height, aside = 4.0, 6.0
    link = mt.Link(
        water=CLEAR,
        transmitter=mt.AirLed(height=height, half_angle_deg=60.0),
        receiver=mt.Receiver(height=height, position=(aside, 0.0), radius=0.5, fov_deg=180.0),
    )
    scores = gains_of(link, 200_000)
    square = (2.0 * height) ** 2 + aside**2
    cosine = 2.0 * height / math.sqrt(square)
    mirror = mt.optics.fresnel_reflectance(cosine, 1.0, 1.33)
    expected = mirror / math.pi * cosine**2 / square * math.pi * 0.5**2
    print(scores, expected)
    # the light of a disk of (0.5 / 10)^2 is even to 0.2 %
    assert abs(z_of(scores[1], expected, 2e-3 * expected)) < LIMIT
    assert scores[0, 0] == 0.0


def test_lamp_and_receiver_look_at_each_other_in_the_water():
    """Straight up, straight down, and total reflection off the level surface."""
    for zenith, depths in ((0.0, (8.0, 5.0)), (180.0, (5.0, 8.0))):
        link = mt.Link(
            water=CLEAR,
            transmitter=mt.Led(depth=depths[0], zenith_deg=zenith, half_angle_deg=30.0),
            receiver=mt.WaterReceiver(
                depth=depths[1], radius=0.6, fov_deg=180.0, tilt_deg=180.0 - zenith
            ),
        )
        scores = gains_of(link, 60_000)
        assert abs(z_of(scores[0], straight_gain(link))) < LIMIT
    link = mt.Link(
        water=CLEAR,
        transmitter=mt.Led(depth=3.0, half_angle_deg=60.0),
        receiver=mt.WaterReceiver(depth=3.0, position=(9.0, 0.0), radius=0.7, fov_deg=180.0),
    )
    scores = gains_of(link, 200_000)
    square = 36.0 + 81.0
    cosine = 6.0 / math.sqrt(square)
    # beyond the critical angle everything is reflected
    expected = cosine**2 / math.pi / square * math.pi * 0.49 * math.exp(-0.151 * math.sqrt(square))
    print(scores, expected)
    assert abs(z_of(scores[1], expected, 5e-3 * expected)) < LIMIT
