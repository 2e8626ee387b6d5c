"""Links whose ends lie on one side of the surface: closed forms, analog photons, true errors.

Apertures are wide, so that analog photons hit them. Links are drawn from one generator: lamps of
all kinds, receivers that look at the lamp, at its image in the surface, or at the bottom.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import meshtrace as mt
from meshtrace.mesh import UnresolvedSlopes
from meshtrace.results import tallies
from meshtrace.surfaces import FlatSea, JonswapSea, SinusoidalSea

WATERS = [(0.114, 0.037), (0.179, 0.219), (0.366, 0.9)]


def facing(center, at):
    """Return (tilt from straight up, azimuth) in degrees of the way from a place to another."""
    way = np.subtract(at, center)
    tilt = math.degrees(math.acos(way[2] / np.linalg.norm(way)))
    return tilt, math.degrees(math.atan2(way[1], way[0])) % 360.0


def random_link(rng, under):
    """Return a link with both ends under or over the sea, and the sea."""
    a, b = WATERS[rng.integers(3)]
    water = mt.Water(a=a, b=b, n=1.34)
    if rng.random() < 0.5 or not under:
        depth, albedo = float(rng.uniform(9.0, 12.0)), float(rng.uniform(0.1, 0.8))
        water = water.replace(bottom_depth=depth, bottom_albedo=albedo)
    sign = -1.0 if under else 1.0
    levels = rng.uniform(2.0, 7.0, 2)
    places = rng.uniform(-4.0, 4.0, (2, 2))
    lamp, end = np.array([*places[0], sign * levels[0]]), np.array([*places[1], sign * levels[1]])
    image = end * [1.0, 1.0, -1.0]
    # the lamp shines at the receiver, at its image, or somewhere
    aims = [end, image, rng.uniform(-6.0, 6.0, 3)]
    tilt, azimuth = facing(lamp, aims[rng.integers(3 if under else 2)])
    source = dict(position=tuple(lamp[:2]), azimuth_deg=azimuth, zenith_deg=tilt, depth=levels[0])
    if not under:
        source = dict(position=tuple(lamp[:2]), tilt_azimuth_deg=azimuth, tilt_deg=180.0 - tilt)
        source["height"] = levels[0]
    spread = float(rng.uniform(3.0, 40.0))
    kinds = (mt.Led, mt.TopHatBeam, mt.GaussianBeam) if under else (mt.AirLed, mt.AirTopHatBeam)
    kind = kinds[rng.integers(len(kinds))]
    source["half_angle_deg" if "Led" in kind.__name__ else "divergence_deg"] = spread
    tilt, azimuth = facing(
        end, [lamp, lamp * [1, 1, -1], rng.uniform(-6.0, 6.0, 3)][rng.integers(3)]
    )
    fields = dict(
        position=tuple(end[:2]), radius=float(rng.uniform(0.6, 1.5)), tilt_azimuth_deg=azimuth
    )
    fields |= {"fov_deg": float(rng.choice([90.0, 140.0, 180.0]))}
    if under:
        receiver = mt.WaterReceiver(depth=levels[1], tilt_deg=tilt, **fields)
    else:
        receiver = mt.Receiver(height=levels[1], tilt_deg=180.0 - tilt, **fields)
    seas = [
        FlatSea(),
        SinusoidalSea(amplitude=0.05, wavelength=2.0),
        JonswapSea(wind_speed=4.0, seed=3),
    ]
    return mt.Link(water=water, transmitter=kind(**source), receiver=receiver), seas[
        rng.integers(3)
    ]


def deviations(number, under, photons, analog):
    """Return the deviations of forced from analog gains, over their errors, of random links."""
    z = []
    for i in range(number):
        link, sea = random_link(np.random.default_rng([7, i]), under)
        options = {"extent": 40.0, "threads": 2}
        forced = mt.simulate(link, sea, photons=photons, seed=i + 1, **options)
        hits = mt.simulate(link, sea, "analog", photons=analog, seed=i + 1000, **options)
        assert sum(forced.gain_parts.values()) == pytest.approx(forced.gain, rel=1e-12)
        # the error of fewer hits is hardly known itself
        if hits.gain > 8.0 * hits.gain_stderr:
            error = math.hypot(forced.gain_stderr, hits.gain_stderr)
            z.append((forced.gain - hits.gain) / error)
    return np.array(z)


def require_agreement(z):
    """Require deviations of two independent estimates to be normal, at 1e-4 on each side."""
    # errors that are too large fail as well
    assert stats.chi2.ppf(5e-5, len(z)) < z @ z < stats.chi2.isf(5e-5, len(z))
    assert abs(z.sum()) / math.sqrt(len(z)) < stats.norm.isf(5e-5)


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("under", [True, False], ids=["under", "over"])
@pytest.mark.thorough
def test_random_links_agree_with_analog_photons(under):
    z = deviations(4, under, photons=4000, analog=300_000)
    assert len(z) >= 3
    require_agreement(z)


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("under", [True, False], ids=["under", "over"])
@pytest.mark.slow
def test_forty_random_links_agree_with_analog_photons(under):
    z = deviations(20, under, photons=8000, analog=2_000_000)
    assert len(z) >= 18
    require_agreement(z)


WATER = mt.Water(a=0.114, b=0.037, n=1.33)
MIRROR = mt.Link(
    water=WATER,
    transmitter=mt.Led(depth=5.0, half_angle_deg=60.0),
    receiver=mt.WaterReceiver(depth=3.0, position=(12.0, 0.0), radius=0.1, fov_deg=180.0),
)
FACING = mt.Link(
    water=WATER,
    transmitter=mt.Led(depth=4.0, zenith_deg=90.0, half_angle_deg=10.0),
    receiver=mt.WaterReceiver(
        depth=4.0, position=(10.0, 0.0), radius=0.05, fov_deg=180.0, tilt_deg=90.0,
        tilt_azimuth_deg=180.0,
    ),
)  # fmt: skip
LIDAR = mt.Link(
    water=WATER.replace(bottom_depth=10.0, bottom_albedo=0.15),
    transmitter=mt.AirTopHatBeam(height=300.0, divergence_deg=math.degrees(5e-4)),
    receiver=mt.Receiver(height=300.0, radius=0.1, fov_deg=math.degrees(5e-3)),
)


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize(
    ("link", "part", "expected"),
    [
        # images in the plane mirror, integrated over the disk
        (MIRROR, "mirrored", 1.67619e-6),
        (FACING, "mirrored", 5.45954e-10),
        (FACING, "straight", 1.27750e-4),
        # (rho / pi) T^2 A exp(-2 a D) / (n H + D)^2
        (LIDAR.replace("water.b", 0.0), "bottom", 8.8075e-10),
        # R0 of a plane mirror that spreads the cone over (2 H tan(alpha))^2
        (LIDAR, "mirrored", ((1.33 - 1.0) / (1.33 + 1.0)) ** 2 * (0.1 / (600.0 * 5e-4)) ** 2),
    ],
)
def test_closed_forms_over_still_water(link, part, expected):
    result = mt.simulate(link, FlatSea(), photons=512, seed=1)
    assert result.gain_parts[part] == pytest.approx(expected, rel=3e-5)
    assert sum(result.gain_parts.values()) == pytest.approx(result.gain, rel=1e-12)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_the_glint_of_gaussian_slopes():
    # R0 A / (4 pi mss H^2), mss of both components, for slopes that are wide against the beam
    s = 0.1
    mesh = replace(
        FlatSea().mesh(0.0, extent=20.0, spacing=1.0),
        unresolved=UnresolvedSlopes(vertex=(s * s, s * s), facet=(s * s, s * s)),
    )
    result = mt.simulate(LIDAR, mesh, photons=64, seed=1)
    expected = ((1.33 - 1.0) / (1.33 + 1.0)) ** 2 * 0.01 / (4.0 * 2.0 * s * s * 300.0**2)
    assert result.gain_parts["mirrored"] == pytest.approx(expected, rel=3e-4)


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize(
    ("link", "photons"),
    [
        (MIRROR, 200),
        pytest.param(FACING, 500, marks=pytest.mark.slow),
        (LIDAR, 500),
        pytest.param(FACING.replace("water.b", 0.9), 32, marks=pytest.mark.slow),
    ],
)
@pytest.mark.thorough
def test_stated_errors_are_true(link, photons):
    results = [mt.simulate(link, FlatSea(), photons=photons, seed=k) for k in range(1, 65)]
    # what has noise: neither straight light nor that which still water mirrors
    noisy = [tallies.ONE_SIDE_PARTS["scattered"], tallies.ONE_SIDE_PARTS["bottom"]]
    gains = np.array([result.gain_part[0, noisy].sum() for result in results])
    variance = np.mean([(result.gain_part_stderr[0, noisy] ** 2).sum() for result in results])
    # scatter of 64 seeds over the stated variance; wider than chi-square's own bounds, as the
    # stated errors of heavy tails scatter, too
    assert 0.4 < gains.var(ddof=1) / variance < 2.5


def test_receivers_at_and_behind_a_lamp_see_the_light_that_the_water_sends_back():
    """A receiver 1 mm behind the lamp saw an eighth of it, one at its place ended in an error."""
    for depth in (10.0, 10.001):
        link = mt.Link(receiver=mt.WaterReceiver(depth=depth, radius=0.3))
        forced = mt.simulate(link, mt.surfaces.FlatSea(), photons=40_000, seed=3)
        # analog photons: 8.30(18)e-5, `photons=20_000_000`
        assert abs(forced.gain - 8.3e-5) < 4.0 * np.hypot(forced.gain_stderr, 0.18e-5)
        assert forced.gain_stderr < 0.05 * forced.gain
