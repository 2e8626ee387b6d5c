"""Water: defaults, layers, named types, and the tables and formulas behind them."""

import numpy as np
import pytest

from meshtrace.errors import Refused
from meshtrace.optics import FournierForand, HenyeyGreenstein, Petzold, Rayleigh, Water
from meshtrace.optics.pure_water import pure_water_absorption, quan_fry, sea_water_scattering
from meshtrace.optics.spectra import WATER_TYPES, coefficients

JERLOV = [name for name in WATER_TYPES if name.startswith("jerlov")]


def jerlov_wavelengths(name):
    last = {"jerlov-3C": 650, "jerlov-5C": 575}.get(name, 700)
    wavelengths = np.array([300, 310, 350, *range(375, 701, 25)], dtype=np.float64)
    return wavelengths[wavelengths <= last]


def test_defaults_are_those_of_the_paper():
    water = Water()
    assert (water.a, water.b, water.n) == (0.114, 0.037, 1.33)
    assert water.c == pytest.approx(0.151)
    assert water.albedo == pytest.approx(0.245033, abs=5e-7)
    assert water.phase == FournierForand(n=1.1, mu=3.5835)
    assert water.bottom_depth is None


def test_a_medium_that_does_nothing_has_albedo_zero():
    assert Water(a=0.0, b=0.0).albedo == 0.0


def test_layers_are_linear_between_nodes_and_constant_below():
    water = Water(layers=[(0.0, 0.1, 0.2), (10.0, 0.1, 0.4), (20.0, 0.3, 0.0)])
    assert (water.a, water.b) == (0.1, 0.2)
    a, b = water.profile([0.0, 5.0, 10.0, 15.0, 20.0, 90.0])
    np.testing.assert_allclose(a, [0.1, 0.1, 0.1, 0.2, 0.3, 0.3])
    np.testing.assert_allclose(b, [0.2, 0.3, 0.4, 0.2, 0.0, 0.0])
    a, b = Water().profile(7.0)
    assert (a, b) == (0.114, 0.037)


def test_layers_may_be_an_array():
    layers = np.array([(0.0, 0.1, 0.2), (10.0, 0.2, 0.1)])
    assert Water(layers=layers) == Water(layers=[tuple(row) for row in layers])


@pytest.mark.parametrize(
    "water",
    [
        Water(),
        Water(phase=HenyeyGreenstein(g=0.8), bottom_depth=12.0, bottom_albedo=0.3),
        Water(layers=[(0.0, 0.1, 0.2), (10.0, 0.1, 0.4)]),
        Water.from_type("petzold-harbour", 514.0),
        Water.from_type("jerlov-II", 500.0, n=1.34, bottom_depth=30.0),
    ],
)
def test_round_trip(water):
    assert Water.model_validate(water.model_dump()) == water
    assert Water.model_validate_json(water.model_dump_json()) == water


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"a": -0.1}, "a: -0.1, allowed: >= 0"),
        ({"b": float("inf")}, "b: inf, allowed: finite"),
        ({"n": 1.0}, "n: 1.0, allowed: 1 < n <= 2"),
        ({"bottom_depth": 0.0}, "bottom_depth: 0.0, allowed: > 0"),
        ({"bottom_albedo": 1.1}, "bottom_albedo: 1.1, allowed: 0 <= bottom_albedo <= 1"),
        ({"phase": {"kind": "mist"}}, "phase.kind: 'mist', .*allowed: .*fournier-forand"),
        ({"layers": [(1.0, 0.1, 0.1)]}, "layers: depths .*increasing from 0"),
        ({"layers": [(0.0, 0.1, 0.1), (0.0, 0.1, 0.1)]}, "layers: depths"),
        (
            {"layers": [(0.0, 0.1, 0.1), (1.0, 0.1, -0.1)]},
            "layers: -0.1, allowed: finite numbers >= 0",
        ),
        ({"layers": [(0.0, 0.1, 0.1)], "a": 0.2}, "a, b: 0.2, 0.1, allowed: with layers"),
        ({"layers": [(0.0, 0.1)]}, "layers: .*rows of"),
        ({"layers": [(0.0, 0.1, 0.1), (1.0,)]}, "layers: .*rows of"),
        ({"salt": 35.0}, "salt: 35.0, no such key"),
        ({"a": "0.1"}, "a: '0.1', allowed: numbers without quotes"),
        ({"a": True}, "a: true, allowed: neither true nor false"),
    ],
)
def test_errors_name_field_value_and_what_is_allowed(kwargs, message):
    for make in (Water.model_validate, lambda values: Water(**values)):
        with pytest.raises(Refused, match=f"^{message}"):
            make(kwargs)


@pytest.mark.parametrize("name", ["jerlov-II", "Jerlov-II", "II", "jerlov ii", " ii ", "JERLOV_II"])
def test_types_have_any_spelling(name):
    assert Water.from_type(name) == Water.from_type("jerlov-II")


@pytest.mark.parametrize("name", WATER_TYPES)
def test_every_type_makes_a_water(name):
    water = Water.from_type(name, wavelength_nm=514.0)
    assert water.a > 0.0
    assert water.b > 0.0
    assert Water.from_type(name, 514.0, n=1.34, a=0.5).model_dump(include={"n", "a"}) == {
        "n": 1.34,
        "a": 0.5,
    }


def test_a_type_keeps_its_spectrum():
    water = Water.from_type("jerlov-II", 470.0, n=1.34, phase=Rayleigh(), bottom_depth=30.0)
    for start in (water, Water.model_validate_json(water.model_dump_json())):
        green = start.at_wavelength(550.0)
        assert (green.a, green.b) == coefficients("jerlov-II", 550.0)
        assert (green.n, green.phase, green.bottom_depth) == (1.34, Rayleigh(), 30.0)
        assert green.at_wavelength(470.0) == water
    assert water.replace("spectrum.type", "jerlov-III") == Water.from_type(
        "jerlov-III", 470.0, n=1.34, phase=Rayleigh(), bottom_depth=30.0
    )


@pytest.mark.parametrize(
    "water",
    [
        Water(a=0.1, b=0.2),
        Water.from_type("jerlov-II", a=0.1),
        Water.from_type("jerlov-II").replace("b", 0.1),
        Water.from_type("jerlov-II", layers=[(0.0, 0.1, 0.2)]),
    ],
)
def test_given_coefficients_have_no_spectrum(water):
    assert (water.spectrum, water.wavelength_nm) == (None, None)
    with pytest.raises(Refused, match=r"^water: a .* of one wavelength, allowed: a water with a"):
        water.at_wavelength(520.0)
    again = Water.model_validate(water.model_dump())
    assert again == water == water.replace("bottom_depth", None)


def test_a_spectrum_has_a_wavelength_of_its_tables():
    with pytest.raises(Refused, match=r"^wavelength_nm: 750.0, allowed: 300 <= "):
        Water.from_type("jerlov-II").at_wavelength(750.0)
    with pytest.raises(Refused, match=r"^wavelength_nm: missing"):
        Water(spectrum={"type": "jerlov-II"})
    with pytest.raises(Refused, match=r"^wavelength_nm: 500.0, allowed: nothing, or with a spec"):
        Water(wavelength_nm=500.0)


def test_phase_functions_of_the_types():
    assert Water.from_type("jerlov-II").phase == FournierForand()
    assert Water.from_type("petzold-clear", 514.0).phase == Petzold(water="clear")
    assert Water.from_type("pure-sea").phase == Rayleigh(gamma=0.835)
    assert Water.from_type("pure-sea", phase=Rayleigh()).phase == Rayleigh()


def test_petzold_waters():
    for name, a, b in (
        ("clear", 0.114, 0.037),
        ("coastal", 0.179, 0.219),
        ("harbour", 0.366, 1.824),
    ):
        for wavelength in (476.5, 514.0, 551.5):
            water = Water.from_type(f"petzold-{name}", wavelength)
            assert (water.a, water.b) == (a, b)


@pytest.mark.parametrize("wavelength", [450.0, 470.0, 476.4, 551.6, 650.0])
def test_petzold_waters_are_refused_far_from_their_wavelength(wavelength):
    """The instruments had 75 nm at half maximum about 514 nm (Ocean Optics Web Book)."""
    with pytest.raises(Refused) as refused:
        Water.from_type("coastal", wavelength)
    assert str(refused.value) == (
        f"wavelength_nm: {wavelength}, allowed: 476.5 to 551.5 nm for petzold-coastal, measured at "
        "514 nm; to keep these values at another wavelength set a = 0.179 and b = 0.219; jerlov-* "
        "have 300 to 700 nm"
    )
    with pytest.raises(Refused):
        coefficients("petzold-coastal", [514.0, wavelength])
    given = Water.from_type("coastal", wavelength, a=0.2, b=0.3)
    assert given == Water(a=0.2, b=0.3, phase=Petzold(water="coastal"))
    layers = [(0.0, 0.1, 0.2), (5.0, 0.1, 0.4)]
    assert Water.from_type("coastal", wavelength, layers=layers).layers == tuple(layers)


@pytest.mark.parametrize(
    ("water", "wavelength", "text"),
    [
        (Water(), 470.0, "a 0.114, b 0.037 m-1 at 470 nm: petzold-clear (measured at 514 nm, "
         "Petzold 1972)"),
        (Water.from_type("ib", 475.0), 475.0, "a 0.0225, b 0.0635 m-1 at 475 nm: jerlov-IB "
         "(Solonenko and Mobley 2015)"),
        (Water.from_type("ib", 475.0), 500.0, "a 0.0225, b 0.0635 m-1 at 500 nm: jerlov-IB "
         "(Solonenko and Mobley 2015), for 475 nm"),
        (Water.from_type("pure-sea", 470.0), 470.0, "a 0.0106, b 0.003777 m-1 at 470 nm: pure-sea "
         "(Pope and Fry 1997, Morel 1974)"),
        (Water(a=0.1, b=0.2), 250.0, "a 0.1, b 0.2 m-1 at 250 nm: as given"),
        (Water(layers=[(0.0, 0.1, 0.2), (5.0, 0.1, 0.4)]), 470.0, "a 0.1, b 0.2 m-1 at 470 nm, at "
         "the surface of layers: as given"),
    ],
)  # fmt: skip
def test_a_water_states_its_source(water, wavelength, text):
    assert water.described(wavelength) == text
    if water.spectrum is not None:
        assert str(water) == water.described(water.wavelength_nm)


def test_jerlov_nodes_and_interpolation():
    # Solonenko and Mobley (2015), tables 4 to 8
    for name, wavelength, a, b in (
        ("I", 475, 0.019, 0.00306),
        ("IB", 475, 0.0225, 0.0635),
        ("II", 500, 0.0288, 0.421),
        ("III", 550, 0.0646, 0.98),
        ("1C", 450, 0.105, 0.514),
        ("3C", 550, 0.082, 1.06),
        ("9C", 700, 0.651, 2.07),
    ):
        assert coefficients(f"jerlov-{name}", wavelength) == (a, b)
    a, b = coefficients("jerlov-IB", 470.0)
    assert a == pytest.approx(0.0235 + 0.8 * (0.0225 - 0.0235))
    assert b == pytest.approx(0.068 + 0.8 * (0.0635 - 0.068))


@pytest.mark.parametrize("name", JERLOV)
def test_jerlov_scattering_follows_the_papers_own_model(name):
    # their equation 8: molecules, small and large particles; a slip of one digit would show
    wavelength = jerlov_wavelengths(name)
    b = coefficients(name, wavelength)[1]
    molecules = 0.00583 * (400.0 / wavelength) ** 4.322
    particles = np.column_stack(
        [1.513 * (400.0 / wavelength) ** 1.7, 0.3411 * (400.0 / wavelength) ** 0.3]
    )
    amounts = np.linalg.lstsq(particles / b[:, None], (b - molecules) / b, rcond=None)[0]
    np.testing.assert_allclose(molecules + particles @ amounts, b, rtol=4e-3)


@pytest.mark.parametrize("name", JERLOV)
def test_jerlov_absorption_is_that_of_water_and_more(name):
    wavelength = jerlov_wavelengths(name)
    wavelength = wavelength[(wavelength >= 400.0)]
    a = coefficients(name, wavelength)[0]
    assert np.all(a > 0.9 * pure_water_absorption(wavelength))


def test_turbid_types_scatter_and_absorb_more():
    for family in (
        [f"jerlov-{x}" for x in ("I", "IA", "IB", "II", "III")],
        [f"jerlov-{x}" for x in ("1C", "3C", "5C", "7C", "9C")],
    ):
        a, b = np.transpose([coefficients(name, 425.0) for name in family])
        assert np.all(np.diff(a) > 0.0)
        assert np.all(np.diff(b) > 0.0)


def test_unknown_types_and_wavelengths_are_refused():
    with pytest.raises(
        ValueError, match=r"type: 'jerlov-X', did you mean .* allowed: pure-sea, petzold-clear"
    ):
        Water.from_type("jerlov-X")
    with pytest.raises(ValueError, match=r"wavelength_nm: 675\.0, allowed: 300 <= .* <= 650 nm"):
        Water.from_type("jerlov-3C", wavelength_nm=675.0)
    with pytest.raises(ValueError, match=r"wavelength_nm: nan, allowed: 380"):
        pure_water_absorption(float("nan"))


def test_pure_water_absorption_of_pope_and_fry():
    # 417.5 nm is the minimum
    wavelength, a = (
        [380.0, 417.5, 470.0, 500.0, 514.0, 600.0, 700.0],
        [0.01137, 0.00442, 0.0106, 0.0204, 0.038640, 0.2224, 0.624],
    )
    np.testing.assert_allclose(pure_water_absorption(wavelength), a, rtol=1e-9)
    grid = np.arange(380.0, 700.0, 0.5)
    assert grid[np.argmin(pure_water_absorption(grid))] == 417.5


def test_sea_water_scattering_of_morel():
    # Smith and Baker (1981): 0.0076 (400 / lambda)^4.32; Morel: 0.00288 at 500 nm
    assert sea_water_scattering(400.0) == pytest.approx(0.0076, rel=5e-3)
    assert sea_water_scattering(500.0) == pytest.approx(0.00288, rel=5e-3)
    # the factor is the sphere integral of the phase function over its value at 90 degrees
    assert 1.0 / Rayleigh(gamma=0.91 / 1.09).pdf(np.pi / 2.0) == pytest.approx(16.06, abs=5e-3)


def test_quan_fry_against_tables_of_fresh_and_sea_water():
    # fresh water at 20 degrees, relative to air (CRC Handbook)
    wavelength, fresh = [404.7, 501.6, 589.3], [1.3427, 1.3364, 1.3330]
    np.testing.assert_allclose(quan_fry(wavelength, 20.0, 0.0), fresh, atol=2.5e-4)
    # Parrish's fit to the table of Austin and Halikas, rms error 2e-4
    w, t = np.meshgrid([400.0, 500.0, 600.0, 700.0], [0.0, 10.0, 20.0, 30.0])
    fit = -1.50156e-6 * t**2 + 1.07085e-7 * w**2 - 4.27594e-5 * t - 1.60476e-4 * w + 1.39807
    assert np.sqrt(np.mean((quan_fry(w, t, 35.0) - fit) ** 2)) < 4e-4


def test_quan_fry_refuses_what_lies_outside_its_fit():
    for kwargs, message in (
        ({"wavelength_nm": 800.0}, "wavelength_nm: 800.0, allowed: 400"),
        ({"wavelength_nm": 500.0, "temperature_c": -2.0}, "temperature_c: -2.0, allowed: 0"),
        ({"wavelength_nm": 500.0, "salinity": 40.0}, "salinity: 40.0, allowed: 0"),
    ):
        with pytest.raises(ValueError, match=message):
            quan_fry(**kwargs)
