"""Link performance from this package's own gains: ranges, fading averages, tilt, dataset."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from mc_statistics import ALPHA, sidak, z_test
from scipy.special import ndtri

import meshtrace as mt
from meshtrace import fading
from meshtrace.comms import ChannelResponse, LedDriver, OokLink, SiPM
from meshtrace.comms.budget import required_gain
from meshtrace.comms.capacity import capacity
from meshtrace.comms.combining import combined_ber
from meshtrace.results import GainSeries, impulse_response
from meshtrace.scenario import Scenario
from meshtrace.studies import LinkPerformance, operating_point
from meshtrace.studies.operating_point import FadingSamples, array_of
from meshtrace.surfaces import FlatSea, JonswapSea, sea_in_wind
from meshtrace.uav import TiltFactors, h_alpha

RATES = (1e6, 5e6, 1e7)
GRID = tuple(range(25, 95, 5))
REFERENCE = json.loads((Path(__file__).parents[1] / "data" / "link_reference.json").read_text())
FOV = math.radians(60.0)


def at_depth(depth, **receiver):
    return mt.Link(transmitter=mt.Led(depth=depth), receiver=mt.Receiver(**receiver))


def steady(tilt_deg, wind_speed=13.0):
    """Return an airframe and a wind without gusts that tilt a receiver by a given angle."""
    unit = mt.Uav().tilt_coefficient * wind_speed**2
    drag = 0.8 * math.tan(math.radians(tilt_deg)) / unit
    return mt.Uav(drag_coefficient=drag), mt.Dryden(wind_speed=wind_speed, w20=0.0)


def synthetic(gain, mean_stderr=0.0):
    n = len(gain)
    return GainSeries("realization", np.arange(n), gain, 0.0 * gain, gain, mean_stderr)


# --- several receivers ---------------------------------------------------------------------


def two(radius=0.05, fov_deg=60.0):
    """Return a link with two receivers 0.4 m apart, the second of its own lens and view."""
    second = mt.Receiver(position=(0.4, 0.0), radius=radius, fov_deg=fov_deg)
    return mt.Link(transmitter=mt.Led(depth=45.0), receiver=[mt.Receiver(), second])


@pytest.mark.parametrize("combining", ["selection", "equal", "maximal"])
def test_combined_receivers_are_brute_force(combining):
    """Error rate and outage over correlated fades and tilts, sample by sample."""
    ook, link = OokLink.of_link(two(), receiver=0), two(radius=0.03)
    links = [OokLink.of_link(link, ook, receiver=j) for j in range(2)]
    z = np.random.default_rng(3).standard_normal((20, 2)) @ [[1.0, 0.5], [0.0, 0.8]]
    gains = required_gain(ook, 1e-3) * np.exp(0.4 * z - 0.6)
    gains[:, 1] *= 0.03**2 / 0.05**2  # of the smaller lens
    tilt = TiltFactors(np.array([0.0, 0.8, 1.0]), np.array([0.1, 0.4, 0.5]))
    series = GainSeries("realization", np.arange(20), gains, 0.0 * gains, gains, np.zeros(2))
    samples = FadingSamples(series, tilt, 20.0, array_of(link, ook, combining, None))
    point = operating_point.operating_point(ook, 45.0, samples, 1e-3, 0.95, 1)
    bers = combined_ber(links, gains[:, None] * tilt.h[:, None], combining)
    assert point.ber.value == pytest.approx(float((bers @ tilt.weight).mean()), rel=1e-6)
    level = FadingSamples(series, TiltFactors(np.ones(1), np.ones(1)), 20.0, samples.array)
    point = operating_point.operating_point(ook, 45.0, level, 1e-3, 0.95, 1)
    missed = combined_ber(links, gains, combining) > 1e-3
    assert 0 < missed.sum() < 20
    assert point.outage.value == pytest.approx(missed.mean())


def test_the_page_counts_the_pixels_of_a_receiver():
    """It once counted the keys of the only receiver."""
    pixels = mt.Link(receiver=mt.Receiver(pixels=3))
    page = mt.link_performance(pixels, FlatSea(), photons=64).summary()
    assert "9 pixels combined by maximal ratio" in page


def test_two_receivers_over_still_water():
    """Shot noise dominates: the light of both counts; the page says how they are combined."""
    options = {"photons": 128, "realizations": 2, "ook": OokLink(saturation=False)}
    alone = mt.link_performance(two().replace("receiver", mt.Receiver()), FlatSea(), **options)
    both = mt.link_performance(two(), FlatSea(), combining="equal", **options)
    gained = both.at().margin_optical_db.value - alone.at().margin_optical_db.value
    assert 2.5 < gained < 3.02
    assert "2 receivers combined by equal gain" in both.summary()
    with pytest.raises(ValueError, match="equal views"):
        mt.link_performance(two(fov_deg=30.0), FlatSea(), daylight=mt.Daylight.night(), **options)


# --- gains and ranges ----------------------------------------------------------------------


# The tables are Monte Carlo too, of 1 % and, where the gain falls steeply, up to 3 %.
@pytest.mark.parametrize(
    ("preset", "key", "table_error"),
    [
        ("physical", "flat_gain_MC_physical_h5_r5cm_th10", 0.02),
        ("paper-ranges", "flat_gain_MC_paper_a2", 0.035),
    ],
)
def test_flat_sea_gains_match_the_tables(preset, key, table_error):
    for depth, expected in REFERENCE[key].items():
        link = OokLink.preset(preset).channel(at_depth(float(depth)))
        found = mt.simulate(link, FlatSea(), photons=8192)
        error = abs(found.gain - expected)
        assert error < table_error * expected + 4.0 * found.gain_stderr, f"{depth} m"
        if preset == "physical":
            ballistic = REFERENCE["flat_gain_ballistic"][depth]
            assert found.gain_ballistic == pytest.approx(ballistic, rel=5e-4)
            assert found.gain > ballistic


@pytest.mark.parametrize(
    ("preset", "expected"), [("physical", (55, 43, 31)), ("paper-ranges", (49, 42, 34.5))]
)
@pytest.mark.thorough
@pytest.mark.slow_but("paper-ranges-expected1")
def test_flat_sea_ranges(preset, expected):
    found = mt.link_performance(
        mt.Link(), FlatSea(), depths=GRID, bit_rate=RATES, ook=preset, photons=4096
    )
    ranges = found.range_at_ber()
    assert [r.value for r in ranges] == pytest.approx(expected, abs=1.0)
    for r in ranges:
        assert r.low < r.value < r.high
        assert r.high - r.low < 0.5
    assert ("not physics" in found.status) == (preset == "paper-ranges")
    assert found.status in found.summary()


@pytest.mark.thorough
def test_foam_and_bubbles_of_13_metres_per_second_cost_a_metre():
    still, windy = (
        mt.link_performance(
            mt.Link().in_wind(wind), FlatSea(), depths=(50, 55, 60), photons=8192
        ).range_at_ber()[0]
        for wind in (0.0, 13.0)
    )
    assert 0.7 < still.value - windy.value < 1.3


def test_range_is_a_crossing_of_the_direct_curve():
    link, ook = mt.Link(), OokLink()
    found = mt.link_performance(link, FlatSea(), depths=(50, 55, 60), photons=8192)
    for ber in (1e-3, 3.8e-3):
        there = at_depth(found.range_at_ber(ber)[0].value)
        gain = mt.simulate(there, FlatSea(), photons=8192)
        error = gain.gain_stderr / gain.gain + found.fades[1].chain_error
        assert math.log(gain.gain / required_gain(ook, ber)) == pytest.approx(0.0, abs=4.0 * error)
    assert math.isnan(found.range_at_ber(0.4)[0].value)


def test_gain_at_13_over_5_metres_per_second_as_printed():
    gains = []
    for wind in (5.0, 13.0):
        given = Scenario.from_config({"wind_speed": wind, "physics": "paper"}).link
        foam = {"whitecaps": given.whitecaps, "bubbles": given.bubbles}
        gains.append(mt.simulate(mt.Link().model_copy(update=foam), FlatSea()).gain)
    assert gains[1] / gains[0] == pytest.approx(0.835, abs=0.01)


def test_foam_follows_the_wind():
    windy = mt.Link().in_wind(13.0)
    scenario = Scenario.from_config({"wind_speed": 13.0}).link
    assert (windy.whitecaps, windy.bubbles) == (scenario.whitecaps, scenario.bubbles)
    assert windy.in_wind(0.0) == mt.Link()


# --- averages over fading ------------------------------------------------------------------


@pytest.fixture(scope="module")
def ensemble_performance():
    return mt.link_performance(
        at_depth(40.0), bit_rate=RATES, realizations=24, photons=512, limit=2e-3
    )


def test_a_band_without_the_fading_is_reported():
    sea = JonswapSea(omega_max=4.11112)
    with pytest.warns(UserWarning, match="for fading use .* up to 19.7 rad/s"):
        found = mt.link_performance(mt.Link(), sea, realizations=50, photons=64)
    closed = found.provenance["closed_form"]
    assert closed["index_of_band"] == pytest.approx(
        fading.scintillation_of_spectrum(mt.Link(), sea, closed["omega_max"], heights=True)
    )
    line = (
        "10 m: scintillation index of unscattered light 0.00449 up to 4.11 rad/s, 0.317 with all "
        "waves (closed form)"
    )
    assert line in found.summary().splitlines()


@pytest.mark.thorough
def test_average_ber_equals_brute_force(ensemble_performance):
    gains = mt.ensemble(at_depth(40.0), 24, photons=512).gain
    for rate in RATES:
        ook = ensemble_performance.transmission(bit_rate=rate)
        figures = ensemble_performance.at(bit_rate=rate)
        bers = ook.ber(ook.received_power(gains))
        assert figures.ber.value == pytest.approx(bers.mean(), rel=1e-12)
        assert figures.outage.value == np.mean(bers > 2e-3)
        assert figures.capacity == pytest.approx(capacity(ook, gains), rel=1e-12)
        margin = 10.0 * math.log10(gains.mean() / required_gain(ook, 2e-3))
        assert figures.margin_optical_db.value == pytest.approx(margin, abs=1e-9)
        assert figures.margin_electrical_db.value == pytest.approx(2.0 * margin, abs=1e-9)
        power = figures.received_power.value
        photons = power / rate / (6.62607015e-34 * 299792458.0 / 470e-9)
        assert figures.photons_per_bit.value == pytest.approx(photons, rel=1e-6)


@pytest.mark.thorough
def test_tilts_are_averaged_as_brute_force_does():
    found = mt.link_performance(
        at_depth(40.0),
        sea_in_wind(13.0),
        bit_rate=5e6,
        realizations=12,
        photons=256,
        flight=mt.Flight(),
    )
    ook, gains, draws = found.transmission(), found.fades[0].series.gain, 200_000
    wind = mt.Dryden(wind_speed=13.0).sample_wind(draws, 7)
    factors = h_alpha(mt.Uav().tilt(wind).angle, FOV)
    power = ook.received_power(np.linspace(0.0, gains.max(), 4001))
    rates = ook.ber(power)

    def average(values):
        """Return the mean over seas and tilts with its error by the tilts."""
        return values.mean(), values.mean(axis=0).std() / math.sqrt(draws)

    bers = np.interp(ook.received_power(gains[:, None] * factors), power, rates)
    for value, drawn in ((found.at().ber.value, bers), (found.at().outage.value, bers > 1e-3)):
        mean, error = average(drawn)
        assert z_test(mean, error, value) > sidak(ALPHA, 2)


def test_tilt_outage_is_that_of_the_law():
    uav, wind = mt.Uav(), mt.Dryden(wind_speed=13.0)
    found = mt.link_performance(
        mt.Link(),
        FlatSea(),
        bit_rate=1e6,
        flight=mt.Flight(uav, wind),
        photons=256,
        realizations=400,
    )
    share = uav.tilt_law(wind).outage(FOV)
    assert found.at().outage == pytest.approx([share] * 3, rel=1e-5)
    assert found.at().ber.value == pytest.approx(0.5 * share, rel=1e-6)


def test_a_tilt_beyond_the_view_is_named():
    """0.70 % at 13 m/s and 60 deg: an error rate of 3.5e-3 at any power, over 1e-3."""
    found = mt.link_performance(
        mt.Link(), FlatSea(), depths=[5.0, 40.0, 60.0], bit_rate=1e6, photons=256,
        flight=mt.Flight(mt.Uav(), mt.Dryden(wind_speed=13.0)),
    )  # fmt: skip
    text, share = found.summary(), mt.Uav().tilt_law(mt.Dryden(wind_speed=13.0)).outage(FOV)
    assert math.isnan(found.range_at_ber()[0].value)
    assert re.search(
        r"none at any power, by the tilt; within the field of view 5\d\.\d m  \(", text
    )
    assert f"no power has an error rate below {0.5 * share:.2e}" in text
    assert found.range_at_ber(3.8e-3)[0].low > 40.0
    held = mt.link_performance(
        mt.Link(), FlatSea(), photons=256, flight=mt.Flight(wind=mt.Dryden(wind_speed=5.0))
    )
    assert "tilt" not in held.summary()


def test_gimbal_takes_the_tilt_away():
    link, seas = (at_depth(40.0), sea_in_wind(13.0)), {"realizations": 4, "photons": 256}
    level = mt.link_performance(*link, **seas).at()
    held = mt.link_performance(*link, flight=mt.Flight(mt.Uav(gimbal=True)), **seas).at()
    assert held.ber.value == pytest.approx(level.ber.value, rel=1e-9)


def test_band_of_a_flat_sea_is_the_error_of_its_chains():
    found = mt.link_performance(at_depth(40.0), FlatSea(), bit_rate=5e6, photons=1024)
    ook, fades, ber = found.transmission(), found.fades[0], found.at().ber
    reach = ndtri(0.975) * fades.chain_error
    gain = float(fades.series.gain[0]) * np.exp([reach, 0.0, -reach])
    assert ber == pytest.approx(ook.ber(ook.received_power(gain))[[1, 0, 2]], rel=1e-9)


@pytest.mark.parametrize("chain_error", [0.0, 0.03])
@pytest.mark.thorough
@pytest.mark.slow_but("0.03")
def test_bands_cover_the_truth(chain_error):
    rng = np.random.default_rng(3)
    ook, n, sigma = OokLink(model="GP"), 100, 0.25
    centre = 1.25 * required_gain(ook, 1e-3)
    x, weight = np.polynomial.hermite_e.hermegauss(80)
    curve = ook.ber(ook.received_power(centre * np.exp(sigma * x)))
    truth = weight @ curve / weight.sum()
    missed = float(np.mean(rng.standard_normal(10**6) < -math.log(1.25) / sigma))
    covered = np.zeros(2)
    for trial in range(100):
        gains = centre * np.exp(sigma * rng.standard_normal(n))
        gains *= 1.0 + chain_error * rng.standard_normal()
        level = TiltFactors(np.ones(1), np.ones(1))
        fades = FadingSamples(synthetic(gains, chain_error * gains.mean()), level, float(n))
        quantile = float(ndtri(0.975))
        ber = operating_point.ber_of_samples(ook, lambda dark: dark, fades, quantile, 0.95, trial)
        outage = operating_point.outage_of_samples(ook, fades, 1e-3, quantile, 0.95)
        covered += ber.low <= truth <= ber.high, outage.low <= missed <= outage.high
    # 0.95 of 100 lies above 0.85 but for a probability of 1e-4
    assert np.all(covered / 100 >= 0.85)


def test_threads_do_not_matter():
    one, two = (
        mt.link_performance(mt.Link(), realizations=3, photons=256, threads=n).at() for n in (1, 2)
    )
    assert one == two


# --- the tilt inside of the transport ------------------------------------------------------


@pytest.mark.parametrize("tilt_deg", [3.0, 10.0])
def test_small_tilts_agree_with_the_factor(tilt_deg):
    uav, wind = steady(tilt_deg)
    link, sea, times = mt.Link(), JonswapSea(wind_speed=5.0, waves="paper"), np.arange(4.0)
    coupled = mt.time_series(link, sea, times, flight=mt.Flight(uav, wind), photons=1024)
    level = mt.time_series(link, sea, times, photons=1024)
    tilt = uav.tilt(wind.simulate_wind(times, 1))
    assert tilt.angle == pytest.approx(math.radians(tilt_deg), rel=1e-9)
    ratio = coupled.gain / level.gain
    assert ratio == pytest.approx(math.cos(math.radians(tilt_deg)), rel=0.01)


@pytest.mark.parametrize(("tilt_deg", "most"), [(28.0, 0.93), (33.0, 0.15), (45.0, 0.02)])
def test_gain_falls_at_the_edge_of_the_field_of_view(tilt_deg, most):
    uav, wind = steady(tilt_deg)
    link, times = at_depth(40.0), np.arange(2.0)
    flight = mt.Flight(uav, wind)
    coupled = mt.time_series(link, FlatSea(), times, flight=flight, photons=2048)
    level = mt.simulate(link, FlatSea(), photons=2048)
    share = coupled.gain / (level.gain * math.cos(math.radians(tilt_deg)))
    assert np.all((0.0 < share) & (share < most))


def test_a_gimbal_makes_the_flown_series_the_plain_one():
    sea, times = JonswapSea(wind_speed=5.0, waves="paper"), np.arange(3.0)
    wind = mt.Dryden(wind_speed=13.0)
    flight = mt.Flight(mt.Uav(gimbal=True), wind)
    held = mt.time_series(mt.Link(), sea, times, flight=flight, photons=1024)
    plain = mt.time_series(mt.Link(), sea, times, photons=1024)
    error = np.hypot(held.gain_stderr, plain.gain_stderr)
    assert np.all(np.abs(held.gain - plain.gain) < 4.5 * error)
    assert held.gain_ballistic == pytest.approx(plain.gain_ballistic, rel=1e-9)


def test_each_frame_has_its_own_tilt():
    wind, times = mt.Dryden(wind_speed=13.0), np.arange(3.0)
    options = {"photons": 1024, "seed": 5}
    flight = mt.Flight(mt.Uav(), wind)
    series = mt.time_series(mt.Link(), FlatSea(), times, flight=flight, **options)
    tilt = mt.Uav().tilt(wind.simulate_wind(times, 5))
    for i, (angle, azimuth) in enumerate(zip(*tilt, strict=True)):
        azimuth_deg = math.degrees(azimuth)
        link = at_depth(10.0, tilt_deg=math.degrees(angle), tilt_azimuth_deg=azimuth_deg)
        alone = mt.simulate(link, FlatSea(), photons=1024, seed=5)
        assert series.gain[i] == pytest.approx(alone.gain, rel=1e-9)
    assert series.provenance["uav"]["mass"] == 8.37


def test_coupled_performance_counts_correlated_times():
    found = mt.link_performance(
        mt.Link(),
        sea_in_wind(13.0),
        flight=mt.Flight(coupled=True, time_step=0.25),
        realizations=8,
        photons=256,
    )
    fades = found.fades[0]
    assert fades.tilt.h.tolist() == [1.0]
    assert 1.0 <= fades.n_effective <= 8.0
    assert fades.series.time == pytest.approx(0.25 * np.arange(8))
    assert found.provenance["coupled"] is True


def test_saturation_is_reported():
    near, far = (
        mt.link_performance(at_depth(d), FlatSea(), ook="paper", photons=256).summary()
        for d in (10.0, 45.0)
    )
    # r1 tau / N = 7.9 at 10 m and below 1e-3 beyond 45 m: 1 / 8.9 of the counts pass
    assert "10 m: the SiPM saturates and passes on 11 % of the counts of a one" in near
    assert "saturates" not in far


# --- what fits together --------------------------------------------------------------------


def test_transmission_takes_over_the_link():
    link = mt.Link(
        transmitter=tuple(mt.Led(power_mw=p, wavelength_nm=450.0) for p in (20.0, 30.0)),
        receiver=mt.Receiver(radius=0.02, fov_deg=40.0),
    )
    ook = OokLink.of_link(link, OokLink.preset("paper"), 5e6)
    assert (ook.led.power, ook.led.wavelength) == pytest.approx((0.05, 450e-9))
    assert (ook.optics.radius, ook.optics.fov_deg, ook.optics.etendue_limited) == (
        0.02,
        40.0,
        False,
    )
    assert (ook.model, ook.bit_rate) == ("PC", 5e6)


def test_only_the_calibration_doubles_the_absorption():
    layered = mt.Link(water=mt.Water(layers=[(0.0, 0.1, 0.2), (9.0, 0.3, 0.1)]))
    assert OokLink.preset("paper").channel(layered) is layered
    doubled = OokLink.preset("paper-ranges").channel(layered).water
    assert (doubled.a, doubled.b) == (0.2, 0.2)
    assert doubled.layers == ((0.0, 0.2, 0.2), (9.0, 0.6, 0.1))


def test_dataset_goes_to_disk_and_back(tmp_path):
    sweep = mt.depth_sweep(
        mt.Link(),
        (30, 35),
        bit_rate=(5e6, 1e7),
        wind_speeds=(0.0, 13.0),
        realizations=3,
        photons=256,
    )
    sweep.save(tmp_path / "sweep.nc")
    with xr.open_dataset(tmp_path / "sweep.nc", engine="h5netcdf") as data:
        assert dict(data.sizes) == {"wind_speed": 2, "depth": 2, "bit_rate": 2}
        for i, performance in enumerate(sweep.performances):
            ber = performance.estimates("ber")
            assert data["ber"].to_numpy()[i] == pytest.approx(ber[..., 0], rel=1e-12)
            assert data["ber_high"].to_numpy()[i] == pytest.approx(ber[..., 2], rel=1e-12)
        assert np.all(data["ber_low"] <= data["ber"])
        assert np.all(data["ber"] <= data["ber_high"])
        assert data["received_power"].attrs["units"] == "W"
        assert data["margin_optical_db"].attrs["units"] == "dB"
        assert data["range"].to_numpy() == pytest.approx(sweep.range_at_ber()[..., 0], nan_ok=True)
        assert data.attrs["kind"] == "depth-sweep"
    assert "13 m/s" in sweep.summary()


def test_eye_at_the_received_power():
    found = mt.link_performance(at_depth(30.0), FlatSea(), bit_rate=(1e6, 5e6), photons=256)
    ook, power = found.transmission(bit_rate=5e6), found.at(bit_rate=5e6).received_power.value
    assert np.array_equal(found.eye(bit_rate=5e6).level, ook.eye(power).level)


# --- response of the channel ---------------------------------------------------------------


def test_a_short_response_changes_no_digit_and_a_long_one_enters(tmp_path):
    options = {"bit_rate": (1e6, 1e7), "realizations": 3, "photons": 256}
    found = mt.link_performance(at_depth(10.0), **options)
    gains = found.fades[0].series.gain
    for rate in (1e6, 1e7):
        prompt, through = OokLink(bit_rate=rate), found.transmission(bit_rate=rate)
        figures = found.at(bit_rate=rate)
        assert through.response == found.responses[0]
        assert figures.required_power == through.required_power(1e-3)
        assert figures.capacity == capacity(through, gains)
        spread = figures.rms_delay_spread.value * rate
        assert spread == pytest.approx(through.spread_in_bits, rel=0.02)
        if spread < 1e-3:
            assert figures.required_power == prompt.required_power(1e-3)
            assert figures.dispersion_db == 0.0
        else:
            ratio = through.required_power(1e-3) / prompt.required_power(1e-3)
            assert figures.dispersion_db == pytest.approx(10.0 * math.log10(ratio), rel=1e-12)
            assert figures.dispersion_db > 0.0
    found.save(tmp_path / "found.nc")
    assert LinkPerformance.load(tmp_path / "found.nc").responses == found.responses


@pytest.mark.thorough
def test_the_text_says_when_the_response_matters():
    murky = mt.Water.from_type("petzold-harbour", 514.5)
    link = mt.Link(
        transmitter=mt.Led(depth=6.0, wavelength_nm=514.5),
        receiver=mt.Receiver(fov_deg=120.0, height=2.0),
        water=murky,
    )
    ook = OokLink(led=LedDriver(bandwidth=1e8), sipm=SiPM(bandwidth=1e8))
    found = mt.link_performance(link, FlatSea(), ook=ook, bit_rate=(1e4, 5e7), photons=512)
    (line,) = (text for text in found.summary().splitlines() if "rms delay spread" in text)
    assert re.search(r"\de-05 bit at 0.01 Mbit/s \(below 0.001 bit: taken as instantaneous\)", line)
    assert re.search(r"0\.\d+ bit at 50 Mbit/s \(0\.\d+ dB optical\)", line)
    own = ook.replace(response=ChannelResponse(delay=(0.0, 4e-9), share=(0.5, 0.5)))
    given = mt.link_performance(link, FlatSea(), ook=own, bit_rate=5e7, photons=512)
    assert given.transmission() == OokLink.of_link(link, own, 5e7)
    assert given.at().rms_delay_spread.value == pytest.approx(2e-9)


def test_the_response_is_that_of_the_chains():
    link = at_depth(20.0)
    found = mt.link_performance(link, FlatSea(), bit_rate=1e7, photons=512)
    single = mt.simulate(link, FlatSea(), photons=512, record=[mt.options.Arrivals()])
    response = impulse_response(single)
    error = math.hypot(response.rms_delay_spread_stderr, found.at().rms_delay_spread.high
                       - found.at().rms_delay_spread.value)  # fmt: skip
    spread = found.at().rms_delay_spread.value
    assert abs(spread - response.rms_delay_spread) < 4.0 * error


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"limit": 0.5}, "limit"),
        ({"realizations": 1}, "realizations"),
        ({"confidence": 1.0}, "confidence"),
        ({"coupled": True}, "coupled: true, no such key"),
        ({"depths": (30.0, 20.0)}, "depths"),
        ({"depths": ()}, "depths"),
        ({"ook": "printed"}, "ook: 'printed', allowed: an OokLink or physical, paper"),
        ({"bit_rate": -1.0}, "bit_rate: -1.0, allowed: "),
        ({"bit_rate": 1e7, "ook": OokLink(window=1e-6)}, "window: 1e-06, allowed"),
        ({"depths": (-5.0, 5.0)}, "depth"),
        ({"surface": FlatSea(), "flight": mt.Flight()}, "flight.wind"),
        ({"sea": FlatSea()}, "sea: .*no such key"),
        ({"combining": "sum"}, "combining"),
        (
            {"link": mt.Link(receiver=[mt.Receiver()] * 2), "flight": mt.Flight(coupled=True)},
            "receiver",
        ),
        ({"link": mt.Link(transmitter=(mt.Led(), mt.Led())), "depths": (9.0,)}, "transmitter"),
        (
            {"link": at_depth(9.0, tilt_deg=5.0), "flight": mt.Flight(coupled=True)},
            "receiver.tilt_deg",
        ),
    ],
)
def test_wrong_options_are_named(options, name):
    given = {"link": mt.Link(), **options}
    with pytest.raises(ValueError, match=name):
        mt.link_performance(given.pop("link"), **given)


@pytest.mark.parametrize("place", [{"depth": 11.0}, {"bit_rate": 2e6}])
def test_figures_are_only_where_computed(place):
    found = mt.link_performance(mt.Link(), FlatSea(), photons=256)
    with pytest.raises(ValueError, match="allowed"):
        found.at(**place)


# --- slow ----------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("band", ["mean", "paper"])
def test_waves_of_5_metres_per_second_do_not_cost_what_the_paper_prints(band):
    options = {"bit_rate": 5e6, "depths": (35, 40, 45), "realizations": 50}
    windy_link = mt.Link().in_wind(5.0)
    (still,) = mt.link_performance(mt.Link(), FlatSea(), **options).range_at_ber()
    sea = JonswapSea(wind_speed=5.0, waves=band)
    with pytest.warns(UserWarning, match="all waves"):
        found = mt.link_performance(windy_link, sea, **options)
    (windy,) = found.range_at_ber()
    assert windy[2] - windy[1] < 0.5
    assert abs(still[0] - windy[0]) < 0.5  # the paper prints a loss of 4 m
    if band == "paper":
        assert windy[1] < still[0] < windy[2]
