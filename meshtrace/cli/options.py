"""Options that several commands share, and the parsers of their texts."""

import math
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

import meshtrace as mt
from meshtrace.cli import console
from meshtrace.errors import Described, Refused


def parse_numbers(text: str) -> list[float]:
    """Parse a list "1,2,3" or a range "start:stop:step", its end included."""
    try:
        if ":" not in text:
            values = [float(word) for word in text.split(",")]
        else:
            start, stop, step = (float(word) for word in text.split(":"))
            # 1e-9: rounding of the quotient must not lose the end: 0:0.3:0.1 has four numbers
            n = math.floor((stop - start) / step + 1e-9) + 1
            # a list of more than 10^7 numbers is taken for a mistake
            values = [start + step * i for i in range(n)] if step > 0.0 and n <= 10**7 else []
    except (ValueError, ZeroDivisionError, OverflowError):
        values = []
    if not values or not all(map(math.isfinite, values)):
        raise Refused("", text, "numbers as in 1,2,3, or start:stop:step")
    return values


def parse_integer(text: str) -> int:
    """Parse an integer, also in scientific notation such as 1e6."""
    # first as an integer: a float has no more than 53 bits
    with suppress(ValueError):
        return int(text)
    with suppress(ValueError):
        if float(text).is_integer():
            return int(float(text))
    raise Refused("", text, "an integer")


def parse_workers(text: str) -> int | str:
    """Parse a number of processes, or the address or file of a scheduler."""
    return int(text) if text.lstrip("-").isdecimal() else text


def parse_pair(text: str) -> tuple[float, float]:
    """Parse two numbers "1,2"."""
    values = parse_numbers(text)
    if len(values) != 2:
        raise Refused("", text, "two numbers, as in 1,2")
    return values[0], values[1]


def parse_bounds(text: str) -> tuple[str, tuple[float, float]]:
    """Parse a key of a link file and its bounds "key=low,high"."""
    key, _, limits = text.partition("=")
    with suppress(Refused):
        return key, parse_pair(limits)
    raise Refused("", text, "KEY=LOW,HIGH, as in receiver.fov_deg=6,90")


def value(
    metavar: str, text: str, *names: str, parser: Any = None, low: Any = None, high: Any = None
) -> Any:
    """Describe an option: placeholder, help, names (by default its parameter's), parser, bounds."""
    return typer.Option(*names, metavar=metavar, help=text, parser=parser, min=low, max=high)


def flag(name: str, text: str) -> Any:
    """Describe an option without a value."""
    return typer.Option(name, help=text)


def count(text: str, *names: str) -> Any:
    """Describe an option that takes an integer."""
    return value("N", text, *names, parser=parse_integer)


def numbers(text: str, *names: str) -> Any:
    """Describe an option that takes a list or a range of numbers."""
    return value("LIST", f"{text}; as 1,2,3 or start:stop:step.", *names, parser=parse_numbers)


def seas(text: str) -> Any:
    """Describe the option of the number of seas."""
    return count(text, "--realizations", "-n")


def without_none(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options that the user has set."""
    return {name: item for name, item in values.items() if item is not None}


_LINK = "Link file; default: the link of the paper."
_SET = "Replace a value of the link file, such as transmitter.depth=20; repeatable."
_TRUST = "Run the modules that the link file names, as in module:Class."
_STORE = "File that keeps finished steps: a second call with the same arguments resumes the first."
_WORKERS = "Processes in place of threads, or the address or file of a running dask scheduler."
_BOUNDS = "Bounds of a value to choose by its key, such as receiver.fov_deg=6,90; repeatable."
_WAVELENGTHS = "Wavelengths in vacuum [nm] in place of that of the sources, a result for each"

LinkFile = Annotated[Path | None, typer.Argument(metavar="[LINK.TOML]", help=_LINK)]
Output = Annotated[Path | None, typer.Option("--output", "-o", help="Write the result as netCDF.")]
Json = Annotated[bool, flag("--json", "Print the result as JSON, without progress bar.")]
Set = Annotated[list[str] | None, value("KEY=VALUE", _SET, "--set")]
PerLamp = Annotated[bool, flag("--per-lamp", "Add the gains by lamp, from the same samples.")]
Combining = Annotated[Any, value("WORD",
    "Combining of several receivers: selection, equal or maximal.")]  # fmt: skip
Trust = Annotated[bool, flag("--trust", _TRUST)]
Chains = Annotated[int, count("Chains, common to all surfaces.", "--photons")]
Bounds = Annotated[list[Any] | None, value("KEY=LOW,HIGH", _BOUNDS, parser=parse_bounds)]
Wavelengths = Annotated[Any, numbers(_WAVELENGTHS, "--wavelengths")]
ErrorLimit = Annotated[float, value("BER", "Largest bit error rate of a working link, uncoded.")]
BitRate = Annotated[float | None, value("R", "Bit rate R_b [bit s-1]; default: that of the link.")]
Bar = AbstractContextManager[console.Callbacks]


@dataclass(frozen=True, kw_only=True)
class Changes:
    """Options that change a link file."""

    # texts: the checks of link files parse them, and refuse them by their keys
    set_: Set = None
    trust: Trust = False
    wind: Annotated[str | None, value("U", "Wind speed at 10 m [m/s].")] = None
    seed: Annotated[str | None, value("N", "Seed of the random numbers.")] = None
    threads: Annotated[str | None, value("N", "Number of threads; default: all cores.")] = None

    def scenario(self, link: Path | None, more: Mapping[str, Any] | None = None) -> "mt.Scenario":
        """Return the scenario of a link file with these changes and `more`, values by key."""
        from meshtrace.scenario import parse_setting

        values = {"wind_speed": self.wind, "run.seed": self.seed, "run.threads": self.threads}
        values |= more or {}
        settings = [f"{key}={value}" for key, value in values.items() if value is not None]
        changes = dict(parse_setting(setting) for setting in (*(self.set_ or []), *settings))
        if link is None:
            return mt.Scenario.from_toml("", changes=changes, trust=self.trust)
        if "=" in link.name and not link.exists():
            raise Refused(
                str(link), Described("no such file"), "a link file", f"did you mean --set {link}?"
            )
        return mt.Scenario.load(link, changes, trust=self.trust)


@dataclass(frozen=True, kw_only=True)
class ResultFiles(Changes):
    """Options that change a link file, and files of the result."""

    output: Output = None
    plot: Annotated[Path | None, value("A.PNG", "Draw the result.")] = None

    def check(self, *links: Path | None) -> None:
        """Refuse output files that could not be written, before the work."""
        console.check_plot(self.plot, *links, self.output)
        console.check_output(self.output, *links)

    def write(self, result: Any, quiet: bool = False) -> None:
        """Write the result to the files of the options, if any."""
        console.save(result, self.output, quiet)
        console.draw(result, self.plot, quiet)


@dataclass(frozen=True, kw_only=True)
class StudyOptions(ResultFiles):
    """Options of a study of a link: file and its changes, run, and files of the result."""

    link: LinkFile = None
    store: Annotated[Path | None, value("PATH", _STORE)] = None
    workers: Annotated[Any, value("N", _WORKERS, parser=parse_workers)] = None

    def compute(self, study: Callable[..., Any], subject: Any, bar: Bar) -> Any:
        """Return the result of a study, behind a progress bar."""
        # None: without a store, and in threads in place of processes
        with bar as (_, advance):
            return study(subject, store=self.store, workers=self.workers, progress=advance)

    def run(self, study: Callable[..., Any], bar: Bar, subject: Any = None) -> None:
        """Run a study of the link, or of another subject, print its result and write it."""
        if subject is None:
            subject = self.scenario(self.link)
            # files that cannot be written are refused now, not after minutes of work
            self.check(self.link)
        result = self.compute(study, subject, bar)
        typer.echo(result.summary())
        self.write(result)
