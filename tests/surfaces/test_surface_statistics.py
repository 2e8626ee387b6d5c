import math

import numpy as np
import pytest
from scipy import stats

from meshtrace.surfaces import (
    Elfouhaily,
    FlatSea,
    Jonswap,
    JonswapSea,
    PiersonMoskowitz,
    SinusoidalSea,
    TiltedPlane,
)
from meshtrace.surfaces.statistics import (
    components_hs,
    components_slope_variance,
    cox_munk,
    hs,
    mean_square_slope,
    sampled_hs,
    sampled_slope_variance,
    spectral_moment,
    tp,
    unresolved_slope_variance,
)

PAPER = [
    # wind, band, Hs full, Hs in band, slope variance in band, its share of Cox-Munk
    (5.0, (1.2, 4.0), 0.552, 0.540, 0.00616, 0.22),
    (13.0, (0.9, 3.0), 1.305, 1.279, 0.00988, 0.14),
]


@pytest.mark.parametrize(("wind", "band", "full", "inside", "slopes", "share"), PAPER)
def test_reference_values_of_the_spectrum(wind, band, full, inside, slopes, share):
    spectrum = Jonswap(wind_speed=wind, fetch=30e3)
    assert hs(spectrum) == pytest.approx(full, abs=5e-4)
    assert hs(spectrum, *band) == pytest.approx(inside, abs=5e-4)
    mss = mean_square_slope(spectrum, omega_min=band[0], omega_max=band[1])
    assert mss == pytest.approx(slopes, abs=5.1e-6)
    assert mss / (0.003 + 5.12e-3 * wind) == pytest.approx(share, abs=5e-3)


@pytest.mark.parametrize(
    ("wind", "values"),
    [(5.0, (0.0147, 0.0213, 0.0252, 0.0318)), (13.0, (0.0272, 0.0372, 0.0431, 0.0532))],
)
def test_slope_variance_grows_with_the_band(wind, values):
    found = [mean_square_slope(Jonswap(wind_speed=wind), top) for top in (10, 20, 30, 60)]
    np.testing.assert_allclose(found, values, atol=5.1e-5)


@pytest.mark.parametrize(("wind", "along", "across"), [(5.0, 0.069, 0.040), (13.0, 0.087, 0.050)])
def test_slope_deviations_of_the_wave_sum(wind, along, across):
    waves = JonswapSea(wind_speed=wind, waves="paper").components
    variances = components_slope_variance(waves)
    np.testing.assert_allclose(np.sqrt(variances), [along, across], atol=5.1e-4)
    # cos^2 puts three quarters of the slopes along the wind.
    assert variances[0] == pytest.approx(3 * variances[1], rel=1e-12)


@pytest.mark.parametrize(("wind", "band", "full", "inside", "slopes", "share"), PAPER)
def test_wave_sum_is_the_midpoint_rule_of_the_spectrum(wind, band, full, inside, slopes, share):
    sea = JonswapSea(wind_speed=wind, waves="paper")
    waves, half = sea.components, 0.5 * sea.band.d_omega
    cells = band[0] - half, band[1] + half
    assert components_hs(waves) == pytest.approx(hs(sea.spectrum, *cells), rel=2e-3)
    assert sum(components_slope_variance(waves)) == pytest.approx(
        mean_square_slope(sea.spectrum, omega_min=cells[0], omega_max=cells[1]), rel=2e-3
    )


@pytest.mark.parametrize("wind", [5.0, 13.0])
@pytest.mark.parametrize("options", [{}, {"waves": "paper"}], ids=str)
def test_meshes_have_the_statistics_of_the_spectrum(wind, options):
    # Sampling error: seeds are independent, so the scatter of 60 meshes of 120 m by 120 m gives
    # the standard error of their mean. The family has 12 tests; alpha = 1e-4 for all of them.
    seeds, tests = 60, 12
    sea = JonswapSea(wind_speed=wind, seed=1000, **options)
    samples = []
    for i in range(seeds):
        mesh = sea.with_seed(1000 + i).mesh(extent=60.0, spacing=3.0)
        samples.append((sampled_hs(mesh) ** 2 / 16, *sampled_slope_variance(mesh)))
    samples = np.array(samples)
    # Averaged over the phases, a finite patch misses the variance of its own mean.
    patch = components_hs(sea.components) ** 2 / 16
    patch -= _variance_of_the_mean(sea.components)
    along, across = components_slope_variance(sea.components)
    error = samples.std(axis=0, ddof=1) / math.sqrt(seeds)
    t = (samples.mean(axis=0) - [patch, along, across]) / error
    limit = stats.t.isf(0.5 * (1 - (1 - 1e-4) ** (1 / tests)), seeds - 1)
    assert (np.abs(t) < limit).all(), t
    assert (error / [patch, along, across] < 0.06).all()


def _variance_of_the_mean(waves):
    window = np.sinc(60.0 * waves.kx / math.pi) * np.sinc(60.0 * waves.ky / math.pi)
    return 0.5 * np.sum((waves.amplitude * window) ** 2)


def test_samples_of_a_plane_and_a_sinusoid():
    plane = TiltedPlane(slope_x=0.3, slope_y=0.4).mesh(extent=1.0, spacing=0.1)
    np.testing.assert_allclose(sampled_slope_variance(plane), [0.09, 0.16], rtol=1e-12)
    wind = math.degrees(math.atan2(0.4, 0.3))
    np.testing.assert_allclose(sampled_slope_variance(plane, wind), [0.25, 0.0], atol=1e-12)
    wave = SinusoidalSea(amplitude=0.1, wavelength=2.0).mesh(extent=2.0, spacing=0.02)
    assert sampled_hs(wave) == pytest.approx(4 * 0.1 / math.sqrt(2), rel=1e-3)
    assert sampled_slope_variance(wave)[0] == pytest.approx((0.1 * math.pi) ** 2 / 2, rel=1e-3)
    assert sampled_hs(FlatSea(height=3.0).mesh(extent=1.0)) == pytest.approx(0.0, abs=1e-12)


def test_graded_meshes_are_not_biased():
    sea = SinusoidalSea(amplitude=0.1, wavelength=10.0)
    graded = sea.mesh(extent=20.0, spacing=0.05, fine_extent=2.0, coarse_spacing=0.5)
    # Within 2 m of a crest the water is high: without areas the mean square is 20 % off.
    assert sampled_hs(graded) == pytest.approx(4 * 0.1 / math.sqrt(2), rel=5e-3)


def test_moments():
    # Without peak enhancement: m0 = a / (5 w^4), m2 = a sqrt(pi / 20) ... of a Bretschneider sea.
    spectrum = PiersonMoskowitz(wind_speed=10.0)
    scale, w = 0.0081 * 9.81**2, spectrum.omega_p
    assert spectral_moment(spectrum, 0) == pytest.approx(scale / (5 * w**4), rel=1e-12)
    closed = scale / w**2 * math.sqrt(math.pi / 5) / 2
    assert spectral_moment(spectrum, 2) == pytest.approx(closed, rel=1e-9)
    m4 = spectral_moment(spectrum, 4, omega_max=10.0)
    assert m4 / 9.81**2 == pytest.approx(mean_square_slope(spectrum, 10.0), rel=1e-12)
    split = spectral_moment(spectrum, 0, 0.0, 0.7) + spectral_moment(spectrum, 0, 0.7)
    assert split == pytest.approx(scale / (5 * w**4), rel=1e-12)
    assert spectral_moment(spectrum, 0, 0.0, 0.01) == 0.0
    assert tp(spectrum) == 2 * math.pi / w


def test_cox_munk():
    for wind in (1.0, 5.0, 13.0):
        along, across = cox_munk(wind)
        assert along + across == pytest.approx(0.003 + 5.12e-3 * wind, rel=0.02)
        assert along == 3.16e-3 * wind


def test_unresolved_slopes():
    resolved = components_slope_variance(JonswapSea(wind_speed=13.0).components)
    missing = unresolved_slope_variance(cox_munk(13.0), resolved)
    np.testing.assert_allclose(np.add(resolved, missing), cox_munk(13.0), rtol=1e-14)
    assert unresolved_slope_variance(cox_munk(5.0), (1.0, 0.0)) == (0.0, cox_munk(5.0)[1])
    with pytest.raises(ValueError, match=r"resolved\[0\]: -0\.1, allowed: >= 0"):
        unresolved_slope_variance(cox_munk(5.0), (-0.1, 0.0))


def test_capillary_dispersion_lowers_the_mean_square_slope():
    spectrum = Elfouhaily(wind_speed=8.0)
    gravity = mean_square_slope(spectrum, 200.0)
    assert mean_square_slope(spectrum, 200.0, capillary=True) < 0.9 * gravity


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda s: spectral_moment(s, 4),
            "omega_max: None, allowed: a finite limit .rad.s. for order 4",
        ),
        (lambda s: spectral_moment(s, 0, 3.0, 2.0), "omega_max: 2.0, allowed: 3 < omega_max"),
        (lambda s: spectral_moment(s, 0, -1.0), "omega_min: -1.0"),
        (lambda s: mean_square_slope(s, math.nan), "omega_max: nan"),
        (lambda s: cox_munk(-1.0), "wind_speed: -1.0"),
    ],
)
def test_refuses(call, message):
    with pytest.raises(ValueError, match=message):
        call(Jonswap())
