"""Receiver models as objects, a user's own model, and the fields that an OokLink shares with a link."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import pytest
from scipy.special import ndtr

import meshtrace as mt
from meshtrace.comms import Decision, OokLink, OpticalFrontEnd, ReceiverModel, SiPM
from meshtrace.errors import Refused


class FixedThreshold(ReceiverModel):
    """Threshold at a fixed share of the swing; shot noise in half the bit rate."""

    kind: Literal["test-fixed"] = "test-fixed"
    share: float = 0.5

    def decide(self, link, power):
        mean, variance = self.moments(link, power)
        threshold = mean[:, 0] + self.share * (mean[:, 1] - mean[:, 0])
        distance = np.abs(mean - threshold[:, None]) / np.sqrt(variance)
        return Decision(ndtr(-distance).mean(axis=1), threshold)


def test_built_in_kinds_are_known():
    assert {"W", "A", "CP", "PC", "G0", "GP"} <= set(ReceiverModel.registered)
    with pytest.raises(ValueError, match=r"model.*'X', allowed: .*W"):
        OokLink(model="X")


def test_own_model_decides():
    link = OokLink(model=FixedThreshold(share=0.3), bit_rate=1e6)
    power = 2e-11
    low, high = (float(level) for level in link.levels(power))
    thermal = link.tia.thermal_noise(link.sipm.electrons_per_count)
    f = link.sipm.excess_noise_factor
    deviation = [math.sqrt((2.0 * f * m + thermal) * 0.5e6) for m in (low, high)]
    swing = high - low
    expected = 0.5 * (ndtr(-0.3 * swing / deviation[0]) + ndtr(-0.7 * swing / deviation[1]))
    assert float(link.ber(power)) == pytest.approx(expected, rel=1e-12)
    assert link.threshold(power) == pytest.approx(low + 0.3 * swing, rel=1e-12)
    # the best threshold of the same levels and noise is better than any fixed one
    assert float(OokLink(model="G0", bit_rate=1e6).ber(power)) < expected
    assert float(link.ber(link.required_power(1e-3))) == pytest.approx(1e-3, rel=1e-6)


def test_own_model_goes_to_plain_data_and_back():
    link = OokLink(model=FixedThreshold(share=0.3))
    assert link.model_dump(mode="json")["model"] == {"kind": "test-fixed", "share": 0.3}
    assert OokLink.model_validate(link.model_dump(mode="json")) == link
    named = OokLink(model="test-fixed")
    assert named.model == "test-fixed"
    assert OokLink(model=FixedThreshold()) == named
    assert named.receiver == FixedThreshold()


def test_own_model_has_no_eye():
    with pytest.raises(Refused, match="model: 'test-fixed', allowed: a model with pulses"):
        OokLink(model="test-fixed").eye(1e-11)


def test_concentration_falls_with_the_index_of_the_medium():
    # etendue n^2 A sin^2(theta): light from water fills n_water^2 as much of it
    area = SiPM().area
    air, water = OpticalFrontEnd(), OpticalFrontEnd(medium_index=1.34)
    efficiency = water.concentration_efficiency(area)
    etendue_in = math.pi * 1.34**2 * math.pi * 0.05**2 * math.sin(math.radians(30.0)) ** 2
    etendue_out = math.pi * 1.5**2 * area
    assert efficiency == pytest.approx(etendue_out / etendue_in, rel=1e-12)
    assert air.concentration_efficiency(area) / efficiency == pytest.approx(1.34**2, rel=1e-12)
    # the radiance on the detector never exceeds n^2 / n_water^2 times that of the water
    power = water.background_power(1e-7, area) / water.filter_width_nm
    assert power <= 1e-7 * (1.5 / 1.34) ** 2 * math.pi * area * (1.0 + 1e-12)


def test_aperture_under_water_stands_in_water():
    link = mt.Link(receiver=mt.WaterAperture(fov_deg=60.0))
    assert OokLink.of_link(link).optics.medium_index == link.water.n
    assert OokLink.of_link(mt.Link()).optics.medium_index == 1.0
    two = mt.Link(receiver=(mt.Receiver(), mt.Receiver(position=(1.0, 0.0))))
    with pytest.raises(Refused, match=r"receiver: .*allowed: one aperture"):
        OokLink.of_link(two)


def test_powers_of_several_wavelengths_do_not_add():
    lamps = mt.Led(wavelength_nm=470.0), mt.Led(wavelength_nm=650.0)
    with pytest.raises(Refused, match="wavelength_nm: 470 nm and 650 nm, allowed: one wavelength"):
        OokLink.of_link(mt.Link(transmitter=lamps))
    assert OokLink.of_link(mt.Link(transmitter=lamps[:1] * 2)).led.power == pytest.approx(0.2)
