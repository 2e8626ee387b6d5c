"""The command-line application, its reporting of failures, and the commands of commands.toml."""

from __future__ import annotations

import errno
import json
import os
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from meshtrace.cli import console
from meshtrace.cli.made import StudyCommand, StudyRow, defaults, numbers
from meshtrace.errors import Refused, extra, require_word

if TYPE_CHECKING:
    import xarray as xr

    from meshtrace.studies.performance import LinkPerformance

Asked = dict[str, Any]  # options of the study that are given

_MOST_ROWS = 200  # printed; the store holds all


def on_link(study: StudyRow, asked: Asked, *, of: console.LinkOptions) -> None:
    """Run the study of one link."""
    scenario, (function, *_) = of.opened(), study.functions
    values = defaults(function) | asked
    steps = None if values.get("rtol") else values.get(study.steps)
    total = steps if isinstance(steps, int | None) else len(steps)
    if total is not None and total < study.least:
        raise Refused(study.steps, total, f">= {study.least}")
    of.write(study.run(function, scenario, total, asked))


def compare(study: StudyRow, asked: Asked, links: list[Path], *, of: console.ResultOptions) -> None:
    """Compare the links of several files.

    Parameters
    ----------
    links : A.TOML B.TOML ...
        Two link files or more.
    """
    scenarios, (function,) = {path.stem: of.scenario(path) for path in links}, study.functions
    if len(scenarios) < len(links):
        raise Refused("links", ", ".join(map(str, links)), "files of different names")
    of.check(*links)
    seas = (defaults(function) | asked)["realizations"] * len(links)
    of.write(study.run(function, scenarios, seas, asked))


_REFINED = {"spacings": "--spacings", "steps": "--time-steps", "omega_max": "--omega-max"}


def converge(study: StudyRow, asked: Asked, *, what: str = "gain", of: console.LinkOptions) -> None:
    """Refine the mesh, the time step or the band of waves.

    Parameters
    ----------
    what : WORD
        gain, or fading over the band of waves.
    """
    require_word(what, ("gain", "fading"), "--what")
    scenario, function = of.opened(), _chosen(study, asked, what)
    values = defaults(function) | asked
    of.write(study.run(function, scenario, _surfaces(values), asked))


def _chosen(study: StudyRow, asked: Asked, what: str) -> Any:
    """Return the function that the options ask for; refuse options of other functions."""
    of = dict(zip(_REFINED, study.functions, strict=False))
    first = next((name for name in _REFINED if name in asked), "spacings")
    chosen = study.functions[-1] if what == "fading" else of[first]
    for name in asked.keys() - defaults(chosen).keys():
        others = [_REFINED[key] for key in _REFINED if name in defaults(of[key])]
        allowed = f"only with {' or '.join(others)}"
        if what == "fading":
            allowed = "only with --what gain"
        elif name in _REFINED:
            allowed = f"not beside {_REFINED[first]}"
        raise Refused(name, asked[name], allowed)
    return chosen


def _surfaces(values: Asked) -> int | None:
    """Return the number of surfaces of a study of convergence."""
    if "steps" in values:
        steps = values["steps"]
        duration = values["duration"] or 8.0 * max(steps)
        return round(2.0 * duration / min(steps) + 1.0) if min(steps) > 0.0 else None
    if "spacings" in values:
        return len(values["spacings"]) * values["placements"]
    return len(values["omega_max"]) * values["realizations"]


@dataclass(frozen=True, kw_only=True)
class DaylightOptions:
    """Light of the day at the receiver.

    Parameters
    ----------
    daylight : NAME
        clear, overcast, uniform, moon, night or none.
    sun_zenith : DEG
        Zenith angle of sun or moon.
    sun_elevation : DEG
        90 minus the zenith angle.
    filter_nm : NM
        Width of the optical filter.
    """

    daylight: str | None = None
    sun_zenith: float | None = None
    sun_elevation: float | None = None
    filter_nm: float | None = None

    def changes(self) -> dict[str, Any]:
        """Return the settings of the link file; an angle without a model means a clear sky."""
        zenith = self.sun_zenith
        if self.sun_elevation is not None:
            if zenith is not None:
                raise Refused("--sun-elevation", self.sun_elevation, "without --sun-zenith")
            if not 1.0 <= self.sun_elevation <= 90.0:
                allowed = "1 to 90 (below the horizon: --daylight night)"
                raise Refused("--sun-elevation", self.sun_elevation, allowed)
            zenith = 90.0 - self.sun_elevation
        filtered = {"detector.optics.filter_width_nm": self.filter_nm}
        if self.daylight is None and zenith is None:
            return filtered
        model = self.daylight or "clear"
        return {"daylight.model": model, "daylight.sun_zenith_deg": zenith, **filtered}


def traces(
    study: StudyRow, asked: Asked, *, down: str | None = None, of: console.LinkOptions
) -> None:
    """Compute the channel of a link over time.

    Parameters
    ----------
    down : FILE
        Link file of the downlink, or none; default: lamp and receiver at both ends.
    """
    scenario, (function, pieces_in) = of.opened(), study.functions
    if down is not None:
        asked["down"] = None if down == "none" else of.scenario(Path(down)).link
    values = defaults(function) | asked
    total = pieces_in(values["hours"], values["rate"])
    of.write(study.run(function, scenario, total, asked))


def ber(
    study: StudyRow,
    asked: Asked,
    *,
    link: console.LinkFile = None,
    realizations: int | None = None,
    wind: str | None = None,
    preset: str | None = None,
    uav: str | None = None,
    light: DaylightOptions,
    coupled: bool = False,
    printed: console.PrintOptions,
    changes: console.RunChanges,
) -> None:
    """Evaluate a link in each wind.

    Parameters
    ----------
    realizations
        Independent seas per depth: 200, or 50 with --depths.
    wind : LIST
        Wind speeds [m/s], such as 0,5,13.
    preset : NAME
        physical, paper or paper-ranges.
    uav : NAME
        Airframe that tilts the receiver.
    coupled
        Apply the tilt to every photon.
    """
    from meshtrace.mesh import SeededSurface
    from meshtrace.studies.performance import DepthSweep
    from meshtrace.uav import Flight

    given = {"detector.preset": preset, "uav.preset": uav, **light.changes()}
    speeds = [None] if wind is None else numbers("--wind", wind)
    scenarios = [changes.scenario(link, given | {"wind_speed": speed}) for speed in speeds]
    printed.check(link)
    if realizations is None:
        realizations = 50 if "depths" in asked else 200
    many = [coupled or isinstance(s.surface, SeededSurface) for s in scenarios]
    seas = sum(realizations if m else 1 for m in many) * len(asked.get("depths", [0]))
    asked["realizations"] = realizations
    flights = [Flight(s.uav, coupled=True) if coupled and s.uav else None for s in scenarios]
    if coupled and None in flights:
        raise Refused("--coupled", True, "with an aircraft that tilts the receiver")
    with console.progress(seas, printed.json_, study.doing, study.kernels) as (_, advance):
        found = [
            (s.wind_speed, study.functions[0](s, flight=flight, progress=advance, **asked))
            for s, flight in zip(scenarios, flights, strict=True)
        ]
    if printed.json_:
        typer.echo(json.dumps([_plain(*one) for one in found], allow_nan=False))
    else:
        texts = [f"wind {speed:g} m/s\n\n{p.summary()}" for speed, p in found]
        typer.echo("\n\n".join(texts))
    winds_of, performances = zip(*found, strict=True)
    result = performances[0] if len(found) == 1 else DepthSweep(winds_of, performances)
    printed.save(result, printed.json_)


def _plain(speed: float, performance: LinkPerformance) -> dict[str, Any]:
    """Return the performance in a wind as plain data for JSON."""
    ranges = zip(performance.bit_rates, performance.range_at_ber(), strict=True)
    return {
        "wind_speed": speed,
        "limit": performance.limit,
        "confidence": performance.confidence,
        "status": performance.status,
        "light": performance.light,
        "figures": console.finite(performance.figures),
        "ranges": [{"bit_rate": rate, "range": console.finite(value)} for rate, value in ranges],
        "provenance": performance.provenance,
    }


def sweep(
    study: StudyRow, asked: Asked, file: Path, *, written: console.FileOptions, trust: bool = False
) -> None:
    """Run a study file, print and write its gains.

    Parameters
    ----------
    file : STUDY.TOML
        Link file with a table [sweep].
    trust
        Run the modules that the link file names, as in module:Class.
    """
    _, read_study = study.functions
    written.check(file)
    found, store = read_study(file, asked.pop("store", None), trust)
    total = len(list(found.tasks()))
    try:
        with extra("batch", "sweep"):
            data = study.run(found.run, store, total, asked)
    except KeyboardInterrupt:
        typer.echo(f"finished points are in {store}; the same command resumes", err=True)
        raise
    typer.echo("\n".join(_rows(data)))
    if written.output is not None:
        from meshtrace.stored import write_dataset

        write_dataset(data, written.output)
    for path in (store, written.output):
        if path is not None:
            typer.echo(f"\nwritten to {path}")
    errors = [text for text in data["error"].values.ravel().tolist() if text]
    if errors:
        share = f"{len(errors)} of {data['error'].size} runs failed"
        typer.echo(f"warning: {share}, the first: {errors[0]}", err=True)
        raise typer.Exit(1)


def _rows(data: xr.Dataset) -> list[str]:
    """Return gains over the realizations as a table, one row for each point and receiver."""
    import xarray as xr

    from meshtrace.results.series import by_wavelength
    from meshtrace.tables import text_table

    data = by_wavelength(data)
    gain, stderr, n = data["gain"], data["gain_stderr"], data.sizes["realization"]
    dims = [str(name) for name in gain.dims if name != "realization"]
    columns = {
        "gain": gain.mean("realization"),
        # each realization draws its own chains: their errors are independent
        "stderr": (stderr**2).sum("realization", skipna=False) ** 0.5 / n,
        "scatter": gain.std("realization", ddof=min(1, n - 1)),
    }
    lit = {"background_radiance": "background", "ber": "BER"} if "ber" in data else {}
    columns |= {heading: data[name].mean("realization") for name, heading in lit.items()}
    forms = [*[".6g"] * len(dims), ".4e", ".1e", ".1e", ".3e", ".3e"]
    frame = xr.Dataset(columns).to_dataframe(dim_order=dims)[list(columns)].reset_index()
    if n == 1:
        frame["scatter"] = "-"
    rows = [
        [f"{x:{forms[i]}}" if isinstance(x, float) else str(x) for i, x in enumerate(row)]
        for row in frame.head(_MOST_ROWS).itertuples(index=False)
    ]
    lines = text_table(rows, [*dims, *columns]).splitlines()
    lines += [f"... {len(frame) - len(rows)} more"] * (len(frame) > len(rows))
    if lit:
        lines += ["", "background in W m-2 sr-1 nm-1", f"light of the BER: {data['ber'].light}"]
    return lines


_OWN = {work.__name__: work for work in (ber, compare, converge, sweep, traces)}


def study_commands() -> dict[str, StudyCommand]:
    """Return the commands of the table by their names."""
    text = Path(__file__).with_name("commands.toml").read_text(encoding="utf-8")
    rows = tomllib.loads(text).items()
    return {
        name: StudyCommand(name, StudyRow(**row), _OWN.get(name, on_link)) for name, row in rows
    }


INTERRUPTED = 130


class _Commands(TyperGroup):
    """Command group: failures are one line on stderr, with exit code 2, or 130 after Ctrl-C."""

    def __init__(self, **given: Any) -> None:
        super().__init__(**given)
        self.commands = dict(sorted([*self.commands.items(), *study_commands().items()]))

    def main(self, *args: Any, **extra: Any) -> Any:
        standalone = extra.get("standalone_mode", True)
        try:
            with console.warnings_as_lines():
                code = super().main(*args, **{**extra, "standalone_mode": False}) or 0
            if sys.stdout is not None:
                sys.stdout.flush()
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

    def format_commands(self, context: Any, formatter: Any) -> None:
        """Write the first sentence of each command, in several lines if it is long."""
        commands = {name: self.get_command(context, name) for name in self.list_commands(context)}
        rows = [(name, one.get_short_help_str(limit=1000)) for name, one in commands.items() if one]
        with formatter.section("Commands"):
            formatter.write_dl(rows)


app = typer.Typer(
    cls=_Commands,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _message(error: Exception) -> str | None:
    """Return the message for the user, None for an internal error."""
    if hasattr(error, "format_message"):  # typer's error for invalid arguments
        return _refusal(error) or str(error.format_message())
    if isinstance(error, Refused):
        return str(error)
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    if isinstance(error, OSError) and error.errno == errno.ENOSPC:
        # the interpreter flushes again at its end, and would print a traceback
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.__stdout__.fileno())  # type: ignore[union-attr]
        return f"standard output: {error.strerror}"
    return None


def _refusal(error: Any) -> str:
    """Return the refusal of an option's value, or "" for any other invalid argument."""
    import pydantic

    from meshtrace.checks import allowed_by

    cause = error.__cause__
    if not isinstance(cause, pydantic.ValidationError):
        return ""
    first = cause.errors(include_url=False)[0]
    return str(Refused(max(error.param.opts, key=len), first["input"], allowed_by(first)))


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"meshtrace {version('meshtrace')}")
        raise typer.Exit


_ABOUT = "Monte Carlo ray tracing of light that crosses a wavy sea."  # -OO drops docstrings


@app.callback(invoke_without_command=True, help=_ABOUT)
def _options(
    context: typer.Context,
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
