"""Ranges, budgets, fading averages, outage and capacity from arrays of gains."""

from __future__ import annotations

import json
import math
from decimal import Decimal, localcontext
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import norm

from meshtrace.comms import OokLink, OpticalFrontEnd
from meshtrace.comms.budget import (
    FEC_LIMITS,
    average_ber,
    depth_at,
    link_budget,
    outage,
    range_at_ber,
    required_gain,
)
from meshtrace.comms.capacity import capacity, hard_information, wyner_capacity

REFERENCE = json.loads((Path(__file__).parents[1] / "data" / "link_reference.json").read_text())
RATES = (1e6, 5e6, 1e7)
LOSS_FREE = OpticalFrontEnd(etendue_limited=False)


def gains(key: str) -> tuple[np.ndarray, np.ndarray]:
    table = {float(depth): gain for depth, gain in REFERENCE[key].items()}
    return np.array(list(table)), np.array(list(table.values()))


PHYSICAL = gains("flat_gain_MC_physical_h5_r5cm_th10")
DOUBLED = gains("flat_gain_MC_paper_a2")


@pytest.mark.parametrize(
    ("links", "table", "ranges"),
    [
        ([OokLink(bit_rate=r) for r in RATES], PHYSICAL, (55.4, 42.6, 31.3)),
        ([OokLink(bit_rate=r, model="GP") for r in RATES], PHYSICAL, (56.0, 46.0, 41.8)),
        ([OokLink.preset("paper-ranges", bit_rate=r) for r in RATES], DOUBLED, (49.1, 41.8, 34.5)),
        (
            [OokLink(bit_rate=r, model="A", optics=LOSS_FREE) for r in RATES],
            DOUBLED,
            (42.6, 41.3, 34.8),
        ),
    ],
    ids=["etendue-W", "etendue-GP", "paper-ranges", "doubled-A"],
)
def test_ranges_match_table(links, table, ranges):
    found = [range_at_ber(link, *table, 1e-3) for link in links]
    assert found == pytest.approx(ranges, abs=0.7)


@pytest.mark.parametrize(("bit_rate", "expected"), [(5e6, 72.1), (1e7, 59.4)])
def test_loss_free_ranges_match_table(bit_rate, expected):
    link = OokLink(bit_rate=bit_rate, optics=LOSS_FREE)
    assert range_at_ber(link, *PHYSICAL, 1e-3) == pytest.approx(expected, abs=0.7)


@pytest.mark.parametrize(
    ("link", "table", "expected"),
    [(OokLink(), PHYSICAL, 54.1), (OokLink.preset("paper-ranges"), DOUBLED, 48.4)],
)
def test_range_at_13_metres_per_second(link, table, expected):
    depth, gain = table
    assert range_at_ber(link, depth, 0.83 * gain, 1e-3) == pytest.approx(expected, abs=0.7)


def test_reference_gains_exceed_the_unscattered_light():
    depth, gain = PHYSICAL
    ballistic = gains("flat_gain_ballistic")[1]
    order = -math.log(2.0) / math.log(math.cos(math.radians(10.0)))
    closed = (
        0.5
        * (order + 1.0)
        * (0.05 / (depth + 1.33 * 5.0)) ** 2
        * np.exp(-0.151 * depth)
        * (1.0 - (0.33 / 2.33) ** 2)
    )
    assert ballistic == pytest.approx(closed, rel=1e-12)
    assert np.all(gain > ballistic)


def test_depth_at_is_exact_on_exponentials_and_takes_the_deepest_crossing():
    depth = np.array([1.0, 4.0, 5.0, 9.0])
    assert depth_at(depth, np.exp(-0.3 * depth), math.exp(-0.3 * 7.7)) == pytest.approx(7.7)
    dip = [1e-2, 1e-6, 1e-6, 1e-1]
    assert 5.0 < depth_at(depth, dip, 1e-3) < 9.0
    for bad in (
        lambda: depth_at([1.0, 2.0], [1e-3, 1e-4], 1e-6),
        lambda: depth_at([2.0, 1.0], [1e-3, 1e-4], 5e-4),
        lambda: depth_at([1.0, 2.0], [1e-3, 0.0], 5e-4),
        lambda: depth_at([1.0], [1e-3], 1e-3),
    ):
        with pytest.raises(ValueError, match="allowed"):
            bad()


def test_budget_adds_up():
    link = OokLink(optics=OpticalFrontEnd(filter_transmission=0.8))
    budget = link_budget(link, np.array([6.4e-8, 1e-9, 0.0]), 1e-3, h_alpha=0.96)
    total = budget.transmitted_dbm + budget.gain_db + budget.tilt_db
    total = total + budget.concentration_db + budget.filter_db
    assert budget.transmitted_dbm == pytest.approx(20.0)
    assert budget.received_dbm[:2] == pytest.approx(total[:2], abs=1e-9)
    assert budget.margin_optical_db[:2] == pytest.approx(
        (budget.received_dbm - budget.required_dbm)[:2], abs=1e-9
    )
    assert budget.margin_electrical_db[:2] == pytest.approx(2.0 * budget.margin_optical_db[:2])
    assert budget.margin_optical_db[2] == -math.inf
    at_limit = link_budget(link, required_gain(link, 1e-3), 1e-3)
    assert float(at_limit.margin_optical_db) == pytest.approx(0.0, abs=1e-9)


def lognormal(scintillation: float, n: int = 20_000) -> np.ndarray:
    """Evenly spaced quantiles of a lognormal gain of mean 1."""
    variance = math.log1p(scintillation)
    normal = norm.ppf((np.arange(n) + 0.5) / n)
    return np.exp(math.sqrt(variance) * normal - 0.5 * variance)


@pytest.mark.parametrize(
    ("scintillation", "average_db", "outage_db"),
    [
        (0.006, 0.10, 0.79),
        (0.012, 0.16, 1.13),
        (0.1, 1.11, 3.33),
        (0.4, 3.45, 6.59),
        (0.7, 5.12, 8.51),
    ],
)
def test_fading_penalties_match_table(scintillation, average_db, outage_db):
    link = OokLink(model="GP", saturation=False)
    h = lognormal(scintillation)
    need = required_gain(link, 1e-3)

    def excess(db: float) -> float:
        return average_ber(link, need * 10.0 ** (0.1 * db) * h, resamples=1).value - 1e-3

    assert brentq(excess, 0.0, 8.0) == pytest.approx(average_db, abs=0.05)
    # The link keeps 99 % of the realizations with just this much more light.
    for shift, side in ((0.01, 1.0), (-0.01, -1.0)):
        lit = need * 10.0 ** (0.1 * (outage_db + shift)) * h
        assert (0.01 - outage(link, lit, 1e-3).value) * side > 0.0


@pytest.mark.parametrize("model", ["W", "GP", "PC"])
@pytest.mark.slow_but("W", "PC")
def test_interpolated_average_equals_the_direct_one(model):
    link = OokLink(bit_rate=5e6, model=model)
    gain = 1.5 * required_gain(link, 1e-3) * lognormal(0.3, 2000)
    gain[:50] = 0.0
    table = average_ber(link, gain, resamples=1).value
    direct = float(
        np.mean([link.ber(link.received_power(part)).mean() for part in np.split(gain, 8)])
    )
    assert table == pytest.approx(direct, rel=1e-4)


def test_average_ber_interval_covers_and_tightens():
    link = OokLink()
    need = required_gain(link, 1e-3)
    rng = np.random.default_rng(3)
    gain = 1.3 * need * rng.lognormal(-0.05, 0.3, 4000)
    full = average_ber(link, gain)
    part = average_ber(link, gain[:400])
    series = average_ber(link, gain, n_effective=400.0)
    assert full.low < full.value < full.high
    assert part.high - part.low > 2.0 * (full.high - full.low)
    assert series.high - series.low > 2.0 * (full.high - full.low)
    assert part.low < full.value < part.high


def test_tilt_joins_average_and_outage():
    link = OokLink()
    gain = np.full(1000, 10.0 * required_gain(link, 1e-3))
    h_alpha = np.where(np.arange(1000) < 70, 0.0, 0.95)
    assert average_ber(link, gain, h_alpha).value == pytest.approx(0.035, rel=1e-3)
    missed = outage(link, gain, 1e-3, h_alpha)
    assert missed.value == pytest.approx(0.07)
    assert missed.low < 0.07 < missed.high
    dark = average_ber(link, np.zeros(1000))
    assert dark == (0.5, 0.5, 0.5)


def test_outage_of_a_closed_eye_is_certain():
    assert outage(OokLink(bit_rate=3e7), np.full(10, 1e-3), 1e-3).value == 1.0


@pytest.mark.parametrize(("ber", "bits"), [(1e-3, 0.988592), (2e-3, 0.979186), (3.8e-3, 0.963977)])
def test_hard_information_matches_table(ber, bits):
    assert float(hard_information(ber)) == pytest.approx(bits, abs=1e-6)
    assert ber in FEC_LIMITS.values()


def test_capacity_orders():
    link = OokLink(bit_rate=1e6, model="GP")
    gain = required_gain(link, 1e-2) * lognormal(0.2, 300)
    rates = capacity(link, gain, outage=0.05)
    assert 0.0 < rates.hard_outage < rates.hard < rates.soft < link.bit_rate
    strong = capacity(link, np.full(3, 1e-3))
    assert strong.soft == strong.hard == strong.hard_outage == link.bit_rate
    with pytest.raises(ValueError, match=r"outage: 1\.0"):
        capacity(link, gain, outage=1.0)


@pytest.mark.parametrize("bit_rate", RATES)
def test_hard_decisions_never_carry_more_than_full_counts(bit_rate):
    link = OokLink(bit_rate=bit_rate)
    for ber in (0.49, 0.45, 0.35, 0.2):
        rates = capacity(link, [required_gain(link, ber)])
        assert 0.0 < rates.hard <= rates.soft


@pytest.mark.parametrize("bit_rate", RATES)
def test_few_counts_are_worse_than_gaussian(bit_rate):
    link = OokLink(bit_rate=bit_rate)
    exact = link.model_copy(update={"model": "CP", "window": link.averaging_window})
    assert float(exact.ber(link.required_power(0.35))) > 0.36


@pytest.mark.parametrize("share", [1.0, 0.1])
@pytest.mark.parametrize("ratio", ["1e-12", "0.9", "990", "1010", "1e6", "1e8", "1e10", "1e15"])
def test_wyner_capacity_with_much_background(ratio, share):
    """Differences of large numbers once gave 0.27 for 1.8e-11; here with 80 digits."""
    with localcontext() as context:
        context.prec = 80
        s = Decimal(ratio)
        best = ((1 + s) * (1 + s).ln() - s * s.ln() - 1).exp() - s
        q = min(Decimal(str(share)), best)
        nats = q * (1 + s) * (1 + s).ln() + (1 - q) * s * s.ln() - (q + s) * (q + s).ln()
        expected = float(nats / Decimal(2).ln())
    assert wyner_capacity(1.0, float(ratio), share) == pytest.approx(expected, rel=1e-11)


def test_wyner_capacity_against_its_definition():
    """Mutual information of duty q, in units of the peak rate, maximised by brute force."""
    s = 0.1
    q = np.linspace(1e-4, 1.0, 200_001)[:-1]
    rate = q * (1 + s) * math.log1p(s) + (1 - q) * s * math.log(s) - (q + s) * np.log(q + s)
    best = int(np.argmax(rate))
    assert q[best] == pytest.approx(0.414325, abs=1e-5)
    assert wyner_capacity(2e6, 2e5) * math.log(2.0) == pytest.approx(2e6 * rate[best], rel=1e-8)
    assert wyner_capacity(1.0, 0.0) * math.log(2.0) == pytest.approx(1.0 / math.e, rel=1e-12)
    low_duty = wyner_capacity(1.0, 0.1, mean_share=0.1)
    assert low_duty < wyner_capacity(1.0, 0.1)
    for bad in ((0.0, 1.0, 0.5), (1.0, -1.0, 0.5), (1.0, 1.0, 0.0)):
        with pytest.raises(ValueError, match="allowed"):
            wyner_capacity(*bad)


def test_bad_ensembles_are_refused():
    link = OokLink()
    with pytest.raises(ValueError, match="n_effective: 5"):
        average_ber(link, [1e-8, 1e-8], n_effective=5.0)
    with pytest.raises(ValueError, match=r"gain\[1\]: "):
        average_ber(link, [1e-8, math.nan])
    with pytest.raises(ValueError, match=r"ber: 0\.6"):
        range_at_ber(link, *PHYSICAL, 0.6)
