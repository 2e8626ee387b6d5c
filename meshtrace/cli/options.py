"""Arguments and options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

SERIES_CHAINS = "2048"

LinkFile = Annotated[
    Path | None,
    Argument(metavar="[LINK.TOML]", help="Link file; default: the link of the paper."),
]
Output = Annotated[Path | None, Option("--output", "-o", help="Write the result as netCDF.")]
AsJson = Annotated[bool, Option("--json", help="Print the result as JSON, without progress bar.")]
Chains = Annotated[str, Option("--photons", metavar="N", help="Chains, shared by all seas.")]
Wind = Annotated[str | None, Option("--wind", metavar="U", help="Wind speed at 10 m [m/s].")]
Plot = Annotated[Path | None, Option("--plot", metavar="A.PNG", help="Draw the result.")]
Seed = Annotated[str | None, Option(metavar="N", help="Seed of the random numbers.")]
Threads = Annotated[str | None, Option(metavar="N", help="Number of threads; default: all cores.")]
Settings = Annotated[
    list[str] | None,
    Option(
        "--set",
        metavar="KEY=VALUE",
        help="Replace a value of the link file, such as transmitter.depth=20; repeatable.",
    ),
]
