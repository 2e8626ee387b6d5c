"""Services shared by the commands: progress, warnings, plain data."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from typing import Any

import typer

from meshtrace.errors import Described, Refused, one_line

COMPILING = "compiling kernels (first run only)"


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
def named_steps(
    total: int, quiet: bool, doing: str, *estimators: str
) -> Iterator[Callable[[str], None]]:
    """Yield a callback that takes the name of each step as it begins; see `progress`."""
    with progress(total, quiet, doing, *estimators) as (say, advance):
        begun = count()

        def step(name: str) -> None:
            if next(begun):
                advance(1)
            say(name)

        yield step


def kernels_are_compiled(estimator: str) -> bool:
    """Return whether the kernels of an estimator are compiled, in this process or on disk.

    Forced detection has one slow kernel for seas with random slopes and one for other surfaces.
    """
    from meshtrace.engine.chains import gain, microfacets
    from meshtrace.engine.photons import flight
    from meshtrace.kernels import jit

    slowest = {
        "forced": (gain.contributions, microfacets.blurred_contributions),
        "analog": (flight.follow,),
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
