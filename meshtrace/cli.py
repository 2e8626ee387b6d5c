"""The command line. Heavy imports happen inside commands, so that --help is quick."""

from __future__ import annotations

import json
import math
import os
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

if TYPE_CHECKING:
    from meshtrace.performance import LinkPerformance
    from meshtrace.result import GainResult
    from meshtrace.scenario import Scenario
    from meshtrace.series import GainSeries

INTERRUPTED = 130
COMPILING = "compiling kernels (first run only)"
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
CHAIN_MEANING = {
    "chains": "scattering chains drawn",
    "solved": "aimed at the aperture",
    "no_flat": "without a crossing of the flat sea",
    "enumerated": "searched through all facets",
    "extra_roots": "further crossings found",
    "blocked": "blocked by a wave",
}


class _Commands(TyperGroup):
    """Commands whose failures are one line on stderr: exit code 2, or 130 after Ctrl-C."""

    def main(self, *args: Any, **extra: Any) -> Any:
        standalone = extra.get("standalone_mode", True)
        try:
            code = super().main(*args, **{**extra, "standalone_mode": False}) or 0
        except typer.Abort:
            code = INTERRUPTED
        except Exception as error:
            message = _message(error)
            if message is None:
                raise
            typer.echo(f"error: {message}", err=True)
            code = 2
        if code == INTERRUPTED:
            typer.echo("interrupted", err=True)
        if standalone:
            sys.exit(code)
        return code


app = typer.Typer(
    cls=_Commands,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main() -> None:
    """Run the command line and exit."""
    app(prog_name="meshtrace")


def _message(error: Exception) -> str | None:
    """Return what to tell the user, None for an error that is ours."""
    if hasattr(error, "format_message"):  # how typer says that the arguments are wrong
        return str(error.format_message())
    scenario = sys.modules.get("meshtrace.scenario")
    if scenario is not None and isinstance(error, scenario.ScenarioError):
        return str(error)
    return None


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"meshtrace {version('meshtrace')}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _options(
    context: typer.Context,
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    """Monte Carlo ray tracing of light that crosses a wavy sea."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


@app.command()
def run(
    link: LinkFile = None,
    output: Output = None,
    as_json: AsJson = False,
    photons: Annotated[
        str | None, typer.Option(metavar="N", help="Chains (forced) or photons (analog).")
    ] = None,
    rtol: Annotated[
        str | None, typer.Option(metavar="R", help="Relative standard error to reach, as in 0.01.")
    ] = None,
    seed: Seed = None,
    estimator: Annotated[str | None, typer.Option(metavar="NAME", help="forced or analog.")] = None,
    threads: Threads = None,
    settings: Settings = None,
) -> None:
    """Simulate one link and print its channel gain."""
    # words as yet, for the link file's own checks
    options = {
        "photons": photons,
        "rtol": rtol,
        "seed": seed,
        "estimator": estimator,
        "threads": threads,
    }
    scenario = _scenario(link, settings or [], options)
    if output is not None:
        _refuse_unwritable(output)
    with _warnings_as_lines():
        result, wall_time = _simulate(scenario, quiet=as_json)
    if output is not None:
        result.save(output)
    if as_json:
        typer.echo(json.dumps(_as_data(result, wall_time), allow_nan=False))
    else:
        typer.echo(_summary(scenario, result, wall_time, output))


@app.command()
def bench(
    link: Annotated[
        Path | None,
        typer.Argument(
            metavar="[LINK.TOML]", help="Link file; the paper's link at 13 m/s if none."
        ),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Write the measurements as JSON.")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the measurements as JSON.")
    ] = False,
    quick: Annotated[bool, typer.Option("--quick", help="A quarter of the photons.")] = False,
) -> None:
    """Measure the speed of the engine, as ratios within one run."""
    from meshtrace.bench import bench as measure
    from meshtrace.bench import report

    scenario = _scenario(link, ["wind_speed=13", "bubbles=none"] if link is None else [], {})
    result = measure(scenario.link, scenario.surface, quick=quick)
    text = json.dumps(result, indent=1)
    if output is not None:
        output.write_text(text + "\n")
    typer.echo(text if as_json else report(result))


@app.command()
def series(
    link: LinkFile = None,
    times: Annotated[
        str, typer.Option(metavar="START:STOP:STEP", help="Times [s], or a list as in 0,1,2.")
    ] = "0:30:0.5",
    output: Output = None,
    photons: Chains = SERIES_CHAINS,
    seed: Seed = None,
    threads: Threads = None,
    settings: Settings = None,
) -> None:
    """Follow the channel gain over a moving sea and print its fading."""
    seconds = _numbers("--times", times)
    options = {"photons": photons, "seed": seed, "threads": threads}
    scenario = _scenario(link, settings or [], options)
    _fading_of(scenario, len(seconds), output, lambda step: scenario.time_series(seconds, step))


@app.command()
def ensemble(
    link: LinkFile = None,
    realizations: Annotated[
        int, typer.Option("--realizations", "-n", min=2, max=10**7, help="Independent seas.")
    ] = 200,
    output: Output = None,
    photons: Chains = SERIES_CHAINS,
    seed: Seed = None,
    threads: Threads = None,
    settings: Settings = None,
) -> None:
    """Print the distribution of the channel gain over random seas, and its fading."""
    options = {"photons": photons, "seed": seed, "threads": threads}
    scenario = _scenario(link, settings or [], options)
    _fading_of(scenario, realizations, output, lambda step: scenario.ensemble(realizations, step))


@app.command()
def ber(
    link: LinkFile = None,
    bit_rates: Annotated[
        str, typer.Option(metavar="LIST", help="Bit rates [bit/s], as in 1e6,5e6,1e7.")
    ] = "1e6,5e6,1e7",
    depths: Annotated[
        str | None,
        typer.Option(metavar="START:STOP:STEP", help="Depths [m], or a list; for the range."),
    ] = None,
    winds: Annotated[
        str | None,
        typer.Option("--wind", metavar="LIST", help="Wind speeds [m/s], as in 0,5,13."),
    ] = None,
    preset: Annotated[
        str | None, typer.Option(metavar="NAME", help="physical, paper or paper-ranges.")
    ] = None,
    limit: Annotated[
        float, typer.Option(metavar="BER", help="Bit error rate that counts as success.")
    ] = 1e-3,
    realizations: Annotated[
        int, typer.Option("--realizations", "-n", help="Independent seas at each depth.")
    ] = 200,
    uav: Annotated[
        str | None, typer.Option(metavar="NAME", help="Airframe that tilts the receiver.")
    ] = None,
    coupled: Annotated[
        bool, typer.Option("--coupled", help="Let the tilt act on every photon.")
    ] = False,
    output: Output = None,
    as_json: AsJson = False,
    photons: Chains = SERIES_CHAINS,
    seed: Seed = None,
    threads: Threads = None,
    settings: Settings = None,
) -> None:
    """Print bit error rate, outage, margin, capacity and range of a link."""
    given = {"detector.preset": preset, "uav.preset": uav}
    changes = [f"{key}={value}" for key, value in given.items() if value is not None]
    options = {"photons": photons, "seed": seed, "threads": threads}
    speeds = [None] if winds is None else _numbers("--wind", winds)
    scenarios = [
        _scenario(
            link,
            [*(settings or []), *changes, *([] if u is None else [f"wind_speed={u}"])],
            options,
        )
        for u in speeds
    ]
    if output is not None:
        _refuse_unwritable(output)
    wished: dict[str, Any] = {
        "bit_rate": _numbers("--bit-rates", bit_rates),
        "depths": None if depths is None else _numbers("--depths", depths),
        "limit": limit,
        "realizations": realizations,
        "coupled": coupled,
    }
    seas = sum(_seas(s, realizations, coupled) for s in scenarios) * len(wished["depths"] or [0])
    with _warnings_as_lines(), _over_seas(seas, as_json) as step:
        found = [(s.wind_speed, s.performance(step, **wished)) for s in scenarios]
    if output is not None:
        _sweep(found).save(output)
    if as_json:
        typer.echo(json.dumps(_performance_data(found), allow_nan=False))
        return
    for speed, performance in found:
        typer.echo(f"wind {speed:g} m/s\n\n{performance.summary()}\n")
    if output is not None:
        typer.echo(f"written to {output}")


def _seas(scenario: Scenario, realizations: int, coupled: bool) -> int:
    """Return how many surfaces a link's performance takes at one depth."""
    from meshtrace.series import RandomSea

    return realizations if coupled or isinstance(scenario.surface, RandomSea) else 1


def _sweep(found: list[tuple[float, LinkPerformance]]) -> Any:
    """Return what to save: one performance, or those of several winds."""
    from meshtrace.performance import DepthSweep

    if len(found) == 1:
        return found[0][1]
    return DepthSweep(tuple(u for u, _ in found), tuple(p for _, p in found))


def _performance_data(found: list[tuple[float, LinkPerformance]]) -> list[dict[str, Any]]:
    """Return performances as plain data for JSON."""
    return [
        {
            "wind_speed": speed,
            "limit": performance.limit,
            "confidence": performance.confidence,
            "status": performance.status,
            "figures": [_finite(figures) for figures in performance.figures],
            "ranges": [
                {"bit_rate": rate, "range": _finite(value)}
                for rate, value in zip(
                    performance.bit_rates, performance.range_at_ber(), strict=True
                )
            ],
            "provenance": performance.provenance,
        }
        for speed, performance in found
    ]


def _fading_of(
    scenario: Scenario,
    seas: int,
    output: Path | None,
    evaluate: Callable[[Callable[[int], None]], GainSeries],
) -> None:
    """Compute gains over many seas, write them, and print their fading."""
    import numpy as np

    if output is not None:
        _refuse_unwritable(output)
    with _warnings_as_lines(), _over_seas(seas, quiet=False) as step:
        gains = evaluate(step)
    if output is not None:
        gains.save(output)
    for receiver, gain in enumerate(np.atleast_2d(gains.gain.T)):
        if gains.gain.ndim == 2:
            typer.echo(f"receiver {receiver}")
        if gains.along == "realization":
            shares = (1, 5, 25, 50, 75, 95, 99)
            quantiles = np.percentile(gain, shares)
            typer.echo("".join(f"{f'{share} %':>12}" for share in shares))
            typer.echo("".join(f"{value:>12.4e}" for value in quantiles) + "\n")
        typer.echo(gains.fading(receiver).summary())
    error = np.atleast_1d(gains.mean_stderr / gains.gain.mean(axis=0))
    typer.echo(f"  chains               mean gain +- {100.0 * float(error.max()):.2g} %")
    if output is not None:
        typer.echo(f"\nwritten to {output}")


@contextmanager
def _over_seas(seas: int, quiet: bool) -> Iterator[Callable[[int], None]]:
    """Yield how to say that a sea is done."""
    with _progress(seas, quiet, "over the seas") as (say, advance):
        if not _kernels_are_compiled("forced"):
            say(COMPILING)
        yield advance


def _numbers(option: str, text: str) -> list[float]:
    """Return the numbers of a list "1,2,3" or a range "start:stop:step", its end included."""
    from meshtrace.scenario import ScenarioError

    wrong = f"{option}: {text!r}, allowed: numbers as in 1,2,3, or start:stop:step"
    try:
        if ":" not in text:
            found = [float(word) for word in text.split(",")]
        else:
            start, stop, step = (float(word) for word in text.split(":"))
            count = int((stop - start) / step + 1e-9) + 1
            if not (step > 0.0 and 1 <= count <= 10**7):
                raise ScenarioError(wrong)
            found = [start + step * i for i in range(count)]
    except (ValueError, ZeroDivisionError, OverflowError) as error:
        raise ScenarioError(wrong) from error
    if not all(math.isfinite(value) for value in found):
        raise ScenarioError(wrong)
    return found


def _scenario(link: Path | None, settings: list[str], options: dict[str, str | None]) -> Scenario:
    """Return the scenario of a link file, with the changes of the command line."""
    from meshtrace.scenario import Scenario, parse_setting

    given = [f"run.{key}={value}" for key, value in options.items() if value is not None]
    changes = dict(parse_setting(setting) for setting in [*settings, *given])
    if link is None:
        return Scenario.from_toml("", changes=changes)
    return Scenario.load(link, changes)


def _refuse_unwritable(output: Path) -> None:
    from meshtrace.scenario import ScenarioError

    if output.is_dir() or not os.access(output.parent, os.W_OK):
        raise ScenarioError(f"--output: {str(output)!r}, allowed: a file in a folder to write to")


def _simulate(scenario: Scenario, quiet: bool) -> tuple[GainResult, float]:
    """Return the result of a scenario and its wall time [s], compiling beforehand if need be."""
    known = scenario.run.photons if scenario.run.rtol is None else None
    with _progress(known, quiet) as (say, advance):
        if not _kernels_are_compiled(scenario.run.estimator):
            scenario.mesh()  # so that a wrong link is told without waiting for the compiler
            say(COMPILING)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                single = scenario.run.model_copy(update={"photons": 1, "rtol": None})
                scenario.model_copy(update={"run": single}).simulate()
        start = time.perf_counter()
        result = scenario.simulate(advance)
        return result, time.perf_counter() - start


@contextmanager
def _progress(
    total: int | None, quiet: bool, doing: str = "following photons"
) -> Iterator[tuple[Callable[[str], None], Callable[[int], None]]]:
    """Yield how to say what goes on, and how to say that photons or seas are done."""
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


def _kernels_are_compiled(estimator: str) -> bool:
    """Whether numba's cache on disk has kernels of an estimator, of whatever version."""
    from meshtrace.kernels.analog import advance

    stats = getattr(advance, "stats", None)  # a plain function where compiling is disabled
    # kernels/forced.py and kernels/analog.py: numba names its files after the module
    return stats is None or any(Path(stats.cache_path).glob(f"{estimator}.*.nbi"))


@contextmanager
def _warnings_as_lines() -> Iterator[None]:
    """Print warnings as lines of stderr when done."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    for warning in caught:
        typer.echo(f"warning: {' '.join(str(warning.message).split())}", err=True)


def _as_data(result: GainResult, wall_time: float) -> dict[str, Any]:
    """Return a result as plain data for JSON, with null for what is not finite."""
    return {
        "gain": _finite(result.gain),
        "gain_stderr": _finite(result.gain_stderr),
        "gain_db": _finite(result.gain_db),
        "gain_ballistic": _finite(result.gain_ballistic),
        "gain_scattered": _finite(result.gain_scattered),
        "photons": result.photons,
        "photons_per_second": result.photons / wall_time,
        "wall_time": wall_time,
        "fates": {name: tally._asdict() for name, tally in result.fates.items()},
        "chains": result.chains,
        "misses": {"cast_again": result.misses[0], "given_up": result.misses[1]},
        "provenance": result.provenance,
    }


def _finite(value: Any) -> Any:
    """Return numbers in tuples and arrays as plain data, with null for what is not finite."""
    import numpy as np

    if value is None:
        return None
    if hasattr(value, "_asdict"):
        return {key: _finite(item) for key, item in value._asdict().items()}
    if np.ndim(value):
        return [_finite(item) for item in value]
    return float(value) if math.isfinite(value) else None


def _summary(scenario: Scenario, result: GainResult, wall_time: float, output: Path | None) -> str:
    """Return a result as text."""
    sea, forced = result.provenance["surface"]["kind"], scenario.run.estimator == "forced"
    rate = result.photons / wall_time
    lines = [
        f"{scenario.run.estimator} estimator, {sea} sea, wind {scenario.wind_speed:g} m/s",
        "",
        *_gain_lines(result),
        _line(
            "chains" if forced else "photons",
            f"{result.photons:,} in {wall_time:.2f} s, {rate:,.0f} per second",
        ),
    ]
    if result.fates:
        cast, lost = result.misses
        lines.append(_line("misses", f"{cast:,} rays cast again, {lost:,} given up"))
        lines += ["", *_fate_lines(result)]
    if result.chains:
        lines += ["", *_chain_lines(result)]
    if output is not None:
        lines += ["", f"written to {output}"]
    return "\n".join(lines)


def _line(name: str, text: str) -> str:
    return f"{name:<18}{text}"


def _gain_lines(result: GainResult) -> list[str]:
    """Return gain and standard error of each receiver."""
    import numpy as np

    gains, errors = np.atleast_1d(result.gain), np.atleast_1d(result.gain_stderr)
    direct = None if result.gain_ballistic is None else np.atleast_1d(result.gain_ballistic)
    lines = []
    for i, (gain, stderr) in enumerate(zip(gains, errors, strict=True)):
        name = "channel gain" if np.ndim(result.gain) == 0 else f"channel gain [{i}]"
        if not gain > 0.0:
            # 3 / n: what is seen in none of n trials has, at 95 %, at most this probability
            bound = f", below {3.0 / result.photons:.2g} at 95 % confidence" if result.fates else ""
            lines.append(_line(name, f"0: no light received{bound}"))
            continue
        decibel = 10.0 / math.log(10.0) * stderr / gain
        percent = 100.0 * stderr / gain
        lines.append(_line(name, f"{gain:.4e}  ({10.0 * math.log10(gain):.3f} dB optical)"))
        lines.append(_line("standard error", f"{stderr:.1e}  ({percent:.2g} %, {decibel:.2g} dB)"))
        if direct is not None:
            scattered = 100.0 * (1.0 - direct[i] / gain)
            lines.append(_line("", f"{direct[i]:.4e} unscattered; scattered {scattered:.1f} %"))
    return lines


def _fate_lines(result: GainResult) -> list[str]:
    """Return what became of the photons, as a table."""
    from meshtrace.result import FATE_MEANING, Fate

    lines = [f"{'fate':<12}{'photons':>15}{'weight %':>12}  meaning"]
    for name, tally in result.fates.items():
        meaning = FATE_MEANING[Fate[name.upper()]]
        lines.append(f"{name:<12}{tally.photons:>15,}{100.0 * tally.weight:>12.4g}  {meaning}")
    return lines


def _chain_lines(result: GainResult) -> list[str]:
    """Return what became of the scattering chains, as a table."""
    lines = [f"{'chains':<12}{'number':>15}  meaning"]
    for name, number in result.chains.items():
        lines.append(f"{name:<12}{number:>15,}  {CHAIN_MEANING.get(name, name)}")
    return lines
