"""The work of the commands in commands.toml."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from typer import Argument, Option

from meshtrace.cli.ber import ber
from meshtrace.cli.console import progress
from meshtrace.cli.made import Study, StudyCommand, defaults
from meshtrace.cli.options import Case, LinkFile
from meshtrace.cli.outputs import Written
from meshtrace.cli.sweep import sweep
from meshtrace.errors import Refused, require_word

Asked = dict[str, Any]  # options of the study that are given


def on_link(
    study: Study, asked: Asked, *, link: LinkFile = None, written: Written, case: Case
) -> None:
    """Run the study of one link."""
    scenario, (function, *_) = case.scenario(link), study.functions
    written.check(link)
    values = defaults(function) | asked
    steps = None if values.get("rtol") else values.get(study.steps)
    total = steps if isinstance(steps, int | None) else len(steps)
    if total is not None and total < study.least:
        raise Refused(study.steps, total, f">= {study.least}")
    with progress(total, False, study.doing, study.kernels) as (_, advance):
        found = function(scenario, progress=advance, **asked)
    written.write(found)


def compare(
    study: Study,
    asked: Asked,
    *,
    links: list[Path] = Argument(metavar="A.TOML B.TOML ...", help="Two link files or more."),
    written: Written,
    case: Case,
) -> None:
    """Compare the links of several files."""
    scenarios, (function,) = {path.stem: case.scenario(path) for path in links}, study.functions
    if len(scenarios) < len(links):
        raise Refused("links", ", ".join(map(str, links)), "files of different names")
    written.check(*links)
    seas = (defaults(function) | asked)["realizations"] * len(links)
    with progress(seas, False, study.doing, study.kernels) as (_, advance):
        found = function(scenarios, progress=advance, **asked)
    written.write(found)


_REFINED = {"spacings": "--spacings", "steps": "--time-steps", "omega_max": "--omega-max"}


def converge(
    study: Study,
    asked: Asked,
    *,
    link: LinkFile = None,
    what: str = Option("gain", metavar="WORD", help="gain, or fading over the band of waves."),
    written: Written,
    case: Case,
) -> None:
    """Refine the mesh, the time step or the band of waves."""
    from meshtrace.studies.convergence.measure import is_wave_sum

    require_word(what, ("gain", "fading"), "--what")
    scenario = case.scenario(link)
    function = _chosen(study, asked, what)
    written.check(link)
    values = defaults(function) | asked
    if "reference" in values:
        exact = is_wave_sum(scenario.case().surface) and values["unresolved"] != "tilt"
        asked["reference"] = "analytic" if exact else None
    total = _surfaces(values)
    with progress(total, total == 0, study.doing, study.kernels) as (_, advance):
        found = function(scenario, progress=advance, **asked)
    written.write(found)


def _chosen(study: Study, asked: Asked, what: str) -> Any:
    """Return the function that the options ask for; refuse those of others."""
    of = dict(zip(_REFINED, study.functions, strict=False))
    first = next((name for name in _REFINED if name in asked), "spacings")
    chosen = study.functions[-1] if what == "fading" else of[first]
    for name in asked.keys() - defaults(chosen).keys():
        others = [_REFINED[key] for key in _REFINED if name in defaults(of[key])]
        allowed = f"only with {' or '.join(others)}"
        if what == "fading":
            allowed = "only with --what gain"
        elif name in _REFINED:
            allowed = f"not beside {_REFINED[first]}"
        raise Refused(name, asked[name], allowed)
    return chosen


def _surfaces(values: Asked) -> int | None:
    """Return the number of surfaces of a study of convergence."""
    if "steps" in values:
        steps = values["steps"]
        duration = values["duration"] or 8.0 * max(steps)
        return round(2.0 * duration / min(steps) + 1.0) if min(steps) > 0.0 else None
    if "spacings" in values:
        return len(values["spacings"]) * values["placements"]
    return len(values["omega_max"]) * values["realizations"]


_OWN: dict[str, Callable[..., None]] = {
    "ber": ber,
    "compare": compare,
    "converge": converge,
    "sweep": sweep,
}


def study_commands() -> dict[str, StudyCommand]:
    """Return the commands of the table by their names."""
    text = Path(__file__).with_name("commands.toml").read_text(encoding="utf-8")
    rows = tomllib.loads(text).items()
    return {name: StudyCommand(name, Study(**row), _OWN.get(name, on_link)) for name, row in rows}
