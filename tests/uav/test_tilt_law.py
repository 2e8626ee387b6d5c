"""Laws of the tilt angle and of h_alpha against closed forms, brute force and the tables."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import kstest

from meshtrace.uav import Dryden, Uav, compare_laws, h_alpha, squared_wind_moments

REFERENCE = json.loads((Path(__file__).parents[1] / "data" / "link_reference.json").read_text())
CASES = [
    pytest.param(preset, speed, REFERENCE["uav"][f"{key}_U{speed}"], id=f"{key}-{speed}")
    for key, preset in (("paper", "paper"), ("mil", "physical"))
    for speed in (5, 13)
]
FOV = math.radians(60.0)


def laws(preset: str, speed: float):
    wind = Dryden.preset(preset, wind_speed=speed, height=5.0)
    return tuple(Uav().tilt_law(wind, law) for law in ("exact", "gamma"))


@pytest.mark.parametrize(("preset", "speed", "expected"), CASES)
def test_moments_match_reference(preset, speed, expected):
    wind = Dryden.preset(preset, wind_speed=speed, height=5.0)
    mean, variance = squared_wind_moments(wind.mean_wind, wind.std)
    exact, gamma = laws(preset, speed)
    assert mean == pytest.approx(expected["E_V2"], rel=1e-12)
    assert variance == pytest.approx(expected["Var_V2"], rel=1e-12)
    assert gamma.shape == pytest.approx(expected["alpha_Gamma"], rel=1e-12)
    assert gamma.scale == pytest.approx(expected["beta_Gamma"], rel=1e-12)
    for law, name in ((exact, "exact"), (gamma, "gamma")):
        assert math.degrees(law.mean()) == pytest.approx(
            expected[f"alpha_mean_deg_{name}"], abs=1e-8
        )
        assert math.degrees(law.std()) == pytest.approx(expected[f"alpha_std_deg_{name}"], abs=1e-8)


@pytest.mark.parametrize(("preset", "speed", "expected"), CASES)
def test_densities_integrate_to_one(preset, speed, expected):
    peak = math.radians(expected["alpha_mean_deg_exact"])
    for law in laws(preset, speed):
        cuts = [0.5 * peak, peak, 1.5 * peak, 2.0 * peak]
        total = quad(
            lambda a, law=law: float(law.pdf(a)), 0.0, 1.5, points=cuts, epsabs=1e-11, limit=200
        )[0]
        assert total == pytest.approx(1.0, abs=1e-8)
        # In y = arccos(h) the endpoint singularity at h = 1 is regular.
        over_h = quad(
            lambda a, law=law: float(law.h_pdf(math.cos(a))) * math.sin(a),
            1e-6,
            1.5,
            points=cuts,
            epsabs=1e-11,
            limit=200,
        )[0]
        assert over_h == pytest.approx(1.0, abs=1e-8)


@pytest.mark.parametrize(
    ("preset", "speed", "at_deg", "per_deg", "h_density"),
    [
        ("paper", 5, 2.0, 0.755827, 1240.87),
        ("paper", 13, 15.0, 0.132160, 29.2567),
        ("physical", 5, 2.0, 0.488504, 801.995),
        ("physical", 13, 16.0, 0.0743662, 15.4582),
    ],
)
def test_gamma_densities_match_table(preset, speed, at_deg, per_deg, h_density):
    gamma = laws(preset, speed)[1]
    at = math.radians(at_deg)
    assert float(gamma.pdf(at)) * math.pi / 180.0 == pytest.approx(per_deg, rel=2e-6)
    assert float(gamma.h_pdf(math.cos(at))) == pytest.approx(h_density, rel=5e-6)


@pytest.mark.parametrize(
    ("preset", "speed", "mean_h", "beyond"),
    [
        ("paper", 5, 0.999150, 1.5e-108),
        ("paper", 13, 0.963577, 1.62e-5),
        ("physical", 5, 0.998992, 3.5e-38),
        ("physical", 13, 0.958029, 8.83e-3),
    ],
)
def test_gamma_h_alpha_and_outage_match_table(preset, speed, mean_h, beyond):
    gamma = laws(preset, speed)[1]
    assert gamma.h_moment() == pytest.approx(mean_h, abs=1e-6)
    assert gamma.outage(FOV) == pytest.approx(beyond, rel=0.02)


@pytest.mark.parametrize("speed", [5, 13])
@pytest.mark.parametrize(("preset", "key"), [("paper", "paper"), ("physical", "mil")])
def test_goodness_of_fit_does_not_depend_on_the_wind(preset, key, speed):
    distance = compare_laws(*laws(preset, speed))
    expected = REFERENCE["gof_deterministic"]
    assert distance.ks == pytest.approx(expected[f"{key}_KS"], abs=1e-7)
    assert distance.kl == pytest.approx(expected[f"{key}_KL_nat"], abs=1e-9)


def test_density_errors_match_table():
    for speed, rmse, mae in ((5, 9.17e-3, 6.37e-3), (13, 1.48e-3, 1.05e-3)):
        distance = compare_laws(*laws("paper", speed))
        assert distance.rmse == pytest.approx(rmse, rel=1e-3)
        assert distance.mae == pytest.approx(mae, rel=1e-3)


@pytest.mark.parametrize("preset", ["paper", "physical"])
def test_exact_cdf_against_the_characteristic_function(preset):
    """Gil-Pelaez inversion of prod (1 - 2 i s^2 t)^-1/2 exp(i u^2 t / (1 - 2 i s^2 t))."""
    wind = Dryden.preset(preset, wind_speed=13.0, height=5.0)
    exact = laws(preset, 13)[0]
    step = 2.0 * math.pi / 1500.0
    t = (np.arange(40_000) + 0.5) * step
    phi = np.ones_like(t, dtype=complex)
    for u, s in zip(wind.mean_wind, wind.std, strict=True):
        pole = 1.0 - 2.0j * s * s * t
        phi *= np.exp(1j * u * u * t / pole) / np.sqrt(pole)
    v2 = np.array([60.0, 120.0, 180.0, 260.0, 400.0])
    inverse = (
        0.5 - np.sum(np.imag(phi * np.exp(-1j * np.outer(v2, t))) / t, axis=1) * step / math.pi
    )
    assert exact.squared_wind_cdf(v2) == pytest.approx(inverse, abs=1e-8)
    assert exact.squared_wind_cdf(v2) + exact.squared_wind_sf(v2) == pytest.approx(1.0, abs=1e-12)


def test_exact_tail_is_relatively_accurate():
    """Far out, where 1 - cdf has no digits left, sf is the integral of the density."""
    exact = laws("physical", 5)[0]
    tail, _ = quad(lambda v: float(exact.squared_wind_pdf(v)), 180.0, 450.0, epsrel=1e-10)
    assert exact.squared_wind_sf(180.0) < 1e-15
    assert exact.squared_wind_sf(180.0) == pytest.approx(tail, rel=1e-6)


@pytest.mark.slow
def test_simulated_tilts_follow_the_exact_law_and_not_the_gamma_law():
    """KS at alpha 1e-4; one sample a minute is independent (correlation below 5e-4)."""
    wind = Dryden(wind_speed=5.0, height=5.0)
    exact, gamma = laws("physical", 5)
    tilt = Uav().tilt(wind.simulate_wind(np.arange(100_000) * 60.0, seed=4)).angle
    assert kstest(tilt, exact.cdf).pvalue > 1e-4
    assert kstest(tilt, gamma.cdf).pvalue < 1e-4


def test_gamma_law_of_the_paper_is_close_in_a_sample():
    wind = Dryden.preset("paper", wind_speed=5.0)
    tilt = Uav().tilt(wind.sample_wind(100_000, seed=8)).angle
    assert kstest(tilt, laws("paper", 5)[1].cdf).statistic < 0.012


def test_thinned_record_follows_the_exact_law():
    """A record at 10 Hz, thinned to one sample in 50 s, at alpha 1e-4."""
    wind = Dryden.preset("paper", wind_speed=13.0)
    tilt = Uav().tilt(wind.simulate_wind(np.arange(1_000_000) * 0.1, seed=21))
    thinned = tilt.angle[::500]
    assert kstest(thinned, laws("paper", 13)[0].cdf).pvalue > 1e-4


def test_ppf_inverts_cdf():
    for law in laws("physical", 13):
        for probability in (1e-6, 0.3, 0.999):
            assert float(law.cdf(law.ppf(probability))) == pytest.approx(probability, rel=1e-9)


@pytest.mark.parametrize("index", [0, 1])
def test_h_alpha_has_its_atom_in_the_field_of_view(index):
    law = laws("physical", 13)[index]
    edge = math.cos(0.5 * FOV)
    assert float(law.h_cdf(0.0, FOV)) == pytest.approx(law.outage(FOV), rel=1e-9)
    assert float(law.h_cdf(0.5 * edge, FOV)) == pytest.approx(law.outage(FOV), rel=1e-9)
    assert float(law.h_cdf(1.0, FOV)) == 1.0
    assert float(law.h_pdf(0.99 * edge, FOV)) == 0.0
    assert float(law.h_pdf(1.01 * edge, FOV)) > 0.0
    inside = quad(lambda h: float(law.h_pdf(h, FOV)), edge, 1.0 - 1e-13, limit=400)[0]
    assert inside + law.outage(FOV) == pytest.approx(1.0, abs=1e-6)
    mean = quad(lambda h: h * float(law.h_pdf(h, FOV)), edge, 1.0 - 1e-13, limit=400)[0]
    assert law.h_moment(1, FOV) == pytest.approx(mean, abs=1e-6)
    assert law.outage(math.pi) == 0.0


def test_h_alpha_samples_agree_with_their_law():
    wind = Dryden(wind_speed=13.0)
    law = laws("physical", 13)[0]
    h = h_alpha(Uav().tilt(wind.sample_wind(200_000, seed=9)).angle, FOV)
    for order in (1, 2):
        error = h.size**-0.5 * np.std(h**order)
        assert abs(np.mean(h**order) - law.h_moment(order, FOV)) < 4.0 * error
    assert np.mean(h == 0.0) == pytest.approx(law.outage(FOV), abs=4.0 * math.sqrt(0.007 / h.size))


def test_printed_density_is_off_by_a_power_of_k():
    """Eq. final_f_h_alpha has 1/K where 1/K^a belongs: it integrates to K^(a-1) = 10^-61.26."""
    gamma = laws("paper", 5)[1]
    h = np.cos(np.radians([1.5, 2.0, 3.0]))
    log_ratio = np.log10(gamma.h_pdf_printed(h) / gamma.h_pdf(h))
    defect = (gamma.shape - 1.0) * math.log10(gamma.tilt_coefficient)
    assert log_ratio == pytest.approx(defect, abs=1e-9)
    assert defect == pytest.approx(-61.26, abs=5e-3)


def test_field_of_view_is_the_full_angle():
    tilt = np.radians([0.0, 29.9, 30.1, 59.0])
    assert h_alpha(tilt, FOV) == pytest.approx([1.0, math.cos(tilt[1]), 0.0, 0.0])
    for fov in (0.0, -1.0, 3.2, math.nan):
        with pytest.raises(ValueError, match="fov: "):
            h_alpha(0.1, fov)
