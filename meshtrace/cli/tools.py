"""The commands that run no study."""

from __future__ import annotations

import json
import time
import warnings
from itertools import count
from pathlib import Path
from typing import Any, Literal

import typer
from typer import Argument, Option

from meshtrace.cli.app import app
from meshtrace.cli.console import COMPILING, extra, finite, progress
from meshtrace.cli.made import grouped
from meshtrace.cli.options import AsJson, Changes, InWind, LinkFile, Trust
from meshtrace.cli.outputs import check_output, check_plot, draw
from meshtrace.errors import Refused, require_word
from meshtrace.files import atomic


@app.command()
@grouped
def new(*, link: LinkFile = None, changes: InWind) -> None:
    """Print a complete link file with a note on every key.

    Redirect it to a file: meshtrace new > link.toml
    """
    typer.echo(changes.scenario(link).to_toml(notes=True), nl=False)


@app.command()
@grouped
def explore(
    *,
    link: LinkFile = None,
    host: str = Option(
        "127.0.0.1", metavar="ADDRESS", help="Address to listen on; default: this machine only."
    ),
    port: int = Option(8080, metavar="N", min=0, max=65_535, help="Port; 0 for a free one."),
    browser: bool = Option(True, "--browser/--no-browser", help="Open the page in a browser."),
    changes: InWind,
) -> None:
    """Explore a link in the browser: move its parts and see gain, rays, fading and coverage."""
    from meshtrace.explorer.launch import explore as start

    title = "the link of the paper" if link is None else link.name
    start(changes.scenario(link), host=host, port=port, open_browser=browser, title=title)


@app.command()
def figures(
    output: Path = Option(
        Path("figures"), "--output", "-o", metavar="FOLDER", help="Folder of the figures."
    ),
    only: list[str] | None = Option(
        None, metavar="NAME", help="Draw this figure only; repeatable. Names: see --list."
    ),
    quick: bool = Option(False, "--quick", help="Fewer photons and seas: minutes for all figures."),
    profiles: list[Path] | None = Option(
        None, metavar="A.NC", help="Temperature and salinity (AODN, Argo); repeatable."
    ),
    names: bool = Option(False, "--list", help="List the names of the figures."),
    seed: int = Option(1, metavar="N", min=0, help="Seed of the random numbers."),
    threads: int | None = Option(
        None, metavar="N", min=1, max=1024, help="Number of threads; default: all cores."
    ),
) -> None:
    """Redraw the figures of the paper, with data, tables and an index page.

    Finished figures are kept; an interrupted run resumes.
    """
    from meshtrace.paper import FIGURES, Setting, make_figures
    from meshtrace.paper.runner import INDEX

    if names:
        typer.echo("\n".join(FIGURES))
        return
    if output.exists() and not output.is_dir():
        raise Refused("--output", str(output), "a folder")
    setting = Setting(seed=seed, threads=threads, profiles=tuple(profiles or ()))
    try:
        with extra("viz", "viz"):
            made = make_figures(output, only, quick=quick, setting=setting, on_figure=_report)
    except OSError as error:
        raise Refused("--output", error, "a folder to write to") from error
    kept = sum(record["kept"] for record in made)
    typer.echo(f"{len(made) - kept} drawn, {kept} kept; read {output / INDEX}")


def _report(name: str, record: dict[str, Any] | None) -> None:
    """Report the progress on stderr."""
    state = " ..."
    if record is not None:
        state = ": kept" if record["kept"] else f": {record['wall_s']:.1f} s"
    typer.echo(f"{name}{state}", err=True)


@app.command()
def validate(
    quick: bool = Option(False, "--quick", help="Use a twentieth of the photons."),
    case: str | None = Option(
        None, metavar="NAME", help="Run one reference case instead of the suite: w2a1."
    ),
    as_json: AsJson = False,
) -> None:
    """Check the engine against closed forms, or against a reference case.

    Without a standard error, z is the deviation divided by the stated tolerance. The exit code is
    1 if any |z| exceeds 4.
    """
    from meshtrace.validation import LIMIT, SUITE, format_table, w2a1
    from meshtrace.validation import validate as run_checks

    if case is not None:
        require_word(case, ("w2a1",), "--case")
    with progress(
        len(SUITE) if case is None else w2a1.STEPS, as_json, "checking", "forced", "analog"
    ) as (say, advance):
        done = count()

        def step(name: str) -> None:
            if next(done):
                advance(1)
            say(name)

        checks = run_checks(quick, step) if case is None else tuple(w2a1.checks(quick, step))
    failed = sum(not check.passed for check in checks)
    if as_json:
        rows = [finite(check.as_data()) for check in checks]
        typer.echo(json.dumps({"limit": LIMIT, "failed": failed, "checks": rows}, allow_nan=False))
    else:
        typer.echo(
            f"{format_table(checks)}\n\n{len(checks)} checks, {failed} beyond |z| = {LIMIT:g}. "
            "z = (got - expected) / hypot(std. error, tolerance);\nchecks without a standard error "
            "are deterministic, and z is relative to the tolerance alone."
        )
        if case is not None:
            typer.echo(f"Score by the rules of the case: {w2a1.score(checks)} of {len(checks)}.")
    if failed:
        raise typer.Exit(1)


@app.command()
def bench(
    link: Path | None = Argument(
        None, metavar="[LINK.TOML]", help="Link file; default: the link of the paper at 13 m/s."
    ),
    output: Path | None = Option(None, "--output", "-o", help="Write the measurements as JSON."),
    as_json: bool = Option(False, "--json", help="Print the measurements as JSON."),
    quick: bool = Option(False, "--quick", help="Use a quarter of the photons."),
    cold: bool = Option(False, "--cold", help="Also measure a first run, which compiles."),
    trust: Trust = False,
) -> None:
    """Measure the speed of the engine, as ratios within one run."""
    from meshtrace.bench import bench as measure
    from meshtrace.bench import report

    check_output(output, link)
    changes = ["wind_speed=13", "bubbles=none"] if link is None else []
    scenario = Changes(changes, trust).scenario(link)
    result = measure(scenario, quick=quick, cold=cold)
    text = json.dumps(result, indent=1)
    typer.echo(text if as_json else report(result))
    if output is not None:
        with atomic(output) as temporary:
            temporary.write_text(text + "\n", encoding="utf-8")


@app.command("plot")
def plot_command(
    file: Path = Argument(
        metavar="RESULT", help="Result of any command (.nc), or the store of a sweep."
    ),
    output: Path | None = Option(
        None, "--output", "-o", metavar="A.PNG", help="Picture; default: RESULT.png."
    ),
) -> None:
    """Draw a result file."""
    path = file.with_suffix(".png") if output is None else output
    check_plot(path, file, option="--output")
    draw(_content(file), path)


def _content(file: Path) -> object:
    """Return a result, or the dataset of a sweep."""
    from meshtrace.stored import load, read_dataset
    from meshtrace.studies.store import is_store

    if is_store(file):
        from meshtrace.studies.sweeps import read_store

        return read_store(file)
    data = read_dataset(file)
    return data if data.attrs.get("kind") == "sweep" else load(file)


@app.command()
def warm() -> None:
    """Compile the kernels of both estimators, and keep them for later runs."""
    from meshtrace.engine.simulate import simulate
    from meshtrace.kernels.jit import folder
    from meshtrace.link import Link, Physics, Receiver
    from meshtrace.optics.water import Water
    from meshtrace.surfaces import JonswapSea

    start, sea = time.perf_counter(), JonswapSea()
    runs: list[tuple[Link, Literal["forced", "analog"]]] = [
        (Link(), "forced"),
        (Link(physics=Physics(unresolved="none")), "forced"),
        (Link(water=Water(bottom_depth=20.0), receiver=(Receiver(), Receiver())), "forced"),
        (Link(), "analog"),
    ]
    with progress(len(runs), False, COMPILING, "forced", "analog") as (_, advance):
        for link, estimator in runs:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                simulate(link, sea, estimator, photons=64, spacing=0.5)
            advance(1)
    typer.echo(f"kernels in {folder()}, {time.perf_counter() - start:.1f} s")
