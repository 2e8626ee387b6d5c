"""Units as files spell them, and their conversion with the angle as a dimension."""

import contextlib
import math
import random
import subprocess
import sys

import numpy as np
import pytest

from meshtrace.errors import Refused
from meshtrace.units import convert, is_convertible

SAME = {
    "m2 Hz-1": ["m2/Hz", "m^2/Hz", "m²/Hz", "m² Hz⁻¹", "m**2 Hz**-1", "m2 s", "m^{2} Hz^{-1}", "m2 per Hz"],
    "m2 Hz-1 deg-1": ["m2/Hz/deg", "m2 s deg-1", "m^2/(Hz degree)", "m^{2}.s.degree^{-1}", "m2 s degree-1"],
    "m2 s rad-1": ["m2 s", "m2.s.rad-1", "m2*s/rad", "m² s rad⁻¹"],
    "rad s-1": ["rad/s", "radians/s", "1/s", "s^-1"],
    "Hz": ["hz", "s-1", "cycles/s"],
    "deg": ["degrees_true", "degT", "degree_north", "deg T", "°", "Degrees"],
    "m-1": ["1/m", "m^-1", "m⁻¹", "m**(-1)"],
    "s": ["sec", "Seconds", "second"],
    "1": ["", "-", "1", "dimensionless"],
    "mg m-3": ["ug/L", "µg l-1", "mg/m^3"],
    "degC": ["degrees_Celsius", "°C", "celsius"],
}  # fmt: skip
FACTORS = [
    ("mm", "m", 1e-3),
    ("ft", "m", 0.3048),
    ("um", "nm", 1e3),
    ("µm", "nm", 1e3),
    ("rad", "deg", 180.0 / math.pi),
    ("Hz", "rad s-1", 2.0 * math.pi),
    ("m2/Hz", "m2 s rad-1", 0.5 / math.pi),
    ("m2 s rad-1", "m2 Hz-1", 2.0 * math.pi),
    ("m2 s rad-1", "m2 Hz-1 deg-1", math.pi / 180.0),
    ("m2 rad-1 s rad-1", "m2 Hz-1 deg-1", 2.0 * math.pi * math.pi / 180.0),
    ("cm2 s degree-1", "m2 Hz-1 deg-1", 1e-4),
    ("cm-1", "m-1", 100.0),
    ("1/(m sr)", "m-1 sr-1", 1.0),
    ("uW/cm^2/nm", "W m-2 nm-1", 1e-2),
    ("hPa", "dbar", 1e-2),
    ("%", "1", 1e-2),
]


@pytest.mark.parametrize(("target", "unit"), [(t, u) for t, units in SAME.items() for u in units])
def test_spellings(target, unit):
    assert convert(0.37, unit, target, "x") == pytest.approx(0.37, rel=1e-14)


@pytest.mark.parametrize(("unit", "target", "factor"), FACTORS)
def test_factors(unit, target, factor):
    values = convert([[1.0, -2.5]], unit, target, "x")
    assert values.dtype == np.float64
    np.testing.assert_allclose(values, [[factor, -2.5 * factor]], rtol=1e-15)


def test_temperatures_have_an_offset():
    assert convert(283.15, "K", "degC", "x") == pytest.approx(10.0)


@pytest.mark.parametrize(
    ("unit", "target", "kind"),
    [
        ("dBar", "m", "length"),
        ("m H2O", "m", "length"),
        ("V", "m", "length"),
        ("NM", "nm", "length"),
        ("counts", "m", "length"),
        ("", "rad", "an angle"),
        ("m-1 sr-1", "m-1", "a coefficient"),
        ("m-1", "m-1 sr-1", "volume scattering"),
        ("m2/Hz", "m2 Hz-1 deg-1", "frequency and direction"),
        ("m2 s", "m2 Hz-1 deg-1", "frequency and direction"),
        ("m2/kHz", "m2 Hz-1 deg-1", "frequency and direction"),
        ("m2 s-1", "m2 Hz-1", "a density over frequency"),
        ("degC", "m2 Hz-1", "a density over frequency"),
        ("A/W", "1", "a ratio"),
        ("dB", "1", "a ratio"),
        ("9**9**9**9", "m", "length"),
        ("m**99999999", "m", "length"),
        ("__import__('os')", "m", "length"),
    ],
)
def test_other_kinds_are_refused(unit, target, kind):
    with pytest.raises(Refused, match=f"eta: .*allowed: .*{kind}.*such as"):
        convert(1.0, unit, target, "eta")
    assert not is_convertible(unit, target)


def test_any_text_is_converted_or_refused():
    rng = random.Random(1)
    words = [*"m s rad deg Hz ** ^ -1 2 / ( ) e9 9 degC K psu sr . % { °".split(), " ", "\0", "²"]
    for _ in range(1000):
        unit = "".join(rng.choices(words, k=rng.randint(0, 8)))
        with contextlib.suppress(Refused):
            assert np.isfinite(convert(1.0, unit, "m", "x"))


def test_pint_is_imported_for_other_units_alone():
    code = (
        "import sys, meshtrace; from meshtrace.units import convert;"
        "convert(1.0, ' m2  Hz^-1', 'm2 Hz-1', 'x'); assert 'pint' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
