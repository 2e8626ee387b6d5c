"""The best wavelength of a link against closed forms."""

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.comms.budget import required_gain
from meshtrace.optics import Constituents
from meshtrace.surfaces import FlatSea

AT = np.arange(400.0, 601.0, 10.0)
WATER = mt.Water(spectrum=Constituents(chlorophyll=0.1), wavelength_nm=470.0)
COEFFICIENTS = WATER.spectra(AT)
LEAST = {name: AT[COEFFICIENTS[name].to_numpy().argmin()] for name in "ac"}


def gains(depth, radius, fov_deg):
    link = mt.Link(water=WATER, receiver=mt.Receiver(radius=radius, fov_deg=fov_deg))
    return mt.simulate(link.at_depth(depth), FlatSea(), photons=2048, wavelengths_nm=AT)


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore:.*effective sample size:meshtrace.FewSamplesWarning")
def test_unscattered_light_is_best_where_attenuation_is_least():
    """Between two depths it falls by exp(-c d), up to the change of the refracted cone with n."""
    near, far = (gains(d, 0.05, 1.0)["gain_ballistic"].to_numpy()[:, 0] for d in (20.0, 40.0))
    assert AT[far.argmax()] == LEAST["c"] == 490.0
    assert np.ptp(np.log(far / near) + 20.0 * COEFFICIENTS.c.to_numpy()) < 3e-3


def test_a_wide_view_is_best_between_least_absorption_and_least_attenuation():
    found = gains(40.0, 0.5, 120.0)
    unscattered = AT[found["gain_ballistic"].to_numpy()[:, 0].argmax()]
    assert LEAST["a"] <= found.brightest < unscattered == LEAST["c"]


@pytest.mark.parametrize("rate", [1e11, 1e12])
def test_the_light_needed_by_day_follows_photon_noise(rate):
    """Signal counts P lambda stand against noise (L lambda)^(1/2): P ~ (L / lambda)^(1/2)."""
    needed = []
    for nm in (450.0, 550.0):
        ook = mt.OokLink.of_link(mt.Link(water=WATER).at_wavelength(nm), bit_rate=1e6)
        lit = ook.replace(saturation=False, background_rate=rate * nm / 450.0)
        needed.append(required_gain(lit, 1e-3))
    assert needed[1] / needed[0] == pytest.approx((450.0 / 550.0) ** 0.5, rel=1e-3)
