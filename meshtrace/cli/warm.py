"""`meshtrace warm`: compile all kernels ahead of the first run."""

from __future__ import annotations

import time
import warnings
from typing import Literal

import typer

from meshtrace.cli.app import app
from meshtrace.cli.console import COMPILING, progress


@app.command()
def warm() -> None:
    """Compile the kernels of both estimators, and keep them for later runs."""
    from meshtrace.kernels.jit import folder
    from meshtrace.link import Link, Physics, Receiver
    from meshtrace.optics.water import Water
    from meshtrace.surfaces import JonswapSea
    from meshtrace.transport.simulate import simulate

    start, sea = time.perf_counter(), JonswapSea()
    runs: list[tuple[Link, Literal["forced", "analog"]]] = [
        (Link(), "forced"),
        (Link(physics=Physics(unresolved="none")), "forced"),
        (Link(water=Water(bottom_depth=20.0), receiver=(Receiver(), Receiver())), "forced"),
        (Link(), "analog"),
    ]
    with progress(len(runs), False, COMPILING, "forced", "analog") as (_, advance):
        for link, estimator in runs:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                simulate(link, sea, estimator, photons=64, spacing=0.5)
            advance(1)
    typer.echo(f"kernels in {folder()}, {time.perf_counter() - start:.1f} s")
