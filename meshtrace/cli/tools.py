"""The commands that run no study."""

import json
import time
import warnings
from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

import meshtrace as mt
from meshtrace.cli import console
from meshtrace.cli import options as opt
from meshtrace.cli.application import command
from meshtrace.cli.options import flag, numbers, value
from meshtrace.errors import Described, Refused, require_word

_ALL = "forced analog"  # `kernels` of `console.progress`: those of both estimators


@command()
def run(
    changes: opt.Changes,
    link: opt.LinkFile = None,
    photons: Annotated[str | None, value("N", "Chains (forced) or photons (analog).")] = None,
    rtol: Annotated[str | None, value("R", "Relative standard error to reach, e.g. 0.01.")] = None,
    estimator: Annotated[str | None, value("NAME",
        "forced (chains led to the receiver) or analog (single photons).")] = None,
    wavelengths: Annotated[Any, numbers("Wavelengths [nm] with common paths")] = None,
    per_lamp: opt.PerLamp = False,
    output: opt.Output = None,
    json_: opt.Json = False,
    verbose: Annotated[bool, typer.Option(
        "--verbose", "-v", help="Print samples and chains, too.")] = False,
) -> None:  # fmt: skip
    """Simulate one link and print its channel gain."""
    # left as texts, like the options of `Changes`: they are parsed and checked as in link files
    settings = {"run.photons": photons, "run.rtol": rtol, "run.estimator": estimator}
    scenario = changes.scenario(link, settings)
    console.check_output(output, link)
    result, wall_time = _simulate(scenario, json_, wavelengths, per_lamp)
    if json_:
        plain = partial(_plain, wall_time=wall_time)
        data = {f"{nm:g}": plain(gain) for nm, gain in result} if wavelengths else plain(result)
        typer.echo(json.dumps(data, allow_nan=False))
    else:
        typer.echo(result.summary() if wavelengths else result.summary(wall_time, verbose))
    console.save(result, output, quiet=json_)


def _simulate(
    scenario: "mt.Scenario", quiet: bool, wavelengths: Any, per_lamp: bool
) -> tuple[Any, float]:
    """Return the result of a scenario and its wall time [s], which excludes compilation."""
    photons = scenario.run.photons if scenario.run.rtol is None else None
    # kernels "": the status on compilation is set below, after the link has been checked
    with console.progress(photons, "following photons", kernels="", quiet=quiet) as (say, advance):
        if not console.kernels_are_compiled(scenario.run.estimator.kind):
            # refuse a wrong link here, before the kernels compile
            scenario.mesh()
            say(console.COMPILING)
            with warnings.catch_warnings(action="ignore"), console.compiling_ahead(scenario):
                # in this thread alone: with others, Ctrl-C would wait until these have compiled
                few = {"photons": min(scenario.run.photons, 64), "rtol": None, "threads": 1}
                short = scenario.run.model_copy(update=few)
                scenario.model_copy(update={"run": short}).simulate()
        start = time.perf_counter()
        result = scenario.simulate(advance, wavelengths, per_lamp)
        return result, time.perf_counter() - start


# Attributes of a result that are written to JSON by the same names.
_GAINS = ("gain", "gain_stderr", "gain_db", "gain_bound", "gain_ballistic", "gain_scattered",
          "mesh_error")  # fmt: skip


def _plain(result: "mt.GainResult", wall_time: float) -> dict[str, Any]:
    """Return a result as plain data for JSON, with null for non-finite values."""
    gains = {name: console.finite(getattr(result, name)) for name in _GAINS}
    if result.gain_by_lamp is not None:
        gains["gain_by_lamp"] = result.gain_by_lamp.tolist()
    return gains | {
        "photons": result.photons,
        "photons_per_second": result.photons / wall_time,
        "wall_time": wall_time,
        "fates": {name: tally._asdict() for name, tally in result.fates.items()},
        "chains": result.chains and result.chains._asdict(),
        "scattered": [row._asdict() for row in result.scattered],
        "misses": {"cast_again": result.rays_recast, "given_up": result.rays_lost},
        "provenance": result.provenance,
    }


@command()
def new(changes: opt.Changes, link: opt.LinkFile = None) -> None:
    """Print a complete link file with a note on every key.

    Redirect it to a file: meshtrace new > link.toml
    """
    typer.echo(changes.scenario(link).to_toml(notes=True), nl=False)


@command()
def explore(
    changes: opt.Changes,
    link: opt.LinkFile = None,
    host: Annotated[str, value(
        "ADDRESS", "Address to listen on; default: this machine only.")] = "127.0.0.1",
    port: Annotated[int, value("N", "Port; 0 for a free one.", low=0, high=65_535)] = 8080,
    browser: Annotated[bool, flag("--browser/--no-browser", "Open the page in a browser.")] = True,
) -> None:  # fmt: skip
    """Explore a link in the browser: move its parts and see gain, rays, fading and coverage."""
    title = "the link of the paper" if link is None else link.name
    scenario = changes.scenario(link)
    mt.explore(scenario, host=host, port=port, open_browser=browser, title=title)


@command()
def validate(
    quick: Annotated[bool, flag(
        "--quick", "Use a twentieth of the photons; an eighth for measurements.")] = False,
    suite: Annotated[str, value("NAME", "closed-forms, or measured: published measurements (some "
        "minutes).")] = "closed-forms",
    case: Annotated[str | None, value("NAME", "Run one reference case instead of the suite: w2a1; "
        "or one experiment of the suite measured.")] = None,
    output: Annotated[Path | None, value("FILE", "Write the table of measurements, as netCDF or, "
        "with the ending .csv, as text.", "--output", "-o")] = None,
    json_: opt.Json = False,
) -> None:  # fmt: skip
    """Check the engine against closed forms, measurements, or a reference case.

    Without a standard error, z is the deviation divided by the stated tolerance. The exit code is
    1 if any |z| exceeds 4; measurements outside their bands do not change it.
    """
    require_word(suite, ("closed-forms", "measured"), "--suite")
    if suite == "measured":
        _measured(quick, case, output, json_)
        return
    if output is not None:
        raise Refused("--output", str(output), "only with --suite measured")
    from meshtrace import validation
    from meshtrace.apps import w2a1

    require_word(case or "w2a1", ("w2a1",), "--case")
    steps = len(validation.SUITE) if case is None else w2a1.STEPS
    with console.named_steps(steps, "checking", kernels=_ALL, quiet=json_) as step:
        checks = tuple((validation.validate if case is None else w2a1.checks)(quick, step))
    limit, failed = validation.LIMIT, sum(not check.passed for check in checks)
    if json_:
        plain = [console.finite(check.as_data()) for check in checks]
        typer.echo(json.dumps({"limit": limit, "failed": failed, "checks": plain}, allow_nan=False))
    else:
        table = validation.format_table(checks)
        typer.echo(
            f"{table}\n\n{len(checks)} checks, {failed} beyond |z| = {limit:g}. "
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

    console.check_output(output, suffixes=(".csv", ".nc"))
    names = list(measured.experiments())
    if case is not None:
        require_word(case, names, "--case")
        names = [case]
    with console.named_steps(len(names), "comparing", kernels="analog", quiet=json_) as step:
        table = measured.run(names, quick=quick, progress=step)
    if json_:
        entries = [dict(zip(measured.HEADINGS, row, strict=True)) for row in table.text_rows()]
        typer.echo(json.dumps({"rows": entries}))
    else:
        typer.echo(table.summary())
    if output is not None:
        table.save(output)


@command("plot")
def plot_command(
    file: Annotated[Path, typer.Argument(
        metavar="RESULT", help="Result of any command (.nc), or the store of a sweep.")],
    output: Annotated[Path | None, value(
        "A.PNG", "Picture; default: RESULT.png.", "--output", "-o")] = None,
) -> None:  # fmt: skip
    """Draw a result file."""
    if file.suffix.lower() == ".toml":
        raise Refused(str(file), Described("a link file"), "a result; meshtrace view draws links")
    path = file.with_suffix(".png") if output is None else output
    console.check_plot(path, file, option="--output")
    console.draw(_content(file), path)


def _content(file: Path) -> object:
    """Return the result in a file, or the dataset of a sweep from a file or its store."""
    from meshtrace.stored import load, read_dataset
    from meshtrace.studies.store import is_store

    if is_store(file):
        from meshtrace.studies.sweeps import read_store

        return read_store(file)
    data = read_dataset(file)
    return data if data.attrs.get("kind") == "sweep" else load(file)


@command()
def warm() -> None:
    """Compile the kernels of gains, several wavelengths, maps and daylight; keep them."""
    from meshtrace.kernels.jit import folder

    start, runs = time.perf_counter(), _runs_of_all_kernels()
    compiled = all(map(console.kernels_are_compiled, _ALL.split()))
    from_the_end = "meshtrace.cli.tools:warm_from_the_end"
    beside = nullcontext() if compiled else console.compiling_beside(from_the_end)
    with console.progress(len(runs), console.COMPILING, kernels=_ALL) as (_, advance), beside:
        _each(runs, advance)
    typer.echo(f"kernels in {folder()}, {time.perf_counter() - start:.1f} s")


def warm_from_the_end() -> None:
    """Compile the kernels of `meshtrace warm` in reverse order.

    A process that begins with the first run meets this one halfway, however fast each is.
    """
    _each(_runs_of_all_kernels()[::-1])


def _each(runs: list[Callable[[], Any]], advance: Callable[[int], None] = lambda _: None) -> None:
    for run_once in runs:
        with warnings.catch_warnings(action="ignore"):
            run_once()
        advance(1)


def _runs_of_all_kernels() -> list[Callable[[], Any]]:
    """Return short runs that together compile all kernels for all types of arguments."""
    import numpy as np

    from meshtrace.link import Body

    sea = mt.JonswapSea()
    several = mt.Link(water=mt.Water(bottom_depth=20.0), receiver=(mt.Receiver(), mt.Receiver()))
    turbid = mt.Link(water=mt.Water(a=0.1, b=1.0))
    links = [mt.Link().mirrored(), mt.Link(physics=mt.Physics(unresolved="none")), several, turbid]
    clear, murky = (mt.Link(water=mt.Water.from_type(name)) for name in ("jerlov-IB", "jerlov-9C"))
    # Links under water, and bodies in the light, bring arrays of types of their own.
    corners = np.array([(-2.0, -2.0, 0.0), (2.0, -2.0, 0.0), (0.0, 2.0, 0.0)])
    plate = mt.TriangleMesh(corners, np.array([[0, 1, 2]], np.int32))
    # the upper one lies between the sea and a receiver at 4 m
    plates = tuple(Body(mesh=plate, position=(0.5, 0.0, z), albedo=0.0) for z in (-3.0, 2.0))
    ends = mt.WaterReceiver(depth=5.0), mt.Receiver(height=4.0)
    under, above = (mt.Link(receiver=end) for end in ends)
    links += [under, *(link.replace(objects=plates) for link in (under, above, links[1]))]
    coloured = [link.replace(objects=bodies, water=clear.water) for link in (under, above)
                for bodies in ((), plates)]  # fmt: skip
    in_colours = partial(mt.simulate, surface=sea, photons=64, wavelengths_nm=[450.0, 550.0])
    day = mt.Daylight(direct=1.0, diffuse=0.2)
    return [
        # the default sea of `meshtrace run` has another mesh than `sea` has in `simulate`
        opt.Changes().scenario(None).simulate,
        *(partial(mt.simulate, link, sea, photons=64) for link in links),
        partial(mt.simulate, mt.Link(), sea, "analog", photons=64),
        partial(mt.simulate, above.replace(objects=plates), sea, "analog", photons=64),
        partial(mt.coverage_map, mt.Link(), sea, extent=1.0, step=0.5, rtol=0.5),
        *(partial(in_colours, link) for link in (murky, *coloured)),
        partial(in_colours, clear, estimator="analog"),
        partial(mt.background, mt.Link(), sea, day, photons=64),
        partial(mt.OokLink().ber, 1e-9),
        partial(mt.apps.irradiance_series, sea, day, photons=1000, patch=(0.5, 0.5)),
    ]


@command()
def water(
    link: opt.LinkFile = None,
    type_: Annotated[str | None, value(
        "NAME", "Known water, such as coastal, jerlov-IB or pure-sea.", "--type")] = None,
    chlorophyll: Annotated[float | None, value("C", "Chlorophyll [mg m-3].")] = None,
    cdom: Annotated[float | None, value("A", "Absorption of CDOM at 440 nm [m-1].")] = None,
    minerals: Annotated[float | None, value("M", "Mineral particles [g m-3].")] = None,
    temperature_c: Annotated[float | None, value("T", "Temperature [degree Celsius].")] = None,
    salinity: Annotated[float | None, value("S", "Salinity [g/kg].")] = None,
    file: Annotated[Path | None, value("FILE", "SeaBASS file, BGC-Argo profile or table.")] = None,
    wavelengths: Annotated[Any, numbers("Wavelengths [nm], by default 400 to 700 nm")] = None,
    plot: Annotated[Path | None, value("A.PNG", "Draw the coefficients.")] = None,
    set_: opt.Set = None,
    trust: opt.Trust = False,
) -> None:  # fmt: skip
    """Print absorption, scattering, attenuation and index of a water over the wavelength.

    The water is that of a link file, or of the options, whose keys in a link file are in [water].
    """
    from meshtrace.scenario.parts import spectrum_of
    from meshtrace.tables import text_table

    console.check_plot(plot, link)
    keys = opt.without_none({
        "type": type_, "chlorophyll": chlorophyll, "cdom": cdom, "minerals": minerals,
        "temperature_c": temperature_c, "salinity": salinity,
    })  # fmt: skip
    if keys or file is not None:
        if link is not None or set_:
            conflict = Described(f"{link or set_} beside options of a water")
            raise Refused("link", conflict, "one of them")
        spectrum = spectrum_of(keys if file is None else keys | {"file": str(file)})
        # a `Water` needs a wavelength, 470 nm or the nearest that its spectrum has; its spectra do
        # not depend on it
        low, high = spectrum.limits_nm
        sample = mt.Water(spectrum=spectrum, wavelength_nm=min(max(low, 470.0), high))
    else:
        scenario_link = opt.Changes(set_=set_, trust=trust).scenario(link).link
        sample = scenario_link.water
        if sample.spectrum is None and wavelengths is None and plot is None:
            typer.echo(sample.described(scenario_link.transmitters[0].wavelength_nm))
            return
    data = sample.spectra(wavelengths)
    columns = [data[name].values for name in ("wavelength_nm", *"abcn")]
    cells = [(f"{w:g}", *(f"{x:.4g}" for x in abc), f"{n:.4f}")
            for w, *abc, n in zip(*columns, strict=True)]  # fmt: skip
    headings = ("wavelength [nm]", "a [m-1]", "b [m-1]", "c [m-1]", "n")
    note = ", at the surface" if sample.layers else ""
    typer.echo(f"{data.attrs['source']}{note}\n\n{text_table(cells, headings)}")
    console.draw(data, plot)
