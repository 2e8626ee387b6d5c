"""`meshtrace view`: a link, a result or a mesh in a window, as a picture, a page or a movie."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from meshtrace.cli.app import app
from meshtrace.cli.console import extra, progress
from meshtrace.cli.made import Span, described
from meshtrace.cli.options import WindChanges
from meshtrace.errors import MISSING, Described, Refused, require_finite

if TYPE_CHECKING:
    from meshtrace.daylight.light import Daylight
    from meshtrace.link import Link
    from meshtrace.mesh import MeshSource, TriangleMesh
    from meshtrace.results.coverage import CoverageMap
    from meshtrace.results.series import GainSeries
    from meshtrace.scenario import Scenario

MESH_SUFFIXES = (".stl", ".ply", ".obj")

MOST_PATHS, MOST_FRAMES = 100_000, 10_000


class Subject(NamedTuple):
    """Subject of a view: a link over a surface at a time, and the data of a result."""

    surface: MeshSource | TriangleMesh
    link: Link | None = None
    time: float = 0.0
    coverage: CoverageMap | int | None = None
    gain: GainSeries | None = None
    daylight: Daylight | None = None


@dataclass(frozen=True, kw_only=True)
class Files:
    """Files to write; without one a window opens.

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
    """

    screenshot: Path | None = None
    html: Path | None = None
    movie: Path | None = None
    light: Path | None = None
    export: Path | None = None


@dataclass(frozen=True, kw_only=True)
class PathOptions:
    """Light in the scene.

    Parameters
    ----------
    paths : N
        Photon paths, in addition to received light [default: 100; movie: 0].
    received : N
        Paths of received light.
    map_ : N
        Photons of a coverage map at receiver height.
    """

    paths: Annotated[int | None, Span(0, MOST_PATHS)] = None
    received: Annotated[int | None, Span(1, MOST_PATHS)] = None
    map_: Annotated[int | None, Span(1)] = None


@dataclass(frozen=True, kw_only=True)
class Style:
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


@dataclass(frozen=True, kw_only=True)
class Film:
    """Frames of a movie.

    Parameters
    ----------
    frames : N
        Frames of the movie.
    frame_rate : N
        Frames per second, at natural speed [default: 30].
    """

    frames: Annotated[int, Span(2, MOST_FRAMES)] = 300
    frame_rate: float | None = None


@app.command()
@described
def view(
    file: Path | None = None,
    *,
    files: Files,
    light: PathOptions,
    style: Style,
    time: float | None = None,
    film: Film,
    seed: Annotated[int, Span(0)] = 1,
    changes: WindChanges,
) -> None:
    """Show a link, a result or a mesh: in a window, or as a picture, page, movie or VTK files.

    Parameters
    ----------
    file : [FILE]
        Link (.toml), result (.nc) or mesh (.stl, .ply, .obj); default: the paper's link.
    time : S
        Time of the sea [s].
    seed : N
        Seed of the paths.
    """
    positive = {
        "--extent": style.extent,
        "--spacing": style.spacing,
        "--frame-rate": film.frame_rate,
    }
    for option, value in positive.items():
        if value is not None and not 0.0 < value < math.inf:
            raise Refused(option, Described(f"{value:g}"), "numbers > 0")
    if time is not None and not math.isfinite(time):
        raise Refused("--time", Described(f"{time:g}"), "finite numbers [s]")
    with extra("viz", "viz"):
        from meshtrace.viz import SceneStyle
        from meshtrace.viz import view as show
    subject = _subject(file, changes)
    subject = subject._replace(
        time=subject.time if time is None else time, coverage=light.map_ or subject.coverage
    )
    steps = film.frames if subject.gain is None else len(subject.gain.coordinate)
    kernels = () if subject.link is None else ("forced",)
    with progress(steps, False, "drawing frames", *kernels) as (_, advance), extra("viz", "viz"):
        written = show(
            **subject._asdict(),
            paths=light.paths,
            received=light.received,
            **vars(files),
            **vars(film),
            title="meshtrace" if file is None else file.name,
            progress=advance,
            seed=seed,
            style=SceneStyle(**vars(style)),
        )
    for path in written:
        typer.echo(f"written to {path}")


def _subject(file: Path | None, changes: WindChanges) -> Subject:
    """Return the contents of a file."""
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
        return Subject(MeshFile(file=str(file)).load())
    kinds = ", ".join((".toml", ".nc", *MESH_SUFFIXES))
    raise Refused(str(file), file.suffix, f"a file name in {kinds}")


def _of_scenario(scenario: Scenario) -> Subject:
    from meshtrace.scenario import MeshFile

    still = isinstance(scenario.surface, MeshFile)
    surface = scenario.mesh() if still else scenario.case().surface
    return Subject(surface, scenario.link, scenario.meshing.time, daylight=scenario.daylight)


def _of_result(file: Path) -> Subject:
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
            return subject._replace(coverage=result, time=float(times.flat[0]))
    except Refused as error:
        raise error.of(str(file)) from None
    if isinstance(result, GainSeries) and result.along == "time":
        return subject._replace(gain=result, time=float(result.time[0]))
    return subject
