"""SiPM, amplifier, LED and optics against the reference table and closed forms."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from meshtrace.comms import LedDriver, OokLink, OpticalFrontEnd, SiPM, Tia
from meshtrace.comms.devices import photon_energy

NEP = json.loads((Path(__file__).parents[1] / "data" / "link_reference.json").read_text())["nep"]
BLUE = 470e-9
RATES = (1e6, 5e6, 1e7)


def test_photon_energy_and_excess_noise():
    assert photon_energy(BLUE) == pytest.approx(NEP["E_ph_J"], rel=1e-12)
    assert SiPM().excess_noise_factor == pytest.approx(NEP["F_e"], rel=1e-14)
    assert SiPM().branching == pytest.approx(0.033039854, rel=1e-7)


@pytest.mark.parametrize(("pde", "key"), [(0.3, "pde30"), (0.4, "pde40")])
def test_printed_nep_and_noise_power(pde, key):
    sipm = SiPM(pde=pde)
    assert sipm.nep_paper(BLUE) == pytest.approx(NEP[f"NEP_{key}"], rel=1e-12)
    powers = [sipm.noise_power_paper(BLUE, 0.5 * rate) for rate in RATES]
    assert powers == pytest.approx(NEP[f"Pn_{key}"], rel=1e-12)


def test_noise_has_the_digits_of_the_print():
    sipm = SiPM(pde=0.4)
    assert sipm.nep_paper(BLUE) == pytest.approx(3.42e-15, abs=5e-18)
    found = [sipm.noise_power_paper(BLUE, 0.5 * rate) for rate in (1e6, 5e6, 1e7)]
    assert found == pytest.approx([2.42e-12, 5.41e-12, 7.65e-12], abs=5e-15)


def test_p_min_makes_the_snr_one():
    sipm = SiPM()
    found = [sipm.p_min(BLUE, 0.5 * rate) for rate in RATES]
    assert found == pytest.approx([1.95219e-12, 7.89695e-12, 1.52055e-11], rel=1e-5)
    for rate, power in zip(RATES, found, strict=True):
        counts = float(sipm.count_rate(power, BLUE))
        noise = sipm.excess_noise_factor * rate * (counts + sipm.dark_count_rate)
        assert counts / math.sqrt(noise) == pytest.approx(1.0, rel=1e-12)


def test_printed_snr_is_an_optical_ratio():
    """28.64 dB at 47 m is 10 log10 of optical powers over P_n, without refraction."""
    order = -math.log(2.0) / math.log(math.cos(math.radians(10.0)))
    gain = 0.5 * (order + 1.0) * (0.05 / 52.0) ** 2 * math.exp(-0.151 * 47.0)
    assert gain == pytest.approx(1.770460475487946e-8, rel=1e-12)
    assert 10.0 * math.log10(0.1 * gain / 2.42e-12) == pytest.approx(28.6427, abs=1e-3)


def test_thermal_noise_in_count_units():
    assert Tia().thermal_noise(1e6) == pytest.approx(6.454220e2, rel=1e-6)


def test_saturation_and_flash():
    sipm = SiPM()
    assert sipm.saturated_rate(1e3) == pytest.approx(1e3, rel=1e-8)
    assert sipm.saturated_rate(1e20) == pytest.approx(sipm.n_spads / sipm.recovery_time, rel=1e-6)
    assert SiPM(recovery_time=0.0).saturated_rate(1e15) == 1e15
    assert sipm.fired_cells(10.0) == pytest.approx(3.0, rel=1e-3)
    assert sipm.fired_cells(1e9) == pytest.approx(sipm.n_spads)
    assert sipm.bias_current(1e30) == pytest.approx(0.16, abs=0.01)


def test_led_levels():
    low, high = LedDriver().levels(1.0)
    assert 0.5 * (low + high) == pytest.approx(1.0)
    assert low / high == pytest.approx(0.1)
    peak = LedDriver(power_is_peak=True)
    assert peak.levels(np.array([1.0, 2.0]))[1] == pytest.approx([1.0, 2.0])
    average = 0.5 * sum(peak.levels(1.0))
    assert 10.0 * math.log10(average) == pytest.approx(-2.6, abs=0.01)


def test_etendue_limit():
    area = SiPM().area
    assert 1.0 / OpticalFrontEnd().efficiency(area) == pytest.approx(92.541, abs=1e-3)
    assert 10.0 * math.log10(OpticalFrontEnd().efficiency(area)) == pytest.approx(-19.663, abs=1e-3)
    assert OpticalFrontEnd(etendue_limited=False).efficiency(area) == 1.0
    narrow = OpticalFrontEnd(fov_deg=2.0 * 2.97)
    assert narrow.concentration_efficiency(area) == 1.0
    assert OpticalFrontEnd(fov_deg=2.0 * 2.99).concentration_efficiency(area) < 1.0
    assert OpticalFrontEnd(filter_transmission=0.5).efficiency(area) * 2.0 == pytest.approx(
        OpticalFrontEnd().efficiency(area)
    )


def test_background_light_fills_the_etendue():
    sipm = SiPM()
    moon = OpticalFrontEnd().background_power(8.6e-8, sipm.area)
    assert moon == pytest.approx(8.6e-8 * 10.0 * math.pi * sipm.area * 1.5**2, rel=1e-12)
    assert float(sipm.count_rate(moon, BLUE)) == pytest.approx(4e7, rel=0.03)
    open_lens = OpticalFrontEnd(etendue_limited=False).background_power(8.6e-8, sipm.area)
    etendue = math.pi * math.pi * 0.05**2 * math.sin(math.radians(30.0)) ** 2
    assert open_lens == pytest.approx(8.6e-7 * etendue, rel=1e-12)
    with pytest.raises(ValueError, match="radiance_per_nm: -1"):
        OpticalFrontEnd().background_power(-1.0, sipm.area)


@pytest.mark.parametrize(
    ("model", "fields"),
    [
        (SiPM, {"pde": 1.1}),
        (SiPM, {"n_spads": 0}),
        (SiPM, {"area": math.nan}),
        (Tia, {"resistance": 0.0}),
        (LedDriver, {"extinction_ratio": 1.0}),
        (LedDriver, {"wavelength": 470.0}),
        (OpticalFrontEnd, {"fov_deg": 181.0}),
        (OpticalFrontEnd, {"mirror": 1}),
    ],
)
def test_bad_fields_are_refused(model, fields):
    with pytest.raises(ValueError, match=next(iter(fields))):
        model(**fields)


@pytest.mark.parametrize("call", [lambda: photon_energy(470.0), lambda: SiPM().p_min(BLUE, 0.0)])
def test_bad_arguments_are_refused(call):
    with pytest.raises(ValueError, match="allowed"):
        call()


@pytest.mark.parametrize("model", [SiPM(pde=0.4), Tia(), LedDriver(power=0.2), OpticalFrontEnd()])
def test_round_trip(model):
    assert type(model).model_validate_json(model.model_dump_json()) == model


def test_thermal_noise_is_that_of_the_current_of_a_count():
    """Johnson noise 4 k T / R of the amplifier, over the mean current of a primary count."""
    sipm = SiPM(p_crosstalk=0.2)
    current = float(sipm.bias_current(1.0))
    cold, warm = (
        OokLink(model="G0", sipm=sipm, tia=Tia(temperature=t), bit_rate=2e6) for t in (200.0, 300.0)
    )
    change = warm.receiver.moments(warm, 1e-10)[1] - cold.receiver.moments(cold, 1e-10)[1]
    johnson = 4.0 * 1.380649e-23 * 100.0 / warm.tia.resistance
    assert change == pytest.approx(johnson / current**2 * 1e6, rel=1e-5)
