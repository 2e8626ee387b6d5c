"""`meshtrace coverage`: the gain over the plane of the receiver."""

from __future__ import annotations

import typer
from typer import Option

from meshtrace.cli.app import app
from meshtrace.cli.console import progress, scenario_of
from meshtrace.cli.drawing import check_plot, draw
from meshtrace.cli.options import LinkFile, Output, Plot, Seed, Settings, Threads, Wind
from meshtrace.cli.outputs import check_output, save


@app.command()
def coverage(
    link: LinkFile = None,
    extent: float = Option(5.0, metavar="M", help="Half-width of the map [m]."),
    step: float = Option(0.25, metavar="M", help="Edge of a cell [m]."),
    photons: int = Option(4_000_000, metavar="N", min=1, max=10**12, help="Analog photons."),
    rtol: float | None = Option(
        None,
        metavar="R",
        help="Target for the relative standard error of each cell: forced "
        "detection, where chains follow the link.",
    ),
    output: Output = None,
    plot: Plot = None,
    seed: Seed = None,
    threads: Threads = None,
    wind: Wind = None,
    settings: Settings = None,
) -> None:
    """Map the gain over the plane of the receiver."""
    from meshtrace.studies.coverage import coverage_map

    estimator = "analog" if rtol is None else None
    given = {"estimator": estimator, "seed": seed, "threads": threads}
    scenario = scenario_of(link, settings, wind, **given)
    check_output(output, link)
    check_plot(plot, link, output)
    total = photons if rtol is None else None  # cells or photons
    with progress(total, False, "mapping the gain", estimator or "forced") as (_, advance):
        found = coverage_map(
            scenario, extent=extent, step=step, photons=photons, rtol=rtol,
            times=(scenario.meshing.time,), progress=advance,
        )  # fmt: skip
    typer.echo(found.summary())
    save(found, output)
    draw(found, plot)
