"""`meshtrace view`: a link, a result or a mesh in a window, as a picture, a page or a movie."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from meshtrace.cli.app import app
from meshtrace.cli.console import extra, progress
from meshtrace.cli.made import Span, described
from meshtrace.cli.options import WindChanges
from meshtrace.errors import MISSING, Described, Refused, require_between, require_finite

if TYPE_CHECKING:
    from meshtrace.scenario import Scenario

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
    changes: WindChanges,
) -> None:
    """Show a link, a result or a mesh: in a window, or as a picture, page, movie or VTK files.

    Parameters
    ----------
    file : [FILE]
        Link (.toml), result (.nc) or mesh (.stl, .ply, .obj); default: the paper's link.
    """
    if options.frame_rate is not None:  # a view without a movie does not check it
        require_between(options.frame_rate, 0.0, math.inf, "--frame-rate", allowed="numbers > 0")
    with extra("viz", "viz"):
        from meshtrace.viz import SceneStyle
        from meshtrace.viz import view as show
    given: Inputs = {name: value for name, value in vars(options).items() if value is not None}
    if photons := given.pop("map_", None):
        given["coverage"] = photons
    subject = {**_subject(file, changes), **given}
    gain = subject.get("gain")
    steps = options.frames if gain is None else len(gain.coordinate)
    kernels = () if subject["link"] is None else ("forced",)
    with progress(steps, False, "drawing frames", *kernels) as (_, advance), extra("viz", "viz"):
        written = show(
            **subject,
            title="meshtrace" if file is None else file.name,
            progress=advance,
            style=SceneStyle(**vars(style)),
        )
    for path in written:
        typer.echo(f"written to {path}")


def _subject(file: Path | None, changes: WindChanges) -> Inputs:
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
    return {"link": scenario.link, "surface": surface, **at}


def _of_result(file: Path) -> Inputs:
    """Return the inputs of a result file, with its map or its gain over time."""
    from meshtrace.results import load
    from meshtrace.results.coverage import CoverageMap
    from meshtrace.results.series import GainSeries
    from meshtrace.scenario import Scenario

    result = load(file)
    origin: Any = result.provenance
    if isinstance(origin, list) and origin:  # of several winds: the first
        origin = origin[0]
    if not isinstance(origin, dict) or "link" not in origin:
        raise Refused(str(file), result.kind, "a result of a link over a sea")
    try:
        subject = _of_scenario(Scenario.from_provenance(origin))
        if isinstance(result, CoverageMap):
            times = require_finite(origin.get("times", MISSING), "times", "times [s]")
            return {**subject, "coverage": result, "time": float(times.flat[0])}
    except Refused as error:
        raise error.of(str(file)) from None
    if isinstance(result, GainSeries) and result.along == "time":
        return {**subject, "gain": result, "time": float(result.time[0])}
    return subject
