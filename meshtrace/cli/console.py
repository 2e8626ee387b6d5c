"""Services shared by the commands: link files, outputs, progress, warnings, plain data."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from meshtrace.errors import Described, Refused, one_line

if TYPE_CHECKING:
    from meshtrace.scenario import Scenario

COMPILING = "compiling kernels (first run only)"


def numbers(option: str, text: str) -> list[float]:
    """Return the numbers of a list "1,2,3" or a range "start:stop:step", its end included."""
    wrong = Refused(option, text, "numbers as in 1,2,3, or start:stop:step")
    try:
        if ":" not in text:
            found = [float(word) for word in text.split(",")]
        else:
            start, stop, step = (float(word) for word in text.split(":"))
            count = math.floor((stop - start) / step + 1e-9) + 1
            if not (step > 0.0 and 1 <= count <= 10**7):
                raise wrong
            found = [start + step * i for i in range(count)]
    except (ValueError, ZeroDivisionError, OverflowError) as error:
        raise wrong from error
    if not all(math.isfinite(value) for value in found):
        raise wrong
    return found


def scenario_of(
    link: Path | None,
    settings: list[str] | None,
    wind: str | float | None = None,
    trust: bool = False,
    **options: str | float | None,
) -> Scenario:
    """Return the scenario of a link file, with changes by "key=value", wind and [run] options."""
    from meshtrace.scenario import Scenario, parse_setting

    given = [f"run.{key}={value}" for key, value in options.items() if value is not None]
    if wind is not None:
        given.append(f"wind_speed={wind}")
    changes = dict(parse_setting(setting) for setting in [*(settings or []), *given])
    if link is None:
        return Scenario.from_toml("", changes=changes, trust=trust)
    return Scenario.load(link, changes, trust=trust)


@contextmanager
def progress(
    total: int | None, quiet: bool, doing: str, *estimators: str
) -> Iterator[tuple[Callable[[str], None], Callable[[int], None]]]:
    """Yield two callbacks: set the status text, and advance the progress bar.

    Warnings become lines of stderr. The status says so if kernels of `estimators` will compile.
    """
    from rich import progress as rich
    from rich.console import Console

    console = Console(stderr=True)
    text, share = rich.TextColumn("{task.description}"), rich.TaskProgressColumn()
    columns = (text, rich.BarColumn(), share, rich.TimeRemainingColumn())
    shown = console.is_terminal and not quiet
    with rich.Progress(*columns, console=console, transient=True, disable=not shown) as bar:
        task = bar.add_task("building the sea", total=None)

        def say(status: str) -> None:
            bar.update(task, description=status)
            if not (shown or quiet):
                typer.echo(status, err=True)

        if not all(kernels_are_compiled(name) for name in estimators):
            say(COMPILING)
        yield say, lambda done: bar.update(task, description=doing, total=total, advance=done)


@contextmanager
def over_seas(seas: int, quiet: bool = False) -> Iterator[Callable[[int], None]]:
    """Yield the callback that advances the progress bar by finished seas."""
    with progress(seas, quiet, "over the seas", "forced") as (_, advance):
        yield advance


def kernels_are_compiled(estimator: str) -> bool:
    """Return whether the kernels of an estimator are compiled, in this process or on disk.

    Forced detection has one slow kernel for seas with random slopes and one for other surfaces.
    """
    from meshtrace.kernels import blurred, chain_gain, jit, photon

    slowest = {
        "forced": (chain_gain.contributions, blurred.blurred_contributions),
        "analog": (photon.follow,),
    }
    return any(jit.is_compiled(kernel) for kernel in slowest[estimator])


@contextmanager
def warnings_as_lines() -> Iterator[None]:
    """Print each warning at once, as a line of stderr; those for programmers are left out."""
    told: set[str] = set()

    def tell(message: Warning | str, *_: Any) -> None:
        line = one_line(message)
        if line not in told:
            told.add(line)
            typer.echo(f"warning: {line}", err=True)

    with warnings.catch_warnings():
        warnings.simplefilter("always")
        for kind in (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning):
            warnings.simplefilter("ignore", kind)
        warnings.showwarning = tell  # type: ignore[assignment]
        yield


@contextmanager
def extra(field: str, name: str) -> Iterator[None]:
    """Refuse with an installation hint if packages of an extra are missing."""
    try:
        yield
    except ImportError as error:
        missing = Described("extra packages are missing")
        raise Refused(field, missing, f'pip install "meshtrace[{name}]"') from error


def finite(value: Any) -> Any:
    """Return numbers in tuples, mappings and arrays as plain data; null if not finite."""
    if value is None or isinstance(value, str | bool):
        return value
    if hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple) or getattr(value, "ndim", None):
        return [finite(item) for item in value]
    return float(value) if math.isfinite(value) else None
