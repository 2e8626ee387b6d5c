"""Controls of the explorer, each a value of the tables of a link file, and the state they make."""

from __future__ import annotations

import copy
import math
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any, Self, get_args

from meshtrace.comms import OokLink
from meshtrace.comms.ook import Preset
from meshtrace.errors import Refused, is_number, require_keys, require_word
from meshtrace.models import Model
from meshtrace.optics import Water, WaterType
from meshtrace.optics.spectra import WATER_TYPES
from meshtrace.scenario import Scenario
from meshtrace.scenario.files import plain
from meshtrace.scenario.parts import detector_of
from meshtrace.uav import UAVS

Table = dict[str, Any]

OWN = "own"
"""Word for a part of the link at the start that no word of its choice describes."""


@cache
def start_of(name: str) -> Scenario:
    """Return a link to start from, at the time of its answer."""
    return begun_at(Scenario.from_config(STARTS[name]["link"]), STARTS[name]["time"])


def begun_at(scenario: Scenario, time: float) -> Scenario:
    """Return a scenario at another time of its sea [s]."""
    return scenario.replace(meshing=scenario.meshing.replace(time=time))


class Control(Model, frozen=True):
    """A value that the user of the explorer moves.

    Parameters
    ----------
    name : str
        Name of the control and of its variable in the page.
    label, unit : str
        Texts beside it.
    group : str
        Heading of its group.
    keys : tuple of str
        Dotted keys of a link file, of which the first present one is set.
    low, high : float
        Range of the slider; see `State.ranges`.
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


def _asset(name: str) -> Table:
    """Return the tables of a file of the explorer."""
    return tomllib.loads(Path(__file__).with_name("assets").joinpath(name).read_text("utf-8"))


_FILE, STARTS = _asset("controls.toml"), _asset("starts.toml")

CONTROLS = tuple(Control.model_validate(row | {"name": n}) for n, row in _FILE["numbers"].items())
"""All controls with a number, in the order of the page."""

BY_NAME = {control.name: control for control in CONTROLS}

_LAMPS = {
    "LED": ("led", "half_angle_deg"),
    "laser": ("gaussian-beam", "divergence_deg"),
    "top hat": ("top-hat-beam", "divergence_deg"),
}
"""Kinds of lamps under water, and the key of their angle; lamps in the air begin with "air-"."""

_WIDEST_LASER = 59.5  # half angle [deg], for a Gaussian beam below 60

CASE_1 = "chlorophyll"
"""Word for water whose absorption and scattering follow from chlorophyll."""

_CHLOROPHYLL = 0.5  # of the choice [mg m-3]


class Choice(Model, frozen=True):
    """A word that the user of the explorer chooses.

    Parameters
    ----------
    label, group : str
        Text beside it, and heading of its group.
    words : tuple of str
        Words to choose from.
    """

    label: str
    group: str
    words: tuple[str, ...]


_NONE = "none"
CHOICES = {
    name: Choice(label=label, group=group, words=words)
    for name, label, group, words in (
        ("light", "Sky", "Daylight", (_NONE, "clear", "overcast", "moon", "night")),
        ("water", "Type", "Water", (CASE_1, *WATER_TYPES)),
        ("lamp", "Kind", "Lamp", tuple(_LAMPS)),
        ("detector", "Detector", "Receiver", get_args(Preset)),
        ("aircraft", "Aircraft", "Receiver", (_NONE, *UAVS)),
    )
}
"""Choices by name."""


def in_words(word: str) -> str:
    """Return the text of a word of a menu.

    Examples
    --------
    >>> in_words("overcast"), in_words("jerlov-1C"), in_words("dji-m300-rtk")
    ('overcast', 'Jerlov 1C', 'DJI M300 RTK')
    """
    text = re.sub("^jerlov", "Jerlov", word).replace("-", " ")
    return str(_FILE["words"].get(word, text.upper() if word in UAVS else text))


def groups() -> dict[str, dict[str, list[dict[str, Any]]]]:
    """Return the choices and the numbers of each group as the page shows them."""
    by_tab: dict[str, dict[str, list[dict[str, Any]]]] = {}
    for c in CONTROLS:
        title = f"{c.label} [{c.unit}]" if c.unit else c.label
        group = by_tab.setdefault(c.group, {"choices": [], "numbers": []})
        group["numbers"].append(c.model_dump() | {"title": title})
    for name, choice in CHOICES.items():
        words = {word: in_words(word) for word in (*choice.words, OWN)}
        by_tab[choice.group]["choices"].append(choice.model_dump() | {"name": name, "words": words})
    return by_tab


BITS_ALONE = ("power", "filter", "pde", "detector", "aircraft", "bit_rate", "light", "sun")
"""Controls on which no gain depends."""

_OF_DETECTOR = {"filter", "pde", "detector", "bit_rate"}
_PARTS = (*CHOICES, "wavelength", "chlorophyll")  # which give other controls their values
_REPLACED = {"water": ("chlorophyll", "a", "b"), "chlorophyll": ("a", "b"),
             "detector": ("filter", "pde")}  # fmt: skip
"""Controls whose earlier moves end with a move of another one."""


def value_of(config: Mapping[str, Any], control: Control) -> float | None:
    """Return the value of a control in the units of the page; None if the link lacks its key.

    Examples
    --------
    >>> value_of({"transmitter": {"depth": 12.0}}, BY_NAME["depth"])
    12.0
    >>> value_of({"transmitter": {"kind": "sun"}}, BY_NAME["depth"])
    """
    place = _place(config, control)
    if place is None or not is_number(place[0][place[1]]):  # a profile
        return None
    # twelve digits, or 0.05 m would show as 5.000000000000001 cm
    return float(f"{control.per_unit * place[0][place[1]]:.12g}")


def with_value(config: Table, control: Control, value: float) -> Table:
    """Return tables with the value of a control in the units of the page.

    Raises
    ------
    Refused
        If the value is no finite number, or the link has no such key.
    """
    if not is_number(value) or not math.isfinite(value):
        raise Refused(control.name, value, "finite numbers")
    config = copy.deepcopy(config)
    place = _place(config, control)
    if place is None or value_of(config, control) is None:
        raise Refused(control.name, value, "a link with this value")
    part, key = place
    part[key] = float(f"{value / control.per_unit:.12g}")
    return config


def with_coefficients(config: Table) -> Table:
    """Replace the spectrum of the water by its numbers in the tables of a link file."""
    # beside a spectrum a moved a or b would be refused
    water = Scenario.from_config(config).link.water
    if water.spectrum is None or water.layers is not None:
        return config
    names = Water.model_fields.keys() - {"spectrum", "wavelength_nm", "layers"}
    numbers = Water.model_validate({name: getattr(water, name) for name in names})
    return config | {"water": plain(numbers)}


def with_choice(config: Table, name: str, word: str) -> Table:
    """Return tables with a type of water, a kind of lamp, a detector, an aircraft or a light.

    Index, bottom and phase function come from the type; the sun stands as by default. A lamp
    keeps its angle, of half power (LED), of 1/e^2 (laser) or of the whole beam, up to its widest.

    Raises
    ------
    Refused
        If the word is unknown, or the link has no lamp.
    """
    require_word(word, CHOICES[name].words, name)
    if name == "lamp":
        return _with_lamp(config, word)
    if (name, word) == ("aircraft", _NONE):
        return {key: table for key, table in config.items() if key != "uav"}
    table = {
        "water": {"chlorophyll": _CHLOROPHYLL} if word == CASE_1 else {"type": word},
        "detector": {"preset": word, "bit_rate": config["detector"]["bit_rate"]},
        "aircraft": {"preset": word},
        "light": {"model": word},
    }[name]
    return config | {{"aircraft": "uav", "light": "daylight"}.get(name, name): table}


def _with_lamp(config: Table, word: str) -> Table:
    """Return tables with another kind of the first lamp."""
    config = copy.deepcopy(config)
    place = _place(config, BY_NAME["half_angle"])
    if place is None:
        raise Refused("lamp", word, "a link with a lamp that has an angle")
    lamp, angle = place
    kind, key = _LAMPS[word]
    kind = f"air-{kind}" if "height" in lamp else kind
    half_angle = min(lamp[angle], _widest(kind))
    # in place, as the lamp may be an item of a list; keys of one kind alone are refused by another
    for stale in lamp.keys() - set(_OF_LAMPS):
        del lamp[stale]
    lamp.update({"kind": kind, key: half_angle})
    return config


def _widest(kind: str) -> float:
    """Return the bound on the half angle of a kind of lamp [deg]."""
    return _WIDEST_LASER if kind.endswith("gaussian-beam") else math.inf


_OF_LAMPS = ("position", "depth", "height", "zenith_deg", "azimuth_deg", "tilt_deg",
             "tilt_azimuth_deg", "power_mw", "wavelength_nm")  # fmt: skip


def slider_range(control: Control, value: float | None) -> tuple[float, float]:
    """Return the range of a slider, extended to twice the value if that lies outside.

    Examples
    --------
    >>> slider_range(BY_NAME["depth"], 10.0), slider_range(BY_NAME["depth"], 100.0)
    ((0.5, 40.0), (0.5, 200.0))
    """
    low, high = control.low, control.high
    if value is not None and value > high:
        high = 2.0 * value
    elif value is not None and value < low:
        low = 0.5 * value if value > 0.0 else 2.0 * value
    return low, high


def _place(config: Mapping[str, Any], control: Control) -> tuple[Any, Any] | None:
    """Find the first key of a control that a link file has; return its table or list, and the key.

    Of a list of parts the first one counts.
    """
    for name in control.keys:
        *path, last = [int(word) if word.isdecimal() else word for word in name.split(".")]
        if path and isinstance(config.get(str(path[0])), list):
            path.insert(1, 0)
        table: Any = config
        try:
            for part in path:
                table = table[part]
            table[last]
        except (KeyError, IndexError, TypeError):
            continue
        return table, last
    return None


@dataclass(frozen=True)
class State:
    """A scenario, the controls that the user has moved, and the time of the sea.

    Parameters
    ----------
    initial : Scenario
        The link that the explorer was started with.
    moves : tuple of (str, object)
        Values of the moved controls by name, in the units of the page, and words of `CHOICES`.
    time : float
        Time of the sea [s].

    Notes
    -----
    Moves act on the link as given, not on each other: a move to a wind of 0 m/s and back returns
    the same sea, and a control at its value as given, or as chosen parts give it, is not moved.
    Another water ends moves of a and b, another detector those of its filter and its efficiency,
    and numbers without a place in the chosen parts, such as the sun without daylight, are left out.

    Examples
    --------
    >>> state = State(Scenario.from_toml(""))
    >>> moved = state.moved({"depth": 12.0})
    >>> state.values["depth"], moved.values["depth"]
    (10.0, 12.0)
    >>> moved.scenario.link.transmitter.depth
    12.0
    """

    initial: Scenario
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
        moves = dict(self.moves) | dict(values)
        ended = {other for name in values for other in _REPLACED.get(name, ())}
        for name in ended - values.keys():
            moves.pop(name, None)
        initial = State(self.initial).settings
        # parts first: the values that they bring decide which other moves are none
        parts = {n: v for n, v in moves.items() if n in _PARTS and v != initial[n]}
        if "lamp" in values and "half_angle" in moves.keys() - values.keys():
            widest = State(self.initial, tuple(parts.items())).ranges["half_angle"][1]
            moves["half_angle"] = min(moves["half_angle"], widest)
        start = State(self.initial, tuple(parts.items())).settings if parts else initial
        lacking = {n for n in moves.keys() - values.keys() if start[n] is None}
        others = {n: v for n, v in moves.items() if n not in _PARTS and v != start[n]}
        settings = {n: v for n, v in (parts | others).items() if n not in lacking}
        state = replace(self, moves=tuple(sorted(settings.items())))
        state.scenario  # noqa: B018 - refuses values that are not allowed
        return state

    def at(self, time: float) -> Self:
        """Return the state at another time of the sea [s]."""
        return replace(self, time=float(time))

    @cached_property
    def scenario(self) -> Scenario:
        """The scenario of the moved controls."""
        if not self.moves:
            return self.initial
        config = self._config
        # a detector that nobody asked for stays out of the link file
        if self.initial.detector is None and not _OF_DETECTOR & dict(self.moves).keys():
            config = {key: table for key, table in config.items() if key != "detector"}
        return Scenario.from_config(config)

    @cached_property
    def detector(self) -> OokLink:
        """Transmission over the link, of the scenario or of the physical preset."""
        return OokLink.of_link(self.scenario.link, self.scenario.detector or "physical")

    @cached_property
    def values(self) -> dict[str, float | None]:
        """Values of the controls in the units of the page; None for keys that a link lacks.

        a and b of a spectrum are rounded to three or four digits.
        """
        values = {name: value_of(self._config, control) for name, control in BY_NAME.items()}
        values["chlorophyll"] = value_of(self._parts, BY_NAME["chlorophyll"])
        water = self.scenario.link.water
        if water.spectrum is not None and water.layers is None:
            for name, value in (("a", water.a), ("b", water.b)):
                values[name] = float(f"{value:.{3 if value < 0.1 else 4}g}")
        return values

    @cached_property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """Ranges of the sliders, set by the initial link and limited by lamp and water."""
        start = self if not self.moves else State(self.initial)
        ranges = {n: slider_range(control, start.values[n]) for n, control in BY_NAME.items()}
        lamp, spectrum = self.scenario.link.transmitters[0], self.scenario.link.water.spectrum
        # a Gaussian beam has no half angle of 60 degrees or more
        low, high = ranges["half_angle"]
        ranges["half_angle"] = low, min(high, _widest(lamp.kind))
        if spectrum is not None:
            control = BY_NAME["wavelength"]
            low, high = (min(max(end, control.low), control.high) for end in spectrum.limits_nm)
            step = control.step  # of which the ends are multiples
            ranges["wavelength"] = step * math.ceil(low / step), step * math.floor(high / step)
        return ranges

    @property
    def barred(self) -> dict[str, str]:
        """Types of water without data at the wavelength, with their limits."""
        nm = self.scenario.link.transmitters[0].wavelength_nm
        limits = {word: WaterType(type=word).limits_nm for word in WATER_TYPES}
        if spectrum := self.initial.link.water.spectrum:
            limits[self.words["water"]] = spectrum.limits_nm
        return {
            word: f"{low:g} to {high:g} nm"
            for word, (low, high) in limits.items()
            if not low <= nm <= high
        }

    @property
    def limits(self) -> dict[str, Any]:
        """Ends of the sliders, and the words that the wavelength bars, with the reason."""
        ends = {
            name: [math.log10(end) if BY_NAME[name].log else end for end in pair]
            for name, pair in self.ranges.items()
        }
        barred = {word: f" ({reason})" for word, reason in self.barred.items()}
        unlisted = [name for name, word in self.words.items() if word == OWN]
        return {"ends": ends, "barred": {"water": barred}, "unlisted": unlisted}

    @property
    def words(self) -> dict[str, str]:
        """Words of the choices that describe the link at the start."""
        start, config = self.initial, self.initial.to_config()
        water, day = config["water"], config.get("daylight", {"model": _NONE})
        rate = (start.detector or OokLink()).bit_rate
        kind = getattr(start.link.transmitters[0], "kind", "").removeprefix("air-")
        described = {
            "light": day.get("model"),
            "water": CASE_1 if "chlorophyll" in water else water.get("type"),
            "lamp": next((word for word, (name, _) in _LAMPS.items() if name == kind), OWN),
            "detector": next((word for word in get_args(Preset) if start.detector in (
                None, detector_of(OokLink.preset(word, bit_rate=rate), start.link))), OWN),
            "aircraft": next((word for word, uav in UAVS.items() if uav == start.uav), OWN)
            if start.uav else _NONE,
        }  # fmt: skip
        return {n: word if word in CHOICES[n].words else OWN for n, word in described.items()}

    @property
    def settings(self) -> dict[str, Any]:
        """Values of all controls and words of all choices."""
        return self.values | self.words | {k: v for k, v in self.moves if k in CHOICES}

    @cached_property
    def channel(self) -> Scenario:
        """The scenario without detector and light above the sea: the inputs of a gain."""
        return self.scenario.replace(detector=None, daylight=None)

    @cached_property
    def _parts(self) -> Table:
        """Tables of the initial link with the chosen parts and the detector in use."""
        scenario, moves = self.initial, dict(self.moves)
        if scenario.detector is None:
            scenario = scenario.replace(detector=detector_of(OokLink(), scenario.link))
        config: Table = scenario.to_config()
        if "wavelength" in moves:  # on which a type of water depends
            config = with_value(config, BY_NAME["wavelength"], moves["wavelength"])
        words = [name for name in CHOICES if name in moves]
        for name in words:
            config = with_choice(config, name, moves[name])
        if words:  # numbers of the chosen parts, which further moves replace
            config = Scenario.from_config(config).to_config()
        if "chlorophyll" in moves:
            config = with_value(config, BY_NAME["chlorophyll"], moves["chlorophyll"])
        return config

    @cached_property
    def _config(self) -> Table:
        """Tables of the moved link, with the detector in use."""
        config, moves = self._parts, dict(self.moves)
        if moves.keys() & {"a", "b"}:
            config = with_coefficients(config)
        for name in moves.keys() - set(_PARTS):
            config = with_value(config, BY_NAME[name], moves[name])
        return config
