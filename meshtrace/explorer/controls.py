"""Controls of the explorer: each sets one value of the tables of a link file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from meshtrace.errors import Refused, require_word
from meshtrace.optics.water import WATER_TYPES

Table = dict[str, Any]

GIVEN_WATER = "as given"
"""Choice of the water of the link that the explorer was started with."""


class Control(NamedTuple):
    """A value that the user of the explorer moves.

    Attributes
    ----------
    name : str
        Name of the control and of its variable in the page.
    label, unit : str
        Texts beside it.
    group : str
        Heading of its group; empty for those that only move in the side view and the plan.
    keys : tuple of str
        Dotted keys of a link file, of which the first present one is set.
    low, high : float
        Range of the slider; widened for links outside of it.
    step : float
        Step of the slider; of its decimal logarithm if `log`.
    log : bool
        Logarithmic slider.
    per_unit : float
        Units of the page per unit of the link file.
    """

    name: str
    label: str
    unit: str
    group: str
    keys: tuple[str, ...]
    low: float
    high: float
    step: float
    log: bool = False
    per_unit: float = 1.0


_LAMP, _RECEIVER = "transmitter", "receiver"

CONTROLS = (
    Control("wind", "Wind", "m/s", "Sea", ("wind_speed",), 0.0, 20.0, 0.5),
    Control(
        "fetch", "Fetch", "km", "Sea", ("sea.fetch", "sea.spectrum.fetch"),
        1.0, 1000.0, 0.05, True, 1e-3,
    ),
    Control("depth", "Depth", "m", "Lamp", (f"{_LAMP}.depth",), 0.5, 40.0, 0.5),
    Control("lamp_x", "Position x", "m", "", (f"{_LAMP}.position.0",), -20.0, 20.0, 0.1),
    Control("lamp_y", "Position y", "m", "", (f"{_LAMP}.position.1",), -20.0, 20.0, 0.1),
    Control(
        "half_angle", "Half angle", "deg", "Lamp",
        (f"{_LAMP}.half_angle_deg", f"{_LAMP}.divergence_deg"), 0.5, 80.0, 0.5,
    ),
    Control("height", "Height", "m", "Receiver", (f"{_RECEIVER}.height",), 0.5, 40.0, 0.5),
    Control("offset_x", "Offset x", "m", "Receiver", (f"{_RECEIVER}.position.0",), -20, 20, 0.1),
    Control("offset_y", "Offset y", "m", "Receiver", (f"{_RECEIVER}.position.1",), -20, 20, 0.1),
    Control("tilt", "Tilt", "deg", "Receiver", (f"{_RECEIVER}.tilt_deg",), 0.0, 60.0, 1.0),
    Control("fov", "Field of view", "deg", "Receiver", (f"{_RECEIVER}.fov_deg",), 1.0, 180.0, 1.0),
    Control(
        "aperture", "Aperture radius", "cm", "Receiver", (f"{_RECEIVER}.radius",),
        0.5, 50.0, 0.05, True, 100.0,
    ),
    Control(
        "bit_rate", "Bit rate", "Mbit/s", "Bits", ("detector.bit_rate",),
        0.1, 100.0, 0.05, True, 1e-6,
    ),
)  # fmt: skip
"""All controls with a number, in the order of the page."""

BY_NAME = {control.name: control for control in CONTROLS}

WATERS = (GIVEN_WATER, *WATER_TYPES)
"""Choices of the water."""


def value_of(config: Mapping[str, Any], control: Control) -> float | None:
    """Return the value of a control in the units of the page, None where a link has no such key.

    Examples
    --------
    >>> value_of({"transmitter": {"depth": 12.0}}, BY_NAME["depth"])
    12.0
    >>> value_of({"transmitter": {"kind": "sun"}}, BY_NAME["depth"])
    """
    for key in control.keys:
        try:
            value = _at(config, _path(config, key))
        except (KeyError, IndexError, TypeError):
            continue
        return float(f"{control.per_unit * value:.12g}")
    return None


def with_value(config: Table, control: Control, value: float) -> Table:
    """Return tables with the value of a control in the units of the page.

    Raises
    ------
    Refused
        If the value is no finite number, or the link has no such key.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise Refused(control.name, value, "finite numbers")
    for key in control.keys:
        path = _path(config, key)
        try:
            _at(config, path)
        except (KeyError, IndexError, TypeError):
            continue
        return _with(config, path, float(f"{value / control.per_unit:.12g}"))
    raise Refused(control.name, value, "a link with this value")


def with_water(config: Table, water: str) -> Table:
    """Return tables with a type of water; its index, bottom and phase function are the type's.

    Raises
    ------
    Refused
        If the type is unknown.
    """
    require_word(water, WATERS, "water.type")
    return config if water == GIVEN_WATER else {**config, "water": {"type": water}}


def slider_range(control: Control, value: float) -> tuple[float, float]:
    """Return the ends of a slider, twice as far as the value if it lies outside.

    Examples
    --------
    >>> slider_range(BY_NAME["depth"], 10.0), slider_range(BY_NAME["depth"], 100.0)
    ((0.5, 40.0), (0.5, 200.0))
    """
    low, high = control.low, control.high
    if value > high:
        high = 2.0 * value
    elif value < low:
        low = 0.5 * value if value > 0.0 else 2.0 * value
    return low, high


def _path(config: Mapping[str, Any], key: str) -> list[str | int]:
    """Return the path of a dotted key, through the first item of a list of parts."""
    path: list[str | int] = []
    for word in key.split("."):
        path.append(int(word) if word.isdecimal() else word)
        if len(path) == 1 and isinstance(config.get(word), list):
            path.append(0)
    return path


def _at(config: Any, path: list[str | int]) -> Any:
    for key in path:
        config = config[key]
    return config


def _with(part: Any, path: list[str | int], value: Any) -> Any:
    """Return a copy of nested tables and lists with the value at a path."""
    if not path:
        return value
    copy: Any = list(part) if isinstance(part, list | tuple) else dict(part)
    copy[path[0]] = _with(part[path[0]], path[1:], value)
    return copy
