"""Output files, progress and warnings of all commands."""

from __future__ import annotations

import math
import subprocess
import sys
import warnings
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, nullcontext, suppress
from itertools import chain, repeat
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from meshtrace.errors import Refused, extra, in_ranges, one_line, require_writable, without_numbers
from meshtrace.files import atomic

if TYPE_CHECKING:
    from meshtrace.scenario import Scenario
    from meshtrace.stored import Stored

Callbacks = tuple[Callable[[str], None], Callable[[int], None]]
COMPILING = "compiling kernels (first run only)"


@contextmanager
def progress(
    total: float | None, doing: str = "over the seas", kernels: str = "forced", quiet: bool = False
) -> Iterator[Callbacks]:
    """Yield two callbacks: one sets the status text, the other advances the progress bar.

    `kernels` names estimators, separated by spaces: if the kernels of one have yet to be compiled,
    the first status says so. Without a terminal each status is a line of stderr.
    """
    quiet = quiet or total == 0
    # standard output is for results, which other programs may read
    shown = not quiet and _is_on_terminal()
    with _bar() if shown else nullcontext() as bar:

        def say(status: str) -> None:
            if bar is not None:
                bar.update(bar.task_ids[0], description=status)
            elif not quiet:
                typer.echo(status, err=True)

        def advance(done: int) -> None:
            if bar is not None:
                bar.update(bar.task_ids[0], description=doing, total=total, advance=done)

        if not all(map(kernels_are_compiled, kernels.split())):
            say(COMPILING)
        yield say, advance


def _is_on_terminal() -> bool:
    return sys.stderr is not None and sys.stderr.isatty()


def _bar() -> Any:
    """Return a progress bar on stderr, with one task."""
    from rich.console import Console  # imported here: without a terminal it is not needed
    from rich.progress import Progress

    bar = Progress(console=Console(stderr=True), transient=True)
    bar.add_task("building the sea", total=None)
    return bar


@contextmanager
def named_steps(
    total: int, doing: str, kernels: str, quiet: bool
) -> Iterator[Callable[[str], None]]:
    """Yield a callback that takes the name of each step as it begins; see `progress`."""
    with progress(total, doing, kernels=kernels, quiet=quiet) as (say, advance):
        # steps that end when another begins: none at the first
        ended = chain([0], repeat(1))

        def step(name: str) -> None:
            advance(next(ended))
            say(name)

        yield step


def kernels_are_compiled(estimator: str) -> bool:
    """Return whether the kernels of an estimator are compiled, in this process or on disk.

    The slowest kernels to compile are asked. Forced detection has one for seas with random slopes
    and one for other surfaces: a run needs one of them, and either counts.
    """
    from meshtrace.engine.chains import gain
    from meshtrace.engine.photons import flight
    from meshtrace.kernels import jit

    of_chains = (gain.contributions, gain.blurred_contributions)
    slowest = {"forced": of_chains, "analog": (flight.follow,)}
    return any(jit.is_compiled(kernel) for kernel in slowest[estimator])


_LAST_WAIT = 5.0  # longest wait for the end of a process that has been killed [s], tuned


@contextmanager
def compiling_beside(function: str, *arguments: str) -> Iterator[None]:
    """Run a function of this package that compiles kernels in a second process.

    numba compiles one function at a time in a process. Both save what they compile, and load what
    the other has saved, so that the block compiles what the second process has not, if that cannot
    start, fails or is late.

    Parameters
    ----------
    function : str
        Module and name of the function, as "meshtrace.cli.console:compile_ahead".
    *arguments : str
        Its arguments.
    """
    from meshtrace.parallel import default_threads, python_start

    process = None
    if default_threads() > 1:
        module, _, name = function.partition(":")
        code = f"import sys; from {module} import {name} as f; f(*sys.argv[1:])"
        silent = subprocess.DEVNULL
        with suppress(OSError):
            command, env = python_start("-c", code, *arguments)
            # a session of its own: Ctrl-C is for the first process, which ends this one
            process = subprocess.Popen(command, env=env, stdin=silent, stdout=silent,
                                       stderr=silent, start_new_session=True)  # fmt: skip
    try:
        yield
    finally:
        if process is not None:
            process.kill()
            # a process that waits for a dead file system does not end when killed
            with suppress(subprocess.TimeoutExpired):
                process.wait(_LAST_WAIT)


@contextmanager
def compiling_ahead(scenario: Scenario) -> Iterator[None]:
    """Compile the kernels of a run in a second process, too.

    That begins with the kernels that evaluate chains, the block with those that draw them.
    """
    from meshtrace.models import modules_of

    if scenario.run.estimator.kind != "forced":
        yield
        return
    text = scenario.to_toml()
    with compiling_beside("meshtrace.cli.console:compile_ahead", text, *modules_of(text)):
        yield


def compile_ahead(toml: str, *modules: str) -> None:
    """Compile the kernels that a link file needs; import the modules of its classes first."""
    from meshtrace.engine.chains.aimed import compile_evaluation
    from meshtrace.models import import_modules
    from meshtrace.scenario import Scenario

    import_modules(modules)
    scenario = Scenario.from_toml(toml)
    compile_evaluation(scenario.case().link, scenario.mesh(), scenario.meshing.normals)


@contextmanager
def warnings_as_lines() -> Iterator[None]:
    """Print a warning as a line of stderr when it is raised.

    Those that differ from it in their numbers alone, as along a sweep, are one line at the end.
    Warnings for programmers, such as of deprecations, are left out.
    """
    alike: dict[str, list[str]] = {}

    def tell(message: Warning | str, *_: Any) -> None:
        # a loop over many seas would repeat its warnings
        line = one_line(message)
        lines = alike.setdefault(without_numbers(line), [])
        if not lines:
            typer.echo(f"warning: {line}", err=True)
        if line not in lines:
            lines.append(line)

    with warnings.catch_warnings():
        warnings.simplefilter("always")
        for kind in (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning):
            warnings.simplefilter("ignore", kind)
        warnings.showwarning = tell  # type: ignore[assignment]
        try:
            yield
        finally:
            for lines in alike.values():
                if len(lines) > 1:
                    text = in_ranges(lines)[0]
                    typer.echo(f"warning, {len(lines)} times in all: {text}", err=True)


def finite(value: Any) -> Any:
    """Return numbers in tuples, mappings and arrays as plain data; None if not finite."""
    if value is None or isinstance(value, str | bool):
        return value
    if hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple) or getattr(value, "ndim", None):
        return [finite(item) for item in value]
    return float(value) if math.isfinite(value) else None


def check_output(
    output: Path | None, *inputs: Path | None, option: str = "--output",
    suffixes: Collection[str] = (".nc",),
) -> None:  # fmt: skip
    """Check, before anything is computed, that an optional output file can be written.

    It must not replace a link file, nor a mesh or spectrum that a link file names, and its name
    must say what it holds.
    """
    if output is None:
        return
    named = (file for link in inputs if link is not None for file in _named_files(link))
    require_writable(output, [*inputs, *named], option)
    if output.suffix.lower() not in suffixes:
        raise Refused(option, str(output), f"a file {', '.join(sorted(suffixes))}")


def _named_files(link: Path) -> Iterator[Path]:
    """Yield every string in a link file as a path; the paths of its files are among them."""
    from meshtrace.scenario.files import parse_toml, read_text

    def texts(part: Any) -> Iterator[str]:
        if isinstance(part, str):
            yield part
        elif isinstance(part, dict | list):
            for item in part.values() if isinstance(part, dict) else part:
                yield from texts(item)

    # a link file that cannot be read is refused later, by its own reader
    with suppress(Refused):
        yield from (link.parent / text for text in texts(parse_toml(read_text(link))))


def check_plot(path: Path | None, *inputs: Path | None, option: str = "--plot") -> None:
    """Refuse a picture that could not be written, before anything is computed."""
    if path is None:
        return
    with extra("viz", option):
        from matplotlib.figure import Figure

        import meshtrace.viz  # noqa: F401, which refuses where any package of the extra is missing
    kinds = {f".{kind}" for kind in Figure().canvas.get_supported_filetypes()}
    check_output(path, *inputs, option=option, suffixes=kinds)


def save(result: Stored, path: Path | None, quiet: bool = False) -> None:
    """Write a result to a file, if one is given, after the text on the console."""
    if path is not None:
        result.save(path)
        if not quiet:
            typer.echo(f"\nwritten to {path}")


def draw(result: Any, path: Path | None, quiet: bool = False) -> None:
    """Write the plot of a result, if a file is given."""
    if path is None:
        return
    with extra("viz", "plot"):
        import matplotlib

        matplotlib.use("agg")
        import matplotlib.pyplot as plt

        from meshtrace.viz import plot, use_style
    use_style()
    plot(result)
    # an interrupted command leaves an earlier picture as it was, not half of a new one
    with atomic(path) as temporary:
        plt.savefig(temporary)
    plt.close()
    if not quiet:
        typer.echo(f"\nwritten to {path}")
