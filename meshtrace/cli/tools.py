"""The commands that run no study."""

from __future__ import annotations

import json
import math
import time
import warnings
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from meshtrace.cli import console
from meshtrace.cli.commands import app
from meshtrace.cli.made import Span, described, numbers
from meshtrace.errors import (
    MISSING,
    Described,
    Refused,
    extra,
    require_between,
    require_finite,
    require_word,
)

if TYPE_CHECKING:
    from meshtrace.results.gain import GainResult
    from meshtrace.scenario import Scenario


@app.command()
@described
def run(
    *,
    link: console.LinkFile = None,
    printed: console.PrintOptions,
    photons: str | None = None,
    rtol: str | None = None,
    estimator: str | None = None,
    wavelengths: str | None = None,
    case: console.AllChanges,
    verbose: bool = False,
) -> None:
    """Simulate one link and print its channel gain.

    Parameters
    ----------
    photons : N
        Chains (forced) or photons (analog).
    rtol : R
        Target for the relative standard error, such as 0.01.
    estimator : NAME
        forced or analog.
    wavelengths : NM,NM,...
        Wavelengths with common paths, or start:stop:step.
    verbose
        Print samples and chains, too.
    """
    # words as yet, for the link file's own checks
    options = {"run.photons": photons, "run.rtol": rtol, "run.estimator": estimator}
    scenario, quiet = case.scenario(link, options), printed.json_
    printed.check(link)
    at = None if wavelengths is None else numbers("--wavelengths", wavelengths)
    result, wall_time = _simulate(scenario, quiet, at)
    if quiet:
        rows = {"": result} if at is None else {f"{nm:g}": one for nm, one in result}
        data = {name: _plain(one, wall_time) for name, one in rows.items()}
        typer.echo(json.dumps(data[""] if at is None else data, allow_nan=False))
    else:
        typer.echo(result.summary(wall_time, verbose) if at is None else result.summary())
    printed.save(result, quiet)


def _simulate(
    scenario: Scenario, quiet: bool, wavelengths_nm: list[float] | None
) -> tuple[Any, float]:
    """Return the result of a scenario and its wall time [s], compiling beforehand if need be."""
    known = scenario.run.photons if scenario.run.rtol is None else None
    with console.progress(known, quiet, "following photons") as (say, advance):
        if not console.kernels_are_compiled(scenario.run.estimator.kind):
            scenario.mesh()  # reports a wrong link before the kernels compile
            say(console.COMPILING)
            with warnings.catch_warnings(), console.compiling_ahead(scenario):
                warnings.simplefilter("ignore")
                # in this thread: others end their compilation before Ctrl-C ends them
                few = {"photons": min(scenario.run.photons, 64), "rtol": None, "threads": 1}
                short = scenario.run.model_copy(update=few)
                scenario.model_copy(update={"run": short}).simulate()
        start = time.perf_counter()
        result = scenario.simulate(advance, wavelengths_nm)
        return result, time.perf_counter() - start


_GAINS = (
    *("gain", "gain_stderr", "gain_db", "gain_bound", "gain_ballistic", "gain_scattered"),
    "mesh_error",
)


def _plain(result: GainResult, wall_time: float) -> dict[str, Any]:
    """Return a result as plain data for JSON, with null for non-finite values."""
    return {
        **{name: console.finite(getattr(result, name)) for name in _GAINS},
        "photons": result.photons,
        "photons_per_second": result.photons / wall_time,
        "wall_time": wall_time,
        "fates": {name: tally._asdict() for name, tally in result.fates.items()},
        "chains": result.chains and result.chains._asdict(),
        "scattered": [row._asdict() for row in result.scattered],
        "misses": {"cast_again": result.rays_recast, "given_up": result.rays_lost},
        "provenance": result.provenance,
    }


@app.command()
@described
def new(*, link: console.LinkFile = None, changes: console.WindChanges) -> None:
    """Print a complete link file with a note on every key.

    Redirect it to a file: meshtrace new > link.toml
    """
    typer.echo(changes.scenario(link).to_toml(notes=True), nl=False)


@app.command()
@described
def explore(
    *,
    link: console.LinkFile = None,
    host: str = "127.0.0.1",
    port: Annotated[int, Span(0, 65_535)] = 8080,
    browser: bool = True,
    changes: console.WindChanges,
) -> None:
    """Explore a link in the browser: move its parts and see gain, rays, fading and coverage.

    Parameters
    ----------
    host : ADDRESS
        Address to listen on; default: this machine only.
    port : N
        Port; 0 for a free one.
    browser
        Open the page in a browser.
    """
    from meshtrace.apps.explorer import explore as start

    title = "the link of the paper" if link is None else link.name
    start(changes.scenario(link), host=host, port=port, open_browser=browser, title=title)


@app.command()
@described
def validate(
    *,
    quick: bool = False,
    suite: str = "closed-forms",
    case: str | None = None,
    output: Path | None = None,
    json_: bool = False,
) -> None:
    """Check the engine against closed forms, measurements, or a reference case.

    Without a standard error, z is the deviation divided by the stated tolerance. The exit code is
    1 if any |z| exceeds 4; measurements outside their bands do not change it.

    Parameters
    ----------
    quick
        Use a twentieth of the photons; an eighth for measurements.
    suite : NAME
        Suite: closed-forms, or measured, published measurements (some minutes).
    case : NAME
        Run one reference case instead of the suite: w2a1; or one experiment of the suite measured.
    output : FILE
        Write the table of measurements, as netCDF or, with the ending .csv, as text.
    json_
        Print the result as JSON, without progress bar.
    """
    require_word(suite, ("closed-forms", "measured"), "--suite")
    if suite == "measured":
        _measured(quick, case, output, json_)
        return
    if output is not None:
        raise Refused("--output", str(output), "only with --suite measured")
    from meshtrace.apps import w2a1
    from meshtrace.validation import LIMIT, SUITE, format_table
    from meshtrace.validation import validate as run_checks

    if case is not None:
        require_word(case, ("w2a1",), "--case")
    steps = len(SUITE) if case is None else w2a1.STEPS
    with console.named_steps(steps, json_, "checking", "forced", "analog") as step:
        checks = run_checks(quick, step) if case is None else tuple(w2a1.checks(quick, step))
    failed = sum(not check.passed for check in checks)
    if json_:
        rows = [console.finite(check.as_data()) for check in checks]
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


def _measured(quick: bool, case: str | None, output: Path | None, json_: bool) -> None:
    """Compare published measurements with computed values."""
    from meshtrace.apps import measured

    console.check_output(output)
    names = list(measured.experiments())
    if case is not None:
        require_word(case, names, "--case")
        names = [case]
    with console.named_steps(len(names), json_, "comparing", "analog") as step:
        table = measured.run(names, quick=quick, progress=step)
    if json_:
        rows = [dict(zip(measured.HEADINGS, row, strict=True)) for row in table.rows()]
        typer.echo(json.dumps({"rows": rows}))
    else:
        typer.echo(table.summary())
    if output is not None:
        table.save(output)


@app.command("plot")
@described
def plot_command(file: Path, *, output: Path | None = None) -> None:
    """Draw a result file.

    Parameters
    ----------
    file : RESULT
        Result of any command (.nc), or the store of a sweep.
    output : A.PNG
        Picture; default: RESULT.png.
    """
    path = file.with_suffix(".png") if output is None else output
    console.check_plot(path, file, option="--output")
    console.draw(_content(file), path)


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
@described
def warm() -> None:
    """Compile the kernels of both estimators and of coverage maps, and keep them for later runs."""
    from meshtrace.engine.simulate import simulate
    from meshtrace.kernels.jit import folder
    from meshtrace.link import Link, Physics, Receiver
    from meshtrace.optics.water import Water
    from meshtrace.studies.coverage import coverage_map
    from meshtrace.surfaces import JonswapSea

    start, sea = time.perf_counter(), JonswapSea()
    runs: list[tuple[Link, Literal["forced", "analog"]]] = [
        (Link().mirrored(), "forced"),
        (Link(physics=Physics(unresolved="none")), "forced"),
        (Link(water=Water(bottom_depth=20.0), receiver=(Receiver(), Receiver())), "forced"),
        (Link(), "analog"),
    ]
    steps, doing = len(runs) + 2, console.COMPILING
    with console.progress(steps, False, doing, "forced", "analog") as (_, advance):
        console.Changes().scenario(None).simulate()  # the mesh of `meshtrace run` is another kind
        advance(1)
        for link, estimator in runs:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                simulate(link, sea, estimator, photons=64)
            advance(1)
        coverage_map(Link(), sea, extent=1.0, step=0.5, rtol=0.5)
        advance(1)
    typer.echo(f"kernels in {folder()}, {time.perf_counter() - start:.1f} s")


@app.command()
@described
def water(
    *,
    link: console.LinkFile = None,
    type_: str | None = None,
    chlorophyll: float | None = None,
    cdom: float | None = None,
    minerals: float | None = None,
    temperature_c: float | None = None,
    salinity: float | None = None,
    file: Path | None = None,
    wavelengths: str | None = None,
    plot: Path | None = None,
    changes: console.Changes,
) -> None:
    """Print absorption, scattering, attenuation and index of a water over the wavelength.

    The water is that of a link file, or of the options, whose keys in a link file are in [water].

    Parameters
    ----------
    type_ : NAME
        Known water, such as coastal, jerlov-IB or pure-sea.
    chlorophyll : C
        Chlorophyll [mg m-3].
    cdom : A
        Absorption of dissolved matter at 440 nm [m-1].
    minerals : M
        Mineral particles [g m-3].
    temperature_c : T
        Temperature [degree Celsius].
    salinity : S
        Salinity [g/kg].
    file : FILE
        SeaBASS file, BGC-Argo profile or text table.
    wavelengths : NM,NM,...
        Wavelengths [nm], or start:stop:step; default: 400 to 700 nm.
    plot : A.PNG
        Draw the coefficients.
    """
    from meshtrace.optics.water import Water
    from meshtrace.scenario.parts import spectrum_of
    from meshtrace.tables import text_table

    console.check_plot(plot, link)
    keys = {"type": type_, "chlorophyll": chlorophyll, "cdom": cdom, "minerals": minerals,
            "temperature_c": temperature_c, "salinity": salinity}  # fmt: skip
    own = {key: value for key, value in keys.items() if value is not None}
    if own or file is not None:
        if link is not None or changes.set_:
            given = Described(f"{link or changes.set_} beside options of a water")
            raise Refused("link", given, "one of them")
        spectrum = spectrum_of(own if file is None else own | {"file": str(file)})
        low, high = spectrum.limits_nm
        found = Water(spectrum=spectrum, wavelength_nm=min(max(low, 470.0), high))
    else:
        lamp = changes.scenario(link).link
        found = lamp.water
        if found.spectrum is None and wavelengths is None and plot is None:
            typer.echo(found.described(lamp.transmitters[0].wavelength_nm))
            return
    data = found.spectra(None if wavelengths is None else numbers("--wavelengths", wavelengths))
    columns = [data[name].values for name in ("wavelength_nm", *"abcn")]
    rows = [(f"{w:g}", *(f"{x:.4g}" for x in abc), f"{n:.4f}")
            for w, *abc, n in zip(*columns, strict=True)]  # fmt: skip
    headings = ("wavelength [nm]", "a [m-1]", "b [m-1]", "c [m-1]", "n")
    where = ", at the surface" if found.layers else ""
    typer.echo(f"{data.attrs['source']}{where}\n\n{text_table(rows, headings)}")
    console.draw(data, plot)


MESH_SUFFIXES = (".stl", ".ply", ".obj")

MOST_PATHS, MOST_FRAMES = 100_000, 10_000

Inputs = dict[str, Any]  # arguments of a view


@dataclass(frozen=True, kw_only=True)
class ViewOptions:
    """Files to write (without one a window opens), light in the scene, frames of a movie.

    Parameters
    ----------
    screenshot : A.PNG
        Write a picture; no window.
    html : A.HTML
        Write an interactive web page.
    movie : A.MP4
        Write a movie (.mp4, .gif) of the sea and the gain.
    light : A.MP4
        Write a picture (.png) or movie of the light pattern on the receiver's plane.
    export : FOLDER
        Write surface, paths and map as VTK files.
    paths : N
        Photon paths, in addition to received light [default: 100; movie: 0].
    received : N
        Paths of received light.
    map_ : N
        Photons of a coverage map at receiver height.
    time : S
        Time of the sea [s].
    frames : N
        Frames of the movie.
    frame_rate : N
        Frames per second, at natural speed [default: 30].
    seed : N
        Seed of the paths.
    """

    screenshot: Path | None = None
    html: Path | None = None
    movie: Path | None = None
    light: Path | None = None
    export: Path | None = None
    paths: Annotated[int | None, Span(0, MOST_PATHS)] = None
    received: Annotated[int | None, Span(1, MOST_PATHS)] = None
    map_: Annotated[int | None, Span(1)] = None
    time: float | None = None
    frames: Annotated[int, Span(2, MOST_FRAMES)] = 300
    frame_rate: float | None = None
    seed: Annotated[int, Span(0)] = 1


@dataclass(frozen=True, kw_only=True)
class StyleOptions:
    """Appearance of the scene.

    Parameters
    ----------
    color : NAME
        water, elevation, slope, slope_x, slope_y or plain.
    path_color : NAME
        fate or weight.
    edges
        Draw the edges of the facets.
    extent : M
        Half-width of the sea shown [m].
    spacing : M
        Mesh spacing of the sea shown [m].
    """

    color: str = "water"
    path_color: str = "fate"
    edges: bool = False
    extent: float | None = None
    spacing: float | None = None


@app.command()
@described
def view(
    file: Path | None = None,
    *,
    options: ViewOptions,
    style: StyleOptions,
    changes: console.WindChanges,
) -> None:
    """Show a link, a result or a mesh: in a window, or as a picture, page, movie or VTK files.

    Parameters
    ----------
    file : [FILE]
        Link (.toml), result (.nc) or mesh (.stl, .ply, .obj); default: the paper's link.
    """
    if options.frame_rate is not None:  # a view without a movie does not check it
        require_between(options.frame_rate, 0.0, math.inf, "--frame-rate", allowed="numbers > 0")
    from meshtrace.results.series import GainSeries

    with extra("viz", "viz"):
        from meshtrace.viz import SceneStyle
        from meshtrace.viz import view as show
    given: Inputs = {name: value for name, value in vars(options).items() if value is not None}
    if photons := given.pop("map_", None):
        given["coverage"] = photons
    subject = {**_subject(file, changes), **given}
    scenario, gain = subject.pop("scenario", None), subject.get("gain")
    steps = len(gain.coordinate) if isinstance(gain, GainSeries) else options.frames
    still = any((options.screenshot, options.html, options.export)) or not (
        options.movie or options.light
    )
    kernels = () if subject["link"] is None else ("forced",)
    with (
        console.progress(steps, False, "drawing frames", *kernels) as (_, advance),
        extra("viz", "viz"),
    ):
        if still and gain is None and scenario is not None:
            with suppress(Refused):  # the picture has no gain then
                subject["gain"] = scenario.simulate()
        written = show(
            **subject,
            title="meshtrace" if file is None else file.name,
            progress=advance,
            style=SceneStyle(**vars(style)),
        )
    for path in written:
        typer.echo(f"written to {path}")


def _subject(file: Path | None, changes: console.WindChanges) -> Inputs:
    """Return the link, the surface and the data of a file as arguments of a view."""
    from meshtrace.scenario import MeshFile

    suffix = ".toml" if file is None else file.suffix.lower()
    if suffix == ".toml":
        return _of_scenario(changes.scenario(file))
    assert file is not None
    first = changes.set_ and changes.set_[0]
    given = {"--set": first, "--wind": changes.wind, "--trust": changes.trust}
    for option, value in given.items():
        if value:
            raise Refused(option, value, "with a link file")
    if not file.is_file():
        raise Refused(str(file), Described("no such file"), "a link file, result or mesh")
    if suffix == ".nc":
        return _of_result(file)
    if suffix in MESH_SUFFIXES:
        return {"link": None, "surface": MeshFile(file=str(file)).load()}
    kinds = ", ".join((".toml", ".nc", *MESH_SUFFIXES))
    raise Refused(str(file), file.suffix, f"a file name in {kinds}")


def _of_scenario(scenario: Scenario) -> Inputs:
    from meshtrace.scenario import MeshFile

    still = isinstance(scenario.surface, MeshFile)
    surface = scenario.mesh() if still else scenario.case().surface
    at = {"time": scenario.meshing.time, "daylight": scenario.daylight}
    return {"link": scenario.link, "surface": surface, "scenario": scenario, **at}


def _of_result(file: Path) -> Inputs:
    """Return the inputs of a result file, with its map or its gain over time."""
    from meshtrace.results import load
    from meshtrace.results.gain import GainResult
    from meshtrace.results.series import CoverageMap, GainSeries
    from meshtrace.scenario import Scenario

    result = load(file)
    origin: Any = result.provenance
    if isinstance(origin, list) and origin:  # of several winds: the first
        origin = origin[0]
    if not isinstance(origin, dict) or "link" not in origin:
        raise Refused(str(file), result.kind, "a result of a link over a sea")
    try:
        # the gain of `run` is that of link files: few chains are enough for each sea of a study
        subject = {**_of_scenario(Scenario.from_provenance(origin)), "scenario": None}
        if isinstance(result, CoverageMap):
            times = require_finite(origin.get("times", MISSING), "times", "times [s]")
            return {**subject, "coverage": result, "time": float(times.flat[0])}
    except Refused as error:
        raise error.in_file(str(file)) from None
    if isinstance(result, GainResult):
        return {**subject, "gain": result}
    if isinstance(result, GainSeries) and result.along == "time":
        return {**subject, "gain": result, "time": float(result.time[0])}
    return subject
