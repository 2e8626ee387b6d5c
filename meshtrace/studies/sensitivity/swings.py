"""Changes of a quantity with parameters at two other values, from runs with common chains."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from meshtrace.comms.ook import OokLink
from meshtrace.errors import Described, Refused, require_between, require_keys, require_pair
from meshtrace.scenario import Scenario
from meshtrace.studies.campaign import Campaign
from meshtrace.studies.neighbours import error_of
from meshtrace.studies.sensitivity.parameters import Parameter, Setting, parameters
from meshtrace.studies.sensitivity.quantities import Quantity
from meshtrace.studies.sensitivity.result import Sensitivities
from meshtrace.studies.sensitivity.study import Study

_DEPTH = "transmitter.depth"
_DB = 10.0 / math.log(10.0)


class Swing(NamedTuple):
    """Change of a quantity at a lower and a higher value of a parameter.

    Attributes
    ----------
    name, unit : str
        Parameter and its unit.
    values : (float, float)
        The two values.
    change, stderr : (float, float)
        Change of the quantity [dB, or m for "range"] and its standard error.
    """

    name: str
    unit: str
    values: tuple[float, float]
    change: tuple[float, float]
    stderr: tuple[float, float]


def swings(
    s: Sensitivities, change: float | Mapping[str, tuple[float, float]] = 0.1
) -> list[Swing]:
    """Return the changes of the quantity of a study over given intervals of its parameters.

    Parameters
    ----------
    s : Sensitivities
        Its link, sea, chains and quantity are used again.
    change : float or mapping of str to (low, high)
        Relative change of all parameters to either side, or the values of some. Offsets and
        angles change by `change` times depth plus height, and `change` times 10 deg.

    Returns
    -------
    list of Swing
        The largest first.

    Notes
    -----
    Each end is a run, not a product of derivatives. For "range" the depth follows the change of
    the light by the derivative by the depth, and a second run at the new depth corrects it.

    Raises
    ------
    Refused
        If a parameter is not in the table, or the study was one over a mesh.
    """
    if not isinstance(s, Sensitivities):
        raise Refused("s", Described(type(s).__name__), "Sensitivities")
    swing = _Swings(s)
    names = [row.name for row in s.table]
    if isinstance(change, Mapping):
        require_keys(change, names)
        ends = {
            name: require_pair(pair, f"change.{name}", "(low, high)")
            for name, pair in change.items()
        }
    else:
        change = require_between(change, 0.0, 1.0, "change")
        ends = {name: swing.ends(name, change) for name in names}
    found = [swing.of(name, pair) for name, pair in ends.items()]
    return sorted(found, key=lambda one: -max(map(abs, one.change)))


class _Swings:
    """Study of a result, set up again."""

    def __init__(self, s: Sensitivities) -> None:
        origin: dict[str, Any] = s.provenance
        scenario = Scenario.from_provenance(origin)
        ook = origin["ook"] and OokLink.model_validate(origin["ook"])
        setting = Setting(scenario.link, scenario.surface, ook)
        inputs: Any = scenario.surface, scenario.run, scenario.meshing
        campaign = Campaign({"link": scenario.link}, *inputs)
        self._quantity = Quantity(s.of, origin["limit"])  # type: ignore[arg-type]
        self._study = Study(setting, campaign, origin["realizations"], self._quantity, {})
        self._base = self._logs(setting)
        names = [row.name for row in s.table]
        found = parameters(setting, names, None, scenario.meshing.normals)
        self._parameters = {p.name: p for p in found}
        self._rate = 0.0
        if s.of == "range":
            p = parameters(setting, [_DEPTH], None, scenario.meshing.normals)[0]
            sides = [self._logs(p.at(setting, p.shifted(k)))[0] for k in (-1.0, 1.0)]
            self._rate = (sides[1] - sides[0]) / (2.0 * p.step * p.base)

    def _logs(self, setting: Setting) -> Any:
        """Return the logarithm of the quantity: of all gains, and of the groups."""
        return self._quantity.logs(self._study.gains("gains", setting), setting.ook)

    def ends(self, name: str, change: float) -> tuple[float, float]:
        """Return the two values of a parameter."""
        p = self._parameters[name]
        if p.absolute:
            far = change * p.step / (0.01 if p.unit == "m" else 0.1)
            return p.base - far, p.base + far
        return p.origin + p.scale * (1.0 - change), p.origin + p.scale * (1.0 + change)

    def of(self, name: str, ends: tuple[float, float]) -> Swing:
        """Return the swing of a parameter."""
        p = self._parameters[name]
        (low, low_error), (high, high_error) = (self._one(p, end) for end in ends)
        return Swing(name, p.unit, ends, (low, high), (low_error, high_error))

    def _one(self, p: Parameter, value: float) -> tuple[float, float]:
        """Return the change of the quantity at one value, and its error."""
        setting = p.at(self._study.setting, value)
        off = self._logs(setting) - self._base
        if self._quantity.of != "range":
            return _DB * float(off[0]), _DB * error_of(off)
        depth = float(setting.link.transmitters[0].depth)  # type: ignore[attr-defined]
        moved = -off / self._rate
        there = setting._replace(link=setting.link.at_depth(depth + float(moved[0])))
        rest = self._logs(there) - self._base
        moved = moved[0] - rest / self._rate
        return float(moved[0]), error_of(moved)
