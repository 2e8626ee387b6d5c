"""Studies of link files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from meshtrace.errors import Described, Refused
from meshtrace.mesh import SurfaceModel
from meshtrace.studies.convergence.band_limit import band_limit_study
from meshtrace.studies.convergence.exact import WaveSum
from meshtrace.studies.convergence.spacing import DEFAULT_SPACINGS, convergence_study
from meshtrace.studies.convergence.study import ConvergenceStudy, Parameter
from meshtrace.studies.convergence.time_step import time_step_study

if TYPE_CHECKING:
    from meshtrace.scenario import Scenario


def study_scenario(
    scenario: Scenario,
    values: Sequence[float] = DEFAULT_SPACINGS,
    *,
    parameter: Parameter = "spacing",
    **options: Any,
) -> ConvergenceStudy:
    """Return the study of a link file in one parameter.

    Parameters
    ----------
    scenario : Scenario
        Link, sea, time, seed and threads.
    values : sequence of float
        Values of the parameter.
    parameter : {"spacing", "time_step", "omega_max"}
        What is refined.
    **options
        Of `convergence_study`, `time_step_study` or `band_limit_study`.

    Returns
    -------
    ConvergenceStudy

    Raises
    ------
    Refused
        If the surface is a mesh from a file, or an option is out of range.
    """
    sea, sampling = scenario.surface, scenario.meshing
    if not isinstance(sea, SurfaceModel):
        raise Refused("sea.mesh", Described("a mesh as it is"), "a sea, which has any spacing")
    studies: dict[str, Callable[..., ConvergenceStudy]] = {
        "spacing": convergence_study,
        "time_step": time_step_study,
        "omega_max": band_limit_study,
    }
    given: dict[str, Any] = {"seed": scenario.run.seed, "threads": scenario.run.threads}
    given["start" if parameter == "time_step" else "time"] = sampling.time
    if parameter == "spacing":
        exact = isinstance(sea, WaveSum) and options.get("unresolved") != "tilt"
        given["reference"] = "analytic" if exact else None
    elif sampling.spacing is not None:
        given["spacing"] = sampling.spacing
    return studies[parameter](scenario.link, sea, values, **{**given, **options})
