"""Arguments checked by annotations: what is kept of a function, and how its refusals read."""

import inspect
import math
import pickle
from collections.abc import Mapping, Sequence
from decimal import Decimal
from typing import Annotated, Literal

import numpy as np
import pytest
from numpy.typing import ArrayLike
from pydantic import Field

import meshtrace as mt
from meshtrace import checks, daylight, errors, fading, optics, surfaces, uav
from meshtrace.checks import Positive, check_call
from meshtrace.errors import Refused
from meshtrace.models import Floats


@check_call
def call(
    rate: Positive = 1.0,
    n: Annotated[int, Field(ge=1, le=9)] = 1,
    word: Literal["left", "right"] = "left",
    gain: ArrayLike = 0.0,
    rows: Annotated[Floats, checks.Shape("n 3")] | None = None,
    ends: tuple[float, float] = (0.0, 1.0),
    either: float | Sequence[float] = 0.0,
    table: Mapping[str, tuple[float, float]] | None = None,
    far: Annotated[float, Field(gt=0.0), checks.Infinite()] = math.inf,
    link: mt.Link | None = None,
):
    """Return what arrives."""
    return locals()


REFUSED = {
    "rate": (np.True_, "rate: True, allowed: > 0"),
    "n": (2.0, "n: 2.0, allowed: an integer 1 <= n <= 9"),
    "word": ("lft", "word: 'lft', did you mean left? allowed: left, right"),
    "gain": ([0.5, math.nan], "gain[1]: nan, allowed: finite numbers"),
    "rows": (np.zeros((2, 2)), "rows: shape (2, 2), allowed: finite numbers (n, 3)"),
    "ends": ((1.0, 2.0, 3.0), "ends: (1.0, 2.0, 3.0), allowed: 2 finite numbers"),
    "either": ("x", "either: 'x', allowed: a finite number or a list of finite numbers"),
    "table": ({"water.a": "ab"}, "table.water.a: 'ab', allowed: 2 finite numbers"),
    "far": (-math.inf, "far: -inf, allowed: > 0"),
    "link": (3, "link: 3, allowed: a Link"),
    "lnk": (3, "lnk: 3, no such key, did you mean link? allowed: "),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refusals(name):
    value, text = REFUSED[name]
    with pytest.raises(Refused) as caught:
        call(**{name: value})
    assert str(caught.value).startswith(text)


def test_values_arrive_as_annotated():
    found = call(np.float32(2.0), np.int8(3), gain=[1, 2], ends=np.array([1, 2]), either=(1, 2))
    assert (found["rate"], found["n"], found["far"]) == (2.0, 3, math.inf)
    assert type(found["rate"]) is float
    assert type(found["n"]) is int
    assert found["gain"].dtype == np.float64
    assert found["ends"] == (1.0, 2.0)
    assert found["either"] == [1.0, 2.0]


def test_signature_and_docstring_are_those_of_the_function():
    assert list(inspect.signature(call).parameters)[:2] == ["rate", "n"]
    assert call.__doc__ == "Return what arrives."
    assert mt.simulate.__name__ == "simulate"
    assert "estimator" in inspect.signature(mt.simulate).parameters


def test_missing_arguments_are_python_s_own_error():
    with pytest.raises(TypeError, match="missing 1 required positional argument"):
        uav.h_alpha(0.1)


def test_validators_are_made_by_the_first_call(monkeypatch):
    def fail(*arguments):
        raise AssertionError("made at import")

    monkeypatch.setattr(checks, "_checks_of", fail)

    @check_call
    def later(x: float) -> float:
        return x

    with pytest.raises(AssertionError, match="made at import"):
        later(1.0)


LINK, FLAT, GAIN = mt.Link(), surfaces.FlatSea(), np.array([1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    ("field", "wrong"),
    [
        ("text", lambda: mt.Scenario.from_toml(None)),
        ("text", lambda: mt.Scenario.from_toml(b"wind_speed = 5.0")),
        ("path", lambda: mt.GainSeries("time", GAIN, GAIN, GAIN, GAIN, 0.1).save(["a.nc"])),
        ("path", lambda: mt.GainSeries("time", GAIN, GAIN, GAIN, GAIN, 0.1).save("a" * 5000)),
        ("sun_zenith_deg", lambda: daylight.clear_irradiance(None)),
        ("cos_i", lambda: optics.fresnel_reflectance("0.5", 1.33, 1.0)),
        ("parameters", lambda: mt.sweep(LINK, [1.0])),
        ("tilt", lambda: uav.h_alpha(-math.inf, 1.0)),
        ("bounds", lambda: mt.design(mt.Scenario.from_toml(""), bounds=3)),
        ("gain_stderr", lambda: fading.fit_gamma_gamma(GAIN, object())),
        ("wavelengths_nm", lambda: mt.Water().spectra({})),
        ("step", lambda: mt.sensitivities(LINK, FLAT, ["water.a"], step=Decimal("1e400"))),
        ("lags", lambda: fading.gain_autocovariance(LINK, surfaces.JonswapSea(), [1j])),
        ("hours", lambda: mt.channel_trace(LINK, FLAT, hours=np.True_)),
        ("Led.depth", lambda: mt.Led(depth=np.True_)),
    ],
)
def test_what_once_ended_in_a_traceback(field, wrong):
    with pytest.raises(Refused) as caught:
        wrong()
    assert caught.value.field == field.removeprefix("Led.")


class Mute:
    """An object without a text."""

    def __repr__(self):
        raise RuntimeError("no text")

    __str__ = __repr__


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (Mute(), "a Mute without a text"),
        (10**5000, "a huge integer"),
        ("\ud800", r"'\ud800'"),
        ([Mute()], "a list without a text"),
        ({10**5000: 1}, "a dict without a text"),
        (np.array([]), "[]"),
    ],
    ids=["mute", "huge", "surrogate", "list", "table", "empty"],
)
def test_refusals_survive_their_values(value, text):
    refused = Refused("field", value, "a number")
    assert str(refused) == f"field: {text}, allowed: a number"
    assert str(pickle.loads(pickle.dumps(refused))) == str(refused)
    str(refused).encode()


def test_objects_that_cannot_be_pickled_go_to_other_processes_as_text():
    refused = Refused("progress", lambda: None, "a function")
    assert str(pickle.loads(pickle.dumps(refused))) == str(refused)


def test_keys_of_a_table_may_be_of_any_type():
    assert Refused("a", 1, "b").inside(None).field == "None.a"
    assert errors.show({}) == "{}"


def test_bounds_of_items_hold():
    @check_call
    def of_rates(rates: Sequence[Positive], pair: tuple[float, Positive] = (0.0, 1.0)):
        return rates, pair

    assert of_rates([1, 2.5], (-1, 3)) == ([1.0, 2.5], (-1.0, 3.0))
    with pytest.raises(Refused, match=r"^rates\[1\]: -1.0, allowed: > 0$"):
        of_rates([1.0, -1.0])
    with pytest.raises(Refused, match=r"^pair\[1\]: 0\.0, allowed: > 0$"):
        of_rates([1.0], (0.0, 0.0))
