"""Daylight above the sea: patterns, spectra, moon, night, refusals."""

import builtins
import datetime
import json
import math
from pathlib import Path

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.daylight import light, patterns, sky, sky_radiance
from meshtrace.daylight.patterns import hemisphere
from meshtrace.errors import Refused
from meshtrace.optics import fresnel

REFERENCE = json.loads(
    (Path(__file__).parents[1] / "data/daylight_downlink_reference.json").read_text()
)
UP = np.array([0.0, 0.0, 1.0])


@pytest.mark.parametrize("pattern", ["cie-12", "cie-1", "uniform", "harrison-coombes"])
def test_zenith_radiance_of_the_reference(pattern):
    found = sky_radiance(sky(pattern, 0.295018, 30.0, 0.0), UP)
    wanted = REFERENCE["sky"]["zenith_radiance_sun30_Edif0.295018"][pattern]
    assert found == pytest.approx(wanted, rel=2e-6)


@pytest.mark.parametrize("pattern", ["cie-12", "harrison-coombes", "cie-1"])
def test_radiance_seen_aside_of_the_sun(pattern):
    found = sky_radiance(
        sky(pattern, 0.295018, 30.0, 0.0), np.array(fresnel.unit_vector(40.0, 135.0))
    )
    assert found == pytest.approx(REFERENCE["sky"]["radiance_40_135"][pattern], rel=2e-5)


@pytest.mark.parametrize("kind", ["1", "12"])
def test_cie_sky_of_another_implementation(kind):
    pattern = sky(f"cie-{kind}", 1.0, 30.0, 0.0)
    ratio = sky_radiance(pattern, np.array(fresnel.unit_vector(45.0, 180.0))) / sky_radiance(
        pattern, UP
    )
    assert ratio == pytest.approx(REFERENCE["sky"]["cie_z45_az180_sun30"][kind], rel=2e-7)


@pytest.mark.parametrize("pattern", patterns.PATTERNS)
@pytest.mark.parametrize("zenith", [0.0, 30.0, 75.0])
def test_patterns_carry_their_irradiance(pattern, zenith):
    # an independent quadrature: uniform midpoints, with the sun turned aside
    made = sky(pattern, 1.0, zenith, 100.0)
    n = 600
    sin2, phi = (np.arange(n) + 0.5) / n, 2.0 * math.pi * (np.arange(n) + 0.5) / n
    s, phi = np.meshgrid(np.sqrt(sin2), phi, indexing="ij")
    towards = np.stack([s * np.cos(phi), s * np.sin(phi), np.sqrt(1.0 - s**2)], axis=-1)
    assert math.pi * sky_radiance(made, towards).mean() == pytest.approx(1.0, rel=3e-4)


def test_normalisation_to_1e_6_against_adaptive_quadrature():
    from scipy.integrate import dblquad

    made = sky("harrison-coombes", 1.0, 30.0, 0.0)

    def flux(azimuth, zenith):
        towards = np.array(fresnel.unit_vector(math.degrees(zenith), math.degrees(azimuth)))
        return float(sky_radiance(made, towards)) * math.cos(zenith) * math.sin(zenith)

    low, _ = dblquad(flux, 0.0, math.pi / 6.0, 0.0, math.pi, epsabs=1e-8)
    high, _ = dblquad(flux, math.pi / 6.0, math.pi / 2.0, 0.0, math.pi, epsabs=1e-8)
    assert 2.0 * (low + high) == pytest.approx(1.0, abs=1e-6)


def test_solid_angles_of_the_hemisphere():
    directions, solid = hemisphere(30.0)
    assert solid.sum() == pytest.approx(2.0 * math.pi, rel=1e-9)
    assert solid @ directions[:, 2] == pytest.approx(math.pi, rel=1e-9)


@pytest.mark.external
@pytest.mark.parametrize("i", range(5))
def test_spectrum_of_pvlib(i):
    pytest.importorskip("pvlib")
    table = REFERENCE["spectrum_pvlib_0.16.1_470nm"]
    day = mt.Daylight.clear_sky(table["zenith_deg"][i])
    assert day.direct == pytest.approx(table["direct_normal"][i], rel=1e-5)
    assert day.diffuse == pytest.approx(table["diffuse"][i], rel=1e-5)


def test_sun_over_toulon_at_noon_of_summer():
    pytest.importorskip("pvlib")
    day = mt.Daylight.at("2026-06-21T11:38Z", latitude=43.1, longitude=5.9)
    # the declination is 23.44 degrees: culmination at 43.1 - 23.44, in the south
    assert day.sun_zenith_deg == pytest.approx(43.1 - 23.44, abs=0.03)
    assert day.sun[1] < 0.0
    assert abs(day.sun[0]) < 0.01
    morning = mt.Daylight.at("2026-06-21T07:00Z", latitude=43.1, longitude=5.9)
    assert morning.sun[0] > 0.5  # east


def test_the_table_for_470_nm_is_that_of_pvlib():
    pytest.importorskip("pvlib")
    from meshtrace.daylight import clear_irradiance
    from meshtrace.daylight.light import default_irradiance

    for zenith in (5.0, 30.0, 48.19, 66.0, 81.0, 84.0):
        wanted = clear_irradiance(zenith)
        found = default_irradiance(zenith, 470.0)
        assert tuple(found) == pytest.approx(tuple(wanted), rel=5e-3, abs=2e-4)


def test_wider_bands_are_averaged():
    pytest.importorskip("pvlib")
    narrow = [mt.Daylight.clear_sky(30.0, wavelength_nm=450.5 + i).direct for i in range(40)]
    wide = mt.Daylight.clear_sky(30.0, width_nm=40.0).direct
    assert wide == pytest.approx(np.mean(narrow), rel=1e-3)


@pytest.mark.parametrize(("phase", "factor"), REFERENCE["moon_phase_factor"].items())
def test_moonlight_scales_with_the_phase(phase, factor):
    # 10^-1.040976 is 0.090996: the digits of the reference at 90 degrees are swapped
    full, moon = mt.Daylight.moon(), mt.Daylight.moon(phase_deg=float(phase))
    assert moon.direct / full.direct == pytest.approx(factor, rel=5e-4)
    assert moon.diffuse / full.diffuse == pytest.approx(factor, rel=5e-4)
    assert full.direct == pytest.approx(2.512e-6 * 1.421482, rel=1e-6)


def test_night_is_uniform():
    night = mt.Daylight.night()
    for zenith in (0.0, 50.0, 89.0):
        towards = np.array(fresnel.unit_vector(zenith, 20.0))
        assert sky_radiance(night.sky, towards) == pytest.approx(2.3e-9, rel=1e-9)


def test_the_night_is_that_of_dark_sites():
    # zero points of Bessell (1979) [Jy], at 440 and 550 nm
    def radiance(blue, green):
        bands = ((4260e-26, 440e-9, blue), (3640e-26, 550e-9, green))
        arcsec2 = math.radians(1.0 / 3600.0) ** 2
        of = [f * 2.998e8 / w**2 * 1e-9 * 10 ** (-0.4 * m) / arcsec2 for f, w, m in bands]
        return np.interp(470.0, (440.0, 550.0), of)

    night = mt.Daylight.night().diffuse / math.pi
    la_palma, paranal = radiance(22.7, 21.9), radiance(22.6, 21.6)
    assert la_palma == pytest.approx(2.4e-9, rel=0.02)
    assert paranal == pytest.approx(2.8e-9, rel=0.02)
    assert night / la_palma == pytest.approx(0.95, abs=0.01)
    assert night / paranal == pytest.approx(0.82, abs=0.01)


ROLO = {  # a0 ... a3, d1 ... d3 of Kieffer and Stone (2005), table 4, by wavelength [nm]
    465.8: (-2.35085, -1.66538, 0.41802, -0.22541, 0.33450, -0.02546, -0.00484),
    475.0: (-2.28999, -1.63180, 0.36193, -0.20381, 0.33024, -0.03131, 0.00222),
    544.0: (-2.13864, -1.60613, 0.27886, -0.16426, 0.37190, -0.10629, 0.01428),
    549.1: (-2.10782, -1.66736, 0.41697, -0.22026, 0.36814, -0.09815, -0.00000),
    553.8: (-2.12504, -1.65970, 0.38409, -0.20655, 0.37206, -0.10745, 0.00347),
}


@pytest.mark.parametrize(("phase", "less"), [(5.0, 0.14), (30.0, 0.16), (90.0, 0.18)])
def test_the_moon_is_redder_than_the_sun(phase, less):
    def reflectance(*wavelengths):
        rows = (ROLO[w] for w in wavelengths)
        return np.mean([
            math.exp(np.polyval(row[3::-1], math.radians(phase)) + row[4] * math.exp(-phase / 4.06054)
                     + row[5] * math.exp(-phase / 12.8802)
                     + row[6] * math.cos((phase + 30.5858) / 16.7498))
            for row in rows
        ])  # fmt: skip

    blue, green = reflectance(465.8, 475.0), reflectance(544.0, 549.1, 553.8)
    assert 1.0 - blue / green == pytest.approx(less, abs=0.006)
    # A Omega / pi with the solid angle of the moon, against 14.0 magnitudes and the phase law
    share = 2.512e-6 * mt.daylight.moon_phase_factor(phase)
    assert share == pytest.approx(green * 6.4177e-5 / math.pi, rel=0.13)


def test_overcast_is_a_quarter_of_the_clear_sky_without_sun():
    day = mt.Daylight.overcast(30.0)
    clear = 1.421482 * math.cos(math.radians(30.0)) + 0.295018
    assert (day.direct, day.diffuse) == (0.0, pytest.approx(0.25 * clear, rel=1e-6))


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"sun_zenith_deg": 90.0}, "below the horizon: use night"),
        ({"sun_zenith_deg": -1.0}, "0 <= sun_zenith_deg <= 89"),
        ({"direct": -1.0}, "direct: -1.0, allowed: >= 0"),
        ({"diffuse": math.nan}, "diffuse: nan, allowed: finite numbers"),
        ({"direct": 0.0, "diffuse": 0.0}, "some light"),
        ({"pattern": "cie-16"}, "pattern: 'cie-16', did you mean"),
        ({"wavelength_nm": 299.0}, "300 <= wavelength_nm <= 1100"),
        ({"foam_reflectance": 1.1}, "0 <= foam_reflectance <= 1"),
        ({"water": "deep"}, "quasi-single"),
    ],
)
def test_refusals(fields, text):
    with pytest.raises(Refused, match=text):
        mt.Daylight(**{"direct": 1.0, "diffuse": 1.0, **fields})


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: mt.Daylight.clear_sky(direct=1.0), "^direct: 1.0, allowed: none"),
        (lambda: mt.Daylight.overcast(diffuse=1.0), "^diffuse: 1.0, allowed: none"),
        (lambda: mt.Daylight.moon(direct=1.0), "^direct: 1.0, allowed: none"),
        (lambda: mt.Daylight.moon(sun_zenith_deg=3.0), "^sun_zenith_deg: 3.0, allowed: none"),
        (lambda: mt.Daylight.moon("0"), "^phase_deg: '0', allowed: -180"),
        (lambda: mt.Daylight.moon(181.0), "^phase_deg: 181.0, allowed: -180"),
        (lambda: mt.Daylight.night(diffuse=1.0), "^diffuse: 1.0, allowed: none"),
        (lambda: mt.Daylight.at("2026-06-21T10Z", 43.1, 5.9, sun_zenith_deg=3.0),
         "^sun_zenith_deg: 3.0, allowed: none"),
        (lambda: mt.Daylight.clear_sky(day_of_year=0), "^day_of_year: 0, allowed: an integer 1"),
        (lambda: mt.Daylight.clear_sky(day_of_year=1.5), "^day_of_year: 1.5, allowed: an integer"),
        (lambda: mt.Daylight.clear_sky(wavelength_nm=310.0, width_nm=40.0),
         "^width_nm: 40.0, from 290 nm, allowed: a band from 300 nm"),
    ],
)  # fmt: skip
def test_lights_refuse_what_their_model_does_not_take(make, text):
    with pytest.raises(Refused, match=text):
        make()


def test_faint_skies_have_a_background():
    from meshtrace.surfaces import FlatSea

    faint = mt.Daylight(direct=0.0, diffuse=5e-324)  # the beams of its sky underflow
    assert mt.background(mt.Link(), FlatSea(), faint, photons=32).radiance < 1e-300


@pytest.mark.parametrize(
    "time",
    [
        *("2026-06-21T10:00", "noon", "NaT", "now", "2026-06-21", "10:00Z", "2026-06-21x10:00Z"),
        *("05/06/2026 10:00Z", "21/06/2026 10:00Z", "2026/06/21 10:00Z", "June 21 2026 10:00Z"),
        *("2026-6-21T10:00Z", "2026-13-21T10:00Z", "2026-06-21T10:00 UTC", 1.7e9, None),
        *(np.datetime64("NaT"), np.datetime64("2026-06-21T10:00"), datetime.datetime(2026, 6, 21)),
        *(datetime.date(2026, 6, 21), b"2026-06-21T10:00Z", ["2026-06-21T10:00Z"]),
    ],
)
def test_times_that_are_no_iso_dates_with_a_zone_are_refused(time):
    pytest.importorskip("pvlib")
    with pytest.raises(Refused, match=r"^time: .*ISO 8601"):
        mt.Daylight.at(time, 43.1, 5.9)


def test_one_time_in_several_forms():
    pytest.importorskip("pvlib")
    stamp = datetime.datetime(2026, 6, 21, 10, tzinfo=datetime.UTC)
    forms = ("2026-06-21T10:00Z", "2026-06-21 12:00+02:00", "20260621T1000Z", "2026-W25-7T10:00Z")
    assert {light.sun_position(time, 43.1, 5.9) for time in forms} == {
        light.sun_position(stamp, 43.1, 5.9)
    }


def test_a_place_is_needed():
    with pytest.raises(Refused, match="latitude"):
        mt.Daylight.at("2026-06-21T10:00Z", None, 5.9)
    with pytest.raises(Refused, match="longitude"):
        mt.Daylight.at("2026-06-21T10:00Z", 43.1, 200.0)


@pytest.fixture
def without_pvlib(monkeypatch):
    found = builtins.__import__

    def refuse(name, *rest, **options):
        if name.split(".")[0] == "pvlib":
            raise ImportError(name)
        return found(name, *rest, **options)

    monkeypatch.setattr(builtins, "__import__", refuse)
    light._clear_spectra.cache_clear()


@pytest.mark.usefixtures("without_pvlib")
def test_without_pvlib_everything_works_but_the_clear_sky():
    for made in (lambda: mt.Daylight.clear_sky(), lambda: mt.Daylight.at("2026-06-21T10Z", 0, 0)):
        with pytest.raises(Refused, match=r"meshtrace\[daylight\]"):
            made()
    assert mt.Daylight.moon().direct > 0.0
    assert mt.Daylight.overcast().diffuse > 0.0
    assert mt.Daylight.night().diffuse > 0.0
    assert mt.Daylight(direct=1.42, diffuse=0.295).irradiance > 1.5


@pytest.mark.usefixtures("without_pvlib")
def test_a_gain_needs_no_package_of_daylight():
    text = 'wind_speed = 0.0\n[daylight]\nmodel = "clear"\nsun_zenith_deg = 37.0\n'
    scenario = mt.Scenario.from_toml(text)
    result = mt.simulate(scenario, photons=64)
    assert result.gain == mt.simulate(mt.Scenario.from_toml("wind_speed = 0.0"), photons=64).gain
    assert scenario.to_config()["daylight"] == {"model": "clear", "sun_zenith_deg": 37.0}
    for study in (mt.background_series, mt.link_performance, mt.design):
        with pytest.raises(Refused, match=r"daylight: pvlib is not installed.*\[daylight\]"):
            study(scenario)
