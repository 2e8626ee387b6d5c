"""The parts of a scenario but the sea: wind, link with its water, bubbles and foam, detector, UAV.

Each is read from its table of a link file, with what it shares with other tables filled in, and
written back without what follows the wind, the water or the transmitter.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, get_args

import pydantic

from meshtrace.comms.devices import LedDriver, OpticalFrontEnd, SiPM, Tia
from meshtrace.comms.ook import OokLink
from meshtrace.errors import (
    ScenarioError,
    is_number,
    refuse_ragged,
    refuse_unknown,
    refuse_unlisted,
    show,
    with_colon,
)
from meshtrace.link import Aperture, IrradiancePlanes, Link, Physics, Source, Whitecaps
from meshtrace.optics.bubbles import HallNovarini
from meshtrace.optics.phase import AnyPhase, FournierForand
from meshtrace.optics.water import WATER_TYPES, Water
from meshtrace.scenario.tables import Table, as_table, of_kind, validated, without_shared_wind
from meshtrace.transport.forced_link import crossing_reach
from meshtrace.uav.airframe import UAVS, Uav

DEFAULT_WIND_SPEED = 5.0

_PRESETS = {"physical": Physics(), "paper": Physics.paper()}
_DETECTOR_PRESETS = ("physical", "paper", "paper-ranges")
_DETECTOR_PARTS: dict[str, type[pydantic.BaseModel]] = {
    "led": LedDriver,
    "sipm": SiPM,
    "tia": Tia,
    "optics": OpticalFrontEnd,
}


def read_wind_speed(config: Mapping[str, Any]) -> Any:
    """Return the wind speed at the top of a link file [m s-1]."""
    wind_speed = config.get("wind_speed", DEFAULT_WIND_SPEED)
    if not is_number(wind_speed) or not 0.0 <= wind_speed <= 60.0:
        raise ScenarioError(f"wind_speed: {show(wind_speed)}, allowed: 0 <= wind_speed <= 60 m/s")
    return wind_speed


def read_link(config: Mapping[str, Any], wind_speed: float) -> Link:
    """Return the link of all tables that describe it."""
    choice = config.get("physics", "physical")
    printed = choice == "paper"
    sources = _one_or_more(Source, config.get("transmitter", {}), "transmitter", "led")
    first = sources[0] if isinstance(sources, tuple) and sources else sources
    if not first:
        raise ScenarioError("transmitter: [], allowed: at least one source")
    water = _water(config.get("water", {}), first.wavelength_nm, printed)
    parts: Table = {
        "physics": _physics(choice),
        "transmitter": sources,
        "receiver": _one_or_more(Aperture, config.get("receiver", {}), "receiver", "receiver"),
        "water": water,
        "bubbles": _bubbles(
            config.get("bubbles", {}), wind_speed, _bubble_defaults(water, first), printed
        ),
        "whitecaps": _whitecaps(config.get("whitecaps", {}), wind_speed, printed),
    }
    if "planes" in config:
        parts["planes"] = validated(IrradiancePlanes, config["planes"], "planes")
    if "n_air" in config:
        parts["n_air"] = config["n_air"]
    return validated(Link, parts, "")


def default_estimator(link: Link) -> str:
    """Return "forced", or "analog" for a link that forced detection cannot follow."""
    try:
        crossing_reach(link)
    except ValueError:
        return "analog"
    return "forced"


def _physics(choice: Any) -> Physics:
    if not isinstance(choice, str):
        return validated(Physics, choice, "physics")
    refuse_unlisted(choice, tuple(_PRESETS), "physics")
    return _PRESETS[choice]


def _one_or_more(union: Any, value: Any, path: str, default: str) -> Any:
    """Return the model of a table, or the tuple of those of a list of tables."""
    if isinstance(value, list | tuple):
        return tuple(
            of_kind(union, item, f"{path}[{i}]", "kind", default) for i, item in enumerate(value)
        )
    return of_kind(union, value, path, "kind", default)


def _water(value: Any, wavelength_nm: float, printed: bool) -> Water:
    table = as_table(value, "water")
    if "phase" in table:
        table["phase"] = _phase(table["phase"], "water.phase")
    if "layers" in table:
        refuse_ragged(table["layers"], "water.layers")
    if "type" in table:
        table = {**_typed_water(table.pop("type"), wavelength_nm, "layers" in table), **table}
    water = validated(Water, table, "water", ("type", *Water.model_fields))
    phase = water.phase
    if printed and isinstance(phase, FournierForand) and "cdf_coef" not in phase.model_fields_set:
        phase = phase.model_copy(update={"cdf_coef": "paper"})
    return water.model_copy(update={"phase": phase})


def _typed_water(type: Any, wavelength_nm: float, layered: bool) -> Table:
    refuse_unlisted(type, WATER_TYPES, "water.type")
    try:
        water = Water.from_type(type, wavelength_nm)
    except ValueError as error:
        raise ScenarioError(f"transmitter.{with_colon(str(error))} for water {type}") from error
    return {"phase": water.phase, **({} if layered else {"a": water.a, "b": water.b})}


def _phase(value: Any, path: str) -> Any:
    table: Table = {"model": value} if isinstance(value, str) else as_table(value, path)
    parts = table.get("components")
    if isinstance(parts, list | tuple):
        table["components"] = tuple(
            _phase(item, f"{path}.components[{i}]") for i, item in enumerate(parts)
        )
    return of_kind(AnyPhase, table, path, "model", "fournier-forand")


def _bubble_defaults(water: Water, source: Any) -> Table:
    """Return what bubbles share with their surroundings."""
    return {"n_water": water.n, "wavelength_nm": source.wavelength_nm}


def _bubbles(value: Any, wind_speed: float, shared: Table, printed: bool) -> HallNovarini | None:
    table = {"model": value} if isinstance(value, str) else as_table(value, "bubbles")
    model = table.pop("model", table.pop("kind", "hall-novarini"))
    refuse_unlisted(model, ("hall-novarini", "none"), "bubbles.model")
    keys = ("model", *(key for key in HallNovarini.model_fields if key != "kind"))
    refuse_unknown(table, keys, "bubbles")
    paper = {"psi": "paper", "q": 2.0, "depth": "mean_level"} if printed else {}
    table = {"wind_speed": wind_speed, **shared, **paper, **table}
    if model == "none" or table["wind_speed"] == 0.0:
        return None
    return validated(HallNovarini, table, "bubbles")


def _whitecaps(value: Any, wind_speed: float, printed: bool) -> Whitecaps | None:
    table = {"model": value} if isinstance(value, str) else as_table(value, "whitecaps")
    table = {
        "wind_speed": wind_speed,
        "model": "paper_0255" if printed else "w_0225",
        **table,
    }
    models = get_args(Whitecaps.model_fields["model"].annotation)
    refuse_unlisted(table["model"], (*models, "none"), "whitecaps.model")
    refuse_unknown(table, tuple(Whitecaps.model_fields), "whitecaps")
    if table["model"] == "none" or table["wind_speed"] == 0.0:
        return None
    return validated(Whitecaps, table, "whitecaps")


def read_detector(value: Any) -> OokLink:
    """Return the transmission of [detector]: fields that replace those of a preset."""
    table: Table = {"preset": value} if isinstance(value, str) else as_table(value, "detector")
    preset: Any = table.pop("preset", "physical")
    refuse_unlisted(preset, _DETECTOR_PRESETS, "detector.preset")
    base = OokLink.preset(preset)
    for name, model in _DETECTOR_PARTS.items():
        if name in table:
            part = {**dict(getattr(base, name)), **as_table(table[name], f"detector.{name}")}
            table[name] = validated(model, part, f"detector.{name}")
    keys = ("preset", *OokLink.model_fields)
    return validated(OokLink, {**dict(base), **table}, "detector", keys)


def read_uav(value: Any) -> Uav:
    """Return the airframe of [uav]: fields that replace those of a known one."""
    table = {"preset": value} if isinstance(value, str) else as_table(value, "uav")
    preset = table.pop("preset", next(iter(UAVS)))
    refuse_unlisted(preset, tuple(UAVS), "uav.preset")
    base = UAVS[preset].model_dump()
    return validated(Uav, {**base, **table}, "uav", ("preset", *Uav.model_fields))


def physics_config(physics: Physics) -> Any:
    """Return the preset of the physics by name, or else its fields."""
    names = (name for name, preset in _PRESETS.items() if preset == physics)
    return next(names, physics.model_dump())


def bubbles_config(link: Link, wind_speed: float) -> Table:
    """Return [bubbles] without what follows the wind, the water or the transmitter."""
    bubbles = link.bubbles
    if bubbles is None:
        return {"model": "none"}
    config = without_shared_wind(bubbles.model_dump(mode="json"), wind_speed)
    for key, value in _bubble_defaults(link.water, link.transmitters[0]).items():
        if config[key] == value:
            del config[key]
    return {"model": config.pop("kind"), **config}


def whitecaps_config(link: Link, wind_speed: float) -> Any:
    """Return the word or the table of the whitecaps."""
    if link.whitecaps is None:
        return "none"
    config = without_shared_wind(link.whitecaps.model_dump(), wind_speed)
    return config if "wind_speed" in config else config["model"]
