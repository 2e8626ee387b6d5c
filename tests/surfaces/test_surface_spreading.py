import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meshtrace.surfaces import (
    Cos2sSpreading,
    ElfouhailySpreading,
    IttcSpreading,
    MitsuyasuSpreading,
)
from meshtrace.surfaces.bands import direction_grid, direction_weights


def density(spreading, theta, omega=1.0):
    return spreading.density(omega, theta, **SEA)


CIRCLE = np.linspace(-math.pi, math.pi, 40_001)
OMEGA = np.array([0.8, 1.4, 1.9, 3.0, 9.0])
SEA = {"omega_p": 1.4147, "wind_speed": 13.0}
ALL = [
    IttcSpreading(),
    Cos2sSpreading(),
    Cos2sSpreading(s=0.5),
    MitsuyasuSpreading(),
    ElfouhailySpreading(),
]


@pytest.mark.parametrize("spreading", ALL, ids=repr)
def test_density_integrates_to_one_and_stays_in_its_half_range(spreading):
    density = spreading.density(OMEGA[:, None], CIRCLE, **SEA)
    assert density.shape == (len(OMEGA), len(CIRCLE))
    assert (density >= 0.0).all()
    # The folded Elfouhaily density jumps at +-pi/2, hence no more than the grid's resolution.
    np.testing.assert_allclose(np.trapezoid(density, CIRCLE, axis=1), 1.0, rtol=1e-4)
    outside = np.abs(CIRCLE) > spreading.half_range + 1e-12
    assert (density[:, outside] == 0.0).all()


@given(s=st.floats(1e-9, 300.0))
@settings(max_examples=40, deadline=None, derandomize=True)
def test_cos_2s_integrates_to_one(s):
    # the trapezoidal rule loses a little at the cusp of s < 1/2
    whole = np.trapezoid(density(Cos2sSpreading(s=s), CIRCLE), CIRCLE)
    assert whole == pytest.approx(1.0, rel=1e-6 if s >= 0.5 else 1e-4)


def test_ittc_is_cos_2s_squeezed():
    theta = np.linspace(-math.pi / 2, math.pi / 2, 51)
    squeezed = 2.0 * density(Cos2sSpreading(s=1.0), 2.0 * theta)
    np.testing.assert_allclose(density(IttcSpreading(), theta), squeezed, atol=1e-15)


def test_mitsuyasu_exponent_peaks_at_the_peak():
    exponent = MitsuyasuSpreading.exponent
    assert exponent(2.0, 2.0, 9.81 / 2.0) == pytest.approx(11.5, rel=1e-14)
    s = exponent([1.0, 2.0, 4.0], 2.0, 9.81 / 2.0)
    np.testing.assert_allclose(s, 11.5 * np.array([2.0**-5, 1.0, 2.0**-2.5]), rtol=1e-14)


@pytest.mark.parametrize(("d_theta", "count"), [(math.pi / 5, 6), (math.pi / 20, 21)])
def test_directions_of_the_paper(d_theta, count):
    theta = direction_grid(math.pi / 2, d_theta)
    assert len(theta) == count
    np.testing.assert_allclose(theta[[0, -1]], [-math.pi / 2, math.pi / 2], rtol=1e-15)
    # cos^2 sums to one on these grids without any normalization,
    assert np.sum(density(IttcSpreading(), theta)) * d_theta == pytest.approx(1.0, rel=1e-14)
    shares = direction_weights(IttcSpreading(), [1.0], theta, d_theta, **SEA)
    # so that the shares in use are the paper's D d_theta.
    np.testing.assert_allclose(
        shares[0], density(IttcSpreading(), theta) * d_theta, rtol=1e-13, atol=1e-30
    )


@pytest.mark.parametrize("spreading", ALL, ids=repr)
@pytest.mark.parametrize("d_theta", [math.pi / 20, 0.1, 0.37])
def test_shares_sum_to_one_on_any_grid(spreading, d_theta):
    theta = direction_grid(spreading.half_range, d_theta)
    np.testing.assert_allclose(theta, -theta[::-1], atol=1e-15)
    np.testing.assert_allclose(np.diff(theta), d_theta, rtol=1e-12)
    assert theta[-1] <= spreading.half_range + 1e-12
    assert theta[-1] - theta[0] < 2.0 * math.pi - 1e-9
    shares = direction_weights(spreading, OMEGA, theta, d_theta, **SEA)
    assert shares.shape == (len(OMEGA), len(theta))
    np.testing.assert_allclose(shares.sum(axis=1), 1.0, rtol=1e-14)


def test_folded_elfouhaily_keeps_the_slope_ratio():
    theta = direction_grid(math.pi / 2, math.pi / 40)
    shares = direction_weights(ElfouhailySpreading(), OMEGA, theta, math.pi / 40, **SEA)
    density = ElfouhailySpreading().density(OMEGA, 0.0, **SEA)
    delta = math.pi * density - 1.0
    np.testing.assert_allclose(shares @ np.cos(theta) ** 2, 0.5 + 0.25 * delta, rtol=1e-12)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: density(IttcSpreading(), math.nan), "theta: nan"),
        (lambda: direction_grid(math.pi / 2, 2.0), "d_theta: 2.0, allowed: 0 < d_theta <= 1.57"),
        (lambda: Cos2sSpreading(s=-2.0), "s: -2.0, allowed: > 0"),
        (lambda: MitsuyasuSpreading.exponent(1.0, 0.0, 5.0), "omega_p: 0.0, allowed: > 0"),
    ],
)
def test_refuses(call, message):
    with pytest.raises(ValueError, match=message):
        call()
