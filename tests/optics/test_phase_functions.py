"""Phase functions: closed forms, published values, moments, errors and round trips."""

from decimal import Decimal, getcontext

import numpy as np
import pydantic
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meshtrace import models
from meshtrace.errors import Refused
from meshtrace.optics import (
    FournierForand,
    HenyeyGreenstein,
    HistogramPhase,
    MixturePhase,
    Petzold,
    PhaseFunction,
    Rayleigh,
    TabulatedPhase,
)

# theta [deg], CDF, phase function [1/sr]: closed form and quadrature in 30 digits
FF_TABLE = np.array(
    [
        (0.1, 0.06828709, 2.07508924e3),
        (0.5, 0.17281362, 2.05087604e2),
        (1.0, 0.25456715, 7.27837825e1),
        (2.0, 0.36720088, 2.42444137e1),
        (5.0, 0.55895674, 4.70246011),
        (10.0, 0.71185962, 1.09623656),
        (20.0, 0.83955470, 2.07733350e-1),
        (30.0, 0.89545733, 7.30562830e-2),
        (60.0, 0.95979570, 1.18353036e-2),
        (90.0, 0.98168732, 4.19331920e-3),
        (120.0, 0.99172458, 2.62489251e-3),
        (150.0, 0.99767755, 2.67342127e-3),
    ]
)

# backscatter fraction of the Ocean Optics Web Book's Fournier-Forand table, and more digits of it
FF_BACKSCATTER = [
    (1.021, 3.0742, 1.0329e-4, 1e-8),
    (1.04, 3.201, 1.00265e-3, 1e-8),
    (1.08, 3.483, 0.0100372, 1e-7),
    (1.175, 4.065, 0.1000781, 1e-7),
    (1.15, 4.874, 0.4005216, 1e-7),
]

EDGES = np.linspace(0.0, np.pi, 41)
ALL = [
    FournierForand(),
    FournierForand(cdf_coef="paper"),
    FournierForand(n=1.175, mu=4.065),
    HenyeyGreenstein(g=0.924),
    HenyeyGreenstein(g=0.0),
    HenyeyGreenstein(g=-0.6),
    Rayleigh(),
    Rayleigh.sea_water(),
    Rayleigh(gamma=0.0),
    Petzold(),
    Petzold(water="clear"),
    TabulatedPhase(theta_deg=(0.0, 2.0, 20.0, 90.0, 150.0), value=(7.0, 5.0, 0.4, 0.01, 0.02)),
    HistogramPhase(theta_edges=EDGES, cdf=HenyeyGreenstein(g=0.5).cdf(EDGES)),
    MixturePhase(
        components=(Petzold(), MixturePhase(components=(Rayleigh(),), weights=(2.0,))),
        weights=(3.0, 1.0),
    ),
]
NAMES = [f"{i}-{phase.kind}" for i, phase in enumerate(ALL)]


def integral(phase, function=np.ones_like, low=1e-9, high=np.pi):
    """Integrate 2 pi pdf function sin over theta by Gauss' rule in log(theta) between kinks."""
    x, weight = np.polynomial.legendre.leggauss(24)
    kinks_deg = np.concatenate([(10.0 ** np.arange(-1.0, 1.0, 0.1)).round(3), np.arange(2, 180)])
    breaks = np.concatenate([np.geomspace(low, high, 60), np.radians(kinks_deg), EDGES])
    breaks = np.log(np.unique(breaks[(breaks >= low) & (breaks <= high)]))[:, None]
    theta = np.exp(breaks[:-1] + np.diff(breaks, axis=0) * (x + 1.0) / 2.0)
    density = 2.0 * np.pi * phase.pdf(theta) * function(theta) * np.sin(theta) * theta
    return np.sum(weight * density * np.diff(breaks, axis=0)) / 2.0


def test_fournier_forand_table():
    theta = np.radians(FF_TABLE[:, 0])
    phase = FournierForand(n=1.1, mu=3.5835)
    np.testing.assert_allclose(phase.cdf(theta), FF_TABLE[:, 1], atol=5.1e-9)
    np.testing.assert_allclose(phase.pdf(theta), FF_TABLE[:, 2], rtol=5e-9)


def test_fournier_forand_moments():
    phase = FournierForand()
    assert phase.backscatter_fraction == pytest.approx(0.0183126758, abs=5e-11)
    assert phase.mean_cosine == pytest.approx(0.929963058, abs=5e-10)


@pytest.mark.parametrize(("n", "mu", "expected", "digits"), FF_BACKSCATTER)
def test_fournier_forand_backscatter_of_the_web_book(n, mu, expected, digits):
    assert FournierForand(n=n, mu=mu).backscatter_fraction == pytest.approx(expected, abs=digits)


def test_fournier_forand_forward_power_law():
    # F ~ 4.168222 s^0.29175 as s goes to 0
    theta = 1e-9
    assert FournierForand().cdf(theta) == pytest.approx(
        4.168222 * (theta / 2.0) ** 0.5835, rel=1e-6
    )
    assert FournierForand().pdf(0.0) == np.inf
    assert FournierForand().cdf(0.0) == 0.0
    assert FournierForand().cdf(np.pi) == pytest.approx(1.0, abs=1e-15)


def printed_phase_function(s, n, mu):
    """Evaluate the printed Fournier-Forand formula in 60 decimal digits."""
    getcontext().prec = 60
    s, n, mu = Decimal(s), Decimal(n), Decimal(mu)
    v = (3 - mu) / 2
    delta, delta_pi = 4 * s / (3 * (n - 1) ** 2), 4 / (3 * (n - 1) ** 2)
    four_pi = Decimal("12.566370614359172953850573533118011536788677597500423")
    dv, dpv, e = delta**v, delta_pi**v, 1 - delta
    first = (v * e - (1 - dv) + (delta * (1 - dv) - v * e) / s) / (four_pi * e**2 * dv)
    cos = 1 - 2 * s
    return float(first + (1 - dpv) / (4 * four_pi * (delta_pi - 1) * dpv) * (3 * cos**2 - 1))


@pytest.mark.parametrize("offset", [1e-1, 1.1e-2, 9e-3, 1e-3, 1e-5, 1e-9, 0.0])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_fournier_forand_is_smooth_through_its_removable_singularity(offset, sign):
    phase = FournierForand(n=1.1, mu=3.5835)
    s = 0.75 * (phase.n - 1.0) ** 2 * (1.0 + sign * offset)
    theta = 2.0 * np.arcsin(np.sqrt(s))
    # just off the zero of the denominator the formula has enough of its 60 digits left
    exact = printed_phase_function(Decimal(s) * (1 + Decimal("1e-20")), phase.n, phase.mu)
    assert phase.pdf(theta) == pytest.approx(exact, rel=1e-11)
    if offset == 0.0:
        assert phase.pdf(theta) == pytest.approx(1.1121216, abs=5e-8)


def test_the_paper_coefficient_differs_by_the_published_metrics():
    # D cos sin^2, D = (1/8 - 1/(16 pi)) K: RMSE D/4, MAE 2 D/(3 pi), maximum 2 D/(3 sqrt 3)
    theta = (np.arange(200_000) + 0.5) * np.pi / 200_000
    exact, paper = FournierForand(), FournierForand(cdf_coef="paper")
    difference = exact.cdf(theta) - paper.cdf(theta)
    assert np.sqrt(np.mean(difference**2)) == pytest.approx(6.2909e-4, abs=5e-9)
    assert np.mean(np.abs(difference)) == pytest.approx(5.3399e-4, abs=5e-9)
    assert np.max(difference) == pytest.approx(9.68547e-4, abs=5e-10)
    assert np.degrees(theta[np.argmax(difference)]) == pytest.approx(54.7356, abs=1e-3)
    grid = np.linspace(0.0, np.pi, 500)
    difference = exact.cdf(grid) - paper.cdf(grid)
    printed = [np.sqrt(np.mean(difference**2)), np.mean(np.abs(difference)), np.max(difference)]
    assert [f"{x:.2e}" for x in printed] == ["6.28e-04", "5.33e-04", "9.69e-04"]
    assert paper.backscatter_fraction == pytest.approx(exact.backscatter_fraction, abs=1e-15)
    assert paper.mean_cosine == pytest.approx(exact.mean_cosine, abs=1e-12)


def test_henyey_greenstein_closed_forms():
    phase = HenyeyGreenstein(g=0.929963058)
    assert phase.mean_cosine == pytest.approx(0.929963058, abs=1e-15)
    assert phase.backscatter_fraction == pytest.approx(0.0155625, abs=5e-8)
    theta = np.linspace(0.0, np.pi, 7)
    g = phase.g
    np.testing.assert_allclose(
        phase.pdf(theta),
        (1.0 - g**2) / (4.0 * np.pi * (1.0 + g**2 - 2.0 * g * np.cos(theta)) ** 1.5),
        rtol=1e-12,
    )


def test_henyey_greenstein_is_isotropic_at_zero():
    phase, theta = HenyeyGreenstein(g=0.0), np.linspace(0.0, np.pi, 7)
    np.testing.assert_allclose(phase.pdf(theta), 1.0 / (4.0 * np.pi), rtol=1e-15)
    np.testing.assert_allclose(phase.cdf(theta), 0.5 * (1.0 - np.cos(theta)), atol=1e-15)
    np.testing.assert_allclose(phase.sample([0.25, 0.5]), [np.pi / 3.0, np.pi / 2.0], rtol=1e-14)


def test_rayleigh_is_the_canonical_function():
    theta = np.linspace(0.0, np.pi, 7)
    np.testing.assert_allclose(
        Rayleigh().pdf(theta), 3.0 / (16.0 * np.pi) * (1.0 + np.cos(theta) ** 2), rtol=1e-14
    )
    # Mobley (1994): 0.06225 (1 + 0.835 cos^2) for pure sea water
    assert Rayleigh.sea_water().pdf(np.pi / 2.0) == pytest.approx(0.06225, abs=5e-6)
    np.testing.assert_allclose(
        Rayleigh(gamma=1e-12).sample([0.1, 0.7]), HenyeyGreenstein(g=0.0).sample([0.1, 0.7])
    )


@pytest.mark.parametrize(
    ("water", "b", "backscatter", "median_deg"),
    [
        # Petzold (1972): totals of the stations AUTEC 8, HAOCE 11 and NUC 2040
        ("clear", 0.037, 0.044, 6.252),
        ("coastal", 0.219, 0.013, 2.534),
        ("harbour", 1.824, 0.020, 4.680),
    ],
)
def test_petzold_integrals_are_those_he_published(water, b, backscatter, median_deg):
    phase = Petzold(water=water)
    assert phase.backscatter_fraction == pytest.approx(backscatter, abs=5.1e-4)
    assert np.degrees(phase.sample(0.5)) == pytest.approx(median_deg, rel=5e-3)
    vsf_at_90_deg = {"clear": 2.459e-4, "coastal": 5.241e-4, "harbour": 8.411e-3}[water]
    assert vsf_at_90_deg / phase.pdf(np.pi / 2.0) == pytest.approx(b, rel=6e-3)


def test_petzold_average_particle():
    phase = Petzold()
    assert phase.backscatter_fraction == pytest.approx(0.0183, abs=5e-5)
    assert phase.mean_cosine == pytest.approx(0.924, abs=5e-4)
    # printed values of Mobley (1994), table 3.10, of which the Web Book's file is 1.003 times
    printed = {0.1: 1.767e3, 1.0: 7.161e1, 10.0: 1.153, 90.0: 4.292e-3, 180.0: 3.154e-3}
    values = phase.pdf(np.radians(list(printed)))
    np.testing.assert_allclose(values / np.array(list(printed.values())), 1.0, atol=0.011)


@pytest.mark.parametrize("phase", ALL, ids=NAMES)
def test_pdf_integrates_to_one_and_to_the_cdf(phase):
    head = float(phase.cdf(1e-9))
    assert integral(phase) + head == pytest.approx(1.0, abs=1e-9)
    for theta in (1e-3, 0.3, EDGES[20], 2.5):
        assert integral(phase, high=theta) + head == pytest.approx(
            float(phase.cdf(theta)), abs=1e-9
        )


@pytest.mark.parametrize("phase", ALL, ids=NAMES)
def test_mean_cosine_and_backscatter_fraction_by_quadrature(phase):
    head = float(phase.cdf(1e-9))
    assert phase.mean_cosine == pytest.approx(integral(phase, np.cos) + head, abs=1e-9)
    assert phase.backscatter_fraction == pytest.approx(integral(phase, low=np.pi / 2), abs=1e-9)


@pytest.mark.parametrize("phase", ALL, ids=NAMES)
def test_cdf_grows_from_zero_to_one_and_pdf_is_not_negative(phase):
    theta = np.concatenate([[0.0], np.geomspace(1e-12, np.pi, 4001)])
    theta[-1] = np.pi
    cdf = phase.cdf(theta)
    assert cdf[0] == 0.0
    assert cdf[-1] == pytest.approx(1.0, abs=1e-14)
    assert np.all(np.diff(cdf) >= -1e-15)
    assert np.all(phase.pdf(theta) >= 0.0)


@settings(max_examples=60, deadline=None)
@given(n=st.floats(1.005, 1.4), mu=st.floats(3.02, 4.98), log_theta=st.floats(-9.0, 0.0))
def test_fournier_forand_property(n, mu, log_theta):
    phase = FournierForand(n=n, mu=mu)
    theta = np.pi * 10.0 ** np.array([log_theta - 1e-4, log_theta])
    low, high = phase.cdf(theta)
    assert 0.0 <= low <= high <= 1.0 + 1e-14
    step = 2.0 * np.pi * (np.cos(theta[0]) - np.cos(theta[1]))
    density = phase.pdf(theta)
    assert np.all(density >= 0.0)
    if theta[1] > 1e-4:
        assert high - low == pytest.approx(step * density.mean(), rel=1e-3, abs=1e-14)


@settings(max_examples=60, deadline=None)
@given(g=st.floats(-0.99, 0.99), u=st.floats(0.0, 1.0, exclude_max=True))
def test_henyey_greenstein_inversion_property(g, u):
    phase = HenyeyGreenstein(g=g)
    assert phase.cdf(phase.sample(u)) == pytest.approx(u, abs=5.2e-7)


def test_a_table_keeps_its_values_up_to_the_norm():
    theta_deg, value = (1.0, 10.0, 60.0, 180.0), (50.0, 2.0, 0.1, 0.3)
    phase = TabulatedPhase(theta_deg=theta_deg, value=value)
    ratio = phase.pdf(np.radians(theta_deg)) / np.array(value)
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-12)
    scaled = TabulatedPhase(theta_deg=theta_deg, value=[7.0 * x for x in value])
    np.testing.assert_allclose(scaled.pdf([0.1, 2.0]), phase.pdf([0.1, 2.0]), rtol=1e-12)


def test_a_fine_table_of_a_closed_form_gives_it_back():
    theta_deg = np.concatenate([np.geomspace(0.01, 5.0, 200), np.linspace(5.1, 180.0, 800)])
    phase = FournierForand()
    table = TabulatedPhase(theta_deg=theta_deg, value=phase.pdf(np.radians(theta_deg)))
    theta = np.radians([0.005, 0.1, 1.0, 17.3, 90.0, 179.0])
    np.testing.assert_allclose(table.cdf(theta), phase.cdf(theta), atol=3e-5)
    np.testing.assert_allclose(table.pdf(theta), phase.pdf(theta), rtol=1e-3)
    assert table.mean_cosine == pytest.approx(phase.mean_cosine, abs=3e-5)


def test_a_table_may_hold_the_power_whose_integral_is_a_logarithm():
    s = np.array([1e-4, 1e-3, 1.0])
    theta_deg = np.degrees(2.0 * np.arcsin(np.sqrt(s)))
    phase = TabulatedPhase(theta_deg=theta_deg, value=(1000.0, 1000.0, 1.0))
    # flat to s = 1e-3 (mass 1), then 1/s (mass ln 1000)
    assert phase.cdf(np.radians(theta_deg[1])) == pytest.approx(1.0 / (1.0 + np.log(1e3)), rel=1e-9)
    u = np.linspace(0.01, 0.99, 99)
    np.testing.assert_allclose(phase.cdf(phase.sample(u)), u, atol=5.2e-7)


def test_table_from_file(tmp_path):
    file = tmp_path / "phase.txt"
    file.write_text("# angle value\n0.5 100.0\n5 3.0  extra\n90 0.01\n180 0.02\n")
    expected = TabulatedPhase(theta_deg=(0.5, 5.0, 90.0, 180.0), value=(100.0, 3.0, 0.01, 0.02))
    assert TabulatedPhase.from_file(file) == expected
    file.write_text("0.5,100.0\n5,3.0\n90,0.01\n180,0.02\n")
    assert TabulatedPhase.from_file(file, delimiter=",") == expected


def test_histogram_is_flat_per_solid_angle_inside_its_bins():
    phase = HistogramPhase(theta_edges=(0.0, 0.2, 1.0, np.pi), cdf=(0.0, 0.5, 0.5, 1.0))
    solid_angle = 2.0 * np.pi * (1.0 - np.cos(0.2))
    np.testing.assert_allclose(phase.pdf([0.0, 0.1, 0.2]), 0.5 / solid_angle, rtol=1e-12)
    assert phase.pdf(0.5) == 0.0
    assert phase.sample(0.5) >= 1.0 - 1e-12


def test_mixture_weighs_its_components():
    parts = (FournierForand(), Rayleigh())
    mixture, theta = MixturePhase(components=parts, weights=(3.0, 1.0)), np.array([0.01, 1.0, 3.0])
    expected = 0.75 * parts[0].pdf(theta) + 0.25 * parts[1].pdf(theta)
    np.testing.assert_allclose(mixture.pdf(theta), expected, rtol=1e-13)
    assert mixture.mean_cosine == pytest.approx(0.75 * parts[0].mean_cosine, rel=1e-13)


@pytest.mark.parametrize("phase", ALL, ids=NAMES)
def test_round_trip(phase):
    adapter = pydantic.TypeAdapter(models.FamilyField[PhaseFunction])
    assert adapter.validate_python(phase.model_dump()) == phase
    assert adapter.validate_json(phase.model_dump_json()) == phase
    assert hash(adapter.validate_python(phase.model_dump())) == hash(phase)


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"kind": "fournier-forand", "n": 1.0}, "n: 1.0, allowed: 1 < n <= 1.5"),
        ({"kind": "fournier-forand", "mu": float("nan")}, "mu: nan, allowed: finite"),
        ({"kind": "fournier-forand", "mu": 5.0}, "mu: 5.0, allowed: 3.01 <= mu < 5"),
        ({"kind": "henyey-greenstein", "g": 1.0}, "g: 1.0, allowed: -1 < g < 1"),
        ({"kind": "rayleigh", "gamma": 1.5}, "gamma: 1.5, allowed: 0 <= gamma <= 1"),
        ({"kind": "petzold", "water": "muddy"}, "water: 'muddy', allowed: average, clear"),
        ({"kind": "tabulated", "theta_deg": [1, 2], "value": [1]}, "2 and 1 numbers"),
        ({"kind": "tabulated", "theta_deg": [0, 2], "value": [1, 1]}, "at least two with"),
        ({"kind": "tabulated", "theta_deg": [2, 1], "value": [1, 1]}, "theta_deg: .*increasing"),
        ({"kind": "tabulated", "theta_deg": [1, 181], "value": [1, 1]}, "theta_deg: .*181"),
        ({"kind": "tabulated", "theta_deg": [1, 2], "value": [1, 0]}, "value: 0.0, allowed"),
        ({"kind": "tabulated", "theta_deg": [1, 2], "value": [9, 1]}, "less steeply than"),
        ({"kind": "tabulated", "theta_deg": [1, 2], "value": [1, np.inf]}, "finite"),
        ({"kind": "histogram", "theta_edges": [0, 1], "cdf": [0, 1]}, "theta_edges: .*0 to pi"),
        ({"kind": "histogram", "theta_edges": [0, np.pi], "cdf": [0, 2]}, "cdf: .*0 to 1"),
        ({"kind": "histogram", "theta_edges": [0], "cdf": [0]}, "at least two"),
        ({"kind": "mixture", "components": [], "weights": []}, "components: .*at least 1"),
        (
            {"kind": "mixture", "components": [{"kind": "rayleigh"}], "weights": [0.0]},
            "weights: .*allowed",
        ),
        ({"kind": "nebula"}, "nebula"),
        ({"kind": "rayleigh", "colour": 1}, "colour"),
    ],
)
def test_errors_name_field_value_and_what_is_allowed(kwargs, message):
    with pytest.raises(Refused, match=message):
        PhaseFunction.read(kwargs)


def test_angles_and_uniforms_are_checked():
    phase = HenyeyGreenstein()
    for theta in (-0.1, 3.2, float("nan")):
        with pytest.raises(ValueError, match=r"theta: .*allowed: 0 <= theta <= pi"):
            phase.pdf(theta)
    for u in (-0.1, 1.0, float("nan")):
        with pytest.raises(ValueError, match=r"u: .*allowed: 0 <= u < 1"):
            phase.sample(u)
