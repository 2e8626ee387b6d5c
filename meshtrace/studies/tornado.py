"""Swings: changes of a link's quantity over intervals of its parameters, by runs at both ends."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from meshtrace.checks import check_call
from meshtrace.errors import require_between, require_keys
from meshtrace.scenario import Scenario
from meshtrace.studies.campaign import Campaign
from meshtrace.studies.derivatives import Sensitivities
from meshtrace.studies.keys import Variant, parameters
from meshtrace.studies.neighbours import DECIBELS, Quantity, depth_key, error_of
from meshtrace.studies.sensitivity import MODELS, Study


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


@check_call
def swings(
    s: Sensitivities, change: float | Mapping[str, tuple[float, float]] = 0.1
) -> list[Swing]:
    """Return the changes of a study's quantity over intervals of its parameters.

    Parameters
    ----------
    s : Sensitivities
        Its link, sea, chains and quantity are used again.
    change : float or mapping of str to (low, high)
        Relative change of all parameters to either side, or both values of some. Offsets change by
        `change` times depth plus height, angles by `change` times 10 deg.

    Returns
    -------
    list of Swing
        The largest first.

    Notes
    -----
    Each end is a run, not a forecast from derivatives. For "range" the change of the light over
    its derivative by the depth gives a new depth, and a second run there corrects it.

    Raises
    ------
    Refused
        If a parameter is not in the table, or the study was one over a mesh.
    """
    names = [row.name for row in s.table]
    if isinstance(change, Mapping):
        require_keys(change, names)
        ends = dict(change)
    else:
        change = require_between(change, 0.0, 1.0, "change")
    study = _study_of(s)
    variant, normals = study.variant, study.campaign.meshing.normals
    known = {p.name: p for p in parameters(variant, names, None, normals)}
    if not isinstance(change, Mapping):
        ends = {name: p.about(change) for name, p in known.items()}
    base, slope = study.logs_of(variant), 0.0
    if s.quantity == "range":  # slope is d ln q / d depth [m-1], negative
        (depth,) = parameters(variant, [depth_key(variant.link)], None, normals)
        low, high = (study.logs_of(depth.at(variant, depth.shifted(k)))[0] for k in (-1.0, 1.0))
        slope = (high - low) / (2.0 * depth.step * depth.base)

    def change_at(there: Variant) -> tuple[float, float]:
        """Return the change [dB, or m] of the quantity and its standard error."""
        off = study.logs_of(there) - base
        if s.quantity != "range":
            return DECIBELS * float(off[0]), DECIBELS * error_of(off)
        moved = -off / slope
        link = there.link.at_depth(there.link.depth + float(moved[0]))
        # a second step of Newton: the difference of ln q that is left at the new depth, over slope
        moved = moved[0] - (study.logs_of(there._replace(link=link)) - base) / slope
        return float(moved[0]), error_of(moved)

    bars = []
    for name, pair in ends.items():
        p = known[name]
        (low, low_error), (high, high_error) = (change_at(p.at(variant, end)) for end in pair)
        bars.append(Swing(name, p.unit, pair, (low, high), (low_error, high_error)))
    return sorted(bars, key=lambda bar: -max(map(abs, bar.change)))


def _study_of(s: Sensitivities) -> Study:
    """Return the study of a result, rebuilt from its provenance."""
    config: dict[str, Any] = s.provenance
    scenario = Scenario.from_provenance(config)
    parts = (config[name] and kind.model_validate(config[name]) for name, kind in MODELS.items())
    inputs: Any = scenario.surface, scenario.run, scenario.meshing
    campaign = Campaign({"link": scenario.link}, *inputs)
    quantity = Quantity(s.quantity, config["limit"])  # type: ignore[arg-type]
    variant = Variant(scenario.link, scenario.surface, *parts)
    return Study(variant, campaign, config["realizations"], quantity)
