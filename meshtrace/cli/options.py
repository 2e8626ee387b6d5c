"""Arguments and options that several commands share, and groups of them."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from meshtrace.cli.console import scenario_of

if TYPE_CHECKING:
    from meshtrace.scenario import Scenario

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
Trust = Annotated[
    bool, Option("--trust", help="Run the modules that the link file names, as in module:Class.")
]
Settings = Annotated[
    list[str] | None,
    Option(
        "--set",
        metavar="KEY=VALUE",
        help="Replace a value of the link file, such as transmitter.depth=20; repeatable.",
    ),
]


def grouped(command: Callable[..., None]) -> Callable[..., None]:
    """Replace the parameters of a command that are dataclasses by the options of their fields."""
    signature = inspect.signature(command, eval_str=True)
    parameters = signature.parameters.values()
    groups: Any = {p.name: p.annotation for p in parameters if is_dataclass(p.annotation)}

    def call(**given: Any) -> None:
        for name, group in groups.items():
            given[name] = group(**{field.name: given.pop(field.name) for field in fields(group)})
        command(**given)

    options: dict[str, inspect.Parameter] = {}
    for p in parameters:
        group = groups.get(p.name)
        options |= inspect.signature(group, eval_str=True).parameters if group else {p.name: p}
    named = [option.replace(kind=option.KEYWORD_ONLY) for option in options.values()]
    call.__name__, call.__doc__ = command.__name__, command.__doc__
    call.__signature__ = inspect.Signature(named)  # type: ignore[attr-defined]
    return call


@dataclass(frozen=True)
class Case:
    """Options that complete a link file."""

    seed: Seed = None
    threads: Threads = None
    wind: Wind = None
    settings: Settings = None
    trust: Trust = False

    def scenario(self, link: Path | None, **run: str | None) -> Scenario:
        """Return the scenario of a link file with these options and others of [run]."""
        own = {"seed": self.seed, "threads": self.threads}
        return scenario_of(link, self.settings, self.wind, self.trust, **run, **own)
