"""`meshtrace converge`: convergence of a gain with mesh, time step or band of waves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from typer import Option

from meshtrace.cli.app import app
from meshtrace.cli.console import numbers, progress
from meshtrace.cli.options import Case, LinkFile, grouped
from meshtrace.cli.outputs import Written
from meshtrace.errors import Refused, require_word

if TYPE_CHECKING:
    from meshtrace.scenario import Scenario
    from meshtrace.stored import Stored

_LISTS = {"spacing": "--spacings", "time_step": "--time-steps", "omega_max": "--omega-max"}
_OWN = {"spacing": "placements", "omega_max": "realizations", "time_step": "duration"}


@dataclass(frozen=True)
class Refined:
    """Values of the refined parameter."""

    spacings: str | None = Option(
        None, metavar="M,M,...", help="Mesh spacings [m]; default: 2, 1, ... 0.0625."
    )
    time_steps: str | None = Option(
        None, metavar="S,S,...", help="Time steps [s], instead of mesh spacings."
    )
    omega_max: str | None = Option(
        None, metavar="W,W,...", help="Band limits [rad/s], instead of mesh spacings."
    )


@dataclass(frozen=True)
class Effort:
    """Meshes and light of each value."""

    normals: str | None = Option(
        None, metavar="KINDS", help="vertex, facet or vertex,facet (for spacings)."
    )
    photons: int = Option(2048, metavar="N", min=1, max=10**7, help="Chains, shared by all meshes.")
    placements: int | None = Option(
        None, metavar="N", min=1, max=10**5, help="Meshes of each spacing [default: 34]."
    )
    realizations: int | None = Option(
        None, metavar="N", min=1, max=10**5, help="Seas of each band [default: 16; fading: 0]."
    )
    duration: float | None = Option(
        None, metavar="S", help="Length of the series [s] [default: 8 longest steps]."
    )
    tolerance: float | None = Option(
        None, metavar="R", help="Relative error of the recommended step."
    )
    unresolved: str | None = Option(
        None, metavar="WORD", help="Slopes of waves too short for the mesh: tilt (random) or none."
    )

    def options(self, parameter: str, values: list[float]) -> dict[str, Any]:
        """Return the options of the study of a parameter; refuse those of another one."""
        options = {name: value for name, value in vars(self).items() if value is not None}
        for key, name in _OWN.items():
            if name in options and key != parameter:
                raise Refused(f"--{name}", options[name], f"only with {_LISTS[key]}")
        if parameter == "time_step":
            options.setdefault("duration", 8.0 * max(values))
        if self.normals is not None:
            options["normals"] = self.normals.split(",")
        return options


@app.command()
@grouped
def converge(
    *,
    link: LinkFile = None,
    what: str = Option("gain", metavar="WORD", help="gain, or fading over the band of waves."),
    refined: Refined,
    effort: Effort,
    written: Written,
    case: Case,
) -> None:
    """Study the convergence of the gain with mesh spacing, time step or band of waves.

    All meshes share the same chains. The table shows gains, their differences, the fitted order,
    the limit at vanishing spacing beside the gain over the exact sum of waves, and the spacing
    recommended for a tolerance. With --what fading it shows the scintillation index in closed
    form, and over --realizations seas.
    """
    require_word(what, ("gain", "fading"), "--what")
    scenario = case.scenario(link)
    given = zip(_LISTS, vars(refined).values(), strict=True)
    parameter, values = _values(what, {k: text for k, text in given if text is not None})
    options = effort.options(parameter, values)
    written.check(link)
    if what == "fading":
        written.write(_fading(scenario, values, options))
    else:
        written.write(_study(scenario, parameter, values, options))


def _values(what: str, given: dict[str, str]) -> tuple[str, list[float]]:
    """Return the name and the values of the refined parameter."""
    from meshtrace.studies.convergence import DEFAULT_SPACINGS
    from meshtrace.studies.convergence.fading import DEFAULT_BANDS

    if what == "fading":
        for key in given.keys() - {"omega_max"}:
            raise Refused(_LISTS[key], given[key], "--omega-max with --what fading")
        given = {"omega_max": ",".join(map(str, DEFAULT_BANDS)), **given}
    if len(given) > 1:
        first, second, *_ = given
        raise Refused(_LISTS[second], given[second], f"not beside {_LISTS[first]}")
    for key, text in given.items():
        found = numbers(_LISTS[key], text)
        if min(found) <= 0.0:
            raise Refused(_LISTS[key], text, "numbers > 0")
        return key, found
    return "spacing", list(DEFAULT_SPACINGS)


def _fading(scenario: Scenario, values: list[float], options: dict[str, Any]) -> Stored:
    """Return the study of the fading of a scenario, with a bar while it runs."""
    from meshtrace.studies.convergence import fading_study

    for name in ("unresolved", "normals"):
        if name in options:
            raise Refused(f"--{name}", str(options[name]), "only with --what gain")
    seas = len(values) * options.get("realizations", 0)
    with progress(seas, not seas, "over the seas", "forced") as (_, advance):
        return fading_study(scenario, None, values, progress=advance, **options)


def _study(
    scenario: Scenario, parameter: str, values: list[float], options: dict[str, Any]
) -> Stored:
    """Return the study of a scenario, with a progress bar."""
    from meshtrace.studies import convergence
    from meshtrace.studies.convergence.exact import is_wave_sum

    if parameter == "spacing":
        study: Any = convergence.convergence_study
        surfaces = len(values) * options.get("placements", convergence.PLACEMENTS)
        exact = is_wave_sum(scenario.case().surface) and options.get("unresolved") != "tilt"
        options["reference"] = "analytic" if exact else None
    elif parameter == "time_step":
        study = convergence.time_step_study
        surfaces = round(2.0 * options["duration"] / min(values) + 1.0)
    else:
        study = convergence.band_limit_study
        surfaces = len(values) * options.get("realizations", convergence.REALIZATIONS)
    with progress(surfaces, False, "over the meshes", "forced") as (_, advance):
        return study(scenario, None, values, progress=advance, **options)
