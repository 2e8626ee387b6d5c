"""Wander of a tracked beam over a Gaussian sea: the table of the design, limits and a simulation."""

from __future__ import annotations

import math

import numpy as np
import pytest
from mc_statistics import ALPHA, z_test
from scipy.stats import chi2

from meshtrace.errors import Refused
from meshtrace.fading import pointing_outage, pointing_residual
from meshtrace.fading.pointing import Wander, outside
from meshtrace.surfaces import FlatSea, resolved_sea

SEA = resolved_sea(5.0)
LATENCIES = 0.005, 0.01, 0.03, 0.1
# 5 m/s: share of the variance left by radius [m], held and predicted
TABLE = {
    0.001: ((0.072, 0.208, 0.574, 1.16), (0.013, 0.114, 0.452, 0.788)),
    0.005: ((0.015, 0.057, 0.351, 1.06), (0.0001, 0.0022, 0.154, 0.715)),
    0.02: ((0.003, 0.012, 0.107, 0.837), (0.0, 0.0, 0.0004, 0.139)),
}


@pytest.mark.parametrize("radius", TABLE)
def test_residuals_of_the_table(radius):
    for predictor, shares in zip(("hold", "linear"), TABLE[radius], strict=True):
        left = [pointing_residual(SEA, tau, radius, predictor) for tau in LATENCIES]
        # half of the last digit printed, and 0.139 for 0.1385
        assert left == pytest.approx(shares, abs=6e-4, rel=5e-3)


def test_slope_variance_of_footprints():
    variances = [Wander.from_sea(SEA, radius).variance.sum() for radius in TABLE]
    assert variances == pytest.approx([0.03128, 0.02800, 0.02390], abs=6e-6)


def test_outage_of_an_open_and_of_a_held_beam():
    assert pointing_outage(SEA, 10.0, 0.3, None, 0.005) == pytest.approx(0.7404, abs=5e-5)
    assert pointing_outage(SEA, 10.0, 0.3, 0.01, 0.005) == pytest.approx(0.00614, abs=5e-6)


def test_the_variance_behind_an_outage_is_the_residual():
    wander = Wander.from_sea(SEA, 0.005)
    for predictor in ("hold", "linear"):
        left = wander.left(0.03, predictor, 0.002, None).sum() / wander.variance.sum()
        assert left == pytest.approx(pointing_residual(SEA, 0.03, 0.005, predictor), rel=1e-6)


def test_a_round_law_has_the_tail_of_rayleigh_and_a_flat_one_of_gauss():
    assert outside(np.array([2.0, 2.0]), 3.0) == pytest.approx(math.exp(-9.0 / 4.0), rel=1e-14)
    # one axis alone: chi-square of one degree of freedom
    assert outside(np.array([2.0, 0.0]), 3.0) == pytest.approx(chi2.sf(4.5, 1), rel=1e-9)
    assert outside(np.zeros(2), 3.0) == 0.0


def test_an_outage_is_that_of_drawn_spots():
    rng, n = np.random.default_rng(5), 200_000
    spots = rng.standard_normal((n, 2)) * np.sqrt([3.0, 1.0])
    count = int((np.hypot(*spots.T) > 2.0).sum())
    p = outside(np.array([3.0, 1.0]), 2.0)
    assert z_test(count / n, math.sqrt(p * (1.0 - p) / n), p) > ALPHA


def test_limits_of_latency_and_noise():
    assert pointing_residual(SEA, 0.0, 0.005) == 0.0
    # a held correction adds its noise, a predictor averages it
    assert pointing_residual(SEA, 0.0, 0.005, noise=0.1) == pytest.approx(0.1)
    assert pointing_residual(SEA, 0.0, 0.005, "linear", noise=0.1) < 0.1
    # the past says nothing: a prediction is the mean, a held correction adds its variance
    assert pointing_residual(SEA, 0.03, 0.005, "linear", noise=1e9) == pytest.approx(1.0)


def test_a_wider_spot_predicted_is_nearly_perfect_where_holding_a_narrow_one_fails():
    assert pointing_residual(SEA, 0.03, 0.005) > 0.3
    assert pointing_residual(SEA, 0.03, 0.02, "linear") < 1e-3


def test_fewer_samples_of_a_longer_past_predict_no_better():
    shares = [pointing_residual(SEA, 0.1, 0.02, "linear", T) for T in (0.002, 0.01, 0.04, 0.2)]
    assert shares == sorted(shares)


@pytest.mark.parametrize(
    ("field", "changed"),
    [
        ("surface", {"surface": FlatSea()}),
        ("latency", {"latency": -1.0}),
        ("radius", {"radius": math.inf}),
        ("predictor", {"predictor": "learned"}),
        ("sample", {"sample": 0.0}),
        ("noise", {"noise": -0.1}),
        ("tolerance", {"tolerance": 0.0}),
        ("n", {"n": 1.0}),
    ],
)
def test_refusals(field, changed):
    call = {"surface": SEA, "height": 10.0, "tolerance": 0.3, "latency": 0.01, "radius": 0.005}
    with pytest.raises(Refused, match=rf"^{field}"):
        pointing_outage(**(call | changed))
