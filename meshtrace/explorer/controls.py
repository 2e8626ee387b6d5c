"""Controls of the explorer, each a value of the tables of a link file, and the state they make."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, Self

from meshtrace.comms.ook import OokLink
from meshtrace.errors import Refused, require_keys, require_word
from meshtrace.optics.water import WATER_TYPES
from meshtrace.scenario import Scenario

Table = dict[str, Any]

GIVEN = "as given"
"""Choice of the water and the light that the explorer was started with."""


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
    Control("depth", "Depth", "m", "Place", (f"{_LAMP}.depth", f"{_RECEIVER}.depth"),
            0.5, 40.0, 0.5),
    Control("lamp_x", "Position x", "m", "", (f"{_LAMP}.position.0",), -20.0, 20.0, 0.1),
    Control("lamp_y", "Position y", "m", "", (f"{_LAMP}.position.1",), -20.0, 20.0, 0.1),
    Control(
        "half_angle", "Half angle", "deg", "Optics",
        (f"{_LAMP}.half_angle_deg", f"{_LAMP}.divergence_deg"), 0.5, 80.0, 0.5,
    ),
    Control("height", "Height", "m", "Place", (f"{_RECEIVER}.height", f"{_LAMP}.height"),
            0.5, 40.0, 0.5),
    Control("offset_x", "Offset x", "m", "Place", (f"{_RECEIVER}.position.0",), -20, 20, 0.1),
    Control("offset_y", "Offset y", "m", "Place", (f"{_RECEIVER}.position.1",), -20, 20, 0.1),
    Control("tilt", "Receiver tilt", "deg", "Optics", (f"{_RECEIVER}.tilt_deg",), 0.0, 60.0, 1.0),
    Control("fov", "Field of view", "deg", "Optics", (f"{_RECEIVER}.fov_deg",), 1.0, 180.0, 1.0),
    Control(
        "aperture", "Aperture radius", "cm", "Optics", (f"{_RECEIVER}.radius",),
        0.5, 50.0, 0.05, True, 100.0,
    ),
    Control(
        "bit_rate", "Bit rate", "Mbit/s", "Bits", ("detector.bit_rate",),
        0.1, 100.0, 0.05, True, 1e-6,
    ),
)  # fmt: skip
"""All controls with a number, in the order of the page."""

BY_NAME = {control.name: control for control in CONTROLS}

CHOICES = {
    "water": (GIVEN, *WATER_TYPES),
    "light": (GIVEN, "none", "clear", "overcast", "moon", "night"),
}
"""Choices of the water and of the light above the sea."""

BITS_ALONE = ("bit_rate", "light")
"""Controls on which no gain depends."""


def value_of(config: Mapping[str, Any], control: Control) -> float | None:
    """Return the value of a control in the units of the page, or None if the link lacks its key.

    Examples
    --------
    >>> value_of({"transmitter": {"depth": 12.0}}, BY_NAME["depth"])
    12.0
    >>> value_of({"transmitter": {"kind": "sun"}}, BY_NAME["depth"])
    """
    found = _find(config, control)
    return None if found is None else float(f"{control.per_unit * found[1]:.12g}")


def with_value(config: Table, control: Control, value: float) -> Table:
    """Return tables with the value of a control in the units of the page.

    Raises
    ------
    Refused
        If the value is no finite number, or the link has no such key.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise Refused(control.name, value, "finite numbers")
    found = _find(config, control)
    if found is None:
        raise Refused(control.name, value, "a link with this value")
    return _with(config, found[0], float(f"{value / control.per_unit:.12g}"))


def with_choice(config: Table, name: str, word: str) -> Table:
    """Return tables with a type of water, or with a light above the sea.

    Index, bottom and phase function are those of the type; the sun stands as by default.

    Raises
    ------
    Refused
        If the word is unknown.
    """
    require_word(word, CHOICES[name], name)
    if word == GIVEN:
        return config
    if name == "water":
        return {**config, "water": {"type": word}}
    return {**config, "daylight": {"model": word}}


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


def _find(config: Mapping[str, Any], control: Control) -> tuple[list[str | int], Any] | None:
    """Return path and value of the first key of a control that the tables have.

    Of a list of parts the first one counts.
    """
    for key in control.keys:
        path: list[str | int] = [int(word) if word.isdecimal() else word for word in key.split(".")]
        if isinstance(config.get(str(path[0])), list):
            path.insert(1, 0)
        found: Any = config
        try:
            for part in path:
                found = found[part]
        except (KeyError, IndexError, TypeError):
            continue
        return path, found
    return None


def _with(part: Any, path: list[str | int], value: Any) -> Any:
    """Return a copy of nested tables and lists with the value at a path."""
    if not path:
        return value
    copy: Any = list(part) if isinstance(part, list | tuple) else dict(part)
    copy[path[0]] = _with(part[path[0]], path[1:], value)
    return copy


@dataclass(frozen=True)
class State:
    """A scenario with the moves of its controls and the time of its sea.

    Parameters
    ----------
    given : Scenario
        The link that the explorer was started with.
    moves : tuple of (str, object)
        Values of the moved controls by name, in the units of the page; "water" and "light" are
        words of `CHOICES`.
    time : float
        Time of the sea [s].

    Notes
    -----
    Moves act on the link as given, not on each other: a move to a wind of 0 m/s and back returns
    the same sea, and a control at its value as given is not moved.

    Examples
    --------
    >>> state = State(Scenario.from_toml(""))
    >>> moved = state.moved({"depth": 12.0})
    >>> state.values["depth"], moved.values["depth"]
    (10.0, 12.0)
    >>> moved.scenario.link.transmitter.depth
    12.0
    """

    given: Scenario
    moves: tuple[tuple[str, Any], ...] = ()
    time: float = 0.0

    def moved(self, values: Mapping[str, Any]) -> Self:
        """Return the state after moves of controls.

        Raises
        ------
        Refused
            If a control is unknown, or its value or the link that it makes is not allowed.
        """
        require_keys(values, [*BY_NAME, *CHOICES])
        start = State(self.given).settings
        moves = {**dict(self.moves), **values}
        moves = {name: value for name, value in moves.items() if value != start[name]}
        state = replace(self, moves=tuple(sorted(moves.items())))
        state.scenario  # noqa: B018 - refuses values that are not allowed
        return state

    def at(self, time: float) -> Self:
        """Return the state at another time of the sea [s]."""
        return replace(self, time=float(time))

    @cached_property
    def scenario(self) -> Scenario:
        """The scenario of the moved controls."""
        if not self.moves:
            return self.given
        config = self._config
        if self.given.detector is None and "bit_rate" not in dict(self.moves):
            config = {key: table for key, table in config.items() if key != "detector"}
        return Scenario.from_config(config)

    @cached_property
    def detector(self) -> OokLink:
        """Transmission over the link, of the scenario or of the physical preset."""
        return OokLink.of_link(self.scenario.link, self.scenario.detector or "physical")

    @cached_property
    def values(self) -> dict[str, float | None]:
        """Values of the controls in the units of the page; None for keys that a link lacks."""
        return {name: value_of(self._config, control) for name, control in BY_NAME.items()}

    @property
    def settings(self) -> dict[str, Any]:
        """Values of all controls, with the words chosen for water and light."""
        words = dict.fromkeys(CHOICES, GIVEN)
        return {**self.values, **words, **{k: v for k, v in self.moves if k in CHOICES}}

    @cached_property
    def channel(self) -> Scenario:
        """The scenario without detector and light above the sea: the inputs of a gain."""
        return self.scenario.replace(detector=None, daylight=None)

    @cached_property
    def _config(self) -> Table:
        """Tables of the moved link, with the bit rate in use."""
        config: Table = {"detector": {"bit_rate": OokLink().bit_rate}, **self.given.to_config()}
        for name, value in self.moves:
            if name in CHOICES:
                config = with_choice(config, name, value)
            else:
                config = with_value(config, BY_NAME[name], value)
        return config
