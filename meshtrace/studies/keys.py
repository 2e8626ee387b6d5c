"""Keys of a link with its sea, detector, daylight and aircraft, and their values in studies.

Names are the keys of a link file with dots, list items by number: "water.a",
"receiver.position.0", "transmitter.1.depth", "sea.hs", "detector.optics.filter_width_nm",
"daylight.sun_zenith_deg", "uav.mass".
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from meshtrace.checks import check_methods
from meshtrace.comms.ook import OokLink
from meshtrace.daylight.light import Daylight
from meshtrace.errors import (
    Described,
    Refused,
    did_you_mean,
    require_between,
    within,
)
from meshtrace.link import Link
from meshtrace.mesh import SeededSurface, WaveSum
from meshtrace.models import Model
from meshtrace.scenario.parts import OF_LINK, daylight_values, daylight_with
from meshtrace.uav import Uav

Bounds = Mapping[str, tuple[float, float]]
"""Lowest and highest value of each key."""

_ABSOLUTE = {
    "zenith_deg": "azimuth_deg",
    "tilt_deg": "tilt_azimuth_deg",
    "sun_zenith_deg": "sun_azimuth_deg",
}
_ANGLE_STEP, _PLACE_STEP = 1.0, 0.01  # [deg], and over depth plus height
_STEPS = {"fov_deg": 0.1, "radius": 0.1, "phase.n": 0.05, "phase.mu": 0.034}
_ORIGINS = {"phase.n": 1.0, "phase.mu": 3.0}  # singular points of the phase function
_SEA = ("wind_speed", "fetch", "gamma", "hs", "amplitude", "alpha_coefficient")
_NOT_BY_DEFAULT = ("wavelength_nm", "power_mw", "n_air", "n_water")
_UNITS = {
    "a": "m-1", "b": "m-1", "wind_speed": "m s-1", "power_mw": "mW", "bit_rate": "bit s-1",
    "dark_count_rate": "s-1", "background_rate": "s-1", "bandwidth": "Hz", "recovery_time": "s",
    "window": "s", "area": "m2", "resistance": "ohm", "temperature": "K", "mass": "kg",
    "air_density": "kg m-3", "pressure": "Pa", "ozone": "cm", "water_vapour": "cm",
    "direct": "W m-2 nm-1", "diffuse": "W m-2 nm-1", "depth": "m", "height": "m", "radius": "m",
    "fetch": "m", "hs": "m", "amplitude": "m", "size": "m",
}  # fmt: skip
_GEOMETRY = ("transmitter", "receiver", "sea", "wind_speed")
_LONGEST = 560  # letters of a list of keys
_BESIDES = ("detector", "daylight", "uav")


@check_methods
class Variant(NamedTuple):
    """Link with its sea, detector, daylight and aircraft, at one value of each key.

    Attributes
    ----------
    link : Link
        The link.
    sea : Surface or TriangleMesh
        The surface.
    detector : OokLink, optional
        Transmission; power, wavelength and aperture are those of the link. Functions of a user
        get it with the counts of the background light.
    daylight : Daylight, optional
        Light above the sea.
    uav : Uav, optional
        Airframe.
    """

    link: Link
    sea: Any
    detector: OokLink | None = None
    daylight: Daylight | None = None
    uav: Uav | None = None

    def at(self, values: Iterable[tuple[Parameter, float]]) -> Variant:
        """Return the variant with other values of parameters."""
        variant = self
        for p, value in values:
            variant = p.at(variant, value)
        return variant

    def set(self, name: str, value: Any) -> Variant:
        """Return a variant with another value of a key.

        Raises
        ------
        Refused
            If there is no such key, or the value is out of range.
        """
        head, _, rest = name.partition(".")
        if name == "wind_speed":
            link = self.link
            # one wind drives them all; parts with coefficients of their own stay
            for part in ("whitecaps", "bubbles"):
                if hasattr(getattr(link, part), "wind_speed"):
                    link = link.replace(f"{part}.wind_speed", value)
            return self._replace(link=link, sea=_sea_at(self.sea, name, value))
        if head == "sea":
            return self._replace(sea=_sea_at(self.sea, rest, value))
        if head in _BESIDES:
            model: Any = getattr(self, head)
            if model is None:
                raise Refused(name, value, f"a link with [{head}]")
            with within(head):
                if head == "daylight":
                    return self._replace(daylight=daylight_with(model, rest, value))
                changed = model.replace(rest, value)
            if head == "uav":
                return self._replace(uav=changed)
            return self._replace(detector=changed)
        return self._on_link(name, value)

    def _on_link(self, name: str, value: Any) -> Variant:
        """Return the variant with another value of a key of the link and of all that follows."""
        # what the rest of the variant takes from the link changes with it
        link, day, last = self.link.replace(name, value), self.daylight, name.rpartition(".")[2]
        # bubbles are in the same water unless the user says otherwise
        if name == "water.n" and getattr(link.bubbles, "n_water", None) == self.link.water.n:
            link = link.replace("bubbles.n_water", value)
        # the light above the sea is that of the wavelength at which the link works
        if day is not None and name.startswith("transmitter.") and last == "wavelength_nm":
            day = daylight_with(day, last, link.transmitters[0].wavelength_nm)
        detector = self.detector and OokLink.of_link(link, self.detector)
        return self._replace(link=link, daylight=day, detector=detector)

    def value(self, name: str) -> Any:
        """Return the value of a key of the link, the detector, the daylight or the aircraft."""
        head, _, rest = name.partition(".")
        part, path = (getattr(self, head), rest) if head in _BESIDES else (self.link, name)
        try:
            for key in path.split("."):
                part = part[int(key)] if isinstance(part, tuple) else getattr(part, key)
        except (AttributeError, IndexError, ValueError) as error:
            raise Refused("name", name, "a dotted key, such as receiver.height") from error
        return part


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
    step, usual : float
        Step of the differences, relative or in `unit`, and the one without any given.
    """

    name: str
    base: float
    unit: str
    absolute: bool
    origin: float
    step: float
    usual: float

    def shifted(self, steps: float) -> float:
        """Return the value at a signed number of steps."""
        return self.moved(steps * self.step)

    def moved(self, move: float) -> float:
        """Return the value after a move in its unit, or in its logarithm if steps are relative."""
        if self.absolute:
            return self.base + move
        return self.origin + self.scale * math.exp(move)

    def about(self, change: float) -> tuple[float, float]:
        """Return the values at a relative change below and above the base.

        Offsets and angles change by a share of depth plus height, and of 10 deg.
        """
        if self.absolute:
            # steps are 1 % of the length of a link, or 1 deg of 10
            far = change * self.step / (_PLACE_STEP if self.unit == "m" else 0.1)
            return self.base - far, self.base + far
        return self.origin + self.scale * (1.0 - change), self.origin + self.scale * (1.0 + change)

    @property
    def scale(self) -> float:
        """Change of the value per unit of `step`."""
        return 1.0 if self.absolute else self.base - self.origin

    def at(self, variant: Variant, value: float) -> Variant:
        """Return a variant with another value of the parameter.

        Raises
        ------
        Refused
            If the value is out of range.
        """
        path, _, last = self.name.rpartition(".")
        if last in _ABSOLUTE and value < 0.0:  # a positive angle of opposite azimuth
            azimuth = f"{path}.{_ABSOLUTE[last]}"
            variant = variant.set(azimuth, variant.value(azimuth) + 180.0)
            value = -value
        return variant.set(self.name, value)

    def allows(self, variant: Variant, steps: float) -> bool:
        """Return whether the value at a signed number of steps is in range."""
        try:
            self.at(variant, self.shifted(steps))
        except Refused:
            return False
        return True


def _sea_at(sea: Any, key: str, value: float) -> Any:
    """Return a sea with another value of a key; refuse one with other waves."""
    new = sea.replace(key, value)
    # differences need the same waves with the same phases: a band that follows the wind moves them
    if isinstance(sea, SeededSurface) and isinstance(sea, WaveSum):
        mine, other = sea.components, new.components
        same = len(mine.omega) == len(other.omega) and all(
            np.array_equal(getattr(mine, k), getattr(other, k)) for k in ("omega", "kx", "ky")
        )
        if not same:
            band = Described("other waves: the band follows the wind")
            allowed = "a sea of a given Band, such as sea.replace(waves=sea.band)"
            raise Refused(f"sea.{key}", band, allowed)
    return new


def _numbers(part: Any, path: str) -> Iterator[tuple[str, float]]:
    """Yield names and values of the continuous fields of a model, items of lists included."""
    if isinstance(part, Model):
        for key in type(part).model_fields:
            yield from _numbers(getattr(part, key), f"{path}.{key}")
    elif isinstance(part, tuple):
        for i, item in enumerate(part):
            yield from _numbers(item, f"{path}.{i}")
    elif isinstance(part, float) and math.isfinite(part):
        yield path, part


def _known(variant: Variant) -> dict[str, float]:
    """Return the values of all continuous parameters by name."""
    link, sea = variant.link, variant.sea
    parts = ["water", "bubbles", "whitecaps", "transmitter", "receiver"]
    numbers = {k: v for part in parts for k, v in _numbers(getattr(link, part), part)}
    # a layer is a list of numbers whose order matters: no value to vary alone
    numbers = {k: v for k, v in numbers.items() if not k.startswith("water.layers")}
    numbers["n_air"] = link.n_air
    for key in _SEA:
        value = getattr(sea, key, None)
        if isinstance(value, float) and key in type(sea).model_fields:
            numbers[f"sea.{key}"] = value
    # one wind for sea, whitecaps and bubbles
    if "sea.wind_speed" in numbers and link.wind_speed is not None:
        numbers["wind_speed"] = numbers["sea.wind_speed"]
    # these follow the link and are no parameters of their own
    from_link = {f"detector.{part}.{key}" for part, keys in OF_LINK.items() for key in keys}
    numbers |= {k: v for k, v in _numbers(variant.detector, "detector") if k not in from_link}
    if variant.daylight is not None:
        numbers |= {f"daylight.{k}": v for k, v in daylight_values(variant.daylight).items()}
    return numbers | dict(_numbers(variant.uav, "uav"))


def _parameter(name: str, base: float, link: Link, step: float | None) -> Parameter:
    last = name.rpartition(".")[2]
    place = ".position." in name
    absolute = place or last in _ABSOLUTE or last in _ABSOLUTE.values()
    key = next((key for key in _STEPS if name.endswith(key)), "")
    unit, usual = _UNITS.get(last, "1"), _STEPS.get(key, 0.01)
    if last.endswith(("_deg", "_nm")):
        unit = last.rpartition("_")[2]
    if place:
        unit = "m"
        # an offset may be 0: the length of the link is its scale
        levels = [abs(item.center[2]) for _, item in link.items()]
        usual = _PLACE_STEP * (max(levels) + min(levels))
    elif absolute:
        usual = _ANGLE_STEP
    chosen = usual if step is None else step
    return Parameter(name, base, unit, absolute, _ORIGINS.get(key, 0.0), chosen, usual)


def parameters(
    variant: Variant,
    wrt: Sequence[str] | None,
    step: float | None,
    normals: str,
    field: str = "wrt",
) -> list[Parameter]:
    """Return the parameters of a study.

    Parameters
    ----------
    variant : Variant
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
    known = _known(variant)
    wanted = list(known) if wrt is None else wrt
    names = [re.sub(r"\[(\d+)\]", r".\1", name) for name in wanted]
    if step is not None:
        require_between(step, 0.0, 100.0, "step")
    if len(set(names)) < len(names):
        raise Refused(field, names, "each name once")
    parameters = []
    for name in names:
        if name not in known:
            hint = f"no such continuous key, {did_you_mean(name, known)}".rstrip()
            raise Refused(field, name, _listed(known, name), hint)
        p = _parameter(name, known[name], variant.link, step)
        if wrt is None and _left_out(p, variant):
            continue
        if normals == "facet" and name.split(".")[0] in _GEOMETRY:
            if wrt is None:
                continue
            raise Refused("normals", "facet", f"vertex: the gain over facets jumps with {name}")
        try:
            if not p.absolute and p.base == p.origin:
                raise Refused(p.name, p.base, "a value other than 0, for relative steps")
            # both ends of the difference have to be allowed values
            for steps in (-1.0, 1.0):
                p.at(variant, p.shifted(steps))
        except Refused:
            if wrt is not None:
                raise
            continue
        parameters.append(p)
    if not parameters:
        raise Refused(field, wrt, "at least one name")
    return parameters


def checked_bounds(bounds: Bounds) -> dict[str, tuple[float, float]]:
    """Return the bounds of each key; refuse those that do not rise."""
    for key, (low, high) in bounds.items():
        if not low < high:
            raise Refused(f"bounds.{key}", (low, high), "(low, high), low < high")
    return dict(bounds)


def _listed(known: Iterable[str], name: str) -> str:
    """List keys for a message: the neighbours of a name, and the names of other tables."""
    names = list(known)
    if len(", ".join(names)) <= _LONGEST:
        return ", ".join(names)
    head = name.partition(".")[0]
    under_head = [key for key in names if key.partition(".")[0] == head]
    others = (key.partition(".") for key in names if key not in under_head)
    tables = dict.fromkeys(f"{table}{dot}{'*' if dot else ''}" for table, dot, _ in others)
    return ", ".join([*under_head, *tables])


def _left_out(p: Parameter, variant: Variant) -> bool:
    """Return whether a parameter is left out by default: idle, or not of the link."""
    path, _, last = p.name.rpartition(".")
    idle = [polar for polar, azimuth in _ABSOLUTE.items() if azimuth == last]
    # the azimuth of what is not tilted has no effect
    if idle and variant.value(f"{path}.{idle[0]}") == 0.0:
        return True
    # the parameters of a population follow its wind
    if p.name.startswith("bubbles.") and last != "wind_speed":
        return True
    return last in _NOT_BY_DEFAULT or path.split(".")[0] in _BESIDES or p.name == "wind_speed"
