"""The commands that run studies: each calls one function of `meshtrace`."""

import inspect
import json
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import meshtrace as mt
from meshtrace.cli import console
from meshtrace.cli import options as opt
from meshtrace.cli.application import command
from meshtrace.cli.console import progress
from meshtrace.cli.options import count, flag, numbers, seas, value
from meshtrace.errors import MISSING, Refused, extra, require_between, require_word

if TYPE_CHECKING:
    import xarray as xr

# Most lines of the table that `sweep` prints. Tuned: a long table pushes the rest of the output out
# of view, and the store holds all points.
_MOST_ROWS = 200

# Link of `lidar` without a file, a common case of airborne bathymetry
_AIRBORNE = {
    "transmitter.kind": "air-top-hat-beam", "transmitter.height": 300, "receiver.height": 300,
    "transmitter.divergence_deg": 0.0286, "receiver.radius": 0.1, "receiver.fov_deg": 0.286,
    "water.bottom_depth": 10, "water.bottom_albedo": 0.15,
}  # fmt: skip


@command()
def ensemble(
    options: opt.StudyOptions,
    wavelengths_nm: opt.Wavelengths = None,
    realizations: Annotated[int, seas("Realizations, each with its own random phases.")] = 200,
    photons: opt.Chains = 2048,
    per_lamp: opt.PerLamp = False,
) -> None:
    """Compute the channel gain over random seas and print its distribution and fading."""
    # `mt.ensemble` accepts one sea, but there is no distribution of one gain to print
    if realizations < 2:
        raise Refused("realizations", realizations, ">= 2")
    study = partial(mt.ensemble, realizations=realizations, photons=photons,
                    wavelengths_nm=wavelengths_nm, per_lamp=per_lamp)  # fmt: skip
    options.run(study, progress(realizations))


@command()
def series(
    context: typer.Context,
    options: opt.StudyOptions,
    wavelengths_nm: opt.Wavelengths = None,
    times: Annotated[Any, numbers("Times [s]; evenly spaced with a flight")] = "0:10:0.05",
    duration: Annotated[float | None, value(
        "S", "Times from 0 to this one [s], every 0.05 s, in place of --times.")] = None,
    photons: opt.Chains = 2048,
    per_lamp: opt.PerLamp = False,
) -> None:  # fmt: skip
    """Compute the channel gain over a moving sea and print its fading statistics."""
    if duration is not None:
        require_between(duration, 0.05, 1e5, "--duration", "[]")
        if context.get_parameter_source("times").name != "DEFAULT":  # type: ignore[union-attr]
            raise Refused("--duration", duration, "not beside --times")
        times = opt.parse_numbers(f"0:{duration}:0.05")
    study = partial(mt.time_series, times=times, photons=photons, wavelengths_nm=wavelengths_nm,
                    per_lamp=per_lamp)  # fmt: skip
    options.run(study, progress(len(times)))


@command()
def coverage(
    options: opt.StudyOptions,
    wavelengths_nm: opt.Wavelengths = None,
    extent: Annotated[float, value("M", "Half-width of the map [m].")] = 5,
    step: Annotated[float, value("M", "Edge of a cell [m].")] = 0.25,
    times: Annotated[Any, numbers("Times [s] to average; default: that of the link file")] = None,
    photons: Annotated[int, count("Photons for each time; with --rtol a first guess.")] = 4_000_000,
    rtol: Annotated[float | None, value("R", "Relative standard error to reach in every cell by "
        "more samples; unscattered light has no noise where its image is known.")] = None,
) -> None:  # fmt: skip
    """Map the gain over the plane of the receiver."""
    study = partial(mt.coverage_map, photons=photons, rtol=rtol, extent=extent, step=step,
                    times=times, wavelengths_nm=wavelengths_nm)  # fmt: skip
    # the number of photons that a tolerance takes is not known beforehand: the bar has no total
    steps = photons if rtol is None else None
    options.run(study, progress(steps, "mapping the gain", kernels="analog"))


@command()
def compare(
    link: Annotated[list[Path], typer.Argument(
        metavar="A.TOML B.TOML ...", help="Two link files or more.")],
    options: opt.StudyOptions,
    realizations: Annotated[int, seas("Realizations of the sea, 1 to 10 000 000.")] = 1,
    photons: opt.Chains = 2048,
) -> None:  # fmt: skip
    """Compare the gains of links over common seas with common chains.

    The error of a difference is smaller than those of the gains: their common noise cancels.
    """
    scenarios = {path.stem: options.scenario(path) for path in link}
    # results are named by the stems of the files, which must differ
    if len(scenarios) < len(link):
        raise Refused("links", ", ".join(map(str, link)), "files of different names")
    options.check(*link)
    total = realizations * len(link)
    study = partial(mt.compare, realizations=realizations, photons=photons)
    options.run(study, progress(total), scenarios)


# Options of `converge` by the parameter of the studies; each of them selects another study.
_REFINED = {"spacings": "--spacings", "steps": "--time-steps", "omega_max": "--omega-max",
            "meshes": "--body-meshes"}  # fmt: skip


@command()
def converge(
    options: opt.StudyOptions,
    spacings: Annotated[Any, numbers(
        "At least four mesh spacings [m], by default 2,1,0.5,0.25,0.125,0.0625")] = None,
    steps: Annotated[Any, numbers(
        "At least four time steps [s], all multiples of the shortest", "--time-steps")] = None,
    omega_max: Annotated[Any, numbers(
        "At least four band limits [rad s-1], of fading by default 4,8,12,16,24,32,64,128")] = None,
    meshes: Annotated[Any, value("FILES", "At least four meshes of the first body, as a.obj,b.obj.",
        "--body-meshes", parser=lambda text: text.split(","))] = None,
    normals: Annotated[Any, value("KINDS", "Normals of the mesh: vertex or facet, by default "
        "vertex,facet for spacings, else vertex.", parser=lambda text: text.split(","))] = None,
    photons: opt.Chains = 2048,
    placements: Annotated[int | None, count(
        "Meshes of each spacing, moved by parts of a cell against the sea; by default 34.")] = None,
    realizations: Annotated[int | None, seas("Seas of each band; default 16, of fading 0.")] = None,
    duration: Annotated[float | None, value("S", "Length of the series [s], a multiple of every "
        "step; by default eight of the longest.")] = None,
    tolerance: Annotated[float | None, value("R", "Relative error of one surface with the "
        "recommended step; by default 0.001 of spacings, 0.03 of fading, else 0.01.")] = None,
    unresolved: Annotated[str | None, value("WORD",
        "Slopes of the waves that each mesh leaves out: tilt or none (default).")] = None,
    what: Annotated[str, value("WORD", "gain, or fading over the band of waves.")] = "gain",
) -> None:  # fmt: skip
    """Study the convergence of the gain with a mesh, the time step or the band of waves.

    All meshes share the same chains. The table shows gains, their differences, the fitted order,
    the limit at vanishing spacing (Richardson) beside the gain over the exact sum of waves, and the
    spacing recommended for a tolerance; scatter is the deviation of the gain as a mesh is shifted,
    BVH s the time to sort its facets for the rays. Time steps, band limits or meshes of a body take
    the place of spacings. With --what fading the table shows the scintillation index in closed
    form, and over --realizations seas (by default none).
    """
    require_word(what, ("gain", "fading"), "--what")
    # only what is set: each of the five studies has defaults of its own
    chosen = opt.without_none({
        "spacings": spacings, "steps": steps, "omega_max": omega_max, "meshes": meshes,
        "normals": normals, "placements": placements, "realizations": realizations,
        "duration": duration, "tolerance": tolerance, "unresolved": unresolved,
    })  # fmt: skip
    study = _study_of(chosen, what)
    surfaces = _surfaces(_defaults(study) | chosen)
    options.run(partial(study, photons=photons, **chosen), progress(surfaces, "over the meshes"))


def _defaults(study: Any) -> dict[str, Any]:
    """Return the default of each parameter of a study."""
    return {name: p.default for name, p in inspect.signature(study).parameters.items()}


def _study_of(options: dict[str, Any], what: str) -> Any:
    """Return the study that the options belong to; refuse options of other studies."""
    studies = {"spacings": mt.convergence_study, "steps": mt.time_step_study,
               "omega_max": mt.band_limit_study, "meshes": mt.body_study}  # fmt: skip
    refined = next((name for name in studies if name in options), "spacings")
    study = mt.studies.fading_study if what == "fading" else studies[refined]
    for name in options.keys() - _defaults(study).keys():
        takers = [_REFINED[key] for key in studies if name in _defaults(studies[key])]
        allowed = f"only with {' or '.join(takers)}"
        if what == "fading":
            allowed = "only with --what gain"
        elif name in _REFINED:
            allowed = f"not beside {_REFINED[refined]}"
        raise Refused(name, options[name], allowed)
    return study


def _surfaces(values: dict[str, Any]) -> float | None:
    """Return the number of surfaces of a convergence study, the total of its progress bar.

    `values` are the arguments of the study, defaults included. None if the number is not known.
    """
    if "steps" in values:
        # if each step is twice the one before, all series together have twice as many times as that
        # of the shortest step: 1 + 1/2 + 1/4 + ... = 2
        steps = values["steps"]
        duration = values["duration"] or 8.0 * max(steps)
        return 2.0 * duration / min(steps) + 1.0 if min(steps) > 0.0 else None
    if "meshes" in values:
        return len(values["meshes"])
    if "spacings" in values:
        return len(values["spacings"]) * int(values["placements"])
    return len(values["omega_max"]) * int(values["realizations"])


@command()
def design(
    options: opt.StudyOptions,
    outage: Annotated[float, value("P", "Share of the time that may fail.")] = 0.01,
    limit: opt.ErrorLimit = 1e-3,
    bounds: opt.Bounds = None,
    realizations: Annotated[int, seas("Seas of the figures; links run alone have 16.")] = 64,
    photons: opt.Chains = 512,
    combining: opt.Combining = "maximal",
) -> None:  # fmt: skip
    """Answer the questions of a system designer about a link on one page.

    Outage and error rate by night and by day, the best lens, field of view, filter, hover point,
    wavelength and bit rate with their flat ranges, the values at which the link just closes, and
    the budget line by line. Best values have bounds, which --bounds replaces.
    """
    study = partial(mt.design, outage=outage, limit=limit, bounds=dict(bounds or ()) or None,
                    realizations=realizations, photons=photons, combining=combining)  # fmt: skip
    options.run(study, progress(realizations))


@command()
def optimize(
    options: opt.StudyOptions,
    bounds: opt.Bounds = None,
    objective: Annotated[Any, value("WORD",
        "Quantity to improve: outage, gain, range, margin or capacity.")] = "outage",
    hover_std: Annotated[Any, value("X,Y", "Standard deviations of the end in the air along x and "
        "y [m].", "--hover", parser=opt.parse_pair)] = "0,0",
    realizations: Annotated[int, seas("Seas, each with 12 places; over a surface without random "
        "phases the number of places.")] = 64,
    quantile: Annotated[float, value("Q", 'Quantile of the gain for "outage".')] = 0.01,
    bit_rate: opt.BitRate = None,
    limit: opt.ErrorLimit = 1e-3,
    method: Annotated[Any, value("WORD", "Search: auto, bounded, cobyqa or global.")] = "auto",
    photons: opt.Chains = 2048,
) -> None:  # fmt: skip
    """Search the best values of parameters over common seas, and check them on fresh ones."""
    if not bounds:
        raise Refused("--bounds", MISSING, "KEY=LOW,HIGH, as in receiver.fov_deg=6,90; repeatable")
    study = partial(mt.optimize, bounds=dict(bounds), objective=objective,
                    hover_std=hover_std, realizations=realizations, quantile=quantile,
                    bit_rate=bit_rate, limit=limit, method=method, photons=photons)  # fmt: skip
    options.run(study, progress(None, "candidates"))


@command()
def sensitivity(
    options: opt.StudyOptions,
    wrt: Annotated[list[str] | None, value("KEY", 'Parameter by its key in a link file, such as '
        '"water.a" or "receiver.position.0"; by default all continuous ones; repeatable.')] = None,
    quantity: Annotated[Any, value("WORD",
        "Quantity: gain, ber, outage, range, margin or capacity.")] = "gain",
    realizations: Annotated[int, seas(
        "Seas; 1 is the sea as it is, more have their own phases.")] = 1,
    bit_rate: opt.BitRate = None,
    limit: opt.ErrorLimit = 1e-3,
    step: Annotated[float | None, value("S", "Step of the differences, relative or in the unit of "
        "an offset or an angle; by default 1 %.")] = None,
    photons: opt.Chains = 8192,
) -> None:  # fmt: skip
    """Print the sensitivity of a link to its parameters, with standard errors.

    An elasticity is the change in per cent for 1 % more of the parameter. All evaluations share
    their chains and seas.
    """
    study = partial(mt.sensitivities, wrt=wrt, quantity=quantity, realizations=realizations,
                    bit_rate=bit_rate, limit=limit, step=step, photons=photons)  # fmt: skip
    options.run(study, progress(len(wrt) if wrt else None, "parameters"))


@command()
def availability(
    options: opt.StudyOptions,
    inputs: Annotated[Path | None, value("FILE", "TOML file of uncertain inputs: laws or samples "
        "by the keys of a link file; default: wind and chlorophyll of the open sea.")] = None,
    threshold: Annotated[float | None, value("G",
        "Gain of a working link; default: what the transmission needs.")] = None,
    bit_rate: opt.BitRate = None,
    limit: opt.ErrorLimit = 1e-3,
    outage: Annotated[float, value("P", "Share of a state that fades may take.")] = 0.01,
    bounds: opt.Bounds = None,
    target: Annotated[float, value("P", "Share of the year at the range.")] = 0.9,
    runs: Annotated[int, count("Runs to which the surfaces are fitted.", "--runs")] = 32,
    realizations: Annotated[int, seas("Seas of the fading of each run.")] = 16,
    photons: opt.Chains = 2048,
) -> None:  # fmt: skip
    """Print the share of the year in which a link works, by month, and its range.

    Response surfaces of mean gain and fading over the inputs are fitted to runs at Sobol points.
    The range is the depth, or the key of --bounds, at which the share is that of --target. With a
    store, another threshold takes no new runs.
    """
    study = partial(mt.studies.availability, inputs=inputs, threshold=threshold, bit_rate=bit_rate,
                    limit=limit, outage=outage, bounds=dict(bounds or ()) or None, target=target,
                    runs=runs, realizations=realizations, photons=photons)  # fmt: skip
    options.run(study, progress(runs, "runs"))


@command()
def irradiance(
    options: opt.StudyOptions,
    depths: Annotated[Any, numbers("Depths of the collector below still water [m], > 0; more than "
        '4.5 standard deviations of the elevation, unless --below is "waves"')] = "1,2,5,10",
    times: Annotated[Any, numbers("Times [s]")] = "0:2:0.005",
    collector: Annotated[float, value("D", "Diameter of the collector [m].")] = 0.05,
    below: Annotated[Any, value("WORD", "Zero of the depths: still, or waves: their mean height "
        "over the collector, as of one that hangs from a float.")] = "still",
    patch: Annotated[Any, value("X,Y", "Half-length of a square about the collector and edge of "
        "its cells [m]: the result has the irradiance that the collector would have there.",
        parser=opt.parse_pair)] = None,
    photons: Annotated[int, count(
        "Photons of the scattered light of each depth, and of the sky.")] = 100_000,
) -> None:  # fmt: skip
    """Compute the irradiance under a moving sea by day, and print its fluctuation and flashes.

    Sea, water and daylight are those of the link file; without daylight the sun stands at a zenith
    angle of 30 degrees in a clear sky.
    """
    study = partial(mt.irradiance_series, depths=depths, times=times, collector=collector,
                    below=below, patch=patch, photons=photons)  # fmt: skip
    options.run(study, progress(len(times), "over the times"))


@command()
def lidar(
    options: opt.ResultFiles,
    link: Annotated[Path | None, typer.Argument(
        metavar="[LINK.TOML]", help="Link file; default: an airborne lidar, see above.")] = None,
    seas: Annotated[int, count("Seas of independent phases.", "--seas")] = 16,
    photons: Annotated[int, count("An eighth of the photons over each sea.", "--photons")] = 4096,
    bin_: Annotated[float, value("NS", "Width of the bins of the waveform [ns].", "--bin")] = 1.0,
    pulse: Annotated[float, value("NS", "Full width of the pulse at half maximum [ns].")] = 1.5,
) -> None:  # fmt: skip
    """Print the echoes of a lidar over waves, and the bias and scatter of the depth that it reads.

    Without a link file: lamp and telescope of 0.1 m radius 300 m above a bottom 10 m deep.
    """
    scenario = options.scenario(link, _AIRBORNE if link is None else None)
    options.check(link)
    with progress(seas, "over the seas") as (_, advance):
        result = mt.lidar(scenario, seas=seas, photons=photons, bin_width=1e-9 * bin_,
                          pulse_width=1e-9 * pulse, progress=advance)  # fmt: skip
    typer.echo(result.summary())
    options.write(result)


@command()
def traces(
    options: opt.StudyOptions,
    hours: Annotated[float, value("H", "Duration [h], > 0.")] = 0.01,
    rate: Annotated[float, value("HZ", "Frames per second [s-1], > 0.")] = 50,
    background_rate: Annotated[float, value("HZ",
        "Times per second [s-1] at which the background is computed, > 0, at most --rate.")] = 1,
    photons: opt.Chains = 1024,
    down: Annotated[str | None, value("FILE",
        "Link file of the downlink, or none; default: lamp and receiver at both ends.")] = None,
    per_lamp: opt.PerLamp = False,
) -> None:  # fmt: skip
    """Compute the channel of a link over time: gains of both directions, background, attitude.

    The background is that of [daylight], and the aircraft that of [uav]. A stopped run resumes from
    its store.
    """
    from meshtrace.apps.traces import pieces_in

    # values of the argument `down`: "mirrored" has lamp and receiver at both ends, None no downlink
    downlink: Any = "mirrored" if down is None else None
    if down is not None and down != "none":
        downlink = options.scenario(Path(down)).link
    study = partial(mt.channel_trace, down=downlink, hours=hours, rate=rate,
                    background_rate=background_rate, photons=photons,
                    per_lamp=per_lamp)  # fmt: skip
    pieces = None
    # numbers without pieces, such as nan, are left to the study, whose refusal names the option
    with suppress(ValueError, OverflowError):
        pieces = pieces_in(hours, rate)
    options.run(study, progress(pieces, "frames"))


@command()
def ber(
    options: opt.StudyOptions,
    bit_rate: Annotated[Any, numbers("Bit rates R_b [bit s-1]", "--bit-rates")] = "1e6,5e6,1e7",
    depths: Annotated[Any, numbers("Depths of the transmitter [m], rising, needed for the range; "
        "by default that of the link")] = None,
    limit: opt.ErrorLimit = 1e-3,
    confidence: Annotated[float, value("P", "Level of the intervals.")] = 0.95,
    realizations: Annotated[int | None, seas("Seas per depth: 200, or 50 with --depths.")] = None,
    photons: opt.Chains = 2048,
    wind: Annotated[Any, numbers("Wind speeds at 10 m [m/s]")] = None,
    preset: Annotated[str | None, value("NAME", "physical, paper or paper-ranges.")] = None,
    uav: Annotated[str | None, value("NAME", "Airframe that tilts the receiver.")] = None,
    coupled: Annotated[bool, flag("--coupled", "Apply the tilt to every photon.")] = False,
    daylight: Annotated[str | None, value("NAME",
        "clear, overcast, uniform, moon, night or none.")] = None,
    sun_zenith: Annotated[float | None, value("DEG", "Zenith angle of sun or moon.")] = None,
    sun_elevation: Annotated[float | None, value("DEG", "90 minus the zenith angle.")] = None,
    filter_nm: Annotated[float | None, value("NM", "Width of the optical filter.")] = None,
    combining: opt.Combining = "maximal",
    json_: opt.Json = False,
) -> None:  # fmt: skip
    """Print bit error rate, outage, margin, capacity and range of a link.

    P_rx is the mean power on the detector: the light in the aperture, less what the etendue of the
    lens and the filter withhold. Outage is the share of fades that miss --limit.
    """
    from meshtrace.mesh import SeededSurface

    settings = _daylight(daylight, sun_zenith, sun_elevation) | {
        "detector.preset": preset, "uav.preset": uav, "detector.optics.filter_width_nm": filter_nm,
    }  # fmt: skip
    link, winds = options.link, wind or [None]
    scenarios = [options.scenario(link, settings | {"wind_speed": speed}) for speed in winds]
    options.check(link)
    if realizations is None:
        # each depth is computed over all seas: fewer of them
        realizations = 50 if depths else 200
    by_wind = []
    for scenario in scenarios:
        flight = mt.Flight(scenario.uav, coupled=True) if coupled and scenario.uav else None
        if coupled and flight is None:
            raise Refused("--coupled", True, "with an aircraft that tilts the receiver")
        # a surface without random phases takes one evaluation: further seas would be the same
        repeated = coupled or isinstance(scenario.surface, SeededSurface)
        steps = (realizations if repeated else 1) * len(depths or [0])
        study = partial(mt.link_performance, flight=flight, bit_rate=bit_rate, depths=depths,
                        limit=limit, confidence=confidence, realizations=realizations,
                        photons=photons, combining=combining)  # fmt: skip
        performance = options.compute(study, scenario, progress(steps, quiet=json_))
        by_wind.append((scenario.wind_speed, performance))
    if json_:
        typer.echo(json.dumps([_plain(*item) for item in by_wind], allow_nan=False))
    else:
        typer.echo("\n\n".join(f"wind {speed:g} m/s\n\n{p.summary()}" for speed, p in by_wind))
    speeds, performances = zip(*by_wind, strict=True)
    several = len(performances) > 1
    options.write(mt.DepthSweep(speeds, performances) if several else performances[0], json_)


def _daylight(model: str | None, zenith: float | None, elevation: float | None) -> dict[str, Any]:
    """Return settings of [daylight] by dotted key; an angle without a model means a clear sky."""
    if elevation is not None:
        if zenith is not None:
            raise Refused("--sun-elevation", elevation, "without --sun-zenith")
        if not 1.0 <= elevation <= 90.0:
            allowed = "1 to 90 (below the horizon: --daylight night)"
            raise Refused("--sun-elevation", elevation, allowed)
        zenith = 90.0 - elevation
    if model is None and zenith is None:
        return {}
    return {"daylight.model": model or "clear", "daylight.sun_zenith_deg": zenith}


def _plain(speed: float, performance: "mt.LinkPerformance") -> dict[str, Any]:
    """Return the performance at a wind speed [m s-1] as plain data for JSON."""
    ranges = zip(performance.bit_rates, performance.range_at_ber(), strict=True)
    names = ("limit", "confidence", "status", "background_light")
    return {name: getattr(performance, name) for name in names} | {
        "wind_speed": speed,
        "figures": console.finite(performance.figures),
        "ranges": [{"bit_rate": rate, "range": console.finite(value)} for rate, value in ranges],
        "provenance": performance.provenance,
    }


@command()
def sweep(
    file: Annotated[Path, typer.Argument(
        metavar="STUDY.TOML", help="Link file with a table [sweep].")],
    store: Annotated[Path | None, value("PATH",
        "File that keeps finished points; of a study file by default beside it.")] = None,
    workers: Annotated[Any, value("N", "Processes: 1 is this one alone, default all cores where "
        "points take long; or the address or file of a dask scheduler.",
        parser=opt.parse_workers)] = None,
    timeout: Annotated[float, value("S", "Seconds to wait for scheduler and workers.")] = 60,
    output: opt.Output = None,
    trust: opt.Trust = False,
) -> None:  # fmt: skip
    """Compute the gain at every combination of some parameters.

    Finished points are kept in the store: after an interruption the same command resumes. The exit
    code is 1 if points failed; their errors are in the store.
    """
    from meshtrace.stored import write_dataset
    from meshtrace.studies.sweeps import read_study

    console.check_output(output, file)
    study, store = read_study(file, store, trust)
    total = len(list(study.tasks()))
    try:
        with extra("batch", "sweep"), progress(total, "over the points") as (_, advance):
            data = study.run(store, workers, timeout, advance)
    except KeyboardInterrupt:
        typer.echo(f"finished points are in {store}; the same command resumes", err=True)
        raise
    typer.echo("\n".join(_rows(data)))
    typer.echo(f"\nwritten to {store}")
    if output is not None:
        write_dataset(data, output)
        typer.echo(f"\nwritten to {output}")
    errors = [text for text in data["error"].values.ravel().tolist() if text]
    # the store has the finished points; the exit code tells scripts that others failed
    if errors:
        failures = f"{len(errors)} of {data['error'].size} runs failed"
        typer.echo(f"warning: {failures}, the first: {errors[0]}", err=True)
        raise typer.Exit(1)


def _rows(data: "xr.Dataset") -> list[str]:
    """Return means over the realizations as lines of a table, one for each point and receiver."""
    import xarray as xr

    from meshtrace.results.series import by_wavelength
    from meshtrace.tables import text_table

    data = by_wavelength(data)
    gain, stderr, n = data["gain"], data["gain_stderr"], data.sizes["realization"]
    dims = [str(name) for name in gain.dims if name != "realization"]
    columns = {
        "gain": gain.mean("realization"),
        # realizations differ in their chains, too: the error of the mean is (sum s_i^2)^(1/2) / n;
        # nan, a failed point, stays nan
        "stderr": (stderr**2).sum("realization", skipna=False) ** 0.5 / n,
        # standard deviation; ddof is 0 for a single realization, whose scatter is not shown
        "scatter": gain.std("realization", ddof=min(1, n - 1)),
    }
    if "ber" in data:
        columns["background"] = data["background_radiance"].mean("realization")
        columns["BER"] = data["ber"].mean("realization")
    # of the coordinates, then of `columns` in their order
    formats = [*[".6g"] * len(dims), ".4e", ".1e", ".1e", ".3e", ".3e"]
    frame = xr.Dataset(columns).to_dataframe(dim_order=dims)[list(columns)].reset_index()
    if n == 1:
        frame["scatter"] = "-"
    cells = [
        [f"{x:{formats[i]}}" if isinstance(x, float) else str(x) for i, x in enumerate(row)]
        for row in frame.head(_MOST_ROWS).itertuples(index=False)
    ]
    lines = text_table(cells, [*dims, *columns]).splitlines()
    lines += [f"... {len(frame) - len(cells)} more"] * (len(frame) > len(cells))
    if "ber" in data:
        lines += ["", "background in W m-2 sr-1 nm-1", f"light of the BER: {data['ber'].light}"]
    return lines
