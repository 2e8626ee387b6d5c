"""`meshtrace sweep`: a study file on all cores or on a cluster."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from typer import Argument, Option

from meshtrace.cli.app import app
from meshtrace.cli.console import COMPILING, extra, kernels_are_compiled
from meshtrace.cli.options import Output, Trust
from meshtrace.cli.outputs import check_output

if TYPE_CHECKING:
    import xarray as xr

_MOST_ROWS = 200  # printed; the store holds all


@app.command()
def sweep(
    study: Path = Argument(metavar="STUDY.TOML", help="Link file with a table [sweep]."),
    store: Path | None = Option(
        None, metavar="A.ZARR", help="Store of the results; default: STUDY.zarr beside STUDY.TOML."
    ),
    scheduler: str | None = Option(
        None, metavar="TCP://...", help="Address or file of a running dask scheduler."
    ),
    workers: int | None = Option(
        None, metavar="N", min=1, max=1024, help="Number of processes; default: all cores."
    ),
    timeout: float = Option(
        60.0, metavar="S", min=0.0, help="Time limit for a scheduler and a worker to respond [s]."
    ),
    output: Output = None,
    trust: Trust = False,
) -> None:
    """Compute the gain at every combination of some parameters.

    Finished points are kept in the store: after an interruption the same command resumes. The exit
    code is 1 if points failed; their errors are in the store.
    """
    check_output(output, study)
    options = {"scheduler": scheduler, "workers": workers, "timeout": timeout, "trust": trust}
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
    """Return the results of a study file and their store."""
    from meshtrace.studies.sweep import store_of, sweep_file

    place = store or store_of(study)
    if not kernels_are_compiled("forced"):
        typer.echo(COMPILING, err=True)
    try:
        with extra("sweep", "batch"):
            return sweep_file(study, store=place, **options), place
    except KeyboardInterrupt:
        typer.echo(f"finished points are in {place}; the same command resumes", err=True)
        raise


def _rows(data: xr.Dataset) -> list[str]:
    """Return gains over the realizations as a table, one row for each point and receiver."""
    import numpy as np

    from meshtrace.tables import text_table

    gain, stderr = data["gain"], data["gain_stderr"]
    dims = [str(name) for name in gain.dims if name != "realization"]
    n = data.sizes["realization"]
    mean = gain.mean("realization").values
    # each realization draws its own chains: their errors are independent
    error = np.sqrt((stderr**2).sum("realization", skipna=False).values) / n
    spread = gain.std("realization", ddof=1).values if n > 1 else mean
    lit = [name for name in ("background_radiance", "ber") if name in data]
    by_light = [data[name].mean("realization").values for name in lit]
    rows = [
        (
            *(_label(data, name, i) for name, i in zip(dims, index, strict=True)),
            f"{mean[index]:.4e}",
            f"{error[index]:.1e}",
            f"{spread[index]:.1e}" if n > 1 else "-",
            *(f"{values[index]:.3e}" for values in by_light),
        )
        for index in list(np.ndindex(mean.shape))[:_MOST_ROWS]
    ]
    headings = [*dims, "gain", "stderr", "scatter", *(("background", "BER") if lit else ())]
    lines = text_table(rows, headings).splitlines()
    lines += [f"... {mean.size - len(rows)} more"] * (mean.size > len(rows))
    if lit:
        lines += ["", "background in W m-2 sr-1 nm-1", f"light of the BER: {data['ber'].light}"]
    return lines


def _label(data: xr.Dataset, name: str, i: int) -> str:
    """Return a coordinate as text."""
    value: Any = data[name].values[i] if name in data.coords else i
    return f"{value:.6g}" if isinstance(value, float) else str(value)
