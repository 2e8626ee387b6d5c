"""The work of `meshtrace sweep`: a study file on all cores or on a cluster."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from typer import Argument

from meshtrace.cli.console import COMPILING, extra, kernels_are_compiled
from meshtrace.cli.made import Study
from meshtrace.cli.options import Output, Trust
from meshtrace.cli.outputs import check_output

if TYPE_CHECKING:
    import xarray as xr

_MOST_ROWS = 200  # printed; the store holds all


def sweep(
    study: Study,
    asked: dict[str, Any],
    *,
    file: Path = Argument(metavar="STUDY.TOML", help="Link file with a table [sweep]."),
    output: Output = None,
    trust: Trust = False,
) -> None:
    """Run a study file, print and write its gains."""
    _, sweep_file, store_of = study.functions
    check_output(output, file)
    asked["store"] = asked.get("store") or store_of(file)
    if not kernels_are_compiled("forced"):
        typer.echo(COMPILING, err=True)
    try:
        with extra("sweep", "batch"):
            data = sweep_file(file, trust=trust, **asked)
    except KeyboardInterrupt:
        typer.echo(f"finished points are in {asked['store']}; the same command resumes", err=True)
        raise
    typer.echo("\n".join(_rows(data)))
    if output is not None:
        from meshtrace.stored import write_dataset

        write_dataset(data, output)
    for path in (asked["store"], output):
        if path is not None:
            typer.echo(f"\nwritten to {path}")
    errors = [text for text in data["error"].values.ravel().tolist() if text]
    if errors:
        share = f"{len(errors)} of {data['error'].size} runs failed"
        typer.echo(f"warning: {share}, the first: {errors[0]}", err=True)
        raise typer.Exit(1)


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
