"""Services shared by the commands: link files, progress, warnings, plain data."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from meshtrace.errors import Refused

if TYPE_CHECKING:
    from meshtrace.scenario import Scenario

COMPILING = "compiling kernels (first run only)"

VIZ = 'pip install "meshtrace[viz]"'


@contextmanager
def over_seas(seas: int, quiet: bool) -> Iterator[Callable[[int], None]]:
    """Yield the callback that advances the progress bar by finished seas."""
    with progress(seas, quiet, "over the seas") as (say, advance):
        if not kernels_are_compiled("forced"):
            say(COMPILING)
        yield advance


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


def scenario_of(link: Path | None, settings: list[str], options: dict[str, str | None]) -> Scenario:
    """Return the scenario of a link file, with the changes of the command line."""
    from meshtrace.scenario import Scenario, parse_setting

    given = [f"run.{key}={value}" for key, value in options.items() if value is not None]
    changes = dict(parse_setting(setting) for setting in [*settings, *given])
    if link is None:
        return Scenario.from_toml("", changes=changes)
    return Scenario.load(link, changes)


@contextmanager
def progress(
    total: int | None, quiet: bool, doing: str = "following photons"
) -> Iterator[tuple[Callable[[str], None], Callable[[int], None]]]:
    """Yield two callbacks: set the status text, and advance the progress bar."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeRemainingColumn,
    )

    console = Console(stderr=True)
    if quiet or not console.is_terminal:
        yield (lambda text: None if quiet else typer.echo(text, err=True)), (lambda done: None)
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("building the sea", total=None)
        yield (
            lambda text: bar.update(task, description=text),
            lambda done: bar.update(task, description=doing, total=total, advance=done),
        )


def kernels_are_compiled(estimator: str) -> bool:
    """Return whether the kernels of an estimator are compiled, in this process or on disk."""
    from meshtrace.kernels import chain_gain, jit, photon

    slowest = {"forced": chain_gain.contributions, "analog": photon.advance}
    return jit.is_compiled(slowest[estimator])


@contextmanager
def warnings_as_lines() -> Iterator[None]:
    """Print warnings as lines of stderr when done."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    for warning in caught:
        typer.echo(f"warning: {' '.join(str(warning.message).split())}", err=True)


def finite(value: Any) -> Any:
    """Return numbers in tuples and arrays as plain data, with null for non-finite values."""
    import numpy as np

    if value is None:
        return None
    if hasattr(value, "_asdict"):
        return {key: finite(item) for key, item in value._asdict().items()}
    if np.ndim(value):
        return [finite(item) for item in value]
    return float(value) if math.isfinite(value) else None
