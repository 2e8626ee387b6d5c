"""Parameters of a link that sensitivities are taken by: names, base values, steps, changes.

Names are the keys of a link file with dots, list items by number: "water.a",
"receiver.position.0", "transmitter.1.depth", "sea.hs", "detector.led.extinction_ratio".
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from meshtrace.comms.ook import OokLink
from meshtrace.errors import Described, Refused, did_you_mean, require_between, require_names
from meshtrace.link import Link
from meshtrace.mesh import RandomSea, WaveSum
from meshtrace.models import Model

_ABSOLUTE = {"zenith_deg": "azimuth_deg", "tilt_deg": "tilt_azimuth_deg"}
_ANGLE_STEP, _PLACE_STEP = 1.0, 0.01  # [deg], and over depth plus height
_STEPS = {"fov_deg": 0.1, "radius": 0.1, "phase.n": 0.05, "phase.mu": 0.034}
_ORIGINS = {"phase.n": 1.0, "phase.mu": 3.0}  # singular points of the phase function
_SEA = ("wind_speed", "fetch", "gamma", "hs", "amplitude", "alpha_coefficient")
_NOT_BY_DEFAULT = ("wavelength_nm", "power_mw", "n_air", "n_water")
_UNITS = {"a": "m-1", "b": "m-1", "wind_speed": "m s-1", "power_mw": "mW", "wavelength_nm": "nm"}
_METRES = ("depth", "height", "radius", "position", "fetch", "hs", "amplitude", "size")
_GEOMETRY = ("transmitter", "receiver", "sea", "wind_speed")


class Setting(NamedTuple):
    """Link, surface and receiver electronics at one value of a parameter."""

    link: Link
    sea: Any
    ook: OokLink | None


class Parameter(NamedTuple):
    """A parameter and the step of its differences.

    Attributes
    ----------
    name : str
        Dotted name.
    base : float
        Value of the link.
    unit : str
        Its unit.
    absolute : bool
        Whether steps are in the unit of the parameter, which may be 0, and not relative.
    origin : float
        Value from which relative steps count: 1 for the index of the particles.
    step : float
        Step of the differences, relative or in `unit`.
    """

    name: str
    base: float
    unit: str
    absolute: bool
    origin: float
    step: float

    def shifted(self, steps: float) -> float:
        """Return the value at a signed number of steps."""
        return self.moved(steps * self.step)

    def moved(self, move: float) -> float:
        """Return the value at a move in `unit`, or in the logarithm if it is relative."""
        if self.absolute:
            return self.base + move
        return self.origin + self.scale * math.exp(move)

    @property
    def scale(self) -> float:
        """Change of the value per unit of `step`."""
        return 1.0 if self.absolute else self.base - self.origin

    def at(self, setting: Setting, value: float) -> Setting:
        """Return a setting with another value of the parameter.

        Raises
        ------
        Refused
            If the value is out of range.
        """
        head, _, rest = self.name.partition(".")
        link, sea, ook = setting
        if self.name == "wind_speed":
            for part in ("whitecaps", "bubbles"):
                if hasattr(getattr(link, part), "wind_speed"):
                    link = link.replace(f"{part}.wind_speed", value)
            return Setting(link, _sea_at(sea, "wind_speed", value), ook)
        if head == "sea":
            return Setting(link, _sea_at(sea, rest, value), ook)
        if head == "detector":
            assert ook is not None
            return Setting(link, sea, ook.replace(rest, value))
        link = _turned(link, self.name, value)
        if self.name == "water.n" and getattr(link.bubbles, "n_water", None) == self.base:
            link = link.replace("bubbles.n_water", value)
        if ook is not None:
            ook = OokLink.of_link(link, ook)
        return Setting(link, sea, ook)


def _turned(link: Link, name: str, value: float) -> Link:
    """Return a link with another value; a negative zenith angle is one of opposite azimuth."""
    path, _, last = name.rpartition(".")
    if last in _ABSOLUTE and value < 0.0:
        azimuth = f"{path}.{_ABSOLUTE[last]}"
        link = link.replace(azimuth, _value(link, azimuth) + 180.0)
        value = -value
    return link.replace(name, value)


def _sea_at(sea: Any, key: str, value: float) -> Any:
    """Return a sea with another value of a key; refuse one with other waves."""
    new = sea.replace(**{key: value})
    if isinstance(sea, RandomSea) and isinstance(sea, WaveSum):
        mine, other = sea.components, new.components
        same = len(mine.omega) == len(other.omega) and all(
            np.array_equal(getattr(mine, k), getattr(other, k)) for k in ("omega", "kx", "ky")
        )
        if not same:
            band = Described("other waves: the band follows the wind")
            allowed = "a sea of a given Band, such as sea.replace(waves=sea.band)"
            raise Refused(f"sea.{key}", band, allowed)
    return new


def _value(part: Any, name: str) -> Any:
    """Return the value at a dotted name of nested models and tuples."""
    for key in name.split("."):
        part = part[int(key)] if isinstance(part, tuple) else getattr(part, key)
    return part


def _numbers(part: Any, path: str) -> Iterator[tuple[str, float]]:
    """Yield the names and values of the continuous fields of a part."""
    if isinstance(part, Model):
        for key in type(part).model_fields:
            yield from _numbers(getattr(part, key), f"{path}.{key}")
    elif isinstance(part, tuple):
        for i, item in enumerate(part):
            yield from _numbers(item, f"{path}.{i}")
    elif isinstance(part, float) and math.isfinite(part):
        yield path, part


def _known(setting: Setting) -> dict[str, float]:
    """Return the continuous parameters by name."""
    link, sea, ook = setting
    parts = ["water", "bubbles", "whitecaps", "transmitter", "receiver"]
    found = {k: v for part in parts for k, v in _numbers(getattr(link, part), part)}
    found = {k: v for k, v in found.items() if not k.startswith("water.layers")}
    found["n_air"] = link.n_air
    for key in _SEA:
        value = getattr(sea, key, None)
        if isinstance(value, float) and key in type(sea).model_fields:
            found[f"sea.{key}"] = value
    if "sea.wind_speed" in found and link.wind_speed is not None:
        found["wind_speed"] = found["sea.wind_speed"]
    if ook is not None:
        own = ("detector.led.power", "detector.led.wavelength", "detector.optics.radius")
        found |= {k: v for k, v in _numbers(ook, "detector") if k not in own}
    return found


def _parameter(name: str, base: float, link: Link, step: float | None) -> Parameter:
    last = name.rpartition(".")[2]
    place = ".position." in name
    absolute = place or last in _ABSOLUTE or last in _ABSOLUTE.values()
    key = next((key for key in _STEPS if name.endswith(key)), "")
    unit = _UNITS.get(last, "1")
    if last.endswith("_deg"):
        unit = "deg"
    elif place or last in _METRES:
        unit = "m"
    if step is None:
        step = _STEPS.get(key, 0.01)
        if place:
            levels = [abs(item.center[2]) for _, item in link.items()]
            step = _PLACE_STEP * (max(levels) + min(levels))
        elif absolute:
            step = _ANGLE_STEP
    return Parameter(name, base, unit, absolute, _ORIGINS.get(key, 0.0), step)


def parameters(
    setting: Setting,
    wrt: Sequence[str] | None,
    step: float | None,
    normals: str,
    field: str = "wrt",
) -> list[Parameter]:
    """Return the parameters of a study.

    Parameters
    ----------
    setting : Setting
        The base.
    wrt : sequence of str, optional
        Their names; by default the continuous keys of the link, and those of the sea if its
        band does not follow them.
    step : float, optional
        Step of the differences, relative or in the unit of the parameter.
    normals : {"vertex", "facet"}
        Normals of the mesh: over facets the gain jumps with the geometry.
    field : str
        Name of the argument `wrt` in the study, for messages.

    Raises
    ------
    Refused
        If a name is unknown or not continuous, a value is at the end of its range, or the sea
        has other waves at another value.
    """
    known = _known(setting)
    given = list(known) if wrt is None else require_names(wrt, field)
    names = [re.sub(r"\[(\d+)\]", r".\1", name) for name in given]
    if step is not None:
        require_between(step, 0.0, 100.0, "step")
    if len(set(names)) < len(names):
        raise Refused(field, names, "each name once")
    found = []
    for name in names:
        if name not in known:
            hint = f"no such continuous key, {did_you_mean(name, known)}".rstrip()
            raise Refused(field, name, ", ".join(known), hint)
        p = _parameter(name, known[name], setting.link, step)
        if wrt is None and _left_out(p, setting):
            continue
        if normals == "facet" and name.split(".")[0] in _GEOMETRY:
            if wrt is None:
                continue
            raise Refused("normals", "facet", f"vertex: the gain over facets jumps with {name}")
        try:
            _require_inside(p, setting)
        except Refused:
            if wrt is not None:
                raise
            continue
        found.append(p)
    if not found:
        raise Refused(field, wrt, "at least one name")
    return found


def _left_out(p: Parameter, setting: Setting) -> bool:
    """Return whether a parameter is no default one: without effect, or not of the link."""
    path, _, last = p.name.rpartition(".")
    idle = [polar for polar, azimuth in _ABSOLUTE.items() if azimuth == last]
    if idle and _value(setting.link, f"{path}.{idle[0]}") == 0.0:
        return True
    if p.name.startswith("bubbles.") and last != "wind_speed":
        return True
    return last in _NOT_BY_DEFAULT or p.name.startswith("detector.") or p.name == "wind_speed"


def _require_inside(p: Parameter, setting: Setting) -> None:
    """Refuse a parameter whose steps leave its range."""
    if not p.absolute and p.base == p.origin:
        raise Refused(p.name, p.base, "a value other than 0, for relative steps")
    for steps in (-1.0, 1.0):
        p.at(setting, p.shifted(steps))
