"""Arguments and options that several commands share, and groups of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

if TYPE_CHECKING:
    from meshtrace.scenario import Scenario

LinkFile = Annotated[
    Path | None,
    Argument(metavar="[LINK.TOML]", help="Link file; default: the link of the paper."),
]
Output = Annotated[Path | None, Option("--output", "-o", help="Write the result as netCDF.")]
AsJson = Annotated[bool, Option("--json", help="Print the result as JSON, without progress bar.")]
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

_KEYS = {"wind": "wind_speed", "seed": "run.seed", "threads": "run.threads"}


@dataclass(frozen=True)
class Changes:
    """Options that change a link file."""

    settings: Settings = None
    trust: Trust = False

    def scenario(self, link: Path | None, more: Mapping[str, Any] | None = None) -> Scenario:
        """Return the scenario of a link file with these changes and more of them, by keys."""
        from meshtrace.scenario import Scenario, parse_setting

        own = {key: getattr(self, name, None) for name, key in _KEYS.items()}
        given = (f"{k}={v}" for k, v in {**own, **(more or {})}.items() if v is not None)
        changes = dict(parse_setting(setting) for setting in (*(self.settings or []), *given))
        if link is None:
            return Scenario.from_toml("", changes=changes, trust=self.trust)
        return Scenario.load(link, changes, trust=self.trust)


@dataclass(frozen=True)
class InWind(Changes):
    """Options that change a link file and its wind."""

    wind: Wind = None


@dataclass(frozen=True)
class Case(InWind):
    """Options that change a link file, its wind and its run."""

    seed: Seed = None
    threads: Threads = None
