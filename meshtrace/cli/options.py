"""Arguments and options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

SERIES_CHAINS = "2048"

LinkFile = Annotated[
    Path | None,
    typer.Argument(metavar="[LINK.TOML]", help="Link file; the paper's default link if none."),
]

Output = Annotated[Path | None, typer.Option("--output", "-o", help="Write the result as netCDF.")]

AsJson = Annotated[
    bool, typer.Option("--json", help="Print the result as JSON, without progress bar.")
]

Chains = Annotated[str, typer.Option("--photons", metavar="N", help="Chains, shared by all seas.")]

Seed = Annotated[str | None, typer.Option(metavar="N", help="Key of the random numbers.")]

Threads = Annotated[str | None, typer.Option(metavar="N", help="Threads; all cores by default.")]

Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Replace a value of the link file, as in transmitter.depth=20; repeatable.",
    ),
]
