"""`meshtrace coverage`: the gain over the plane of the receiver."""

from __future__ import annotations

from typer import Option

from meshtrace.cli.app import app
from meshtrace.cli.console import progress
from meshtrace.cli.options import Case, LinkFile, grouped
from meshtrace.cli.outputs import Written


@app.command()
@grouped
def coverage(
    *,
    link: LinkFile = None,
    extent: float = Option(5.0, metavar="M", help="Half-width of the map [m]."),
    step: float = Option(0.25, metavar="M", help="Edge of a cell [m]."),
    photons: int = Option(
        4_000_000, metavar="N", min=1, max=10**12, help="Analog photons; with --rtol at first."
    ),
    rtol: float | None = Option(
        None,
        metavar="R",
        help="Target for the relative standard error of each cell, by more photons; "
        "unscattered light is exact where its image is known.",
    ),
    written: Written,
    case: Case,
) -> None:
    """Map the gain over the plane of the receiver."""
    from meshtrace.studies.coverage import coverage_map

    scenario = case.scenario(link, estimator="analog" if rtol is None else None)
    written.check(link)
    total = photons if rtol is None else None
    with progress(total, False, "mapping the gain", "analog") as (_, advance):
        found = coverage_map(
            scenario, extent=extent, step=step, photons=photons, rtol=rtol,
            times=(scenario.meshing.time,), progress=advance,
        )  # fmt: skip
    written.write(found)
