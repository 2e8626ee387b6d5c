"""`meshtrace converge`: convergence of a gain with mesh, time step or band of waves."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from meshtrace.cli.app import app
from meshtrace.cli.console import (
    COMPILING,
    VIZ,
    kernels_are_compiled,
    numbers,
    progress,
    scenario_of,
    warnings_as_lines,
)
from meshtrace.cli.options import LinkFile, Output, Seed, Settings, Threads
from meshtrace.errors import Described, Refused
from meshtrace.files import atomic, check_writable

if TYPE_CHECKING:
    from meshtrace.scenario import Scenario
    from meshtrace.studies.convergence import ConvergenceStudy

_LISTS = {"spacing": "--spacings", "time_step": "--time-steps", "omega_max": "--omega-max"}


@app.command()
def converge(
    link: LinkFile = None,
    spacings: Annotated[
        str | None,
        typer.Option(metavar="M,M,...", help="Mesh spacings [m]; 2, 1, ... 0.0625 by default."),
    ] = None,
    time_steps: Annotated[
        str | None,
        typer.Option(metavar="S,S,...", help="Time steps [s], in place of mesh spacings."),
    ] = None,
    omega_max: Annotated[
        str | None,
        typer.Option(metavar="W,W,...", help="Band limits [rad/s], in place of mesh spacings."),
    ] = None,
    normals: Annotated[
        str | None,
        typer.Option(metavar="KINDS", help="vertex, facet or vertex,facet (for spacings)."),
    ] = None,
    photons: Annotated[
        int, typer.Option(metavar="N", min=1, max=10**7, help="Chains, shared by all meshes.")
    ] = 2048,
    placements: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, max=10**5, help="Meshes of each spacing [default: 34]."),
    ] = None,
    realizations: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, max=10**5, help="Seas of each band [default: 16]."),
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option(metavar="S", help="Length of the series [s] [default: 8 longest steps]."),
    ] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(metavar="R", help="Relative error that the recommendation is about."),
    ] = None,
    unresolved: Annotated[
        str | None,
        typer.Option(
            metavar="WORD", help="tilt: random slopes for the waves that a mesh leaves out; none."
        ),
    ] = None,
    output: Output = None,
    plot: Annotated[
        Path | None, typer.Option(metavar="A.PNG", help="Draw errors and orders.")
    ] = None,
    seed: Seed = None,
    threads: Threads = None,
    settings: Settings = None,
) -> None:
    """Study how the gain depends on the mesh spacing, the time step or the band of waves.

    All meshes get the same chains. The table shows gains, their differences, the fitted order,
    the value at vanishing spacing beside that of the exact sum of waves, and the spacing that a
    tolerance asks for.
    """
    scenario = scenario_of(link, settings or [], {"seed": seed, "threads": threads})
    given = {"spacing": spacings, "time_step": time_steps, "omega_max": omega_max}
    parameter, values = _values({key: text for key, text in given.items() if text is not None})
    options = {
        "placements": placements,
        "realizations": realizations,
        "duration": 8.0 * max(values) if (parameter, duration) == ("time_step", None) else duration,
        "tolerance": tolerance,
        "unresolved": unresolved,
        "normals": None if normals is None else normals.split(","),
    }
    options = {key: value for key, value in options.items() if value is not None}
    _refuse_other_options(parameter, options)
    for path in (output, plot):
        if path is not None:
            check_writable(path, [link], "--output" if path is output else "--plot")
    if plot is not None:
        _refuse_undrawable(plot)
    study = _study(scenario, parameter, values, {**options, "photons": photons})
    typer.echo(study.summary())
    if output is not None:
        study.save(output)
    if plot is not None:
        _draw(study, plot)
    for path in (output, plot):
        if path is not None:
            typer.echo(f"\nwritten to {path}")


def _refuse_undrawable(path: Path) -> None:
    """Refuse a picture that could not be drawn, before anything is computed."""
    try:
        from matplotlib.figure import Figure
    except ModuleNotFoundError as error:
        raise Refused("--plot", Described("packages are missing"), VIZ) from error
    kinds = Figure().canvas.get_supported_filetypes()
    if path.suffix[1:].lower() not in kinds:
        raise Refused("--plot", str(path), f"a file .{', .'.join(sorted(kinds))}")


def _draw(study: ConvergenceStudy, path: Path) -> None:
    """Write the plot of a study."""
    import matplotlib.pyplot as plt

    from meshtrace.viz import plot_convergence

    plot_convergence(study)
    with atomic(path) as temporary:
        plt.savefig(temporary)
    plt.close()


def _values(given: dict[str, str]) -> tuple[str, list[float]]:
    """Return the name and the values of the refined parameter."""
    from meshtrace.studies.convergence import DEFAULT_SPACINGS

    if len(given) > 1:
        first, second, *_ = (_LISTS[key] for key in given)
        raise Refused(second, given[list(given)[1]], f"not beside {first}")
    for key, text in given.items():
        found = numbers(_LISTS[key], text)
        if min(found) <= 0.0:
            raise Refused(_LISTS[key], text, "numbers > 0")
        return key, found
    return "spacing", list(DEFAULT_SPACINGS)


def _refuse_other_options(parameter: str, options: dict[str, Any]) -> None:
    """Refuse options of another study than that of a parameter."""
    belongs = {"placements": "spacing", "realizations": "omega_max", "duration": "time_step"}
    for name, other in belongs.items():
        if name in options and other != parameter:
            raise Refused(f"--{name}", options[name], f"only with {_LISTS[other]}")


def _study(
    scenario: Scenario, parameter: str, values: list[float], options: dict[str, Any]
) -> ConvergenceStudy:
    """Return the study of a scenario, with a bar while it runs."""
    from meshtrace.studies import convergence
    from meshtrace.studies.convergence.exact import is_wave_sum

    studies: dict[str, Callable[..., ConvergenceStudy]] = {
        "spacing": convergence.convergence_study,
        "time_step": convergence.time_step_study,
        "omega_max": convergence.band_limit_study,
    }
    surfaces = {
        "spacing": len(values) * options.get("placements", convergence.PLACEMENTS),
        "time_step": 2.0 * options.get("duration", 0.0) / min(values) + 1.0,
        "omega_max": len(values) * options.get("realizations", convergence.REALIZATIONS),
    }
    if parameter == "spacing":
        exact = is_wave_sum(scenario.surface) and options.get("unresolved") != "tilt"
        options["reference"] = "analytic" if exact else None
    with (
        warnings_as_lines(),
        progress(round(surfaces[parameter]), False, "over the meshes") as (say, advance),
    ):
        if not kernels_are_compiled("forced"):
            say(COMPILING)
        return studies[parameter](scenario, None, values, progress=advance, **options)
