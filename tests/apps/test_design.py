"""Designs of links: scans by brute force, budgets that add up, links that do not close."""

import math
import re
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from mc_statistics import ALPHA, z_test
from scipy.special import ndtr
from scipy.stats import binom

import meshtrace as mt
from meshtrace.apps.designs import spots, study
from meshtrace.apps.designs.lenses import diversity_gain
from meshtrace.apps.designs.model import LinkModel, MeanGains, log_quantile
from meshtrace.apps.designs.page import BestValue
from meshtrace.errors import Refused
from meshtrace.fading import gamma_gamma
from meshtrace.fading.laws import probability_in_log
from meshtrace.studies.campaign import campaign_of
from meshtrace.studies.neighbours import DECIBELS, error_of, without_each
from meshtrace.surfaces import resolved_sea
from meshtrace.uav import TiltFactors

pytestmark = pytest.mark.filterwarnings(
    "ignore::meshtrace.DaylightWarning",
    "ignore::meshtrace.DomainWarning",
    "ignore::meshtrace.FewSamplesWarning",
)
CALM = "wind_speed = 0.0\n[daylight]\ndirect = 1.42\ndiffuse = 0.295\n[receiver]\nfov_deg = 30.0\n"
WIDTH = "detector.optics.filter_width_nm"
FEW = {"photons": 128, "realizations": 8}
SOME = {**FEW, "photons": 256}
GRID = np.geomspace(1e-3, 10.0, 4001)


@cache
def performance(text, **changes):
    """Return the mean margin of a run of its own by day [dB]; over still water the reserve."""
    changes = {key.replace("__", "."): value for key, value in changes.items()}
    changes.setdefault("detector.preset", "physical")
    at = mt.Scenario.from_toml(text, changes=changes)
    return mt.link_performance(at, photons=1024, realizations=2).at().margin_optical_db.value


@pytest.fixture
def calm(calm_design):
    return calm_design


def test_lines_of_the_budget_add_up(calm):
    for light in ("night", "day"):
        total = 0.0
        for line in calm.budget:
            value = getattr(line, light)
            if line.total:
                assert value == pytest.approx(total, abs=1e-9)
            else:
                total += value
        figures = calm.at(light)
        assert total == pytest.approx(figures.reserve, abs=1e-6)
        assert calm.budget[-2].night == pytest.approx(0.0, abs=1e-4)  # no waves, no fading
        assert figures.margin == pytest.approx(figures.reserve, abs=1e-3)
    scenario = mt.Scenario.from_toml(CALM)
    beer = next(line for line in calm.budget if line.name.startswith("absorption"))
    depth, a = scenario.link.depth, scenario.link.water.a
    # rays are a little longer than the depth
    assert beer.day == pytest.approx(-4.343 * a * depth, rel=0.01)


def test_spots_of_a_tracked_beam_are_closed_forms(monkeypatch):
    monkeypatch.setattr(spots, "_RADII", (0.005, 0.02))
    monkeypatch.setattr(spots, "_LATENCIES", (0.03,))
    beam = mt.GaussianBeam(depth=10.0, divergence_deg=0.0, waist=0.02)
    link = mt.Link(transmitter=beam, receiver=mt.Receiver(height=10.0, radius=0.3))
    sea = resolved_sea(5.0)
    narrow, wide = spots.tracked_spots(link, sea)
    assert (narrow.radius, wide.radius) == (0.005, 0.02)
    assert narrow.held == mt.fading.pointing_residual(sea, 0.03, 0.005)
    assert wide.outage_predicted == mt.fading.pointing_outage(sea, 10, 0.3, 0.03, 0.02, "linear")
    # a lever of 1.43 m times the curvature of the slopes: far beyond 1 for a spot of 5 mm
    assert narrow.loop_gain > 10.0 > wide.loop_gain > 1.0
    text = "\n".join(spots.spot_lines((narrow, wide), 0.01))
    assert "holding leaves 35 % of the variance of a" in text
    assert "predicted: 30 ms 2 cm" in text
    # lamps that are no beams, and seas without a spectrum
    assert spots.tracked_spots(mt.Link(), sea) == ()
    assert spots.tracked_spots(link, mt.FlatSea()) == ()


@pytest.mark.slow
def test_two_receivers_have_a_line_of_the_budget(calm):
    """Reserves are those of one, and what both gain together; best values follow the first."""
    ends = "[[receiver]]\nfov_deg = 30.0\n[[receiver]]\nfov_deg = 30.0\nposition = [0.2, 0.0]\n"
    text = CALM.replace("[receiver]\nfov_deg = 30.0\n", ends)
    both = mt.design(mt.Scenario.from_toml(text), **SOME)
    (line,) = (line for line in both.budget if line.name == "2 receivers together")
    for light, most in (("night", 3.02), ("day", 3.02)):
        gained = getattr(line, light)
        assert 1.0 < gained < most
        assert both.at(light).reserve - calm.at(light).reserve == pytest.approx(gained, abs=0.2)
        mean = both.at(light).margin - calm.at(light).margin
        assert mean == pytest.approx(gained, abs=0.3)
    assert line.day < line.night, "behind background light signal-to-noise ratios add"
    assert both.two_lenses == (), "without waves there is nothing to gain"


@pytest.mark.parametrize("spread", [0.1, 0.5])
def test_diversity_is_that_of_samples(spread):
    """Two gains of one law with a Gaussian copula, by drawing them (1 % quantile: 3 sigma)."""
    gain, rng = diversity_gain(spread, 0.01), np.random.default_rng(7)
    assert gain(1.0) == pytest.approx(0.0, abs=1e-12)
    z = rng.standard_normal((2, 400_000))
    z[1] = 0.5 * z[0] + math.sqrt(0.75) * z[1]
    logs = np.linspace(-12.0, 8.0, 4001)
    law = probability_in_log(spread)(logs)
    gains = np.exp(spread * np.interp(ndtr(z), law, logs))
    quantiles = [np.quantile(x, 0.01) for x in (gains.mean(axis=0), gains[0])]
    drawn = DECIBELS * math.log(quantiles[0] / quantiles[1])
    # error of ln q: (p (1 - p) / n)^(1/2) over the density p z of the logarithm there
    error = DECIBELS * spread * math.sqrt(0.01 * 0.99 / 400_000) / 0.027 * 1.5
    assert abs(gain(float(np.corrcoef(gains)[0, 1])) - drawn) < 4.0 * error


def test_figures_are_those_of_a_performance(calm):
    at = mt.link_performance(mt.Scenario.from_toml(CALM), photons=128, realizations=8).at()
    day = calm.at("day")
    assert day.ber == (at.ber.value, at.ber.low, at.ber.high)
    assert day.margin == at.margin_optical_db.value
    assert day.capacity == at.capacity.hard


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("key", "values"),
    [
        ("receiver.fov_deg", (2.0, 5.0, 10.0, 20.0, 40.0)),
        pytest.param(WIDTH, (8.0, 16.0, 32.0), marks=pytest.mark.slow),
        pytest.param("receiver.radius", (0.0125, 0.05, 0.2), marks=pytest.mark.slow),
        pytest.param("receiver.height", (2.5, 5.0, 10.0), marks=pytest.mark.slow),
    ],
)
def test_scans_are_those_of_runs_of_their_own(calm, key, values):
    choices = [choice for choice in calm.choices]
    row = choices.index(calm.choice(key))
    found = np.interp(values, calm.scanned[row], calm.reserves[row])
    expected = [performance(CALM, **{key: value}) for value in values]
    # other chains, another window for each background; rays of the background
    assert found - calm.at("day").reserve == pytest.approx(
        np.array(expected) - performance(CALM), abs=0.35
    )
    best, grid = calm.choice(key).best, calm.scanned[row]
    assert grid.min() <= best <= grid.max()
    if key == "receiver.fov_deg":
        assert best == pytest.approx(values[int(np.argmax(expected))], rel=0.1)
    if key == WIDTH:  # not below the shift over half of 30 degrees
        assert best == pytest.approx(470.0 * (1.0 - math.sqrt(1.0 - (math.sin(
            math.radians(15.0)) / 2.0) ** 2)), rel=0.1)  # fmt: skip
    low, high = calm.choice(key).flat
    assert low <= best <= high


@pytest.mark.statistical
@pytest.mark.thorough
def test_mean_gains_are_those_of_many_resolved_seas():
    """Ratios by random slopes against 64 seas with all waves that make the light fade."""
    scenario = mt.Scenario.from_toml("")
    campaign = campaign_of(scenario, None, "design", {"photons": 512}, fading=True, several=False)
    link = campaign.link
    narrow, low = link.replace("receiver.fov_deg", 4.0), link.replace("receiver.height", 2.5)
    means = MeanGains(campaign, 64)
    means.compute([narrow, low])
    whole = link.replace("receiver", tuple(one.only_receiver for one in (link, narrow, low)))
    resolved = campaign.for_link(whole)
    found = resolved.gains(resolved.realizations(64))[0, 0].swapaxes(0, 1)
    logs = np.log([[part.mean() for part in without_each(one)] for one in found])
    for row, one in zip(logs[1:], (narrow, low), strict=True):
        ratio, stderr = means.log_ratio(one)
        off = row - logs[0]
        assert z_test(float(off[0]), math.hypot(error_of(off), stderr), ratio) > ALPHA
        assert stderr < 0.5 * error_of(off)  # by 2 seas in place of 64


ECHO = """
wind_speed = 0.0
[water]
a = 0.366
b = 1.824
[transmitter]
depth = 8.0
[receiver]
fov_deg = 120.0
radius = 0.1
[detector]
bit_rate = 50e6
sipm = {bandwidth = 1e8}
led = {bandwidth = 1e8}
"""


@pytest.fixture(scope="module")
def echo():
    return mt.design(mt.Scenario.from_toml(ECHO), **SOME)


@pytest.mark.slow
def test_pulses_spread_by_turbid_water(echo):
    at = mt.link_performance(
        mt.Scenario.from_toml(ECHO), daylight=mt.Daylight.clear_sky(), **SOME
    ).at()
    assert at.dispersion_db > 0.3
    day = echo.at("day")
    assert day.ber == (at.ber.value, at.ber.low, at.ber.high)
    assert day.margin == at.margin_optical_db.value
    assert day.outage == (at.outage.value, at.outage.low, at.outage.high)
    (line,) = (one for one in echo.budget if "response of the channel" in one.name)
    dark = mt.link_performance(mt.Scenario.from_toml(ECHO), **SOME).at()
    assert -line.night == pytest.approx(dark.dispersion_db, abs=0.05)
    total = sum(one.night for one in echo.budget if not one.total)
    assert total == pytest.approx(echo.at("night").reserve, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("key", "off"),
    [
        ("transmitter.power_mw", 0.05),
        ("detector.bit_rate", 0.1),  # found within 1 %
        ("transmitter.depth", 1.2),  # three standard errors of the chains of either run
        ("receiver.fov_deg", 1.2),
    ],
)
def test_links_that_would_close(echo, key, off):
    (value,) = (r.value for r in echo.reach if (r.period, r.key) == ("night", key))
    changes = {key: value, "detector.preset": "physical"}
    at = mt.Scenario.from_toml(ECHO, changes=changes)
    night = mt.link_performance(at, daylight=mt.Daylight.night(), **SOME).at()
    assert night.margin_optical_db.value == pytest.approx(0.0, abs=off)


TURBID = CALM.replace("[receiver]", "[water]\na = 0.3\nb = 0.3\n[receiver]").replace(
    "wind_speed = 0.0", "wind_speed = 0.0\n[transmitter]\ndepth = 20.0\n"
)


@pytest.mark.slow
def test_a_link_that_does_not_close_and_the_nearest_that_does():
    page = mt.design(mt.Scenario.from_toml(TURBID), **FEW)
    assert not page.closes("day")
    text = page.summary()
    assert "By day: no." in text
    assert "dB short of closing 99 % of the time" in text
    reach = {r.key: r for r in page.reach if r.period == "day"}
    depth = reach["transmitter.depth"].value
    assert 0.0 < depth < 20.0
    assert performance(TURBID, transmitter__depth=depth) == pytest.approx(0.0, abs=0.6)
    power = reach["transmitter.power_mw"].value
    assert power > 100.0
    assert performance(TURBID, transmitter__power_mw=power) == pytest.approx(0.0, abs=0.3)
    rate = reach["detector.bit_rate"].value
    if not math.isnan(rate):
        assert performance(TURBID, detector__bit_rate=rate) == pytest.approx(0.0, abs=0.6)
    width = reach[WIDTH].value
    assert math.isnan(width) == ("No width of the filter alone" in text.partition("FIGURES")[0])


@pytest.mark.thorough
def test_a_bit_rate_carries_the_most_after_hard_decisions(calm):
    scenario = mt.Scenario.from_toml(CALM)
    best = calm.choice("detector.bit_rate")
    rates = [best.flat[0] / 2.0, best.best, 2.0 * best.flat[1]]
    at = mt.link_performance(scenario, bit_rate=rates, photons=1024, realizations=2)
    carried = [at.at(bit_rate=rate).capacity.hard for rate in at.bit_rates]
    assert carried[1] > max(carried[0], carried[2])
    told = re.search(r"(\S+) Mbit/s after hard decisions", best.note)
    assert told is not None
    assert float(told[1]) == pytest.approx(carried[1] / 1e6, rel=0.02)


@pytest.mark.parametrize(
    ("closing", "greatest"),
    [("110011100", 6.4), ("111111110", 7.4), ("111111111", 8.0), ("000000000", None)],
)
def test_the_greatest_bit_rate_is_found_where_lower_ones_do_not_close(closing, greatest):
    """To 1 %, also beyond a gap, at the end of a scan above 1 Gbit/s, and without any."""
    rates, edge = np.exp(np.arange(9.0) + 13.0), math.exp(13.0 + (greatest or -20.0))
    reserves = np.where(np.array(list(closing)) == "1", 1.0, -1.0)
    choice = BestValue("night", study.RATE, "bit s-1", rates[0], rates[0], 0.0, 0.0,
                       (rates[0], rates[0]), "")  # fmt: skip
    link = mt.Link()
    fake = SimpleNamespace(
        link=link,
        limit=1e-3,
        quantile=lambda fov_deg: 0.0,
        window_at=lambda period, rate: 0.0,
        at_rate=lambda period, rate, window: SimpleNamespace(
            rate=rate, required_power=lambda limit: 0.0
        ),
        margin_db=lambda period, gain, ook, power: 1.0 if ook.rate <= edge else -1.0,
    )
    found = study._Study._bit_rate(fake, "night", [study.Scan(choice, rates, reserves)])
    if greatest is None:
        assert math.isnan(found)
    else:
        assert found == pytest.approx(edge, rel=0.011)


def test_reserves_are_of_the_night_or_the_day(calm):
    with pytest.raises(Refused, match=r"^period: 'noon', allowed: "):
        calm.reserve_together("noon")


SPECTRUM = """
wind_speed = 0.0
[water]
type = "jerlov-3C"
[transmitter]
depth = 12.0
[daylight]
model = "clear"
"""


@pytest.mark.slow
def test_wavelengths_are_those_of_runs_of_their_own():
    """Chains of both differ: within 4 standard errors and 0.1 dB."""
    scenario = mt.Scenario.from_toml(SPECTRUM)
    page = mt.design(scenario, **FEW)
    values = [470.0, 530.0, 590.0]
    direct = mt.link_performance(scenario, wavelengths_nm=values, photons=1024, realizations=2)
    margins = np.array([one.at().margin_optical_db.value for one in direct.results])
    choice = page.choice("transmitter.wavelength_nm")
    row = page.choices.index(choice)
    found = np.interp(values, page.scanned[row], page.reserves[row])
    assert found - found[0] == pytest.approx(
        margins - margins[0], abs=0.1 + 4.0 * choice.gained_stderr
    )
    assert choice.flat[0] <= choice.best <= choice.flat[1]
    with pytest.raises(Refused, match="a water with a spectrum"):
        mt.design(mt.Scenario.from_toml(CALM), bounds={choice.key: (450.0, 550.0)}, **FEW)


@pytest.mark.statistical
@pytest.mark.parametrize("lognormal", [False, True])
def test_the_quantile_of_fading_light_with_tilts(lognormal):
    """Within 4 standard errors of that of 200 000 draws, significance 1e-4."""
    rng = np.random.default_rng(3)

    def drawn(n):
        if lognormal:
            return rng.lognormal(-12.0, 0.3, n)
        return gamma_gamma.rvs(20.0, 20.0, scale=1e-5, size=n, random_state=rng)

    gains, h = drawn(4000), np.append(rng.uniform(0.8, 1.0, 50), 0.0)
    tilt = TiltFactors(h, np.append(np.full(50, 0.996 / 50), 0.004))
    found = log_quantile(gains, tilt, 0.01, lognormal)
    below = (drawn(200_000) * rng.choice(h, 200_000, p=tilt.weight) < math.exp(found)).mean()
    assert below == pytest.approx(0.01, abs=4.0 * math.sqrt(0.01 / 4000 + 0.01 / 200_000))
    dark = TiltFactors(h, np.append(np.full(50, 0.98 / 50), 0.02))
    assert log_quantile(gains, dark, 0.01, lognormal) == -math.inf


def test_the_quantile_is_that_of_many_seas():
    """The 1 % quantile of 500 seas of the default link is -5.6 dB, -6.8 to -4.9 (95 %).

    A lognormal law with their mean and variance has -4.9, one with those of the logarithm -5.3 dB.
    Here by quantiles of the gamma-gamma law that fits those gains best.
    """
    law = gamma_gamma(28.6, 5.62)
    gains = np.interp((np.arange(500) + 0.5) / 500, law.cdf(GRID), GRID)
    level = TiltFactors(np.ones(1), np.ones(1))
    found = DECIBELS * (log_quantile(gains, level, 0.01) - math.log(gains.mean()))
    assert found == pytest.approx(
        DECIBELS * math.log(np.interp(0.01, law.cdf(GRID), GRID)), abs=0.4
    )
    assert found < -5.58


@pytest.mark.statistical
@pytest.mark.thorough
def test_the_interval_of_the_quantile_covers():
    """Of 64 seas each: two standard errors hold it in 19 of 20 cases, or in 9 of 10 at least."""
    law, rng = gamma_gamma(28.6, 5.62), np.random.default_rng(5)
    wanted, level = np.interp(0.01, law.cdf(GRID), GRID), TiltFactors(np.ones(1), np.ones(1))
    model = object.__new__(LinkModel)
    model.outage, inside = 0.01, 0
    for _ in range(60):
        gains = law.rvs(64, random_state=rng)
        off = log_quantile(gains, level, 0.01) - math.log(wanted)
        inside += abs(off) < 2.0 * model._quantile_error(gains, level, 0.0)
    assert binom.cdf(inside, 60, 0.9) > ALPHA


def test_remedies_are_clauses_of_their_own(calm):
    """A depth after "by night" read as a value of the night."""
    night, day = calm.figures
    page = replace(calm, figures=(night, day._replace(reserve=-3.0)))
    text = " ".join(page.answer)
    assert "As it is, it closes by night. By day any one of these changes would close it: " in text
    clauses = text.partition("would close it: ")[2].partition(".  ")[0].split("; or ")
    assert len(clauses) > 3
    assert all(" at most " in clause or " at least " in clause for clause in clauses)


@pytest.mark.slow
def test_a_windy_link_from_an_aircraft(tmp_path):
    text = CALM.replace("wind_speed = 0.0", "wind_speed = 5.0") + "[uav]\n"
    scenario = mt.Scenario.from_toml(text)
    page = mt.design(scenario, photons=128, realizations=16)
    at = mt.link_performance(scenario, photons=128, realizations=16)
    for light in ("night", "day"):
        figures = page.at(light)
        assert figures.reserve < figures.margin  # it fades
        assert figures.reserve_stderr > 0.0
    assert page.at("day").outage == at.at().outage
    page.save(tmp_path / "d.nc")
    again = mt.Design.load(tmp_path / "d.nc")
    assert again.summary() == page.summary()
    assert again.choices == page.choices


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"outage": 0.0}, "outage: 0"),
        ({"limit": 0.7}, "limit: 0.7"),
        ({"realizations": 2}, "realizations: 2"),
        ({"bounds": {"receiver.fov": (1.0, 2.0)}}, "did you mean receiver.*fov_deg"),
        ({"bounds": {"receiver.fov_deg": (9.0, 2.0)}}, "low < high"),
    ],
)
def test_refusals(options, message):
    with pytest.raises(Refused, match=message):
        mt.design(mt.Scenario.from_toml(CALM), **{**FEW, **options})
    with pytest.raises(Refused, match="a Scenario"):
        mt.design(mt.Link())
