"""A state as the text of a link file and as a Python program."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import tomli_w

import meshtrace
from meshtrace import surfaces
from meshtrace.comms.ook import OokLink
from meshtrace.daylight.light import Daylight
from meshtrace.errors import Refused
from meshtrace.models import Model, modules_of
from meshtrace.optics.water import Water
from meshtrace.scenario import MeshFile, Scenario
from meshtrace.scenario.parts import daylight_recipe, detector_config

_WIDTH = 96
_MAKERS = {"clear": "clear_sky"}  # of `Daylight`, where the name is not that of the model
_PHOTONS = 10_000


def as_toml(scenario: Scenario) -> str:
    """Return the text of a link file with the values that differ from the defaults.

    The full configuration if the shorter text would be another scenario.
    """
    default = Scenario.from_toml("").replace(detector=OokLink())
    short = _difference(scenario.to_config(), default.to_config())
    if scenario.detector is not None:
        short.setdefault("detector", {"bit_rate": scenario.detector.bit_rate})
    try:
        if Scenario.from_config(short) == scenario:
            return tomli_w.dumps(short)
    except Refused:
        pass
    return scenario.to_toml()


def _difference(table: Mapping[str, Any], default: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries of nested tables that differ from the defaults; kinds are kept."""
    found: dict[str, Any] = {}
    for key, value in table.items():
        other = default.get(key)
        if isinstance(value, Mapping) and isinstance(other, Mapping):
            same_kind = all(value.get(k) == other.get(k) for k in ("kind", "model", "spectrum"))
            value = _difference(value, other) if same_kind else dict(value)
            if value:
                found[key] = value
        elif value != other or key == "wind_speed":
            found[key] = value
    return found


def as_python(scenario: Scenario) -> str:
    """Return a program that simulates a scenario.

    Objects of classes outside of the public package are read from the text of a link file.
    """
    lines = ["import meshtrace as mt", ""]
    run = f"photons={_PHOTONS}, seed={scenario.run.seed}"
    try:
        link = f"link = {_expression(scenario.link, 0)}"
        if isinstance(scenario.surface, MeshFile):
            path = scenario.surface.file
            sea = f"sea = mt.surfaces.from_trimesh({path!r}, overhangs=True)"
        else:
            sea = f"sea = {_expression(scenario.surface, 0)}"
    except Refused:
        text = scenario.to_toml().replace("\\", "\\\\")
        lines[1:1] = [f"import {module}" for module in modules_of(text)]
        lines += [f'scenario = mt.Scenario.from_toml("""\n{text}""")']
        return "\n".join([*lines, "print(scenario.simulate().summary())", ""])
    with_bits = scenario.detector is not None or scenario.daylight is not None
    given = scenario.detector or OokLink()
    through = with_bits and given.response is None
    run += ", record=[mt.Arrivals()]" if through else ""
    lines += [link, sea, f"result = mt.simulate(link, sea, {run})", "print(result.summary())"]
    if with_bits:
        detector = OokLink.model_validate(detector_config(given, scenario.link))
        lines += [f"bits = mt.OokLink.of_link(link, {_expression(detector, 0)})"]
        if through:
            lines += [
                "seen = mt.impulse_response(result)",
                "response = mt.comms.ChannelResponse.of(seen.delay, seen.weight, seen.angle)",
                "bits = bits.replace(response=response)",
            ]
        if scenario.daylight is not None:
            day = _daylight(scenario.daylight)
            light = f"mt.background(link, sea, {day})"
            lines += [f"bits = mt.comms.background.with_background(bits, {light})"]
        under = "in the dark" if scenario.daylight is None else f"under {scenario.daylight.light}"
        lines += [
            "ber = float(bits.ber(bits.received_power(result.gain)))",
            f'print(f"BER at {detector.bit_rate:g} bit/s {under}: {{ber:.3g}}")',
        ]
    return "\n".join([*lines, ""])


def _daylight(day: Daylight) -> str:
    """Return the Python expression of a light, by its model if that gives the irradiances."""
    try:
        recipe = daylight_recipe(day)
    except Refused:
        return _expression(day, 0)
    maker = recipe.pop("model")
    if maker == "moon":
        recipe = {key.removeprefix("sun_"): value for key, value in recipe.items()}
    if day.wavelength_nm != Daylight.model_fields["wavelength_nm"].default:
        recipe["wavelength_nm"] = day.wavelength_nm
    given = ", ".join(f"{key}={value!r}" for key, value in recipe.items())
    return f"mt.Daylight.{_MAKERS.get(maker, maker)}({given})"


def _expression(value: Any, indent: int) -> str:
    """Return the Python expression of a value, with the fields that differ from their defaults."""
    if isinstance(value, tuple):
        items = [_expression(item, indent + 4) for item in value]
        return f"({', '.join(items)}{',' if len(items) == 1 else ''})"
    if not isinstance(value, Model):
        return json.dumps(value) if isinstance(value, str) else repr(value)
    name = type(value).__name__
    places = (part for module, part in _PUBLIC if getattr(module, name, None) is type(value))
    path = next((f"mt.{part}{name}" for part in places), "")
    if not path:
        raise Refused("", name, "a public class")
    follows = isinstance(value, Water) and value.spectrum is not None  # a, b and others from it
    given = {
        key: item
        for key, item in value.__repr_args__()
        if key != "kind" and (not follows or key in value.model_fields_set)
    }
    items = [f"{key}={_expression(item, indent + 4)}" for key, item in given.items()]
    short = f"{path}({', '.join(items)})"
    if len(short) + indent <= _WIDTH and "\n" not in short:
        return short
    pad = " " * (indent + 4)
    return f"{path}(\n" + "".join(f"{pad}{item},\n" for item in items) + " " * indent + ")"


_PUBLIC = ((meshtrace, ""), (surfaces, "surfaces."), (meshtrace.comms, "comms."),
           (meshtrace.optics, "optics."))  # fmt: skip
