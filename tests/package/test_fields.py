"""The registry of variable names, units and symbols."""

import re

import pytest

from meshtrace import fields
from meshtrace.errors import Refused

# The unit words of the registry in the spelling of UDUNITS: words and powers, blank between.
UNIT = re.compile(r"(1|[A-Za-z]+(-?[0-9]+)?( [A-Za-z]+(-?[0-9]+)?)*)")
KNOWN = {"m", "s", "rad", "sr", "W", "nm", "dB", "degree"}


@pytest.mark.parametrize("name", fields.FIELDS)
def test_every_field_is_complete(name):
    field = fields.field(name)
    assert UNIT.fullmatch(field.units)
    assert field.units == "1" or set(re.findall(r"[A-Za-z]+", field.units)) <= KNOWN
    assert field.long_name == field.long_name.strip() != ""
    assert field.symbol
    assert "$" not in field.symbol
    assert field.symbol.count("{") == field.symbol.count("}")
    assert name.isidentifier()


@pytest.mark.parametrize(("suffix", "unit"), [("_deg", "degree"), ("_nm", "nm"), ("_db", "dB")])
def test_a_name_carries_its_unit_only_if_it_is_not_si(suffix, unit):
    named = {name for name in fields.FIELDS if name.endswith(suffix)}
    assert named == {name for name, field in fields.FIELDS.items() if field.units == unit}


@pytest.mark.parametrize(
    ("name", "units"),
    [
        ("gain", "1"),
        ("depth", "m"),
        ("time", "s"),
        ("wind_speed", "m s-1"),
        ("mss", "1"),
        ("c", "m-1"),
        ("theta", "rad"),
        ("phase_function", "sr-1"),
        ("n_bubbles", "m-3"),
        ("bit_rate", "s-1"),
        ("coherence_time", "s"),
    ],
)
def test_units_of_the_main_variables(name, units):
    assert fields.attrs(name)["units"] == units


def test_attrs_are_a_fresh_dictionary():
    first = fields.attrs("gain")
    first["units"] = "dB"
    assert fields.attrs("gain") == {"units": "1", "long_name": "channel gain", "symbol": "h"}


def test_an_unknown_name_is_named_with_its_neighbours():
    with pytest.raises(Refused, match=r"name: 'wind_sped', did you mean wind_speed"):
        fields.attrs("wind_sped")
    with pytest.raises(Refused, match=r"name: 'qqqq', allowed: the keys of meshtrace\.fields"):
        fields.field("qqqq")


def test_the_registry_cannot_be_changed():
    with pytest.raises(TypeError):
        fields.FIELDS["gain"] = fields.Field("dB", "gain", "h")


def test_matplotlib_can_set_every_symbol():
    mathtext = pytest.importorskip("matplotlib.mathtext")
    parser = mathtext.MathTextParser("path")
    for field in fields.FIELDS.values():
        parser.parse(f"${field.symbol}$")
