"""Background light at the receiver: noise of saturated cells, filters, ranges of the reference."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.comms import SiPM
from meshtrace.comms.background import (
    filter_shift_nm,
    occupancy,
    warn_of_background,
    widest_filter_nm,
    with_background,
)
from meshtrace.comms.capacity import capacity
from meshtrace.errors import Refused

REFERENCE = json.loads(
    (Path(__file__).parents[1] / "data/daylight_downlink_reference.json").read_text()
)

# unscattered and scattered gain over flat water of the default link, by field of view and depth:
# simulate(Link(...), FlatSea(), photons=4096)
DEPTHS = (5.0, 7.0, 9.0, 12.0, 15.0, 18.0, 21.0, 25.0, 29.0, 33.0, 38.0, 43.0, 48.0, 53.0, 58.0)
GAINS = {
    60.0: (
        2.24864e-04,
        1.28223e-04,
        7.64459e-05,
        3.73230e-05,
        1.91934e-05,
        1.02956e-05,
        5.69360e-06,
        2.67061e-06,
        1.29558e-06,
        6.43070e-07,
        2.75869e-07,
        1.21659e-07,
        5.46681e-08,
        2.50540e-08,
        1.15764e-08,
    ),
    20.0: (
        2.24725e-04,
        1.27861e-04,
        7.60077e-05,
        3.68730e-05,
        1.88305e-05,
        1.00296e-05,
        5.49735e-06,
        2.55697e-06,
        1.22675e-06,
        6.04134e-07,
        2.55466e-07,
        1.10965e-07,
        4.93308e-08,
        2.22072e-08,
        1.01899e-08,
    ),
    5.967: (
        2.21603e-04,
        1.24691e-04,
        7.33766e-05,
        3.49509e-05,
        1.74970e-05,
        9.10559e-06,
        4.90074e-06,
        2.21512e-06,
        1.03494e-06,
        4.96420e-07,
        2.02702e-07,
        8.55896e-08,
        3.67612e-08,
        1.59932e-08,
        7.07552e-09,
    ),
}


def seen_light(radiance):
    """Return a background of given radiance."""
    parts = np.array([radiance, 0.0, 0.0, 0.0, 0.0])
    return mt.Background(parts, 0.0 * parts, radiance, 0.0, 1e-3, 470.0)


def transmission(fov_deg, width_nm=10.0, **fields):
    link = mt.Link(receiver=mt.Receiver(fov_deg=fov_deg))
    ook = mt.OokLink.of_link(link).replace(**fields)
    return ook.replace("optics.filter_width_nm", width_nm)


@pytest.mark.parametrize("angle", ["30", "10", "2.9836"])
def test_shift_of_the_filter(angle):
    found = filter_shift_nm(470.0, float(angle))
    assert found == pytest.approx(REFERENCE["filter_shift_nm_neff2"][angle], rel=2e-4)
    # exact law: sin(theta) = n sin(theta') in the layer, whose path goes with cos(theta')
    inside = math.asin(math.sin(math.radians(float(angle))) / 2.0)
    assert found == pytest.approx(470.0 * (1.0 - math.cos(inside)))


@pytest.mark.parametrize("x", [0.3, 1.0, 4.0])
def test_fano_factor_by_simulation_of_dead_time(x):
    # one cell of dead time 1, Poisson light of rate x: intervals are 1 + exponential
    rng = np.random.default_rng(5)
    window, cells = 600.0, 60_000

    def counted(n):
        arrivals = np.cumsum(1.0 + rng.exponential(1.0 / x, (n, int(window) + 1)), axis=1)
        return (arrivals < window).sum(axis=1)

    counts = np.concatenate([counted(5000) for _ in range(cells // 5000)])
    wanted = float(SiPM(recovery_time=1.0, n_spads=1).fano_factor(x))
    i = REFERENCE["dead_time_fano"]["x"].index(x)
    assert wanted == pytest.approx(REFERENCE["dead_time_fano"]["value"][i], rel=1e-6)
    # standard error of the variance of 60 000 windows: 0.6 %
    assert counts.var() / counts.mean() == pytest.approx(wanted, rel=0.02)


RANGES = [
    ("dark", 0.0, 10.0, 60.0, "poisson", (55.37, 42.63, 31.60)),
    ("moon_10nm_60", 2.5e-6 * 0.0171, 10.0, 60.0, "poisson", (50.81, 41.22, 31.38)),
    ("day_2nm_20", 0.013041, 2.0, 20.0, "poisson", (25.19, 19.76, 15.24)),
    ("day_0.5nm_5.967", 0.012058, 0.5, 5.967, "poisson", (46.71, 40.65, 35.53)),
    ("", 0.0171, 10.0, 60.0, "poisson", (math.nan, math.nan, math.nan)),
    ("", 0.0171, 10.0, 60.0, "auto", (11.1, 7.0, math.nan)),
    ("", 0.012058, 0.5, 5.967, "renewal", (48.3, 42.2, 37.2)),
]


@pytest.mark.parametrize(("name", "radiance", "width", "fov", "noise", "wanted"), RANGES)
@pytest.mark.thorough
@pytest.mark.slow_but(
    "dark-0.0-10.0-60.0-poisson-wanted0",
    "day_2nm_20-0.013041-2.0-20.0-poisson-wanted2",
    "-0.012058-0.5-5.967-renewal-wanted6",
)
def test_ranges_of_the_reference(name, radiance, width, fov, noise, wanted):
    from meshtrace.studies.performance import _range

    if name:
        assert wanted == pytest.approx(REFERENCE["ranges_m_ber1e-3"][name], abs=1e-9)
    for rate, far in zip((1e6, 5e6, 1e7), wanted, strict=True):
        ook = transmission(fov, width, bit_rate=rate, saturation_noise=noise)
        ook = with_background(ook, seen_light(radiance))
        found = _range(DEPTHS, ook.ber(ook.received_power(np.array(GAINS[fov]))), 1e-3)
        assert found == pytest.approx(far, abs=0.5, nan_ok=True)


def test_renewal_noise_needs_background_light_and_a_gaussian_model():
    dark = transmission(60.0)
    lit = with_background(dark, seen_light(0.0171))
    assert (dark.renewal_noise, lit.renewal_noise) == (False, True)
    assert not lit.replace(saturation=False).renewal_noise
    assert not lit.replace(model="GP").renewal_noise
    with pytest.raises(Refused, match="saturation_noise: 'renewal'"):
        lit.replace(model="CP", saturation_noise="renewal")


@pytest.mark.parametrize("model", ["W", "A", "PC", "G0"])
def test_renewal_noise_quiets_the_shot_noise_by_the_fano_factor(model):
    quiet = transmission(60.0, model=model, background_rate=3e12, window=None)
    quiet = quiet.replace("tia.temperature", 1e-6)  # shot noise alone
    loud = quiet.replace(saturation_noise="poisson")
    power = 1e-15  # levels of zero and one are equal
    (mean, variance), (same, more) = (ook.moments(power) for ook in (quiet, loud))
    np.testing.assert_allclose(mean, same)
    x = occupancy(quiet)
    window = quiet.averaging_window == loud.averaging_window
    assert window
    np.testing.assert_allclose(variance / more, 1.0 / (1.0 + x) ** 2, rtol=1e-4)


def test_occupancy_of_the_design():
    assert occupancy(with_background(transmission(60.0), seen_light(0.0171))) == pytest.approx(
        8.4, abs=0.05
    )


def test_counts_behind_the_etendue_limit_do_not_depend_on_the_field_of_view():
    wide, narrow = (seen_light(0.01).count_rate(transmission(fov)) for fov in (60.0, 20.0))
    assert wide == pytest.approx(narrow)


def test_widest_filter_brings_the_limit():
    dark, seen, power = transmission(20.0, 2.0), seen_light(0.013), 4e-8
    width = widest_filter_nm(dark, seen, power, 1e-3)
    fixed = dark.replace("optics.filter_width_nm", width).replace(window=dark.averaging_window)
    assert float(with_background(fixed, seen).ber(power)) == pytest.approx(1e-3, rel=1e-2)
    assert widest_filter_nm(dark, seen, 1e-13, 1e-3) == 0.0
    assert widest_filter_nm(dark, seen_light(1e-12), power, 1e-3) == math.inf


def test_warnings_of_shifted_filters_and_large_currents():
    ook = transmission(60.0)
    with pytest.warns(mt.DaylightWarning, match=r"shift .* 14\.9 nm"):
        warn_of_background(ook, seen_light(1e-9))
    bright = with_background(transmission(5.967, 10.0), seen_light(0.0171))
    with pytest.warns(mt.DaylightWarning, match="mA of bias current"):
        warn_of_background(bright, seen_light(0.0171))


@pytest.mark.parametrize("distance", [0.5, 2.0, 6.0])
def test_decisions_by_huge_counts(distance):
    from scipy.stats import norm

    from meshtrace.comms.decisions import generalized_poisson_decision, soft_information

    below, above, far = (
        (n, n + distance * math.sqrt(n / 0.9), 0.1) for n in (0.9999e9, 1.0001e9, 1e20)
    )  # exact counts below 1e9, their normal law above
    exact = float(generalized_poisson_decision(*below).ber)
    for ends in (above, far):
        assert float(generalized_poisson_decision(*ends).ber) == pytest.approx(exact, rel=5e-4)
        assert soft_information(*ends) == pytest.approx(soft_information(*below), rel=1e-4)
    assert exact == pytest.approx(norm.sf(0.5 * distance), rel=1e-3)


def test_soft_rates_bound_hard_ones_under_background():
    lit = with_background(transmission(20.0, 2.0), seen_light(0.013))
    gains = np.array([3e-6, 1e-5])
    found = capacity(lit, gains)
    assert 0.0 < found.hard <= found.soft <= lit.bit_rate
