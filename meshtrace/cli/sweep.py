"""`meshtrace sweep`: a study file on all cores or on a cluster."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from meshtrace.cli.app import app
from meshtrace.cli.console import (
    COMPILING,
    kernels_are_compiled,
    warnings_as_lines,
)
from meshtrace.cli.options import Output
from meshtrace.errors import Described, Refused
from meshtrace.files import check_writable

if TYPE_CHECKING:
    import xarray as xr

_MOST_ROWS = 200  # printed; the store holds all


@app.command()
def sweep(
    study: Annotated[
        Path, typer.Argument(metavar="STUDY.TOML", help="Link file with a table [sweep].")
    ],
    store: Annotated[
        Path | None,
        typer.Option(metavar="A.ZARR", help="Where results grow; STUDY.zarr beside it if none."),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="TCP://...", help="Address or file of a running dask scheduler."),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, max=1024, help="Processes; all cores by default."),
    ] = None,
    timeout: Annotated[
        float,
        typer.Option(metavar="S", min=0.0, help="Seconds to wait for a scheduler and a worker."),
    ] = 60.0,
    output: Output = None,
) -> None:
    """Compute the gain at every combination of some parameters.

    Finished points are kept in the store: stopped in any way, the same command goes on where it
    was. The exit code is 1 if points failed; their errors are in the store.
    """
    if output is not None:
        check_writable(output, [study])
    options = {"scheduler": scheduler, "workers": workers, "timeout": timeout}
    data, place = _swept(study, store, options)
    typer.echo("\n".join(_rows(data)))
    if output is not None:
        from meshtrace.stored import write_dataset

        write_dataset(data, output)
    for path in (place, output):
        if path is not None:
            typer.echo(f"\nwritten to {path}")
    errors = [text for text in data["error"].values.ravel().tolist() if text]
    if errors:
        share = f"{len(errors)} of {data['error'].size} runs failed"
        typer.echo(f"warning: {share}, the first: {errors[0]}", err=True)
        raise typer.Exit(1)


def _swept(study: Path, store: Path | None, options: dict[str, Any]) -> tuple[xr.Dataset, Path]:
    """Return the results of a study file and the store that they are in."""
    from meshtrace.studies.sweep import store_of, sweep_file

    place = store or store_of(study)
    if not kernels_are_compiled("forced"):
        typer.echo(COMPILING, err=True)
    try:
        with warnings_as_lines():
            return sweep_file(study, store=place, **options), place
    except ModuleNotFoundError as error:
        missing = Described(f"{error.name} is missing")
        raise Refused("sweep", missing, 'after pip install "meshtrace[batch]"') from error
    except KeyboardInterrupt:
        typer.echo(f"finished points are in {place}: the same command goes on", err=True)
        raise


def _rows(data: xr.Dataset) -> list[str]:
    """Return gains over the realizations as a table, one row for each point and receiver."""
    import numpy as np

    gain, stderr = data["gain"], data["gain_stderr"]
    dims = [str(name) for name in gain.dims if name != "realization"]
    n = data.sizes["realization"]
    mean = gain.mean("realization").values
    # chains are drawn anew for each realization: their errors are independent
    error = np.sqrt((stderr**2).sum("realization", skipna=False).values) / n
    spread = gain.std("realization", ddof=1).values if n > 1 else None
    widths = [max(len(name), 12) + 2 for name in dims]
    head = "".join(f"{name:>{width}}" for name, width in zip(dims, widths, strict=True))
    lines = [f"{head}{'gain':>14}{'stderr':>10}{'scatter':>10}"]
    for index in list(np.ndindex(mean.shape))[:_MOST_ROWS]:
        labels = (_label(data, name, i) for name, i in zip(dims, index, strict=True))
        row = "".join(f"{text:>{width}}" for text, width in zip(labels, widths, strict=True))
        scatter = "-" if spread is None else f"{spread[index]:.1e}"
        lines.append(f"{row}{mean[index]:>14.4e}{error[index]:>10.1e}{scatter:>10}")
    if mean.size > _MOST_ROWS:
        lines.append(f"... {mean.size - _MOST_ROWS} more")
    return lines


def _label(data: xr.Dataset, name: str, i: int) -> str:
    """Return a coordinate as text."""
    value: Any = data[name].values[i] if name in data.coords else i
    return f"{value:.6g}" if isinstance(value, float) else str(value)
