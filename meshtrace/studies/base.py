"""The scenario that all points of a sweep share, and its plain data, open to swept keys."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from meshtrace.engine.setup.options import Forced
from meshtrace.link import Link
from meshtrace.mesh import MeshSource
from meshtrace.scenario import DEFAULT_WIND_SPEED, Meshing, Run, Scenario
from meshtrace.scenario.files import Table, as_table
from meshtrace.scenario.parts import changes_irradiance, daylight_recipe, gives_spectrum

FIRST_CHAINS = 1024
"""Chains with which a point begins by default; its tolerance may require more."""

OPTIONS_OF_SWEEP = ("rtol", "photons", "seed")
"""Options of a run that a sweep sets for all its points."""


def base_scenario(
    link: Link | Scenario | Mapping[str, Any], sea: MeshSource | Mapping[str, Any] | None
) -> Scenario:
    """Return the scenario that all points share, without the options that a sweep sets."""
    if isinstance(link, Link):
        # the wind of the sea in the call, or else that of the bubbles and whitecaps
        wind = getattr(sea, "wind_speed", None)
        wind = (link.wind_speed or DEFAULT_WIND_SPEED) if wind is None else wind
        default = Scenario.from_config({"wind_speed": wind})
        scenario = default.model_copy(update={"link": link})
    elif isinstance(link, Scenario):
        scenario = link
    else:
        scenario = Scenario.from_config(link)
    if isinstance(sea, MeshSource):
        # the meshing of the scenario was that of its former sea
        scenario = scenario.model_copy(update={"surface": sea, "meshing": Meshing()})
    elif sea is not None:
        scenario = Scenario.from_config(scenario.to_config() | {"sea": dict(sea)})
    run = scenario.run
    # a first guess of forced detection, from which each point goes on to its tolerance
    photons = FIRST_CHAINS if isinstance(run.estimator, Forced) else run.photons
    fields = run.model_dump(exclude={*OPTIONS_OF_SWEEP, "threads"}, exclude_none=True)
    return scenario.model_copy(update={"run": Run.model_validate(fields | {"photons": photons})})


def plain_base(base: Scenario, keys: Iterable[str], daylight_table: Any = None) -> Table:
    """Return the plain data of a scenario, open to other values of dotted keys.

    `daylight_table` is the table [daylight] as the user wrote it, None if there is only a model.
    """
    config, names = base.to_config(), list(keys)
    if base.daylight is not None and any(map(changes_irradiance, names)):
        # a moved sun needs the model of the light, not its irradiance at one place
        recipe = daylight_recipe(base.daylight) if daylight_table is None else daylight_table
        config["daylight"] = as_table(recipe, "daylight", "model")
    if base.link.water.spectrum is None and any(map(gives_spectrum, names)):
        # a swept description of the water gives its coefficients, which those of the base would
        # contradict; the bottom does not follow from it
        config["water"] = {k: v for k, v in config["water"].items() if k.startswith("bottom")}
    return config
