"""Waters by their constituents: published coefficients, limits, phase functions, attenuation."""

import math

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.apps.measured import daylight
from meshtrace.errors import Refused
from meshtrace.optics import Constituents, MixturePhase, Rayleigh, SpectralTable, Water
from meshtrace.optics.constituents import fournier_forand_of
from meshtrace.optics.pure_water import (
    pure_water_absorption,
    quan_fry,
    sea_water_scattering,
    zhang_hu_he,
)
from meshtrace.optics.spectra import coefficients


def at(wavelength, **given):
    return Water(spectrum=Constituents(**given), wavelength_nm=wavelength)


# values of the authors' program betasw_ZHH2009.m, as ported in the ion-functions of the Ocean
# Observatories Initiative (flo_zhang_scatter_coeffs)
@pytest.mark.parametrize(
    ("wavelength", "temperature", "salinity", "b"),
    [
        (400.0, 20.0, 35.0, 0.006591783190376),
        (470.0, 20.0, 35.0, 0.003308701665204),
        (532.0, 28.0, 33.0, 0.001932979537574),
        (546.0, 20.0, 38.4, 0.001791209899907),
        (700.0, 4.0, 0.0, 0.000497771000344),
    ],
)
def test_scattering_of_sea_water_is_that_of_zhang_hu_and_he(wavelength, temperature, salinity, b):
    assert zhang_hu_he(wavelength, temperature, salinity) == pytest.approx(b, rel=1e-11)


@pytest.mark.parametrize(("salinity", "coldest"), [(0.0, 24.64), (40.0, 27.49)])
def test_scattering_is_least_at_the_published_temperatures(salinity, coldest):
    # Zhang and Hu (2010), Proc. SPIE 7678, abstract
    temperature = np.arange(20.0, 30.0, 0.01)
    found = temperature[np.argmin(zhang_hu_he(546.0, temperature, salinity))]
    assert round(found, 2) == coldest


def test_scattering_of_sea_water_is_refused_outside_its_range():
    for given, message in (
        ((300.0,), "wavelength_nm: 300.0, allowed: 350"),
        ((500.0, 31.0), "temperature_c: 31.0"),
        ((500.0, 20.0, 41.0), "salinity: 41.0"),
        (([500.0, 600.0], [1.0, 2.0, 3.0]), "wavelength_nm: shapes"),
    ):
        with pytest.raises(Refused, match=message):
            zhang_hu_he(*given)


def test_pure_water_absorption_in_a_second_table():
    # Pope and Fry (1997) as kept in the R package Cops
    printed = {382.5: 0.01044, 400: 0.00663, 412.5: 0.00452, 440: 0.00635, 450: 0.00922,
               465: 0.01011, 485: 0.0136, 490: 0.0150, 510: 0.0325, 532.5: 0.0447, 550: 0.0565,
               580: 0.0896, 590: 0.1351, 620: 0.2755, 650: 0.340, 680: 0.465, 727.5: 1.678}  # fmt: skip
    for wavelength, a in printed.items():
        assert pure_water_absorption(wavelength) == a


def test_water_without_constituents_is_sea_water():
    water = at(470.0, temperature_c=10.0, salinity=30.0)
    assert water.a == pure_water_absorption(470.0)
    assert water.b == zhang_hu_he(470.0, 10.0, 30.0)
    assert water.n == quan_fry(470.0, 10.0, 30.0)
    assert water.phase == Rayleigh(gamma=(1 - 0.039) / (1 + 0.039))
    little = at(470.0, temperature_c=10.0, salinity=30.0, chlorophyll=1e-9)
    assert little.a == pytest.approx(water.a, rel=1e-4)
    assert little.b == pytest.approx(water.b, rel=1e-4)


def test_chlorophyll_adds_the_published_terms():
    # Bricaud and others (1998): A, E at 440 and 470 nm; Morel and Maritorena (2001), eqs. 12 to 14
    c, water, pure = 0.5, at(470.0, chlorophyll=0.5), at(470.0)
    particles = 0.04153 * c**0.612938
    # Morel and Gentili (2009), eqs. 2 and 4a
    dissolved = 0.0524 * c**0.63 * math.exp(-0.018 * (470.0 - 412.0))
    assert water.a - pure.a == pytest.approx(particles + dissolved, rel=1e-12)
    v = 0.5 * (math.log10(c) - 0.3)
    b = 0.416 * c**0.766 * (470.0 / 550.0) ** v
    assert water.b - pure.b == pytest.approx(b, rel=1e-12)
    ratio = 0.002 + 0.01 * (0.5 - 0.25 * math.log10(c)) * (470.0 / 550.0) ** v
    back = (0.5 * pure.b + ratio * b) / (pure.b + b)
    assert water.phase.backscatter_fraction == pytest.approx(back, rel=1e-5)


def test_dissolved_matter_and_minerals_add_up():
    pure, wavelength = at(550.0), 550.0
    dark = at(wavelength, cdom=0.3, cdom_slope=0.0176)
    assert dark.a - pure.a == pytest.approx(0.3 * math.exp(-0.0176 * 110.0))
    assert (dark.b, dark.phase) == (pure.b, pure.phase)
    muddy = at(wavelength, minerals=2.0)
    assert muddy.b - pure.b == pytest.approx(1.0)  # Babin and others (2003): 0.5 m2/g
    assert muddy.a - pure.a == pytest.approx(0.082 * math.exp(-0.0123 * 107.0))
    assert muddy.phase.backscatter_fraction == pytest.approx(
        (0.5 * pure.b + 0.0183) / (1.0 + pure.b), rel=1e-5
    )
    both = at(wavelength, cdom=0.3, cdom_slope=0.0176, minerals=2.0)
    assert both.a - pure.a == pytest.approx(dark.a + muddy.a - 2.0 * pure.a)


def test_backscattering_takes_the_place_of_chlorophyll():
    clear = at(700.0, chlorophyll=0.3)
    own = 0.002 + 0.01 * (0.5 - 0.25 * math.log10(0.3)) * (700 / 550) ** (
        0.5 * math.log10(0.3) - 0.15
    )
    b_p = clear.b - at(700.0).b
    for wavelength in (450.0, 700.0):
        same = at(wavelength, chlorophyll=0.3, bbp700=own * b_p)
        assert same.b == pytest.approx(at(wavelength, chlorophyll=0.3).b, rel=1e-12)
        assert same.a == at(wavelength, chlorophyll=0.3).a
    assert at(700.0, bbp700=0.001).b > at(700.0).b  # particles without chlorophyll


def test_profiles_become_layers():
    water = at(488.0, chlorophyll=[(0.0, 0.1), (40.0, 1.0)], bbp700=[(0.0, 1e-3), (20.0, 2e-3)])
    assert [row[0] for row in water.layers] == [0.0, 20.0, 40.0]
    for (_, a, b), chlorophyll, bbp in zip(
        water.layers, (0.1, 0.55, 1.0), (1e-3, 2e-3, 2e-3), strict=True
    ):
        one = at(488.0, chlorophyll=chlorophyll, bbp700=bbp)
        assert (a, b) == pytest.approx((one.a, one.b))
    assert water.phase == at(488.0, chlorophyll=0.1, bbp700=1e-3).phase
    green = water.at_wavelength(550.0)
    assert green.layers[0][1:] == (green.a, green.b)
    assert Water.model_validate_json(water.model_dump_json()) == water


# Ocean Optics Web Book, "The Fournier-Forand phase function", table 1
@pytest.mark.parametrize(
    ("ratio", "n", "mu"), [(0.001, 1.040, 3.2010), (0.01, 1.08, 3.483), (0.1, 1.175, 4.065)]
)
def test_fournier_forand_by_backscatter_ratio(ratio, n, mu):
    phase = fournier_forand_of(ratio)
    assert phase.backscatter_fraction == pytest.approx(ratio, rel=1e-5)
    assert phase.mu == pytest.approx(mu, abs=0.014)  # n is rounded in the table
    assert phase.n == pytest.approx(n, abs=0.003)
    with pytest.raises(Refused, match=r"backscatter_ratio: 0.2, allowed: 0.001"):
        fournier_forand_of(0.2)


@pytest.mark.parametrize("chlorophyll", [0.02, 0.3, 3.0, 25.0])
@pytest.mark.parametrize("wavelength", [400.0, 550.0, 700.0])
def test_every_phase_function_is_normalised(chlorophyll, wavelength):
    phase = at(wavelength, chlorophyll=chlorophyll, minerals=1.0).phase
    assert isinstance(phase, MixturePhase)
    assert phase.cdf(np.pi) == pytest.approx(1.0)
    # logarithmic angles; the light below the first is that of the distribution function
    theta = np.geomspace(1e-6, np.pi, 20001)
    inside = np.trapezoid(2.0 * np.pi * phase.pdf(theta) * np.sin(theta) * theta, np.log(theta))
    assert inside + phase.cdf(1e-6) == pytest.approx(1.0, abs=1e-4)


# chi and e of Morel and Maritorena (2001), table 2, as kept in the R package Cops
REGRESSION = {440.0: (0.10963, 0.67175), 490.0: (0.07242, 0.68955), 550.0: (0.04111, 0.64927)}


@pytest.mark.parametrize("wavelength", REGRESSION)
@pytest.mark.parametrize("chlorophyll", [0.05, 0.3, 1.0, 3.0])
def test_daylight_decays_as_in_the_regression_of_morel_and_maritorena(wavelength, chlorophyll):
    """K_d of the regression lies between those traced here with the sun at 0 and at 60 degrees.

    Down to 1.5 attenuation lengths over still water; 4 % beyond the sun at 0 degrees are allowed
    for C = 0.05 mg/m3 and for the noise, 0.6 % at one standard error.
    """
    chi, e = REGRESSION[wavelength]
    printed = pure_water_absorption(wavelength) + 0.5 * sea_water_scattering(wavelength)
    printed += chi * chlorophyll**e
    spectrum, depth = Constituents(chlorophyll=chlorophyll), 1.5 / printed
    water = Water(spectrum=spectrum, wavelength_nm=wavelength, bottom_depth=2.5 * depth)
    traced = []
    for zenith in (0.0, 60.0):
        planes = mt.receivers.IrradiancePlanes(depths=(0.01, depth))
        link = mt.Link(water=water, transmitter=mt.sources.Sun(zenith_deg=zenith), planes=planes)
        mesh = mt.surfaces.FlatSea().mesh(0.0, 1e4, 5e3)
        run = mt.simulate(link, mesh, estimator="analog", photons=2**12, seed=7, roulette=1e-5)
        traced.append(daylight.attenuation(run.planes)[0])
    assert 0.96 * traced[0] < printed < traced[1]


# a, b and K_d by HydroLight of Solonenko and Mobley (2015), tables 4 to 8, in the transcription of
# the package jerlov 0.9.6
SOLONENKO = [
    ("I", 0.019, 0.00306, 0.023),
    ("IA", 0.0216, 0.00536, 0.026),
    ("IB", 0.0225, 0.0635, 0.030),
    ("II", 0.0228, 0.459, 0.044),
    ("III", 0.0335, 1.26, 0.101),
    ("1C", 0.077, 0.469, 0.123),
    ("3C", 0.105, 1.36, 0.225),
    ("5C", 0.204, 1.71, 0.382),
    ("7C", 0.388, 3.01, 0.614),
    ("9C", 0.709, 4.01, 1.192),
]


@pytest.mark.parametrize(("name", "a", "b", "k"), SOLONENKO)
def test_jerlov_types_have_the_printed_coefficients(name, a, b, k):
    assert coefficients(f"jerlov-{name}", 475.0) == (a, b)
    assert k > a


@pytest.mark.parametrize(
    ("name", "wavelength", "printed"),
    [("IB", 475.0, 0.030), ("II", 475.0, 0.044), ("II", 550.0, 0.085), ("III", 475.0, 0.101),
     ("1C", 475.0, 0.123), ("1C", 550.0, 0.112), ("5C", 475.0, 0.382), ("9C", 475.0, 1.192)],
)  # fmt: skip
def test_traced_daylight_decays_as_in_hydrolight(name, wavelength, printed):
    """K_d down to 10 scattering lengths (6 for III), Petzold's average particle.

    The printed values, of a clear sky without its zenith angle, lie between those of the sun at 0
    and 45 degrees, within 7 % (the noise here is below 1.3 %, at one standard error).
    """
    a, b = map(float, coefficients(f"jerlov-{name}", wavelength))
    depth = (6.0 if name == "III" else 10.0) / b
    low, high = (
        daylight.attenuation(daylight.light_below(a, b, "average", zenith, (0.01, depth), 2**13))[0]
        for zenith in (0.0, 45.0)
    )
    assert 0.93 * low < printed < 1.07 * high


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"chlorophyll": 26.0}, "chlorophyll: 26.0, allowed: 0 to 25, or rows"),
        ({"chlorophyll": -1.0}, "chlorophyll: -1.0, allowed: 0 to 25"),
        ({"chlorophyll": [(0.0, 30.0)]}, "chlorophyll: 30.0, allowed: 0 to 25"),
        ({"chlorophyll": [(1.0, 0.3)]}, "chlorophyll: depths .* increasing from 0 m"),
        ({"chlorophyll": [(0.0, 0.3), (0.0, 0.4)]}, "chlorophyll: depths"),
        ({"chlorophyll": [0.3, 0.4]}, "chlorophyll: .* a number, or rows"),
        ({"bbp700": 2.0}, "bbp700: 2.0, allowed: 0 to 1"),
        ({"cdom": -0.1}, "cdom: -0.1, allowed: 0 <= cdom <= 20"),
        ({"minerals": 200.0}, "minerals: 200.0"),
        ({"salinity": 45.0}, "salinity: 45.0"),
        ({"cdom_slope": 0.1}, "cdom_slope: 0.1"),
        ({"salt": 35.0}, "salt: 35.0, no such key"),
    ],
)
def test_constituents_out_of_range_are_refused(given, message):
    with pytest.raises(Refused, match=f"^{message}"):
        Constituents(**given)


def test_wavelengths_outside_the_tables_are_refused():
    for wavelength in (399.0, 701.0, math.nan):
        with pytest.raises(Refused, match=r"^wavelength_nm: .* allowed: 400 <="):
            Constituents(chlorophyll=0.3).properties(wavelength)


def test_tables_are_linear_between_wavelengths():
    table = SpectralTable(table=[(500.0, 0.04, 0.2), (400.0, 0.02, 0.3)])
    assert table.properties(425.0) == {"a": 0.025, "b": 0.275}
    assert table.limits_nm == (400.0, 500.0)
    layered = SpectralTable(
        table=[(2.0, 400.0, 0.1, 0.2), (2.0, 500.0, 0.2, 0.1), (9.0, 400.0, 0.3, 0.4),
               (9.0, 500.0, 0.1, 0.2)]
    )  # fmt: skip
    found = Water(spectrum=layered, wavelength_nm=450.0)
    assert np.allclose(found.layers, [(0.0, 0.15, 0.15), (9.0, 0.2, 0.3)])
    for rows, message in (
        ([(2.0, 400.0, 0.1, 0.2), (9.0, 500.0, 0.1, 0.2)], "table: 2 rows, .* 2 wavelengths at 2"),
        ([(400.0, -0.1, 0.2)], "table: "),
        ([], "table: "),
    ):
        with pytest.raises(Refused, match=f"^{message}"):
            SpectralTable(table=rows)
    with pytest.raises(Refused, match=r"^wavelength_nm: 550.0, allowed: 400 <= .* <= 500 nm"):
        table.properties(550.0)


@pytest.mark.filterwarnings("ignore::meshtrace.engine.outcome.FewSamplesWarning")
def test_light_in_a_water_of_constituents_is_conserved():
    link = mt.Link(water=at(470.0, chlorophyll=[(0.0, 0.2), (20.0, 3.0)], minerals=1.0))
    run = mt.simulate(link, mt.surfaces.FlatSea(), estimator="analog", photons=4000, seed=1)
    assert sum(fate.weight for fate in run.fates.values()) == pytest.approx(1.0, abs=1e-12)


def test_spectra_of_a_water():
    data = at(470.0, chlorophyll=0.5).spectra()
    assert data.sizes["wavelength_nm"] == 16
    assert np.allclose(data.c, data.a + data.b)
    assert data.a.attrs["units"] == "m-1"
    assert data.n.values == pytest.approx(quan_fry(data.wavelength_nm.values))
    assert Water.from_type("coastal").spectra().wavelength_nm.values.tolist() == [
        480.0, 500.0, 520.0, 540.0,
    ]  # fmt: skip
    with pytest.raises(Refused, match=r"^water: a 0.114"):
        Water().spectra()
