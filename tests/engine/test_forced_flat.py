"""Forced detection over still water: closed forms, quadratures, and honest standard errors.

Reference gains of physics.md section 6. The first order is a quadrature of the radiance along
refracted rays from the receiver, which knows neither chains nor roots.
"""

import math

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak, z_test
from scipy import stats

import meshtrace as mt
from meshtrace.engine.forced import ForcedDetection, TypicalSea
from meshtrace.optics import fresnel_reflectance
from meshtrace.surfaces import FlatSea, JonswapSea, SinusoidalSea

NO_SCATTERING = mt.Water(b=0.0)


def link_of(water=None, depth=10.0, half_angle_deg=10.0, **receiver):
    return mt.Link(
        water=water or mt.Water(),
        transmitter=mt.Led(depth=depth, half_angle_deg=half_angle_deg),
        receiver=mt.Receiver(**receiver),
    )


def forced(link, sea=None, photons=10_000, seed=1, **options):
    return mt.simulate(link, sea or FlatSea(), photons=photons, seed=seed, **options)


# ---- unscattered -----------------------------------------------------------------------------


def test_absorption_only():
    r = forced(link_of(NO_SCATTERING), photons=64)
    assert r.gain == pytest.approx(6.5389e-5, rel=2e-5)
    assert 0.0 < r.gain_stderr < 1e-5 * r.gain
    assert r.gain_scattered == 0.0


def gain_aside(height, aside, radius, n=1.33, a=0.05, nodes=1_000_001):
    """Return the gain of a level aperture beside a Lambertian lamp 1 m deep in clear water.

    Quadrature over the angles of emission up to the critical one; an aperture covers the azimuths
    whose light lands within its radius.
    """
    u = (np.arange(nodes) + 0.5) / nodes
    critical = math.asin(1.0 / n)
    angle, step = critical * (1.0 - (1.0 - u) ** 2), 2.0 * critical * (1.0 - u) / nodes
    cos_i, sin_t = np.cos(angle), n * np.sin(angle)
    cos_t = np.sqrt(1.0 - sin_t**2)
    landing = np.tan(angle) + height * sin_t / cos_t
    cosine = (landing**2 + aside**2 - radius**2) / (2.0 * landing * aside)
    azimuths = 2.0 * np.arccos(np.clip(cosine, -1.0, 1.0))
    light = cos_i / math.pi * (1.0 - fresnel_reflectance(cos_i, n, 1.0)) * np.exp(-a / cos_i)
    return float((light * azimuths * np.sin(angle) * step).sum())


@pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning")  # the mesh ends at 0.04 % of it
@pytest.mark.parametrize(
    ("height", "aside", "radius"),
    [
        (2.0, 10.0, 1.0),
        (1.0, 5.0, 0.05),
        (0.3, 2.0, 0.2),
        (0.3, 8.0, 0.2),
        (0.1, 4.0, 0.2),
        (1.0, 12.0, 0.2),
    ],
)
@pytest.mark.thorough_but("1.0-5.0-0.05")
def test_light_that_leaves_along_the_surface(height, aside, radius):
    """The image of a part is stretched a hundredfold there: bounds on it once left it out."""
    link = link_of(
        mt.Water(a=0.05, b=0.0), 1.0, 60.0,
        height=height, radius=radius, fov_deg=180.0, position=(aside, 0.0),
    )  # fmt: skip
    found = forced(link, photons=64).gain_ballistic
    assert found == pytest.approx(gain_aside(height, aside, radius), rel=1e-3)


def sinusoid_gains(sea, link, spacing, places):
    """Return unscattered gains at places over a mesh of the sinusoid."""
    receivers = tuple(link.receiver.model_copy(update={"position": p}) for p in places)
    several = link.model_copy(update={"receiver": receivers})
    mesh = sea.mesh(extent=3.0, spacing=spacing)
    return ForcedDetection(several, 32, 1, "vertex", sea=TypicalSea(0.2)).evaluate(mesh).ballistic


@pytest.mark.thorough
def test_unscattered_gain_over_waves_converges_as_the_square_of_the_spacing():
    """Root mean square error against quadrature over the exact, strongly focusing sinusoid."""
    from test_transport_waves import quadrature_gains

    sea = SinusoidalSea(amplitude=0.1, wavelength=2.0, phase=0.4, direction_deg=25.0)
    link = link_of(NO_SCATTERING, radius=0.1)
    places = [(0.0, 0.0), (0.31, 0.11), (-0.45, 0.2), (0.7, -0.5), (-0.1, -0.83)]
    receivers = [mt.Receiver(radius=0.1, position=p) for p in places]
    expected = np.array(quadrature_gains(sea, link, receivers, nodes=1200, half=1.2))
    errors = []
    for spacing in (0.25, 0.1, 0.05, 0.025):
        got = sinusoid_gains(sea, link, spacing, places)
        errors.append(np.sqrt(np.mean((got / expected - 1.0) ** 2)))
    assert errors[0] < 0.2
    assert errors[1] < 0.03
    assert errors[2] < 0.008
    # the quadrature itself is good to some 1e-3
    assert errors[3] < 0.003
    order = math.log(errors[0] / errors[2]) / math.log(5.0)
    assert 1.5 < order < 3.0, errors


# ---- first order -----------------------------------------------------------------------------


def first_order(depth, height, water, g, intensity, half_fov, radius=0.05, nodes=(120, 400)):
    """Return the gain of one scattering by Henyey-Greenstein, small upright aperture on the axis.

    E = int L cos dOmega over the air; L = T L_w / n^2; L_w = int b p I exp(-c (s + R)) / R^2 ds
    along the refracted ray, with s = s0 + D tan(phi), so that ds / R^2 = dphi / D.
    """
    n, c = water.n, water.c
    x, w = np.polynomial.legendre.leggauss(nodes[0])
    y, v = np.polynomial.legendre.leggauss(nodes[1])
    theta_t = 0.5 * half_fov * (x + 1.0)
    theta = np.arcsin(np.sin(theta_t) / n)
    transmitted = 1.0 - fresnel_reflectance(np.cos(theta), n, 1.0)
    sin, cos = np.sin(theta)[:, None], np.cos(theta)[:, None]
    across = (height * np.tan(theta_t))[:, None]
    s0 = depth * cos - across * sin
    nearest = np.hypot(across + s0 * sin, depth - s0 * cos)
    low, high = np.arctan(-s0 / nearest), np.arctan((60.0 - s0) / nearest)
    phi = 0.5 * (high - low) * (y + 1.0) + low
    s = s0 + nearest * np.tan(phi)
    px, pz = across + s * sin, depth - s * cos
    r = np.hypot(px, pz)
    turn = (-px * sin + pz * cos) / r
    p = (1 - g * g) / (4 * math.pi * (1 + g * g - 2 * g * turn) ** 1.5)
    along = water.b * p * intensity(pz / r) * np.exp(-c * (s + r)) / nearest
    radiance = (along * v * 0.5 * (high - low)).sum(axis=1)
    ring = 2 * math.pi * np.sin(theta_t) * np.cos(theta_t) * transmitted / n**2
    return math.pi * radius**2 * float((0.5 * half_fov * w * ring * radiance).sum())


SOURCES = {
    "isotropic": (mt.IsotropicSource, {}, lambda z: np.full_like(z, 0.25 / math.pi)),
    "lambertian": (mt.Led, {"half_angle_deg": 60.0}, lambda z: np.maximum(z, 0.0) / math.pi),
    "down": (
        mt.Led,
        {"half_angle_deg": 60.0, "zenith_deg": 180.0},
        lambda z: np.maximum(-z, 0.0) / math.pi,
    ),
}


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("g", [0.0, 0.9])
@pytest.mark.parametrize(
    ("depth", "height", "fov_deg"), [(10.0, 5.0, 60.0), (4.0, 2.0, 120.0), (2.0, 1.0, 180.0)]
)
@pytest.mark.slow_but(
    "10.0-5.0-60.0-0.9-isotropic",
    "4.0-2.0-120.0-0.0-down",
    "2.0-1.0-180.0-0.0-lambertian",
)
@pytest.mark.thorough_but("10.0-5.0-60.0-0.9-isotropic")
def test_first_order(depth, height, fov_deg, g, source):
    """Every crossing of sharply turned chains must be found, shallow and wide ones too."""
    kind, options, intensity = SOURCES[source]
    water = mt.Water(a=0.3, b=0.2, phase=mt.HenyeyGreenstein(g=g))
    link = mt.Link(
        water=water,
        transmitter=kind(depth=depth, **options),
        receiver=mt.Receiver(height=height, fov_deg=fov_deg),
    )
    half = math.radians(fov_deg / 2)
    expected = first_order(depth, height, water, g, intensity, half)
    assert expected == pytest.approx(
        first_order(depth, height, water, g, intensity, half, nodes=(90, 300)), rel=1e-4
    )
    mesh = FlatSea().mesh(extent=10.0, spacing=0.5)
    got = [ForcedDetection(link, 4000, seed).evaluate(mesh).orders[0, 0] for seed in range(6)]
    error = np.std(got, ddof=1) / math.sqrt(len(got))
    # six seeds: the error is uncertain; radius 5 cm stands for a point
    assert abs(np.mean(got) - expected) < 6.0 * error + 2e-3 * expected, np.mean(got) / expected


def test_first_order_of_the_default_link():
    """1.2585e-5 +- 1e-9 by quadrature."""
    got = [forced(mt.Link(), seed=s).gain_order[0, 0] for s in range(8)]
    error = np.std(got, ddof=1) / math.sqrt(8)
    assert error < 2e-3 * 1.2585e-5
    assert z_test(np.mean(got), 1.2 * error, 1.2585e-5, 1e-9) > ALPHA


# ---- all orders ------------------------------------------------------------------------------

TABLE = [
    ({}, 5.9731e-5, 6e-9),
    ({"radius": 0.25}, 1.488835e-3, 3e-7),
    ({"half_angle_deg": 5.0}, 2.247e-4, 5e-8),
    ({"half_angle_deg": 20.0}, 1.626e-5, 5e-9),
    ({"half_angle_deg": 60.0}, 2.763e-6, 1e-9),
    ({"position": (0.5, 0.0)}, 5.841e-5, 1e-8),
    ({"position": (0.0, -1.0)}, 5.465e-5, 1e-8),
    ({"depth": 47.0}, 6.40e-8, 1.5e-10),
]


@pytest.mark.parametrize(("case", "expected", "error"), TABLE, ids=lambda v: str(v))
def test_total_gain(case, expected, error):
    r = forced(link_of(**case), photons=30_000, seed=5)
    assert r.gain_stderr / r.gain < (0.002 if link_of(**case).transmitter.depth < 40.0 else 0.008)
    assert z_test(r.gain, r.gain_stderr, expected, error) > sidak(ALPHA, len(TABLE))


@pytest.mark.parametrize("height", [-0.9, -0.3, 0.3, 0.7, 1.5])
def test_higher_water_is_a_deeper_lamp_and_a_lower_receiver(height):
    raised = forced(mt.Link(), FlatSea(height=height), seed=6)
    shifted = forced(link_of(depth=10.0 + height, height=5.0 - height), seed=7)
    assert raised.gain_ballistic == pytest.approx(shifted.gain_ballistic, rel=2e-5)
    p = z_test(raised.gain, raised.gain_stderr, shifted.gain, shifted.gain_stderr)
    assert p > sidak(ALPHA, 5)


# ---- standard errors -------------------------------------------------------------------------

SEAS = {"flat": FlatSea(), "jonswap": JonswapSea(wind_speed=13.0, seed=3, waves="paper")}


@pytest.mark.parametrize("sea", SEAS)
@pytest.mark.thorough_but("flat")
def test_scatter_over_seeds_is_the_standard_error(sea):
    """Forty seeds: chi-square of the gains about their mean with the reported errors."""
    link = mt.Link()
    mesh = SEAS[sea].mesh(extent=9.0, spacing=0.2)
    rows = []
    for seed in range(40):
        parts = ForcedDetection(link, 800, seed, sea=TypicalSea(float(mesh.bounds[1, 2]))).evaluate(
            mesh
        )
        rows.append((parts.gain[0], parts.stderr[0]))
    gain, error = np.array(rows).T
    chi2 = ((gain - gain.mean()) ** 2).sum() / (error**2).mean()
    assert ALPHA / 4 < stats.chi2.sf(chi2, 39) < 1 - ALPHA / 4, chi2 / 39


@pytest.mark.parametrize(("depth", "most"), [(10.0, 0.15), (47.0, 0.45)])
def test_relative_standard_deviation_per_sample(depth, most):
    """A sample is one chain of each order; here: sqrt(chains) times the relative error."""
    photons = 4096
    mesh = FlatSea().mesh(extent=9.0, spacing=1.0)
    errors, gains = [], []
    for seed in range(8):
        forced_ = ForcedDetection(link_of(depth=depth), photons, seed)
        parts = forced_.evaluate(mesh)
        errors.append(parts.stderr[0])
        gains.append(parts.gain[0])
    samples = parts.counts.drawn / len(parts.orders[0])
    deviation = math.sqrt(samples * np.mean(np.square(errors))) / np.mean(gains)
    assert deviation <= most
