"""Parameters that sensitivities of a link are taken by, and quantities that they are taken of.

Names of parameters are the keys of a link file with dots, list items by number: "water.a",
"receiver.position.0", "transmitter.1.depth", "sea.hs", "detector.led.extinction_ratio".
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq
from scipy.special import ndtr

from meshtrace.comms.budget import required_gain
from meshtrace.comms.ook import OokLink
from meshtrace.errors import (
    Described,
    Refused,
    did_you_mean,
    require_between,
    require_names,
    require_word,
)
from meshtrace.link import Link
from meshtrace.mesh import SeededSurface, WaveSum
from meshtrace.models import Floats, Model
from meshtrace.studies.neighbours import without_each

_ABSOLUTE = {"zenith_deg": "azimuth_deg", "tilt_deg": "tilt_azimuth_deg"}
_ANGLE_STEP, _PLACE_STEP = 1.0, 0.01  # [deg], and over depth plus height
_STEPS = {"fov_deg": 0.1, "radius": 0.1, "phase.n": 0.05, "phase.mu": 0.034}
_ORIGINS = {"phase.n": 1.0, "phase.mu": 3.0}  # singular points of the phase function
_SEA = ("wind_speed", "fetch", "gamma", "hs", "amplitude", "alpha_coefficient")
_NOT_BY_DEFAULT = ("wavelength_nm", "power_mw", "n_air", "n_water")
_UNITS = {"a": "m-1", "b": "m-1", "wind_speed": "m s-1", "power_mw": "mW", "wavelength_nm": "nm"}
_METRES = ("depth", "height", "radius", "position", "fetch", "hs", "amplitude", "size")
_GEOMETRY = ("transmitter", "receiver", "sea", "wind_speed")


class Variant(NamedTuple):
    """Link, surface and receiver electronics at one value of a parameter."""

    link: Link
    sea: Any
    ook: OokLink | None = None

    def at(self, values: Iterable[tuple[Parameter, float]]) -> Variant:
        """Return the variant with other values of parameters."""
        variant = self
        for p, value in values:
            variant = p.at(variant, value)
        return variant


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

    def at(self, variant: Variant, value: float) -> Variant:
        """Return a variant with another value of the parameter.

        Raises
        ------
        Refused
            If the value is out of range.
        """
        head, _, rest = self.name.partition(".")
        link, sea, ook = variant
        if self.name == "wind_speed":
            for part in ("whitecaps", "bubbles"):
                if hasattr(getattr(link, part), "wind_speed"):
                    link = link.replace(f"{part}.wind_speed", value)
            return Variant(link, _sea_at(sea, "wind_speed", value), ook)
        if head == "sea":
            return Variant(link, _sea_at(sea, rest, value), ook)
        if head == "detector":
            assert ook is not None
            return Variant(link, sea, ook.replace(rest, value))
        path, _, last = self.name.rpartition(".")
        if last in _ABSOLUTE and value < 0.0:  # a positive angle of opposite azimuth
            azimuth = f"{path}.{_ABSOLUTE[last]}"
            link = link.replace(azimuth, _value(link, azimuth) + 180.0)
            value = -value
        link = link.replace(self.name, value)
        if self.name == "water.n" and getattr(link.bubbles, "n_water", None) == self.base:
            link = link.replace("bubbles.n_water", value)
        if ook is not None:
            ook = OokLink.of_link(link, ook)
        return Variant(link, sea, ook)


def _sea_at(sea: Any, key: str, value: float) -> Any:
    """Return a sea with another value of a key; refuse one with other waves."""
    new = sea.replace(**{key: value})
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


def _known(variant: Variant) -> dict[str, float]:
    """Return the continuous parameters by name."""
    link, sea, ook = variant
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
            for steps in (-1.0, 1.0):
                p.at(variant, p.shifted(steps))
        except Refused:
            if wrt is not None:
                raise
            continue
        found.append(p)
    if not found:
        raise Refused(field, wrt, "at least one name")
    return found


def _left_out(p: Parameter, variant: Variant) -> bool:
    """Return whether a parameter is no default one: without effect, or not of the link."""
    path, _, last = p.name.rpartition(".")
    idle = [polar for polar, azimuth in _ABSOLUTE.items() if azimuth == last]
    if idle and _value(variant.link, f"{path}.{idle[0]}") == 0.0:
        return True
    if p.name.startswith("bubbles.") and last != "wind_speed":
        return True
    return last in _NOT_BY_DEFAULT or p.name.startswith("detector.") or p.name == "wind_speed"


Of = Literal["gain", "ber", "outage", "range", "margin"]

FADES = ("ber", "outage", "range")
"""Quantities that depend on the distribution of the gain over seas."""

_POINTS = 200  # of the table of error rates
_LEAST_OUTAGES = 30
_LEAST_SEAS = 8
_DB = 10.0 / math.log(10.0)


class Quantity:
    """A quantity of a link over seas.

    Parameters
    ----------
    of : {"gain", "ber", "outage", "range", "margin"}
        Mean gain; bit error rate averaged over the seas; probability that the bit error rate of a
        sea misses the limit; depth at which the averaged rate meets it, or else at which the mean
        gain is that of the link; mean over required gain.
    limit : float
        Bit error rate of a working link.

    Notes
    -----
    `log` is the natural logarithm of the quantity; for "range" that of the factor by which the
    light exceeds the need, whose zero is the range.
    """

    def __init__(self, of: Of, limit: float) -> None:
        require_word(of, get_args(Of), "of")
        self.of, self.limit = of, limit
        self._laws: dict[str, Callable[[Floats], Floats]] = {}
        self._needs: dict[str, float] = {}

    @property
    def unit(self) -> str:
        """Unit of the quantity."""
        return {"range": "m", "margin": "dB"}.get(self.of, "1")

    def log(self, gains: Floats, ook: OokLink | None) -> float:
        """Return the logarithm of the quantity for the gains (seas, shifts)."""
        means = gains.mean(axis=1)
        if not means.min() > 0.0:
            raise Refused("link", float(means.min()), "a gain > 0 over each sea")
        if self.of == "gain" or ook is None:
            return math.log(means.mean())
        if self.of == "margin":
            return math.log(means.mean() / self._need(ook))
        if self.of == "outage":
            return self._outage(np.log(means / self._need(ook)))
        logs = np.log(ook.received_power(means))
        if self.of == "ber":
            return math.log(np.exp(self.law(ook)(logs)).mean())
        law = self.law(ook, rising=False)
        goal = math.log(self.limit)
        spread = 30.0

        def excess(shift: float) -> float:
            return math.log(np.exp(law(logs + shift)).mean()) - goal

        if not excess(-spread) > 0.0 > excess(spread):
            raise Refused("limit", self.limit, "a bit error rate that some power reaches")
        return -float(brentq(excess, -spread, spread, xtol=1e-9))

    def logs(self, gains: Floats, ook: OokLink | None) -> Floats:
        """Return the logarithm for all gains and for the groups of the jackknife."""
        return np.array([self.log(group, ook) for group in without_each(gains)])

    def value(self, log: float) -> float:
        """Return the quantity from its logarithm; for "range" the factor of the light."""
        return _DB * log if self.of == "margin" else math.exp(log)

    def slope(self, value: float) -> float:
        """Return d quantity / d log; for "range" 1."""
        return {"margin": _DB, "range": 1.0}.get(self.of, value)

    def _outage(self, logs: Floats) -> float:
        """Return the logarithm of the outage from the logarithms of gain over need.

        With 30 outages at least: smoothed by a normal kernel. Otherwise: lognormal law.
        """
        if len(logs) < _LEAST_SEAS - 1:
            raise Refused("realizations", len(logs), f">= {_LEAST_SEAS} for outages")
        spread = float(logs.std(ddof=1))
        if np.count_nonzero(logs < 0.0) >= _LEAST_OUTAGES:
            width = 1.06 * spread * len(logs) ** -0.2
            share = float(ndtr(-logs / width).mean())
        else:
            share = float(ndtr(-logs.mean() / spread))
        return math.log(max(share, 1e-300))

    def _need(self, ook: OokLink) -> float:
        key = ook.model_dump_json()
        if key not in self._needs:
            self._needs[key] = required_gain(ook, self.limit)
        return self._needs[key]

    def law(self, ook: OokLink, rising: bool = True) -> Callable[[Floats], Floats]:
        """Return ln BER over ln power, tabulated once for each receiver.

        Without `rising` rates of an overloaded receiver stay at their minimum.
        """
        key = f"{rising}{ook.model_dump_json()}"
        if key not in self._laws:
            middle = math.log(ook.required_power(self.limit))
            nodes = np.linspace(middle - 9.0, middle + 7.0, _POINTS)
            rates = np.log(np.maximum(ook.ber(np.exp(nodes)), 1e-300))
            table = PchipInterpolator(nodes, rates if rising else np.minimum.accumulate(rates))
            self._laws[key] = lambda logs: table(np.clip(logs, nodes[0], nodes[-1]))
        return self._laws[key]
