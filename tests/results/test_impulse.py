"""Impulse responses: weights, delays and spectra of both estimators."""

import math

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak, z_test

import meshtrace as mt
from meshtrace.results import impulse, impulse_response, tallies
from meshtrace.surfaces import FlatSea, JonswapSea

pytestmark = pytest.mark.filterwarnings("ignore:.*left the meshed surface:meshtrace.DomainWarning")

LINK = mt.Link(
    water=mt.Water(a=0.1, b=0.3, phase=mt.HenyeyGreenstein(g=0.9)),
    receiver=(mt.Receiver(radius=0.5), mt.Receiver(radius=0.5, position=(1.0, 0.0))),
    physics=mt.Physics(reflected="kill"),
)
MESH = JonswapSea(wind_speed=5.0, seed=2, mss="band", waves="paper").mesh(extent=12.0, spacing=0.2)


@pytest.fixture(scope="module")
def forced():
    return mt.simulate(LINK, MESH, photons=20_000, seed=1, record=[mt.Arrivals()])


@pytest.fixture(scope="module")
def analog():
    return mt.simulate(
        LINK, MESH, estimator="analog", photons=1_500_000, seed=1, record=[mt.Arrivals()]
    )


@pytest.mark.parametrize("receiver", [0, 1])
@pytest.mark.thorough
def test_weights_add_up_to_the_gain(forced, analog, receiver):
    for r in (forced, analog):
        mine = r.arrivals.receiver == receiver
        total = r.arrivals.weight[mine].sum()
        assert total == pytest.approx(r.gain[receiver], rel=1e-9)
        i = impulse_response(r, receiver=receiver)
        assert i.weight.sum() == pytest.approx(r.gain[receiver], rel=1e-9)
        assert (i.h * np.diff(i.edges)).sum() == pytest.approx(r.gain[receiver], rel=1e-9)


def test_unscattered_rows_are_the_unscattered_gain(forced):
    for receiver in (0, 1):
        mine = forced.arrivals.receiver == receiver
        direct = mine & (forced.arrivals.group < 0)
        total = forced.arrivals.weight[direct].sum()
        assert total == pytest.approx(forced.gain_ballistic[receiver], rel=1e-12)


@pytest.mark.parametrize("receiver", [0, 1])
@pytest.mark.thorough
def test_estimators_agree_on_the_delays(forced, analog, receiver):
    """The first arrival differs: compare the mean time itself, and the spread."""
    f, a = (impulse_response(r, receiver=receiver) for r in (forced, analog))
    assert f.mean_delay > 0.0
    p = z_test(
        f.first_arrival + f.mean_delay,
        f.mean_delay_stderr,
        a.first_arrival + a.mean_delay,
        a.mean_delay_stderr,
    )
    assert p > sidak(ALPHA, 4)
    p = z_test(
        f.rms_delay_spread, f.rms_delay_spread_stderr, a.rms_delay_spread, a.rms_delay_spread_stderr
    )
    assert p > sidak(ALPHA, 4)
    assert a.mean_delay_stderr < 0.2 * a.mean_delay


def test_estimators_agree_on_the_shape(forced, analog):
    """Share of the light later than 0.1, 0.3, 1 and 3 ns behind straight light."""
    start = (1.33 * 10.0 + 5.0) / impulse.SPEED_OF_LIGHT
    for late in (1e-10, 3e-10, 1e-9, 3e-9):
        shares, errors = [], []
        for r in (forced, analog):
            mine = r.arrivals.receiver == 0
            time = 1.33 * r.arrivals.water_path + r.arrivals.air_path
            tail = mine & (time / impulse.SPEED_OF_LIGHT > start + late)
            w, g = r.arrivals.weight, r.arrivals.group
            # straight light is early, but for what rounding leaves of the edge of the field of view
            assert w[tail & (g < 0)].sum() < 1e-9 * w[mine].sum() or late < 2e-10
            groups = np.array([32 * w[tail & (g == k)].sum() for k in range(32)])
            groups += w[tail & (g < 0)].sum()
            shares.append(groups.mean())
            errors.append(groups.std(ddof=1) / math.sqrt(32))
        # 32 groups: the error of the error widens the tails; a t law of 31 degrees
        z = abs(shares[0] - shares[1]) / math.hypot(*errors)
        assert z < 5.0, (late, shares, errors)


def test_straight_light_over_still_water_has_one_delay():
    link = mt.Link(water=mt.Water(b=0.0), receiver=mt.Receiver(radius=0.01))
    r = mt.simulate(link, FlatSea(), photons=64, record=[mt.Arrivals()], extent=3.0, spacing=0.05)
    i = impulse_response(r, bin_width=1e-12)
    expected = (1.33 * 10.0 + 5.0) / impulse.SPEED_OF_LIGHT
    # unscattered light is dated by the centroid of its facet
    assert i.first_arrival == pytest.approx(expected, rel=3e-5)
    assert i.rms_delay_spread < 1e-13
    assert i.mean_delay_stderr < 1e-20
    assert (i.h_stderr <= 1e-14 * i.h.max()).all()


def test_air_has_its_own_speed():
    """Water of index 1.33 under air of 1.0: 5 m more height is 5 m / c0 more."""
    delays = []
    for height in (5.0, 10.0):
        link = mt.Link(water=mt.Water(b=0.0), receiver=mt.Receiver(radius=0.01, height=height))
        r = mt.simulate(
            link, FlatSea(), photons=64, record=[mt.Arrivals()], extent=3.0, spacing=0.05
        )
        delays.append(impulse_response(r).first_arrival)
    assert delays[1] - delays[0] == pytest.approx(5.0 / impulse.SPEED_OF_LIGHT, rel=1e-4)


def test_transfer_function(forced):
    i = impulse_response(forced)
    h = i.transfer_function([0.0, 1e6, 1e8, 1e9, 1e10])
    assert h[0] == pytest.approx(1.0, abs=1e-14)
    assert (np.abs(h) <= 1.0 + 1e-12).all()
    # small frequencies: 1 - 2 pi i f tau - ...
    assert np.angle(h[1]) == pytest.approx(-2 * math.pi * 1e6 * i.mean_delay, rel=1e-4)
    small = 1e7
    fall = 1.0 - abs(i.transfer_function(small)[0]) ** 2
    assert fall == pytest.approx((2 * math.pi * small * i.rms_delay_spread) ** 2, rel=0.05)
    back = np.conj(i.transfer_function([-1e8]))
    assert back[0] == pytest.approx(h[2], abs=1e-14)


def test_moments_are_those_of_the_arrivals(forced):
    i = impulse_response(forced)
    mean = np.average(i.delay, weights=i.weight)
    spread = math.sqrt(np.average((i.delay - mean) ** 2, weights=i.weight))
    assert i.mean_delay == pytest.approx(mean, rel=1e-9)
    assert i.rms_delay_spread == pytest.approx(spread, rel=1e-9)
    assert i.delay.min() == 0.0


@pytest.mark.slow
def test_errors_of_the_delays_are_the_scatter_over_seeds():
    """Reported error against the scatter of 24 seeds, chi-square."""
    from scipy import stats

    rows = []
    for seed in range(24):
        r = mt.simulate(LINK, MESH, photons=600, seed=seed, record=[mt.Arrivals()])
        i = impulse_response(r)
        rows.append((i.first_arrival + i.mean_delay, i.mean_delay_stderr))
    value, error = np.array(rows).T
    chi2 = ((value - value.mean()) ** 2).sum() / (error**2).mean()
    # the errors themselves are good to some 10 % each
    assert ALPHA / 2 < stats.chi2.sf(chi2, 23) < 1 - ALPHA / 2


def test_the_error_of_a_mean_delay_is_that_of_the_mean_of_its_groups():
    """Groups of one weight: the jackknife of their mean is s / sqrt(n). It was once 1.6 % lower."""
    rng, n, each = np.random.default_rng(3), tallies.SHIFTS, 50
    time = 1e-9 * rng.exponential(size=(n, each))
    group, zeros = np.repeat(np.arange(n), each), np.zeros(n * each)
    integers = np.zeros(n * each, np.int64)
    arrivals = tallies.ArrivalTally(
        receiver=integers, weight=zeros + 1e-6, water_path=zeros, air_path=zeros,
        time=time.ravel(), angle=zeros, azimuth=zeros, group=group, sample=integers, part=integers,
        order=integers,
    )  # fmt: skip
    error = time.mean(axis=1).std(ddof=1) / math.sqrt(n)
    assert impulse.response_of(arrivals).mean_delay_stderr == pytest.approx(error, rel=1e-9)


def test_what_is_wrong_is_refused(forced):
    with pytest.raises(ValueError, match="bin_width"):
        impulse_response(forced, bin_width=0.0)
    with pytest.raises(ValueError, match="receiver"):
        impulse_response(forced, receiver=2)
    with pytest.raises(ValueError, match="Arrivals"):
        impulse_response(mt.simulate(LINK, MESH, photons=64))
