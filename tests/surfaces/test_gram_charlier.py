"""Skewness and peakedness of slopes: moments by quadrature, the density, coefficients of seas."""

import math

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.engine.setup import arrays
from meshtrace.errors import Refused
from meshtrace.kernels import interface
from meshtrace.surfaces import GramCharlier, JonswapSea, MeasuredSea, SumSea, sea_from_config
from meshtrace.surfaces.statistics import cox_munk

LAWS = [GramCharlier.cox_munk(u) for u in (2.0, 5.0, 10.0, 14.0)]
LAWS += [GramCharlier.breon_henriot(u) for u in (5.0, 13.0)]
LAWS += [GramCharlier(c21=0.3, c03=-0.6, c40=1.2, c22=0.4, c04=0.8), GramCharlier(c40=-0.5)]


def formula(law, xi, eta):
    """Return the series over the Gaussian density, as printed."""
    f = 1.0 - 0.5 * law.c21 * (xi**2 - 1.0) * eta - law.c03 * (eta**3 - 3.0 * eta) / 6.0
    f += law.c40 * (xi**4 - 6.0 * xi**2 + 3.0) / 24.0
    f += law.c22 * (xi**2 - 1.0) * (eta**2 - 1.0) / 4.0
    return f + law.c04 * (eta**4 - 6.0 * eta**2 + 3.0) / 24.0


def moments(over, xi, eta, mass):
    """Return integral, means, variances and the five coefficients of a density."""
    mean = [float((mass * over * v).sum()) for v in (
        1.0, xi, eta, xi**2, eta**2, xi * eta, -(xi**2) * eta, -(eta**3), xi**4 - 3.0,
        xi**2 * eta**2 - 1.0, eta**4 - 3.0,
    )]  # fmt: skip
    return np.array(mean)


def wanted(law):
    return np.array([1.0, 0.0, 0.0, 1.0, 1.0, 0.0, law.c21, law.c03, law.c40, law.c22, law.c04])


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_moments_of_the_series(law):
    x, w = np.polynomial.hermite_e.hermegauss(12)
    xi, eta = np.meshgrid(x, x, indexing="ij")
    mass = np.outer(w, w) / (2.0 * math.pi)
    np.testing.assert_allclose(
        moments(formula(law, xi, eta), xi, eta, mass), wanted(law), atol=1e-12
    )


@pytest.mark.thorough
@pytest.mark.parametrize("law", LAWS, ids=str)
def test_the_density_is_positive_and_keeps_all_moments(law):
    line = np.arange(-9.0, 9.0, 0.02)
    xi, eta = np.meshgrid(line, line, indexing="ij")
    mass = np.exp(-0.5 * (xi**2 + eta**2)) / (2.0 * math.pi) * 0.02**2
    over = interface.over_gaussian.py_func(law.series, -eta, xi)
    assert over.min() >= 0.0
    np.testing.assert_allclose(moments(over, xi, eta, mass), wanted(law), atol=1e-4)
    series = formula(law, xi, eta)
    off = 0.5 * float((mass * np.abs(over - series)).sum())
    cut = float((mass * np.maximum(-series, 0.0)).sum())
    assert cut <= off + 1e-12
    assert off < 0.06
    if law == LAWS[1]:
        assert off < 1e-7


def test_coefficients_of_cox_and_munk_and_of_breon_and_henriot():
    clean, space = GramCharlier.cox_munk(10.0), GramCharlier.breon_henriot(10.0)
    assert list(clean.model_dump().values()) == pytest.approx([-0.076, -0.29, 0.40, 0.12, 0.23])
    found = [-0.091, -0.45 / (1.0 + math.exp(-3.0)), 0.30, 0.12, 0.40]
    assert list(space.model_dump().values()) == pytest.approx(found)


def test_random_slopes_have_the_cumulants_of_the_sea():
    """Gaussian waves add none: over smaller deviations the coefficients are larger."""
    sea = JonswapSea(wind_speed=10.0, slope_law="cox-munk", wind_direction_deg=30.0)
    whole, law = cox_munk(10.0), GramCharlier.cox_munk(10.0)
    for spacing in (0.2, 2.0):
        left = sea.unresolved_slopes(spacing)
        assert left.cumulants.along3 == pytest.approx(law.c03 * whole[0] ** 1.5)
        assert left.cumulants.along_across2 == pytest.approx(law.c21 * whole[0] ** 0.5 * whole[1])
        assert left.cumulants.across4 == pytest.approx(law.c40 * whole[1] ** 2)
    mesh = sea.mesh(extent=4.0, spacing=0.2)
    a, c = mesh.unresolved.vertex
    series = arrays.surface_arrays(mesh, "vertex", "tilt").roughness.series
    part = {
        "c03": law.c03 * (whole[0] / a) ** 1.5,
        "c21": law.c21 * (whole[0] / a) ** 0.5 * whole[1] / c,
        "c04": law.c04 * (whole[0] / a) ** 2,
        "c22": law.c22 * whole[0] * whole[1] / (a * c),
        "c40": law.c40 * (whole[1] / c) ** 2,
    }
    np.testing.assert_allclose(series, GramCharlier(**part).series, rtol=1e-9)
    assert arrays.surface_arrays(mesh, "vertex", "none").roughness.series == interface.GAUSSIAN


def test_gaussian_waves_and_skewed_slopes_add_to_the_series_of_the_sea():
    """A quarter of the variance is that of the mesh, at 5 m/s, where no series is negative."""
    law, share = GramCharlier.cox_munk(5.0), 0.25
    rest = (1.0 - share) ** 0.5
    part = GramCharlier(
        **{k: v / rest ** (3 if k in ("c21", "c03") else 4) for k, v in law.model_dump().items()}
    )
    x, w = np.polynomial.hermite_e.hermegauss(40)
    for eta, xi in ((0.0, 0.0), (-1.2, 0.4), (2.0, -1.5)):
        along, across = np.meshgrid(-eta - share**0.5 * x, xi - share**0.5 * x, indexing="ij")
        along, across = along / rest, across / rest
        gauss = np.exp(-0.5 * (along**2 + across**2)) / (2.0 * math.pi * rest**2)
        p = gauss * interface.over_gaussian.py_func(part.series, along, across)
        found = (np.outer(w, w) / (2.0 * math.pi) * p).sum()
        whole = math.exp(-0.5 * (xi**2 + eta**2)) / (2.0 * math.pi)
        whole *= interface.over_gaussian.py_func(law.series, -eta, xi)
        assert found == pytest.approx(whole, rel=1e-5)


def test_seas_keep_their_law():
    sea = JonswapSea(slope_law={"c03": -0.2})
    assert sea_from_config(sea.to_config()) == sea
    assert sea.short_waves.slope_law == sea.slope_law
    both = SumSea(parts=[sea, JonswapSea(wind_speed=2.0)])
    assert both.slope_cumulants == sea.slope_cumulants
    table = {"omega": [1.0, 2.0], "theta": [0.0], "variance": [[0.02], [0.005]]}
    measured = MeasuredSea(**table, mss="cox-munk", wind_speed=7.0, slope_law="cox-munk")
    expected = GramCharlier.cox_munk(7.0).cumulants(cox_munk(7.0))
    assert measured.slope_cumulants == expected
    text = "[sea]\nspectrum = 'jonswap'\nslope_law = 'breon-henriot'"
    assert mt.Scenario.from_toml(text).surface.slope_law == "breon-henriot"
    text = "[sea]\nspectrum = 'jonswap'\nslope_law = {c03 = -0.2}"
    assert mt.Scenario.from_toml(text).surface.slope_law == sea.slope_law


@pytest.mark.parametrize(
    "made",
    [
        lambda: GramCharlier(c03=1.5),  # more than the peakedness allows
        lambda: GramCharlier(c40=4.0),
        lambda: JonswapSea(slope_law="log"),
        lambda: JonswapSea(slope_law="cox-munk", mss="band"),
        lambda: mt.light_pattern(mt.Link(), JonswapSea(slope_law="cox-munk"), 1.0, 0.1),
        # of an eighth of the variance
        lambda: mt.simulate(
            mt.Link(),
            JonswapSea(hs=1.0, tp=1.2, slope_law="cox-munk"),
            photons=64,
        ),
    ],
)
def test_refusals(made):
    with pytest.raises(Refused, match="slope_law"):
        made()


def test_without_coefficients_slopes_are_gaussian_bit_for_bit():
    assert GramCharlier().series == interface.GAUSSIAN
    sea = JonswapSea(wind_speed=8.0, seed=2)
    plain, zero = (
        mt.simulate(mt.Link(), s, photons=256, seed=1).gain
        for s in (sea, sea.model_copy(update={"slope_law": GramCharlier()}))
    )
    assert plain == zero
