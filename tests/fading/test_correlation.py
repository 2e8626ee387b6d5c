"""Correlation of the fading of receivers and lamps: closed form, statistics of series, plots."""

import numpy as np
import pytest

import meshtrace as mt
from meshtrace import viz
from meshtrace.errors import Refused
from meshtrace.fading import gain_autocovariance, gain_correlation
from meshtrace.fading.spatial import _covariances
from meshtrace.fading.spectral import open_for_fading, slopes_seen
from meshtrace.surfaces import FlatSea, resolved_sea, sea_in_wind

CLEAR = mt.Link(water=mt.Water(a=0.1, b=0.0))
SEA = sea_in_wind(5.0)


def test_correlation_of_the_reference():
    """Another integral of the two-point spectrum, made for the trial (three digits)."""
    along, across = (gain_correlation(CLEAR, SEA, [0.1, 0.2, 0.4], az) for az in (0.0, 90.0))
    np.testing.assert_allclose(along, [0.872, 0.575, 0.083], atol=2e-3)
    np.testing.assert_allclose(across, [0.874, 0.597, 0.186], atol=2e-3)


def test_at_one_place():
    """At distance 0 it is 1, and the covariance behind it that at lag 0, by other nodes."""
    assert gain_correlation(CLEAR, SEA, [[0.0], [1e-9]]) == pytest.approx(np.ones((2, 1)))
    sea = open_for_fading(CLEAR, SEA)
    parts = slopes_seen(CLEAR, sea, sea.band.omega_max)
    for heights in (False, True):
        here = _covariances(*parts, np.zeros((1, 2)), heights)
        assert here == pytest.approx(
            gain_autocovariance(CLEAR, SEA, [0.0], heights=heights), rel=2e-4
        )


def test_directions_and_ends():
    turned = sea_in_wind(5.0).model_copy(update={"wind_direction_deg": 90.0})
    across = gain_correlation(CLEAR, SEA, [0.3], 90.0)
    assert gain_correlation(CLEAR, turned, [0.3]) == pytest.approx(across)
    # light of two lamps crosses n h / d times as far apart as light to two receivers
    n, h, d = CLEAR.water.n / CLEAR.n_air, CLEAR.receiver.height, CLEAR.transmitter.depth
    lamps = gain_correlation(CLEAR, SEA, [0.3], end="transmitter")
    assert lamps == pytest.approx(gain_correlation(CLEAR, SEA, [0.3 * n * h / d]))


def test_weak_fading_is_that_of_the_first_order():
    r"""To first order the covariance is $\beta^2 \int k^4 \Psi |H|^2 \cos(k \cdot \delta)$."""
    link = mt.Link(transmitter=mt.Led(depth=10.0), receiver=mt.Receiver(height=0.3, radius=0.1))
    sea = resolved_sea(5.0).model_copy(update={"omega_max": 6.0, "mss": "band"})
    lever, spectrum, _ = slopes_seen(link, sea, 6.0)
    k, share = spectrum.k, lever.aperture / 0.1
    from scipy.special import j0, j1

    disk = 2.0 * j1(k * lever.aperture) / (k * lever.aperture)
    weight = spectrum.variance * (k * lever.beta * disk) ** 2

    def covariance(distance):
        # J_0 - 2 c_2 cos(2 phi) J_2 + ... of the spreading, along the wind, up to the fourth order
        from scipy.special import jv

        z = k * share * distance
        waves = j0(z) + sum(
            2.0 * (-1.0) ** (m // 2) * spectrum.harmonics[m] * jv(m, z) for m in range(2, 13, 2)
        )
        return float(np.sum(weight * waves))

    distances = np.array([0.5, 2.0])
    expected = [covariance(d) / covariance(0.0) for d in distances]
    np.testing.assert_allclose(gain_correlation(link, sea, distances), expected, atol=0.01)


@pytest.mark.parametrize(
    ("call", "field"),
    [
        (lambda: gain_correlation(CLEAR, SEA, [-0.1]), "distances"),
        (lambda: gain_correlation(CLEAR, SEA, [0.1], np.inf), "azimuth_deg"),
        (lambda: gain_correlation(CLEAR, FlatSea(), [0.1]), "surface"),
        (lambda: gain_correlation(CLEAR, SEA, [0.1], end="lamp"), "end"),
    ],
)
def test_refusals(call, field):
    with pytest.raises(Refused) as refusal:
        call()
    assert refusal.value.field == field


def _series(along="realization"):
    """Return gains with a known correlation of 0.6."""
    z = np.random.default_rng(2).standard_normal((2, 400))
    gain = 1e-5 * (1.0 + 0.1 * np.stack([z[0], 0.6 * z[0] + 0.8 * z[1]], axis=1))
    link = {"receiver": [{"position": [0.0, 0.0]}, {"position": [0.3, 0.4]}]}
    errors = 1e-3 * gain, gain, np.full(2, 1e-9)
    return mt.GainSeries(along, np.arange(400.0), gain, *errors, provenance={"link": link})


def test_correlation_of_a_series():
    series = _series()
    (pair,) = series.correlated_pairs()
    assert abs(pair.correlation - 0.6) < 4.0 * pair.stderr
    assert pair.stderr == pytest.approx(0.64 / 20.0, rel=0.2)
    assert pair.distance == pytest.approx(0.5)
    assert f"{pair.correlation:.3f} +- {pair.stderr:.3f}, 0.5 m apart" in series.summary()
    assert _series("time").correlation_stderr[0, 1] >= pair.stderr


def test_constant_gains_have_no_correlation():
    gain = np.ones((3, 2))
    series = mt.GainSeries("time", np.arange(3.0), gain, 0.0 * gain, gain, np.zeros(2))
    assert np.isnan(series.correlation).all()
    assert "correlation" not in series.summary()
    with pytest.raises(Refused, match="fade"):
        viz.plot_correlation(series)


def test_plots():
    bars = viz.plot(_series())
    assert len(bars.patches) == 1
    assert bars.patches[0].get_width() == pytest.approx(_series().correlation[0, 1])
    assert "correlation 0." in viz.plot(_series("time")).get_title(loc="left")


@pytest.mark.slow
def test_receivers_over_seas():
    """Receivers 0.2 and 0.4 m apart along and across, over 300 seas (alpha 1e-4, Sidak)."""
    places = [(0.0, 0.0), (0.2, 0.0), (0.0, 0.2), (0.4, 0.0), (0.0, 0.4)]
    link = CLEAR.replace("receiver", [mt.Receiver(position=place) for place in places])
    series = mt.ensemble(link, 300, SEA, photons=32)
    gains = np.log(series.gain)
    expected = np.ravel(
        [gain_correlation(CLEAR, SEA, [d], az) for d in (0.2, 0.4) for az in (0, 90)]
    )
    found = series.correlation[0, 1:]
    # the scatter of Pearson's coefficient of skewed gains: by resampling of the seas
    rng = np.random.default_rng(1)
    again = [
        np.corrcoef(series.gain[rng.integers(0, len(gains), len(gains))].T)[0, 1:]
        for _ in range(400)
    ]
    assert (np.abs(found - expected) < 4.2 * np.std(again, axis=0) + 0.01).all()
