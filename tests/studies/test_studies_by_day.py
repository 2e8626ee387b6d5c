"""Daylight in studies: sweeps, comparisons, flights, links into the water."""

import math

import numpy as np
import pytest
from mc_statistics import ALPHA, z_test

import meshtrace as mt
from meshtrace.comms.background import with_background
from meshtrace.errors import Refused
from meshtrace.scenario.parts import daylight_recipe
from meshtrace.studies import background
from meshtrace.studies.background import Lights, background_over_seas, mean_meshing, mean_sea
from meshtrace.studies.campaign import campaign_of
from meshtrace.surfaces import FlatSea, SinusoidalSea, sea_in_wind

pytestmark = pytest.mark.filterwarnings(
    "ignore::meshtrace.DaylightWarning", "ignore::meshtrace.FewSamplesWarning"
)

DAY = mt.Daylight(direct=1.42, diffuse=0.295)
WAVE = SinusoidalSea(amplitude=0.05, wavelength=3.0)
FILE = """
wind_speed = 0.0
[transmitter]
kind = "led"
depth = 54.0
[receiver]
fov_deg = 20.0
[detector]
optics = {filter_width_nm = 2.0}
"""


@pytest.fixture(scope="module")
def address():
    """Scheduler of one worker in a thread of this process."""
    distributed = pytest.importorskip("distributed")
    pytest.importorskip("zarr")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0"
    ) as cluster:
        yield cluster.scheduler_address


def swept(base, parameters, address, **options):
    options = {"rtol": None, "photons": 256, **options}
    return mt.sweep(base, parameters, workers=address, **options)


@pytest.mark.process
@pytest.mark.slow
def test_a_sweep_moves_the_sun(address):
    pytest.importorskip("pvlib")
    zenith = [10.0, 30.0, 60.0]
    scenario = mt.Scenario.from_toml(FILE + "[daylight]\nsun_zenith_deg = 30.0")
    data = swept(scenario, {"daylight.sun_zenith_deg": zenith}, address)
    ber, link = data["ber"].values.ravel(), scenario.link
    for i, angle in enumerate(zenith):
        day = mt.Daylight.clear_sky(angle)  # with its own irradiance at each zenith angle
        found = mt.background(link, FlatSea(), day, photons=2048, threads=1)
        assert data["background_radiance"].values[i, 0] == found.radiance
        assert data["background_radiance_stderr"].values[i, 0] == found.radiance_stderr
        ook = with_background(mt.OokLink.of_link(link, scenario.detector), found)
        gain = float(data["gain"][i, 0])
        assert ber[i] == pytest.approx(float(ook.ber(ook.received_power(gain))), rel=1e-9)
    assert 0.5 > ber[0] >= ber[1] >= ber[2] > 1e-6
    assert (data["ber_stderr"].values > 0.0).all()
    assert data["ber"].attrs["light"] == "clear sky; at each point by daylight.sun_zenith_deg"


@pytest.mark.process
@pytest.mark.thorough
def test_a_sweep_over_lights_and_a_study_file(address, tmp_path):
    text = (
        FILE + "[sweep]\nphotons = 256\n[sweep.parameters]\ndaylight = ['none', 'night', 'moon']\n"
    )
    path = tmp_path / "lights.toml"
    path.write_text(text.replace("[sweep]", "[sweep]\nstore = 'lights.store'"))
    data = _file(path, address)
    dark, night, moon = data["ber"].values.ravel()
    assert 0.0 < dark < moon < 0.5
    # renewal noise, chosen with any background light, is a little quieter than that of the dark
    assert night == pytest.approx(dark, rel=0.05)
    assert moon > night
    assert data["background_radiance"].values[0, 0] == 0.0
    assert "background_radiance" not in swept(mt.Link(), {"water.b": [0.0]}, address)


def _file(path, address):
    from meshtrace.studies import sweep_file

    first = sweep_file(path, workers=address)
    again = sweep_file(path, workers=address)  # from the store
    np.testing.assert_array_equal(first["ber"], again["ber"])
    return again


def test_irradiances_of_no_model_do_not_follow_the_sun():
    day = mt.Daylight.moon(zenith_deg=50.0)
    assert daylight_recipe(day) == {"model": "moon", "sun_zenith_deg": 50.0}
    assert daylight_recipe(mt.Daylight.night()) == {"model": "night"}
    with pytest.raises(Refused, match="irradiances other than those of a model"):
        daylight_recipe(DAY)


@pytest.mark.thorough
def test_a_comparison_has_background_and_error_rate_of_each_light(tmp_path):
    night = mt.Scenario.from_toml(FILE + '[daylight]\nmodel = "night"')
    links = {"dark": mt.Scenario.from_toml(FILE), "night": night,
             "day": night.model_copy(update={"daylight": DAY})}  # fmt: skip
    found = mt.compare(links, photons=256)
    assert found.lights[1:] == ("moonless night", "daylight")
    assert found.background_radiance[0] == 0.0
    for i, day in enumerate((mt.Daylight.night(), DAY), 1):
        seen = mt.background(night.link, FlatSea(), day, photons=2048)
        assert found.background_radiance[i] == pytest.approx(seen.radiance, rel=1e-9)
        ook = with_background(mt.OokLink.of_link(night.link, night.detector), seen)
        wanted = float(ook.ber(ook.received_power(found.gain[i])))
        assert found.ber[i] == pytest.approx(wanted, rel=1e-9)
    # renewal noise, chosen with any background light, is a little quieter than that of the dark
    assert found.ber[1] == pytest.approx(found.ber[0], rel=0.05)
    assert 0.0 < 2.0 * found.ber[1] < found.ber[2] < 0.5
    assert found.ber_stderr[2] > 0.0
    assert "moonless night" in found.summary()
    found.save(tmp_path / "c.nc")
    again = mt.Comparison.load(tmp_path / "c.nc")
    assert again.summary() == found.summary()
    plain = mt.compare({"a": night.link, "b": night.link}, FlatSea(), photons=64)
    assert plain.ber is None
    assert "BER" not in plain.summary()


@pytest.mark.slow
def test_a_comparison_averages_the_error_rate_over_seas():
    link = mt.Link(transmitter=mt.Led(depth=24.0), receiver=mt.Receiver(fov_deg=20.0))
    sea = sea_in_wind(5.0)
    found = mt.compare({"a": link, "b": link}, sea, realizations=2, photons=64, daylight=DAY)
    alone = mt.link_performance(link, sea, realizations=2, photons=64, daylight=DAY).at()
    assert found.ber[0] == found.ber[1] == pytest.approx(alone.ber.value, rel=0.05)


def test_the_error_of_an_error_rate_is_that_of_gain_light_and_seas():
    link = mt.Link(receiver=mt.Receiver(fov_deg=20.0))
    ook = mt.OokLink.of_link(link).replace("optics.filter_width_nm", 2.0)
    ook = ook.replace("window", ook.averaging_window)  # no search at each rate of background
    seen = mt.background(link, FlatSea(), DAY, photons=256)
    gain, error = np.array([4e-6]), 1e-7
    value, stderr = background.error_rate(ook, gain, error, seen)
    rng = np.random.default_rng(3)

    def drawn():
        scale = 1.0 + rng.normal() * seen.radiance_stderr / seen.radiance
        lit = with_background(ook, seen, scale)
        return float(lit.ber(lit.received_power(float(gain[0] + error * rng.normal()))))

    many = np.array([drawn() for _ in range(400)])
    assert value == pytest.approx(many.mean(), rel=0.05)
    assert stderr == pytest.approx(many.std(), rel=0.15)  # 3.5 % of noise, and curvature
    mean, spread = background.error_rate(ook, np.array([4e-6, 5e-6]), 0.0, None)
    two = [background.error_rate(ook, np.array([g]), 0.0, None)[0] for g in (4e-6, 5e-6)]
    assert mean == pytest.approx(np.mean(two))
    assert spread == pytest.approx(np.std(two, ddof=1) / math.sqrt(2.0))


# Derivatives and optima


def lit_scenario(day):
    scenario = mt.Scenario.from_toml(FILE.replace("54.0", "24.0"))
    return scenario.model_copy(update={"daylight": day})


@pytest.mark.parametrize("of", ["ber", "margin"])
@pytest.mark.thorough
@pytest.mark.slow_but("ber")
def test_sensitivities_hold_under_the_light_of_the_scenario(of, tmp_path):
    options = {"quantity": of, "wrt": ["water.a"], "photons": 256}
    dark, day = (mt.sensitivities(lit_scenario(day), **options) for day in (None, DAY))
    seen = mt.background(day_link := lit_scenario(DAY).link, FlatSea(), DAY, photons=2048)
    ook = with_background(mt.OokLink.of_link(day_link, lit_scenario(DAY).detector), seen)
    gain = mt.sensitivities(day_link, FlatSea(), wrt=["water.a"], photons=256).value
    if of == "ber":
        assert day.value == pytest.approx(float(ook.ber(ook.received_power(gain))), rel=1e-3)
        assert day.value > 2.0 * dark.value
    else:
        need = ook.required_power(1e-3) / float(ook.received_power(1.0))
        assert day.value == pytest.approx(10.0 * math.log10(gain / need), abs=1e-6)
        assert day.value < dark.value
    assert "background light: none: dark" in dark.summary()
    assert "background light: daylight at zenith angle 30 deg" in day.summary()
    day.save(tmp_path / "s.nc")
    assert mt.Sensitivities.load(tmp_path / "s.nc").summary() == day.summary()
    assert "light" not in mt.sensitivities(day_link, FlatSea(), wrt=["water.a"],
                                           photons=256).summary()  # fmt: skip


@pytest.mark.slow
def test_optima_hold_under_the_light_of_the_scenario():
    over = {"receiver.fov_deg": (10.0, 30.0)}
    options = {"objective": "margin", "realizations": 1, "photons": 64}
    dark, day = (mt.optimize(lit_scenario(day), bounds=over, **options) for day in (None, DAY))
    assert day.value < dark.value - 1.0  # dB
    assert dark.notes[-1].startswith("background light: none: dark")
    assert day.notes[-1].startswith("background light: daylight at zenith angle 30 deg")


@pytest.mark.slow
def test_each_depth_of_a_range_has_its_own_background():
    link = mt.Link(transmitter=mt.AirLed(), receiver=mt.WaterReceiver(depth=30.0, fov_deg=20.0))
    lit = mt.Scenario.from_toml("wind_speed = 0.0").model_copy(
        update={"link": link, "daylight": DAY}
    )
    found = mt.sensitivities(lit, quantity="range", wrt=["water.a"], photons=64)
    at = mt.link_performance(
        link.at_depth(found.value), FlatSea(), daylight=DAY, photons=64, realizations=2
    )
    assert at.at().ber.value == pytest.approx(1e-3, rel=0.2)


@pytest.mark.statistical
@pytest.mark.thorough
def test_the_light_of_a_narrow_view_is_the_mean_over_many_seas():
    """Over one resolved sea it is wrong by factors: glint is seen or is not."""
    link, day = mt.Link(receiver=mt.Receiver(fov_deg=3.0)), mt.Daylight.clear_sky(30.0)
    rows = [
        mt.background(link, sea_in_wind(5.0).with_seed(k), day, photons=256).radiance
        for k in range(32)
    ]
    stderr = np.std(rows, ddof=1) / math.sqrt(len(rows))
    found = []
    for k in range(3):
        campaign = campaign_of(link, sea_in_wind(5.0).with_seed(k), run={"photons": 64})
        seen = Lights(campaign).background(mt.studies.Variant(link, None, daylight=day))
        found.append(seen.radiance)
        assert z_test(np.mean(rows), stderr, seen.radiance) > ALPHA
    assert np.std(found, ddof=1) < 0.03 * np.mean(found)  # of one resolved sea some 100 %
    over = background_over_seas(campaign, day, 16)
    assert over.radiance == pytest.approx(np.mean(found), rel=0.03)
    assert over.radiance_stderr < 0.03 * over.radiance
    assert stderr < 0.25 * over.radiance  # a factor of two would show


def test_a_sea_has_its_mean_where_slopes_are_random():
    sea, swell = sea_in_wind(5.0), sea_in_wind(13.0)
    longest = mean_sea(mt.Link(), sea).band
    assert longest.omega_max == pytest.approx(1.1 * sea.band.omega_min)
    resolved = mt.Link(physics=mt.Physics(unresolved="none"))
    assert mean_sea(resolved, sea) is sea
    assert mean_sea(mt.Link(), WAVE) is WAVE
    assert mean_sea(mt.Link(), swell).mss == swell.mss


def test_the_mesh_of_a_mean_sea_is_as_coarse_as_its_waves_allow():
    end = mt.Receiver(height=30.0, fov_deg=20.0)
    link, day = mt.Link(transmitter=mt.Led(depth=20.0), receiver=end), mt.Daylight.clear_sky(30.0)
    campaign = campaign_of(link, sea_in_wind(8.0), run={"photons": 64})
    sea, fine = mean_sea(link, campaign.surface), campaign.meshing
    coarse = mean_meshing(link, sea, fine)
    (lever,) = (crossing.lever for crossing in link.crossings())
    assert coarse.spacing == pytest.approx(0.06 * lever)
    assert coarse.spacing * np.hypot(sea.components.kx, sea.components.ky).max() < 0.05
    assert mean_meshing(mt.Link(), sea, fine) is fine, "a short link needs small facets"
    # gains and backgrounds are those over four times as many facets
    gains, lights = [], []
    for meshing in (fine, coarse):
        means = campaign._replace(surface=sea, meshing=meshing)
        gains.append(means.gains(means.surfaces(2))[0].mean(axis=-1))  # of all shifts
        lights.append(background_over_seas(means, day, 2).radiance)
    np.testing.assert_allclose(gains[1], gains[0], rtol=1e-3)
    assert lights[1] == pytest.approx(lights[0], rel=1e-4)
    # short waves, a spacing of the user, and surfaces that are no waves keep their meshes
    given = fine.replace(spacing=0.5)
    for surface, meshing in ((WAVE, fine), (sea, given), (FlatSea(), fine)):
        assert mean_meshing(link, surface, meshing) is meshing


# Flights

FLIGHT = mt.Flight(mt.Uav(), mt.Dryden(wind_speed=13.0))
UP = mt.Link(receiver=mt.Receiver(fov_deg=20.0), transmitter=mt.Led(depth=20.0))


@pytest.mark.slow
def test_the_background_of_a_flight_has_its_tilts():
    times = [0.0, 0.5, 1.0]
    found = mt.background_series(UP, WAVE, DAY, times, photons=256, flight=FLIGHT)
    level = mt.background_series(UP, WAVE, DAY, times, photons=256)
    tilt = np.degrees(FLIGHT.uav.tilt(FLIGHT.wind.simulate_wind(times, 1)))
    for i, time in enumerate(times):
        at = UP.replace("receiver.tilt_deg", float(tilt[0][i]))
        at = at.replace("receiver.tilt_azimuth_deg", float(tilt[1][i]))
        one = mt.background(at, WAVE, DAY, photons=256, time=time)
        assert found.radiance[i] == pytest.approx(one.radiance, rel=1e-9)
    assert not np.allclose(found.radiance, level.radiance, rtol=1e-3)
    assert found.provenance["wind"]["wind_speed"] == 13.0
    tilted = UP.replace("receiver.tilt_deg", 5.0)
    with pytest.raises(Refused, match=r"^receiver\.tilt_deg: 5"):
        mt.background_series(tilted, WAVE, DAY, times, photons=64, flight=FLIGHT)


@pytest.mark.parametrize("coupled", [False, True])
@pytest.mark.slow
def test_error_rates_of_a_flight_by_day(coupled):
    options = {"photons": 64, "realizations": 2}
    flown = {"flight": mt.Flight(coupled=coupled)}
    sea = sea_in_wind(13.0)
    day = mt.link_performance(UP, sea, daylight=DAY, **flown, **options)
    still = mt.link_performance(UP, sea, daylight=DAY, **options)
    dark = mt.link_performance(UP, sea, **flown, **options)
    assert day.at().gain == dark.at().gain
    assert day.at().ber.value > dark.at().ber.value
    # the tilt of the aircraft turns its receiver to another part of the sea
    assert day.ooks[0].background_rate != still.ooks[0].background_rate
    assert day.background_light.startswith("daylight at zenith angle 30 deg")
    gimbal = mt.Flight(mt.Uav(gimbal=True), coupled=coupled)
    held = mt.link_performance(UP, sea, daylight=DAY, flight=gimbal, **options)
    if not coupled:  # a gimbal keeps the receiver level over the same seas
        assert held.ooks[0].background_rate == still.ooks[0].background_rate


# Into the water


@pytest.mark.slow
def test_error_rates_of_a_downlink_by_day():
    link = mt.Link(
        transmitter=mt.AirLed(), receiver=mt.WaterReceiver(radius=0.05, fov_deg=20.0, depth=20.0)
    )
    ook = mt.OokLink().replace("optics.filter_width_nm", 0.5)
    options = {"photons": 256, "ook": ook}
    dark = mt.link_performance(link, FlatSea(), **options)
    day = mt.link_performance(link, FlatSea(), daylight=DAY, **options)
    seen = mt.background(link, FlatSea(), DAY, photons=2048)
    made = mt.OokLink.of_link(link, ook)
    assert made.optics.medium_index == 1.33
    assert day.ooks[0].background_rate == pytest.approx(seen.count_rate(made), rel=1e-9)
    # the light of the sky fills Snell's window: n^2 times its radiance, less the water's losses
    assert seen.parts["sky"] > 0.0
    assert day.at().ber.value > dark.at().ber.value
    assert day.at().required_power > dark.at().required_power
    assert day.background_light.startswith("daylight at zenith angle 30 deg")
    assert dark.background_light.startswith("none: dark")
    deeper = mt.link_performance(link, FlatSea(), daylight=DAY, depths=[20.0, 30.0], **options)
    assert len(deeper.figures) == 2
    rates = [mt.background(link.at_depth(d), FlatSea(), DAY, photons=2048).count_rate(made)
             for d in (20.0, 30.0)]  # fmt: skip
    assert rates[1] < 0.5 * rates[0]  # each depth has its own background
    assert deeper.at(20.0).required_power > deeper.at(30.0).required_power


@pytest.mark.slow
def test_a_downlink_by_day_from_an_aircraft():
    link = mt.Link(transmitter=mt.AirLed(), receiver=mt.WaterReceiver(fov_deg=20.0, depth=20.0))
    ook = mt.OokLink().replace("optics.filter_width_nm", 0.5)
    options = {"photons": 64, "realizations": 2, "ook": ook, "daylight": DAY}
    flown = mt.link_performance(link, sea_in_wind(5.0), flight=mt.Flight(coupled=True), **options)
    assert 0.0 < flown.at().ber.value < 0.5
    series = mt.background_series(link, WAVE, DAY, [0.0, 0.5], photons=64, flight=FLIGHT)
    level = mt.background_series(link, WAVE, DAY, [0.0, 0.5], photons=64)
    # the lamp tilts, the receiver does not
    np.testing.assert_array_equal(series.radiance, level.radiance)
