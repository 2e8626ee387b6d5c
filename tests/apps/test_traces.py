"""Channel traces: the digits of series and backgrounds, whatever pieces, threads and aircraft."""

import math

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak
from scipy import stats

import meshtrace as mt
from meshtrace import fading
from meshtrace.errors import Refused
from meshtrace.scenario import Scenario
from meshtrace.surfaces import FlatSea, SinusoidalSea, sea_in_wind

LINK = mt.Link()
WAVE = SinusoidalSea(amplitude=0.05, wavelength=3.0)
FEW = {"photons": 64, "seed": 5, "mesh": mt.Meshing(extent=4.0, spacing=0.3)}
DAY = mt.Daylight(direct=1.42, diffuse=0.295)
FLIGHT = mt.Flight(mt.Uav(), mt.Dryden(wind_speed=8.0))
TIMES = np.arange(6) / 10.0
SHORT = {"hours": 0.6 / 3600.0, "rate": 10.0}


def trace(**options):
    return mt.channel_trace(LINK, WAVE, **{**FEW, **SHORT, **options})


@pytest.mark.parametrize("flight", [None, FLIGHT])
def test_gains_are_those_of_a_series(flight):
    found = trace(down=None, flight=flight)
    series = mt.time_series(LINK, WAVE, TIMES, flight=flight, **FEW)
    np.testing.assert_allclose(found.time, TIMES, rtol=1e-12)
    np.testing.assert_allclose(found.gain, series.gain, rtol=1e-12)
    np.testing.assert_allclose(found.gain_stderr, series.gain_stderr, rtol=1e-9)
    np.testing.assert_allclose(found.gain_ballistic, series.gain_ballistic, rtol=1e-12)
    assert found.gain_mean_stderr == pytest.approx(series.mean_stderr, rel=1e-9)
    assert found.down_gain is None
    with pytest.raises(Refused, match="direction: 'down', allowed: up"):
        found.series("down")


def test_both_directions_are_those_of_duplex():
    found, both = trace(), mt.duplex(LINK, LINK.mirrored(), WAVE, TIMES, **FEW)
    # chains of a trace expect the crests of four surfaces, those of `duplex` of one
    np.testing.assert_allclose(found.gain_ballistic, both.up.gain_ballistic, rtol=1e-9)
    np.testing.assert_allclose(found.down_gain_ballistic, both.down.gain_ballistic, rtol=1e-9)
    np.testing.assert_allclose(found.down_gain, both.down.gain, rtol=0.05)
    assert found.correlation == pytest.approx(both.correlation, abs=0.01)
    assert found.series("down").fading().scintillation_index.value > 0.0


def test_a_flight_moves_both_ends_and_is_kept():
    route = mt.Route(times=(0.0, 1.0), positions=((0.0, 0.0), (2.0, 0.0)), heights=(5.0, 6.0))
    found = trace(flight=FLIGHT, route=route)
    tilt = FLIGHT.uav.tilt(FLIGHT.wind.simulate_wind(found.time, FEW["seed"]))
    np.testing.assert_allclose(found.tilt_deg, np.degrees(tilt.angle))
    np.testing.assert_allclose(found.tilt_azimuth_deg, np.degrees(tilt.azimuth))
    np.testing.assert_allclose(found.place[-1], [1.0, 0.0, 5.5])
    lamp = LINK.mirrored().transmitter.replace(
        position=(1.0, 0.0),
        height=5.5,
        tilt_deg=float(found.tilt_deg[-1]),
        tilt_azimuth_deg=float(found.tilt_azimuth_deg[-1]),
    )
    down = LINK.mirrored().replace(transmitter=lamp)
    alone = mt.simulate(down, WAVE, photons=4096, time=0.5, extent=4.0, spacing=0.3)
    assert found.down_gain[-1] == pytest.approx(
        alone.gain, abs=4.0 * np.hypot(found.down_gain_stderr[-1], alone.gain_stderr)
    )
    assert {"uav", "wind", "route", "up", "down"} <= found.provenance.keys()


def test_background_at_its_own_rate():
    found = trace(daylight=DAY, background_rate=4.0, down=None)
    np.testing.assert_allclose(found.background_time, [0.0, 0.3, 0.5])
    beside = mt.background_series(
        LINK, WAVE, DAY, found.background_time, photons=512, seed=5, mesh=FEW["mesh"]
    )
    np.testing.assert_allclose(found.background_radiance, beside.radiance, rtol=1e-12)
    assert found.provenance["daylight"]["direct"] == 1.42


@pytest.mark.thorough
def test_digits_do_not_depend_on_threads():
    options = {"hours": 12.0 / 3600.0, "rate": 10.0, "photons": 64}
    one, two = (mt.channel_trace(LINK, FlatSea(), threads=threads, **options) for threads in (1, 3))
    assert len(one.time) == 120  # two pieces and a half
    for name in ("gain", "gain_stderr", "down_gain", "gain_mean_stderr"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


def test_a_scenario_brings_its_light_and_its_aircraft():
    text = "wind_speed = 5\n[uav]\npreset = 'dji-m300-rtk'\n[daylight]\nmodel = 'overcast'\n"
    scenario = Scenario.from_toml(text)
    found = mt.channel_trace(scenario, photons=64, hours=0.2 / 3600.0, rate=10.0, threads=1)
    assert found.tilt_deg.min() > 0.0
    assert found.background_radiance.shape == (1,)
    assert "tilt of the aircraft" in found.summary()
    assert "background" in found.summary()


def test_several_receivers_have_columns():
    pair = LINK.replace(receiver=(mt.Receiver(), mt.Receiver(position=(0.5, 0.0))))
    found = mt.channel_trace(pair, WAVE, **FEW, **SHORT)
    assert found.gain.shape == (6, 2)
    assert found.down_gain is None
    assert found.to_dataset()["gain"].dims == ("time", "receiver")


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"hours": 0.0}, "hours: 0.0, allowed: > 0"),
        ({"rate": -1.0}, "rate: -1.0, allowed: > 0"),
        ({"hours": 1e9}, "hours: 1000000000.0, allowed: at most 100,000,000 frames"),
        ({"background_rate": 11.0}, "background_rate: 11.0, allowed: 0 < background_rate <= 10"),
        ({"down": LINK}, "down: 1 receivers, direction up, allowed: a link with one receiver"),
        ({"flight": 5}, "flight: 5, allowed: a Flight"),
        ({"mesh": mt.Meshing(time=1.0)}, "sea.time: 1.0, allowed: 0: a trace begins there"),
        ({"photon": 5}, "photon"),
    ],
)
def test_refusals(options, text):
    with pytest.raises(Refused) as caught:
        trace(**options)
    assert text in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize(("wind", "depth", "height"), [(5.0, 10.0, 5.0), (13.0, 20.0, 5.0)])
def test_unscattered_light_fades_as_the_closed_form(wind, depth, height):
    """Scintillation index and covariances at 0.05 to 0.3 s, by blocks of independent bursts.

    The closed form is paraxial, and the mesh has 0.5 % of its own: 2 % are allowed to both.
    """
    link = LINK.at_depth(depth).replace("receiver.height", height)
    bursts, lags = np.arange(100), (0.0, 0.05, 0.1, 0.2, 0.3)
    times = (3.0 * bursts[:, None] + np.array(lags)).ravel()
    sea = mt.surfaces.sea_in_wind(wind)
    runs = [mt.time_series(link, sea.with_seed(seed), times, photons=32) for seed in (1, 2, 3)]
    gain = np.concatenate([run.gain_ballistic.reshape(100, -1) for run in runs])
    off = gain / gain.mean() - 1.0
    products = np.column_stack([(off**2).mean(axis=1), off[:, :1] * off[:, 1:]])
    blocks = products.reshape(30, 10, -1).mean(axis=1)
    found, stderr = blocks.mean(axis=0), blocks.std(axis=0, ddof=1) / math.sqrt(30)
    resolved = fading.resolve_band(link, sea, "fading")
    wanted = fading.gain_autocovariance(link, resolved, lags, heights=True)
    error = np.hypot(stderr, 0.02 * wanted[0])
    p = 2.0 * stats.t.sf(np.abs(found - wanted) / error, 29)
    assert (p > sidak(ALPHA, 2 * len(lags))).all()


def test_a_single_frame_has_no_rate():
    found = trace(hours=1e-9, down=None)
    assert found.time.shape == (1,)
    assert np.isnan(found.rate)
    assert "1 frame, mean gain" in found.summary()


@pytest.mark.parametrize("wind", [3.0, 8.0])
def test_a_trace_has_the_waves_of_a_series(wind):
    """One band for one sea: both directions lie over the waves of the uplink alone."""
    sea, few = sea_in_wind(wind), {"photons": 256, "seed": 1}
    found = mt.channel_trace(mt.Link(), sea, hours=4 / 3600, rate=1.0, **few)
    series = mt.time_series(mt.Link(), sea, found.time, **few)
    for direction in ("up", "down"):
        assert found.provenance[direction]["surface"] == series.provenance["surface"]
    np.testing.assert_allclose(found.gain_ballistic, series.gain_ballistic, rtol=2e-3)
    both = mt.duplex(mt.Link(), mt.Link().mirrored(), sea, found.time, **few)
    assert both.up.provenance["surface"] == series.provenance["surface"]


@pytest.mark.parametrize("wind", [3.0, 5.0])
def test_a_series_of_the_downlink_alone_has_the_waves_of_both_directions(wind):
    """Once 5.5 % between frames at 5 m/s, over waves of the downlink's own band."""
    sea, few, down = sea_in_wind(wind), {"photons": 256, "seed": 1}, mt.Link().mirrored()
    times = [0.0, 1.0, 2.0, 3.0]
    both = mt.duplex(mt.Link(), down, sea, times, **few)
    alone = mt.time_series(down, sea, times, **few)
    assert alone.provenance["surface"] == both.down.provenance["surface"]
    np.testing.assert_allclose(alone.gain_ballistic, both.down.gain_ballistic, rtol=1e-2)


def test_a_series_of_the_downlink_alone_names_its_shorter_waves():
    link = mt.Link().replace("receiver.height", 2.0).mirrored()
    with pytest.warns(UserWarning, match=r"^waves: those up to .*; for fading use waves = \d+"):
        mt.time_series(link, sea_in_wind(3.0), 0.1 * np.arange(50), photons=64)


def test_downlinks_without_a_mirror_image_have_the_band_of_their_uplink():
    sea = sea_in_wind(5.0)
    up, down = mt.Link(), mt.Link().mirrored()
    planes = mt.link.IrradiancePlanes(depths=(1.0,))
    two = down.replace(receiver=(down.receiver, down.receiver.replace(position=(1.0, 0.0))))
    for link in (down, down.replace(planes=planes), two, down.replace("transmitter.tilt_deg", 5.0)):
        assert fading.resolve_band(link, sea) == fading.resolve_band(up, sea)


def test_a_downlink_that_fades_by_shorter_waves_is_named():
    """At 3 m/s, 10 m deep and 2 m up, waves of the uplink give 0.85 of the downlink's index."""
    link = mt.Link().replace("receiver.height", 2.0)
    with pytest.warns(UserWarning, match=r"^downlink: the waves that make the uplink fade, up to"):
        mt.channel_trace(link, sea_in_wind(3.0), hours=1 / 3600, rate=1.0, photons=64)
