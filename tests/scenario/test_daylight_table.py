"""[daylight] of link files, and error rates that name their light."""

import tomllib

import pytest

import meshtrace as mt
from meshtrace.errors import Refused
from meshtrace.surfaces import FlatSea


def scenario(text):
    return mt.Scenario.from_toml(f"wind_speed = 0.0\n{text}")


@pytest.mark.parametrize(
    ("text", "made"),
    [
        ('daylight = "night"', lambda: mt.Daylight.night()),
        ('[daylight]\nmodel = "moon"\nphase_deg = 60.0\nsun_zenith_deg = 20.0',
         lambda: mt.Daylight.moon(60.0, 20.0)),
        ('[daylight]\nmodel = "overcast"\nsun_zenith_deg = 50.0\ntransmittance = 0.3',
         lambda: mt.Daylight.overcast(50.0, transmittance=0.3)),
        ("[daylight]\ndirect = 1.42\ndiffuse = 0.295\nsun_azimuth_deg = 90.0\nwater = \"none\"",
         lambda: mt.Daylight(direct=1.42, diffuse=0.295, sun_azimuth_deg=90.0, water="none",
                             light="clear sky")),
        ('[daylight]\nmodel = "uniform"\ndiffuse = 0.3',
         lambda: mt.Daylight(direct=0.0, diffuse=0.3, pattern="uniform", light="uniform sky")),
    ],
)  # fmt: skip
def test_tables_and_their_light(text, made):
    read = scenario(text)
    assert read.daylight == made()
    assert mt.Scenario.from_toml(read.to_toml()) == read


def test_clear_skies_are_read_and_written():
    pytest.importorskip("pvlib")
    read = scenario('[daylight]\nsun_zenith_deg = 40.0\naerosol = 0.2\npattern = "cie-13"')
    assert read.daylight == mt.Daylight.clear_sky(40.0, pattern="cie-13", aerosol=0.2)
    assert mt.Scenario.from_toml(read.to_toml()) == read
    moment = 'time = "2026-06-21T10:00Z"\nlatitude = 43.1\nlongitude = 5.9'
    read = scenario(f"[daylight]\n{moment}")
    assert read.daylight == mt.Daylight.at("2026-06-21T10:00Z", 43.1, 5.9)


LIGHTS = {
    "clear": ("", lambda sun: mt.Daylight.clear_sky(sun)),
    "hazy": ("aerosol = 0.4\nday_of_year = 172", lambda sun: mt.Daylight.clear_sky(
        sun, aerosol=0.4, day_of_year=172)),
    "overcast": ('model = "overcast"\ntransmittance = 0.4', lambda sun: mt.Daylight.overcast(
        sun, transmittance=0.4)),
    "moon": ('model = "moon"\nphase_deg = 40.0', lambda sun: mt.Daylight.moon(40.0, sun)),
}  # fmt: skip


@pytest.mark.parametrize("name", LIGHTS)
def test_an_edited_copy_has_the_light_of_its_sun(name):
    """`direct` and `diffuse` once stood beside the sun, and changed with nothing."""
    pytest.importorskip("pvlib")
    table, light = LIGHTS[name]
    copy = scenario(f"[daylight]\nsun_zenith_deg = 30.0\n{table}").to_toml()
    assert "direct" not in copy
    assert "diffuse" not in copy
    assert mt.Scenario.from_toml(copy).daylight == light(30.0)
    edited = copy.replace("sun_zenith_deg = 30.0", "sun_zenith_deg = 70.0")
    assert mt.Scenario.from_toml(edited).daylight == light(70.0)
    other = copy.replace("wavelength_nm = 470.0", "wavelength_nm = 520.0")
    assert mt.Scenario.from_toml(other).daylight.irradiance != light(30.0).irradiance


def test_an_edited_copy_has_the_sky_of_its_model():
    """The pattern and the name of the clear sky once stood beside the model."""
    copy = scenario("daylight = 'clear'").to_toml().replace('"clear"', '"overcast"')
    assert mt.Scenario.from_toml(copy).daylight == mt.Daylight.overcast()


def test_an_edited_copy_of_a_place_and_time_has_the_light_of_its_sun():
    pytest.importorskip("pvlib")
    moment = 'time = "2026-06-21T10:00Z"\nlatitude = 43.1\nlongitude = 5.9'
    read = scenario(f"[daylight]\n{moment}")
    table = tomllib.loads(read.to_toml())
    assert table["daylight"]["day_of_year"] == 172
    assert mt.Scenario.from_toml(read.to_toml()) == read
    table["daylight"]["sun_zenith_deg"] = 60.0
    expected = mt.Daylight.clear_sky(60.0, read.daylight.sun_azimuth_deg, day_of_year=172)
    assert mt.Scenario.from_config(table).daylight == expected


def test_irradiances_of_no_model_stand_in_a_copy():
    for day in (mt.Daylight(direct=1.0, diffuse=0.2), mt.Daylight.clear_sky().replace(direct=1.0)):
        lit = scenario("").replace(daylight=day)
        assert "direct = 1.0" in lit.to_toml()
        assert mt.Scenario.from_toml(lit.to_toml()).daylight.irradiance == day.irradiance


def test_a_copy_holds_no_other_keys_that_follow():
    """Of the link in [detector], and of the layers in [water]."""
    text = "[transmitter]\npower_mw = 40.0\n[detector]\n[water]\nlayers = [[0.0, 0.1, 0.2]]\n"
    read = scenario(text)
    table = tomllib.loads(read.to_toml())
    assert not {"power", "wavelength"} & table["detector"]["led"].keys()
    assert not {"radius", "fov_deg", "medium_index"} & table["detector"]["optics"].keys()
    assert not {"a", "b"} & table["water"].keys()
    assert mt.Scenario.from_config(table) == read
    assert read.detector == mt.OokLink.of_link(read.link)
    table["transmitter"]["power_mw"] = 60.0
    table["water"]["layers"] = [[0.0, 0.3, 0.2]]
    edited = mt.Scenario.from_config(table)
    assert edited.detector.led.power == 0.06
    assert edited.link.water.a == 0.3
    with pytest.raises(Refused, match=r"detector\.led\.power: 0\.2, allowed: nothing, or 0\.06"):
        mt.Scenario.from_config({**table, "detector": {"led": {"power": 0.2}}})


def test_none_is_the_dark():
    assert scenario('daylight = "none"').daylight is None
    assert "daylight" not in scenario("").to_toml()


def test_the_light_has_the_wavelength_of_the_transmitter():
    text = '[transmitter]\nkind = "led"\nwavelength_nm = 520.0\n[daylight]\nmodel = "night"'
    assert scenario(text).daylight.wavelength_nm == 520.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('daylight = "day"', "daylight.model: 'day'"),
        ("[daylight]\nsun_zenit_deg = 3.0", "did you mean sun_zenith_deg"),
        ('[daylight]\nmodel = "moon"\nphase_deg = 200.0', "daylight.phase_deg: 200"),
        ("[daylight]\ndirect = -1.0", "daylight.direct: -1.0"),
        ("[daylight]\ndirect = 1.0\naerosol = 0.1", "daylight.aerosol: 0.1"),
        ('[daylight]\nmodel = "uniform"', "daylight.diffuse: missing"),
        ('[daylight]\nmodel = "night"\nsun_zenith_deg = 100.0', "use night"),
        ('[daylight]\ntime = "2026-06-21T10:00Z"\nsun_zenith_deg = 3.0', "sun_zenith_deg: 3"),
        ('[daylight]\ntime = "2026-06-21T10:00Z"', "latitude"),
    ],
)
def test_refusals(text, message):
    with pytest.raises(Refused, match=message):
        scenario(text)


DAY = mt.Daylight(direct=1.42, diffuse=0.295)


@pytest.mark.filterwarnings("ignore::meshtrace.DaylightWarning")
@pytest.mark.thorough
def test_every_error_rate_names_its_light(tmp_path):
    link = mt.Link(receiver=mt.Receiver(fov_deg=20.0))
    dark = mt.link_performance(link, FlatSea(), photons=256)
    night, day = (
        mt.link_performance(link, FlatSea(), photons=256, daylight=light)
        for light in (mt.Daylight.night(), DAY)
    )
    assert "background light: none" in dark.summary()
    assert "background light: moonless night" in night.summary()
    assert "background light: daylight at zenith angle 30 deg" in day.summary()
    assert "widest filter for BER 0.001" in day.summary()
    assert "Mbit/s, dark; 1 point" in repr(dark)
    assert "Mbit/s, moonless night; 1 point" in repr(night)
    assert "Mbit/s, daylight at zenith angle 30 deg; 1 point" in repr(day)
    assert dark.at().required_power < night.at().required_power * 1.01 < day.at().required_power
    day.save(tmp_path / "day.nc")
    loaded = mt.LinkPerformance.load(tmp_path / "day.nc")
    assert loaded.background_light == day.background_light
    assert loaded.at().widest_filter_nm == day.at().widest_filter_nm
    assert loaded.provenance["daylight"]["direct"] == 1.42


@pytest.mark.filterwarnings("ignore::meshtrace.DaylightWarning")
@pytest.mark.thorough
def test_ranges_of_several_winds_name_the_light_of_each():
    from meshtrace.studies import DepthSweep

    link = mt.Link(receiver=mt.Receiver(fov_deg=20.0))
    dark, night, day = (
        mt.link_performance(link, FlatSea(), photons=64, daylight=light)
        for light in (None, mt.Daylight.night(), DAY)
    )
    text = DepthSweep((5.0, 13.0), (night, day)).summary()
    assert f"background light, 5 m/s: {night.background_light}" in text
    assert f"background light, 13 m/s: {day.background_light}" in text
    assert (
        f"\nbackground light: {dark.background_light}"
        in DepthSweep((5.0, 13.0), (dark, dark)).summary()
    )


@pytest.mark.filterwarnings("ignore::meshtrace.DaylightWarning")
def test_overcast_skies_name_their_hidden_sun():
    link = mt.Link(receiver=mt.Receiver(fov_deg=5.0))
    found = mt.link_performance(link, FlatSea(), photons=64, daylight=mt.Daylight.overcast(50.0))
    assert found.background_light.startswith("overcast sky at zenith angle 50 deg, ")


@pytest.mark.filterwarnings("ignore::meshtrace.DaylightWarning")
@pytest.mark.slow
def test_the_error_of_the_background_widens_the_interval():
    from meshtrace.surfaces import JonswapSea

    link = mt.Link(receiver=mt.Receiver(fov_deg=20.0), transmitter=mt.Led(depth=25.0))
    ook = mt.OokLink().replace("optics.filter_width_nm", 2.0)
    options = {"photons": 256, "realizations": 6, "ook": ook}
    bright = mt.link_performance(link, JonswapSea(), daylight=DAY, **options).at()
    dark = mt.link_performance(link, JonswapSea(), **options).at()
    assert bright.ber.value > dark.ber.value
    assert bright.ber.low < bright.ber.value < bright.ber.high


def test_daylight_of_another_wavelength_is_refused():
    with pytest.raises(Refused, match="wavelength_nm: 550"):
        mt.link_performance(mt.Link(), FlatSea(), daylight=DAY.replace(wavelength_nm=550.0))


def test_the_background_flickers_over_time():
    from meshtrace.surfaces import JonswapSea

    link, sea = mt.Link(receiver=mt.Receiver(fov_deg=20.0)), JonswapSea(omega_max=4.0)
    series = mt.background_series(link, sea, DAY, [0.0, 0.5, 1.0], photons=512)
    one = mt.background(link, sea, DAY, photons=512, time=0.5)
    assert series.radiance[1] == pytest.approx(one.radiance)
    assert series.scintillation_index > 1e-3
    assert series.parts["sky"].shape == (3,)
    with pytest.raises(Refused, match="times"):
        mt.background_series(link, sea, DAY)
