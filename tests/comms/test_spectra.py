"""Spectra of the link against independent quadrature, closed forms and limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import constants
from scipy.special import erf

import meshtrace as mt
from meshtrace.comms import (
    ChannelResponse,
    Curve,
    LedDriver,
    OokLink,
    OpticalFrontEnd,
    SiPM,
)
from meshtrace.comms.background import filter_shift_nm, widest_filter_nm, with_background
from meshtrace.comms.budget import link_budget, outage
from meshtrace.comms.spectra import signal_passed
from meshtrace.daylight import clear_irradiance
from meshtrace.errors import Refused
from meshtrace.results import Background
from meshtrace.results.daylight import PARTS
from meshtrace.scenario import Scenario

SIGMA = 1.0 / (2.0 * math.sqrt(2.0 * math.log(2.0)))  # of a Gaussian of full width 1
TABLE = Curve(wavelength_nm=(455.0, 465.0, 472.0, 490.0), value=(0.0, 0.9, 0.8, 0.0))
EFFICIENCY = Curve(wavelength_nm=(300.0, 420.0, 600.0), value=(0.05, 0.4, 0.2))


def lit(radiance=1e-3, wavelength_nm=470.0, **provenance):
    zero = np.zeros(len(PARTS))
    optics = OpticalFrontEnd()
    sin2 = math.sin(math.radians(0.5 * optics.fov_deg)) ** 2
    acceptance = math.pi**2 * optics.radius**2 * sin2
    return Background(zero, zero, radiance, 0.0, acceptance, wavelength_nm, provenance)


def share(led=None, **optics):
    return OokLink(led=led or LedDriver(), optics=OpticalFrontEnd(**optics)).filter_share


# --- limits --------------------------------------------------------------------------------


def test_a_narrow_source_gives_the_numbers_of_one_wavelength():
    plain = OokLink(optics=OpticalFrontEnd(filter_transmission=0.8))
    narrow = plain.replace("led.width_nm", 1e-4)
    assert plain.filter_share == 0.8
    assert narrow.filter_share == pytest.approx(0.8, rel=1e-12)
    for name in ("received_power", "count_rate", "ber"):
        value = 1e-7 if name == "received_power" else 1e-10
        found, expected = (float(getattr(one, name)(value)) for one in (narrow, plain))
        assert found == pytest.approx(expected, rel=1e-9)
    assert narrow.required_power(1e-3) == pytest.approx(plain.required_power(1e-3), rel=1e-9)


def test_a_wide_filter_passes_all():
    for led in (LedDriver(width_nm=25.0), LedDriver(spectrum=TABLE)):
        assert share(led, filter_width_nm=300.0) == pytest.approx(1.0, rel=1e-12)
        assert share(led, filter_width_nm=300.0, filter_index=1.8) == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("width", [2.0, 10.0, 40.0])
def test_a_band_passes_the_error_function_of_a_gaussian(width):
    expected = erf(5.0 / (math.sqrt(2.0) * SIGMA * width))
    assert share(LedDriver(width_nm=width)) == pytest.approx(expected, abs=1e-5)
    aside = share(LedDriver(width_nm=width), filter_center_nm=475.0)
    half = 0.5 * erf(10.0 / (math.sqrt(2.0) * SIGMA * width))
    assert aside == pytest.approx(half, abs=1e-5)


@pytest.mark.parametrize("index", [1.6, 2.0])
def test_the_band_shifts_to_the_blue(index):
    """One wavelength passes while 475 f(theta) >= 470: the share of such angles, in closed form."""
    most = (1.0 - (470.0 / 475.0) ** 2) * index**2 / math.sin(math.radians(30.0)) ** 2
    assert share(filter_index=index) == pytest.approx(most, abs=1.0 / 512)
    edge = math.degrees(math.asin(index * math.sqrt(1.0 - (470.0 / 475.0) ** 2)))
    assert filter_shift_nm(475.0, edge, index) == pytest.approx(5.0, rel=1e-12)
    assert share(filter_index=index, fov_deg=1.99 * edge) == 1.0
    # a centre that leads the shift serves the slanted light
    assert share(filter_index=index, filter_center_nm=474.5) > share(filter_index=index)


def test_angles_of_the_response_take_the_place_of_a_filled_view():
    optics = OpticalFrontEnd(filter_index=2.0)
    steep = ChannelResponse(delay=(0.0,), share=(1.0,), angle_deg=(0.0, 5.0))
    wide = ChannelResponse(delay=(0.0,), share=(1.0,), angle_deg=(0.0, 25.0, 28.0, 29.0))
    assert OokLink(optics=optics, response=steep).filter_share == 1.0
    assert OokLink(optics=optics, response=wide).filter_share == 0.25


def test_light_beside_the_filter_closes_the_link():
    ook = OokLink(optics=OpticalFrontEnd(filter_center_nm=600.0))
    assert ook.filter_share == 0.0
    assert ook.received_power(1e-6) == 0.0
    assert link_budget(ook, 1e-6, 1e-3).margin_optical_db == -math.inf
    assert outage(ook, [1e-6, 2e-6], 1e-3).value == 1.0


# --- quadrature ----------------------------------------------------------------------------


def passed_by_quadrature(fov_deg, index, weight):
    """Return a mean over the angles of a filled view by Gauss' rule and the trapezoidal one."""
    corners, nm = np.array(TABLE.wavelength_nm), np.linspace(430.0, 491.0, 20_001)
    nodes, weights = np.polynomial.legendre.leggauss(40)
    edge = math.sin(math.radians(0.5 * fov_deg)) ** 2
    total = 0.0
    for node, w in zip(nodes, weights, strict=True):
        shifted = corners * math.sqrt(1.0 - edge * 0.5 * (1.0 + node) / index**2)
        passed = np.interp(nm, shifted, TABLE.value, left=0.0, right=0.0)
        total += 0.5 * w * np.trapezoid(passed * weight(nm), nm)
    return total


def test_signal_is_the_integral_over_wavelength_and_angle():
    led, index = LedDriver(width_nm=18.0), 1.7
    gain = Curve(wavelength_nm=(400.0, 470.0, 540.0), value=(0.5, 1.0, 3.0))
    ook = OokLink(
        led=led,
        sipm=SiPM(pde=EFFICIENCY),
        optics=OpticalFrontEnd(filter_transmission=TABLE, filter_index=index, fov_deg=70.0),
        gain_spectrum=gain,
    )
    sigma = SIGMA * led.width_nm

    def density(nm):
        bell = np.exp(-0.5 * ((nm - 470.0) / sigma) ** 2) / (sigma * math.sqrt(2.0 * math.pi))
        return bell * np.interp(nm, gain.wavelength_nm, gain.value)

    def counted(nm):
        return density(nm) * np.interp(nm, EFFICIENCY.wavelength_nm, EFFICIENCY.value) * nm / 470.0

    share, counts = signal_passed(ook)
    assert share == pytest.approx(passed_by_quadrature(70.0, index, density), rel=1e-4)
    assert counts == pytest.approx(passed_by_quadrature(70.0, index, counted), rel=1e-4)
    # counts of the light in the aperture: spectrum, filter and detector in one product
    energy = constants.h * constants.c / 470e-9
    lens = ook.optics.concentration_efficiency(ook.sipm.area)
    rate = ook.count_rate(ook.received_power(1e-6))
    expected = 1e-6 * 0.1 * lens * counts / energy
    assert rate == pytest.approx(expected, rel=1e-12)


def test_background_is_the_integral_of_the_solar_spectrum():
    pytest.importorskip("pvlib")
    day = mt.Daylight.clear_sky(40.0, aerosol=0.2)
    index, fov = 2.1, 60.0
    ook = OokLink(
        sipm=SiPM(pde=EFFICIENCY),
        optics=OpticalFrontEnd(filter_transmission=TABLE, filter_index=index, fov_deg=fov),
    )
    found = lit(daylight=day.model_dump(mode="json"))
    nodes = np.arange(430.0, 500.0, 0.5)
    made = [clear_irradiance(40.0, float(nm), aerosol=0.2) for nm in nodes]
    whole = np.array([math.cos(math.radians(40.0)) * one.direct + one.diffuse for one in made])
    whole /= np.interp(470.0, nodes, whole)

    def weight(nm):
        efficiency = np.interp(nm, EFFICIENCY.wavelength_nm, EFFICIENCY.value)
        return np.interp(nm, nodes, whole) * efficiency * nm / 470.0

    integral = passed_by_quadrature(fov, index, weight)
    energy = constants.h * constants.c / 470e-9
    lens = ook.optics.concentration_efficiency(ook.sipm.area)
    expected = 1e-3 * found.acceptance * lens * integral / energy
    assert found.count_rate(ook) == pytest.approx(expected, rel=1e-3)
    assert with_background(ook, found).background_rate == found.count_rate(ook)


def test_a_flat_background_behind_a_band_is_the_product():
    night = mt.Daylight.night().model_dump(mode="json")
    plain, found = OokLink(), lit(daylight=night)
    centred = plain.replace("optics.filter_center_nm", 470.0)
    assert found.count_rate(centred) == pytest.approx(found.count_rate(plain), rel=1e-5)
    halved = plain.replace("optics.filter_width_nm", 5.0)
    assert 2.0 * found.count_rate(halved) == pytest.approx(found.count_rate(plain), rel=1e-12)


def test_the_widest_filter_trades_signal_for_background():
    found = lit(6e-7, daylight=mt.Daylight.night().model_dump(mode="json"))
    prompt = OokLink(optics=OpticalFrontEnd(filter_width_nm=20.0), window=5e-7)
    power = 2.6e-10
    narrow = widest_filter_nm(prompt.replace("led.width_nm", 1e-4), found, power, 1e-3)
    assert narrow == pytest.approx(widest_filter_nm(prompt, found, power, 1e-3), rel=2e-4)
    wide = prompt.replace("led.width_nm", 4.0)
    most = widest_filter_nm(wide, found, power, 1e-3)

    def error(width):
        trial = wide.replace("optics.filter_width_nm", width)
        signal = power * trial.filter_share / wide.filter_share
        return with_background(trial, found).ber(signal)

    assert error(most) == pytest.approx(1e-3, rel=1e-3)
    assert error(1.01 * most) > 1e-3 > error(0.99 * most)


# --- link files ----------------------------------------------------------------------------


def test_link_files_hold_spectra(tmp_path):
    (tmp_path / "led.csv").write_text("wavelength_nm,power\n450,0\n470,2\n480,1\n500,0\n")
    (tmp_path / "pde.txt").write_text("400 0.3\n500 0.25\n")
    (tmp_path / "link.toml").write_text(
        """
        [detector.led]
        spectrum = {file = "led.csv"}
        [detector.sipm]
        pde = {file = "pde.txt"}
        [detector.optics]
        filter_index = 1.9
        filter_center_nm = 474.0
        """
    )
    scenario = Scenario.load(tmp_path / "link.toml")
    ook = scenario.detector
    assert ook.led.spectrum.value == (0.0, 2.0, 1.0, 0.0)
    assert ook.sipm.pde_at(470.0) == pytest.approx(0.265)
    assert ook.sipm.count_rate(1.0, 470e-9) == pytest.approx(
        0.265 * 470e-9 / constants.h / 3e8, 1e-2
    )
    assert Scenario.from_toml(scenario.to_toml()) == scenario
    table = Scenario.from_toml(
        "[detector.optics]\nfilter_transmission = {wavelength_nm = [460, 480], value = [0.9, 0.9]}"
    )
    assert table.detector.filter_share == pytest.approx(0.9)
    assert Scenario.from_toml(table.to_toml()) == table


@pytest.mark.parametrize(
    ("key", "value", "text"),
    [
        ("detector.led.width_nm", -1.0, "detector.led.width_nm: -1.0, allowed: >= 0"),
        ("detector.led.spectrum", {"file": "no.csv"}, "no.csv: no such file"),
        ("detector.sipm.pde", 1.5, "detector.sipm.pde: 1.5, allowed: 0 < pde <= 1, or a table"),
        (
            "detector.sipm.pde",
            {"wavelength_nm": [500.0, 400.0], "value": [0.1, 0.2]},
            "detector.sipm.pde.wavelength_nm: 2 wavelengths, allowed: two or more, rising",
        ),
        (
            "detector.optics.filter_transmission",
            {"wavelength_nm": [400.0, 500.0], "value": [0.1, 2.0]},
            "detector.optics.filter_transmission.value: 2.0, allowed: shares 0 ... 1",
        ),
        ("detector.optics.filter_index", 0.5, "filter_index: 0.5, allowed: 1 <= filter_index <= 4"),
        ("detector.optics.filter_center_nm", 1.0, "filter_center_nm: 1.0, allowed: 100 <= "),
    ],
)
def test_one_clear_text_for_a_refused_value(key, value, text):
    with pytest.raises(Refused) as error:
        Scenario.from_toml("", changes={key: value})
    assert text in str(error.value)
    assert "\n" not in str(error.value)


def test_what_excludes_each_other_is_refused():
    with pytest.raises(Refused, match=r"width_nm: 5.0, allowed: 0 beside spectrum"):
        LedDriver(width_nm=5.0, spectrum=TABLE)
    with pytest.raises(Refused, match=r"filter_center_nm: 470.0, allowed: none beside a table"):
        OpticalFrontEnd(filter_center_nm=470.0, filter_transmission=TABLE)
    with pytest.raises(Refused, match="pde: no efficiency at 700 nm"):
        SiPM(pde=EFFICIENCY).count_rate(1.0, 700e-9)
    dark = Curve(wavelength_nm=(600.0, 700.0), value=(1.0, 1.0))
    with pytest.raises(Refused, match=r"gain_spectrum: 470.0, allowed: light at the signal"):
        OokLink(gain_spectrum=dark, led=LedDriver(width_nm=5.0)).received_power(1.0)
