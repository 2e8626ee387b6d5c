"""Pixels of a receiver: gains and background by pixel, in known directions and by both estimators."""

import math

import numpy as np
import pytest
from mc_statistics import ALPHA
from scipy import stats

import meshtrace as mt
from meshtrace.comms.combining import combined_ber
from meshtrace.errors import Refused
from meshtrace.link.receivers import Camera
from meshtrace.studies import pixel_signals
from meshtrace.surfaces import FlatSea

pytestmark = pytest.mark.filterwarnings(
    "ignore:.*effective sample size",
    "ignore:.*left the meshed surface",
    "ignore::meshtrace.comms.background.DaylightWarning",
)

CLEAR = mt.Water(a=0.1, b=0.0)


def aside(x, y, pixels=5, **fields):
    """Return a receiver that sees a lamp at (x, y) below, still water and no scattering."""
    return mt.Link(
        water=CLEAR,
        transmitter=mt.Led(depth=10.0, position=(x, y)),
        receiver=mt.Receiver(pixels=pixels, **fields),
    )


@pytest.mark.parametrize(("x", "y", "pixel"), [
    (0.0, 0.0, (2, 2)), (3.0, 0.0, (3, 2)), (-3.0, 0.0, (1, 2)), (0.0, 3.0, (2, 3)),
])  # fmt: skip
def test_unscattered_light_through_still_water_is_in_one_known_pixel(x, y, pixel):
    """By Snell's law light from 3 m aside arrives by 14 deg: the pixel from 6.6 to 19.1 deg."""
    got = mt.simulate(aside(x, y), FlatSea(), photons=64)
    share = got.gain_by_pixel[0] / got.gain
    assert share[pixel] == pytest.approx(1.0, abs=1e-12)
    assert share.sum() == pytest.approx(1.0, abs=1e-12)
    assert got.gain_by_pixel_stderr[0][pixel] > 0.0
    assert got.arrivals is None


def test_the_image_turns_with_the_receiver():
    """A receiver that leans to its lamp sees it in the middle."""
    link = aside(3.0, 0.0, tilt_deg=14.0)
    assert mt.simulate(link, FlatSea(), photons=64).gain_by_pixel[0].argmax() == 12


def test_azimuths_of_the_image():
    """Along a line of sight that leans, the axes of the image lean with it."""
    level, leaning = mt.Receiver(), mt.Receiver(tilt_deg=30.0, tilt_azimuth_deg=25.0)
    for azimuth in (0.0, 1.0, -2.5):
        # light from a side of 10 deg to the line of sight, before the tilt
        side = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
        light = -(math.sin(0.17) * side - math.cos(0.17) * np.array([0.0, 0.0, 1.0]))
        axis = np.array([-math.sin(math.radians(25.0)), math.cos(math.radians(25.0)), 0.0])
        t = -math.radians(30.0)  # from straight down towards the azimuth
        turned = light * math.cos(t) + np.cross(axis, light) * math.sin(t)
        turned += axis * (axis @ light) * (1.0 - math.cos(t))
        np.testing.assert_allclose(turned @ leaning.axis, math.cos(0.17), rtol=1e-12)
        np.testing.assert_allclose(level.azimuths_of(light[None]), azimuth, atol=1e-12)
        np.testing.assert_allclose(leaning.azimuths_of(turned[None]), azimuth, atol=1e-9)


SPREAD = mt.Link(
    water=mt.Water(a=0.05, b=0.8),
    transmitter=mt.Led(depth=5.0, half_angle_deg=8.0),
    receiver=mt.Receiver(height=3.0, radius=0.5, fov_deg=40.0, pixels=3, tilt_deg=6.0),
)
DOWN = mt.Link(
    water=SPREAD.water,
    transmitter=mt.AirLed(height=3.0, half_angle_deg=8.0),
    receiver=mt.WaterReceiver(depth=5.0, radius=0.5, fov_deg=60.0, pixels=3, tilt_deg=9.0),
)
TURBID = SPREAD.replace("water", mt.Water(a=0.1, b=3.0))
DEEP = DOWN.replace("water", TURBID.water)


@pytest.mark.parametrize("link", [SPREAD, DOWN, TURBID, DEEP], ids=["up", "down", "turbid", "deep"])
@pytest.mark.slow_but("up", "down")
def test_both_estimators_agree_in_every_pixel(link):
    """Chains or joined photons against individual photons, with the errors that they state."""
    forced = mt.simulate(link, FlatSea(), photons=1024, seed=2)
    # turbid water leaves few photons to a pixel
    photons = 400_000 if link in (TURBID, DEEP) else 60_000
    analog = mt.simulate(link, FlatSea(), estimator="analog", photons=photons, seed=2)
    for got in (forced, analog):
        assert got.gain_by_pixel.sum() == pytest.approx(got.gain, rel=1e-12)
    difference = forced.gain_by_pixel - analog.gain_by_pixel
    error = np.hypot(forced.gain_by_pixel_stderr, analog.gain_by_pixel_stderr)
    # groups of few photons are not Gaussian
    bright = analog.gain_by_pixel > 25.0 / photons
    assert bright.sum() >= 4
    chi2 = float(np.sum((difference[bright] / error[bright]) ** 2))
    assert stats.chi2.sf(chi2, bright.sum()) > ALPHA


def share_of_view(receiver):
    """Return the share of each pixel in the projected solid angle of the field of view."""
    edge, n = receiver.pixel_edges[-1], 400 * receiver.pixels
    t = edge * ((np.arange(n) + 0.5) * 2.0 / n - 1.0)
    x, y = np.meshgrid(t, t, indexing="ij")
    square = x * x + y * y
    # cos dOmega = dx dy / (1 + x^2 + y^2)^2 in tangents
    part = np.where(square <= edge**2, 1.0 / (1.0 + square) ** 2, 0.0)
    part = part.reshape(receiver.pixels, n // receiver.pixels, receiver.pixels, -1).sum(axis=(1, 3))
    return part / part.sum()


def test_an_even_sky_is_seen_by_projected_solid_angle():
    receiver = mt.Receiver(height=5.0, fov_deg=100.0, pixels=4, tilt_deg=180.0)
    day = mt.Daylight(direct=0.0, diffuse=0.5, pattern="uniform")
    seen = mt.background(mt.Link(receiver=receiver), FlatSea(), day, photons=4096)
    share = seen.pixel_radiance / seen.radiance
    assert seen.pixel_radiance.sum() == pytest.approx(seen.radiance, rel=1e-12)
    error = seen.pixel_radiance_stderr / seen.radiance
    assert 0.0 < error.min() <= error.max() < 0.003
    chi2 = float(np.sum(((share - share_of_view(receiver)) / error) ** 2))
    assert stats.chi2.sf(chi2, 15) > ALPHA
    assert seen.of_pixel(0, 1).radiance == seen.pixel_radiance[0, 1]


@pytest.mark.parametrize("azimuth", [0.0, 90.0])
def test_the_sun_is_in_the_pixel_that_looks_at_it(azimuth):
    """Seen from the air it stands 20 deg off the line of sight, below water by Snell's law."""
    day = mt.Daylight(direct=1.0, diffuse=0.1, sun_zenith_deg=20.0, sun_azimuth_deg=azimuth)
    n, water = 5, mt.Water(a=0.1, b=0.02)
    up = mt.Receiver(height=5.0, fov_deg=60.0, pixels=n, tilt_deg=180.0)
    below = mt.WaterReceiver(depth=2.0, fov_deg=60.0, pixels=n)
    lamps = mt.Led(), mt.AirLed()
    # edges at tan 6.6, 19.1 and 30 deg; under water the sun stands at 14.8 deg
    for receiver, lamp, i in zip((up, below), lamps, (4, 3), strict=True):
        expected = (i, 2) if azimuth == 0.0 else (2, i)
        link = mt.Link(water=water, transmitter=lamp, receiver=receiver)
        seen = mt.background(link, FlatSea(), day, photons=1024)
        assert np.unravel_index(seen.pixel_radiance.argmax(), (n, n)) == expected
        assert seen.pixel_radiance[expected] > 0.5 * seen.radiance


def test_series_have_the_best_pixel_of_each_frame():
    link = mt.Link(receiver=mt.Receiver(pixels=3))
    series = mt.time_series(link, mt.surfaces.sea_in_wind(5.0), [0.0, 0.5], photons=64)
    assert series.gain_by_pixel.shape == (2, 1, 3, 3)
    np.testing.assert_allclose(series.gain_by_pixel.sum(axis=(1, 2, 3)), series.gain, rtol=1e-12)
    assert series.best_pixel.tolist() == [[[1, 1]], [[1, 1]]]
    assert "gain_by_pixel" in series.to_dataset()


@pytest.fixture(scope="module")
def signals():
    day = mt.Daylight(direct=1.42, diffuse=0.295, sun_zenith_deg=40.0)
    link = mt.Link(transmitter=mt.Led(depth=15.0), receiver=mt.Receiver(height=10.0, pixels=3))
    sea = mt.surfaces.sea_in_wind(5.0)
    return link, sea, day, pixel_signals(link, sea, day, photons=256, rays=2048)


def test_pixels_keep_the_sun_out(signals):
    """Maximal ratio is the best, and its ratio the sum of all; one detector sees all the glint."""
    *_, got = signals
    selection, equal, maximal = got.ber
    assert maximal <= selection
    assert maximal <= equal
    assert selection < got.ber_whole
    assert got.best_pixel == (1, 1)
    # Q(SNR^(1/2) / 2) of Gaussian counts of one noise; that of ones is larger than that of zeros
    bound = stats.norm.logsf(0.5 * math.sqrt(got.snr.sum()))
    assert math.log(maximal) == pytest.approx(bound, rel=0.15)
    assert "best pixel (1, 1)" in got.summary()


def test_rates_of_a_link_combine_its_pixels(signals):
    link, _, day, _ = signals
    run = {"photons": 128, "seed": 3}
    kwargs = {"daylight": day, "bit_rate": 1e6, "combining": "maximal"}
    got = mt.link_performance(link, FlatSea(), realizations=2, **kwargs, **run)
    gain = mt.simulate(link, FlatSea(), **run).gain_by_pixel[0]
    assert got.figures[0].ber.value > 0.0 or gain.any()
    alone = mt.link_performance(
        link.replace("receiver.pixels", 1), FlatSea(), realizations=2, **kwargs, **run
    )
    assert got.figures[0].ber.value < alone.figures[0].ber.value
    dark = mt.OokLink.of_link(link, bit_rate=1e6)
    assert float(combined_ber([dark] * 9, gain.ravel())) < 0.5


def test_refusals():
    with pytest.raises(Refused, match="no image of the horizon"):
        mt.Receiver(fov_deg=180.0, pixels=2)
    ends = [mt.Receiver(pixels=2), mt.Receiver(pixels=3)]
    with pytest.raises(Refused, match="equal numbers"):
        mt.simulate(mt.Link(receiver=ends), FlatSea(), photons=64)
    with pytest.raises(Refused, match="one receiver with pixels"):
        pixel_signals(mt.Link(), FlatSea())
    assert issubclass(mt.WaterReceiver, Camera)
