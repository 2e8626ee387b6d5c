"""`meshtrace view`: a link, a result or a mesh in a window, as a picture, a page or a movie."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from meshtrace.cli.app import app
from meshtrace.cli.console import (
    COMPILING,
    kernels_are_compiled,
    progress,
    scenario_of,
    warnings_as_lines,
)
from meshtrace.cli.options import Settings
from meshtrace.errors import Described, Refused

if TYPE_CHECKING:
    from meshtrace.link import Link
    from meshtrace.mesh import SurfaceModel, TriangleMesh
    from meshtrace.results.coverage import CoverageMap
    from meshtrace.results.series import GainSeries
    from meshtrace.scenario import Scenario

MESH_SUFFIXES = (".stl", ".ply", ".obj")

MOST_FRAMES = 10_000


class Subject(NamedTuple):
    """Subject of a view: a link over a surface at a time, with the data of a result."""

    surface: SurfaceModel | TriangleMesh
    link: Link | None = None
    time: float = 0.0
    coverage: CoverageMap | int | None = None
    gain: GainSeries | None = None


@app.command()
def view(
    file: Annotated[
        Path | None,
        typer.Argument(
            metavar="[FILE]",
            help="Link file (.toml), result (.nc) or mesh (.stl, .ply, .obj); the default link "
            "if none.",
        ),
    ] = None,
    screenshot: Annotated[
        Path | None, typer.Option(metavar="A.PNG", help="Write a picture; no window.")
    ] = None,
    html: Annotated[
        Path | None, typer.Option(metavar="A.HTML", help="Write an interactive web page.")
    ] = None,
    movie: Annotated[
        Path | None,
        typer.Option(metavar="A.MP4", help="Write a movie (.mp4, .gif) of the sea and the gain."),
    ] = None,
    export: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Write surface, paths and map as VTK files."),
    ] = None,
    paths: Annotated[
        int, typer.Option(metavar="N", min=0, max=100_000, help="Photon paths, besides received.")
    ] = 100,
    received: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, max=100_000, help="Paths of received light."),
    ] = None,
    map_photons: Annotated[
        int | None,
        typer.Option(
            "--map", metavar="N", min=1, help="Photons of a coverage map in the receiver's plane."
        ),
    ] = None,
    color: Annotated[
        str, typer.Option(metavar="NAME", help="elevation, slope, slope_x, slope_y or plain.")
    ] = "elevation",
    path_color: Annotated[str, typer.Option(metavar="NAME", help="fate or weight.")] = "fate",
    edges: Annotated[bool, typer.Option("--edges", help="Draw the edges of the facets.")] = False,
    extent: Annotated[
        float | None, typer.Option(metavar="M", help="Half-width of the sea shown [m].")
    ] = None,
    spacing: Annotated[
        float | None, typer.Option(metavar="M", help="Mesh spacing of the sea shown [m].")
    ] = None,
    time: Annotated[float | None, typer.Option(metavar="S", help="Time of the sea [s].")] = None,
    frames: Annotated[
        int, typer.Option(metavar="N", min=2, max=MOST_FRAMES, help="Frames of the movie.")
    ] = 50,
    frame_rate: Annotated[
        float | None, typer.Option(metavar="N", help="Frames per second; as in nature if none.")
    ] = None,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Seed of the paths.")] = 1,
    settings: Settings = None,
) -> None:
    """Show a link, a result or a mesh: in a window, or as a picture, page, movie or VTK files."""
    positive = {"--extent": extent, "--spacing": spacing, "--frame-rate": frame_rate}
    _refuse_numbers(positive, time)
    with _refusals():
        from meshtrace.viz import SceneStyle
        from meshtrace.viz import view as show
    subject = _subject(file, settings or [])
    if time is not None:
        subject = subject._replace(time=time)
    if map_photons is not None:
        subject = subject._replace(coverage=map_photons)
    steps = frames if subject.gain is None else len(subject.gain.coordinate)
    with warnings_as_lines(), progress(steps, False, "drawing frames") as (say, advance):
        if subject.link is not None and not kernels_are_compiled("forced"):
            say(COMPILING)
        with _refusals():
            written = show(
                **subject._asdict(),
                paths=paths or None,
                received=received,
                screenshot=screenshot,
                html=html,
                movie=movie,
                export=export,
                frames=frames,
                frame_rate=frame_rate,
                title="meshtrace" if file is None else file.name,
                progress=advance,
                seed=seed,
                style=SceneStyle(
                    color=color, path_color=path_color, edges=edges, extent=extent, spacing=spacing
                ),
            )
    for path in written:
        typer.echo(f"written to {path}")


def _refuse_numbers(positive: dict[str, float | None], time: float | None) -> None:
    """Refuse numbers that typer accepts and no picture can use."""
    for option, value in positive.items():
        if value is not None and not 0.0 < value < math.inf:
            raise Refused(option, Described(f"{value:g}"), "numbers > 0")
    if time is not None and not math.isfinite(time):
        raise Refused("--time", Described(f"{time:g}"), "finite numbers [s]")


@contextmanager
def _refusals() -> Iterator[None]:
    """Turn refusals and missing packages of viz into one line for the user."""
    try:
        yield
    except ImportError as error:
        allowed = 'pip install "meshtrace[viz]"'
        raise Refused("viz", Described("extra packages are missing"), allowed) from error


def _subject(file: Path | None, settings: list[str]) -> Subject:
    """Return the contents of a file."""
    from meshtrace.scenario import MeshFile

    suffix = ".toml" if file is None else file.suffix.lower()
    if suffix == ".toml":
        return _of_scenario(scenario_of(file, settings, {}))
    assert file is not None
    if settings:
        raise Refused("--set", settings[0], "with a link file")
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
    return Subject(surface, scenario.link, scenario.meshing.time)


def _of_result(file: Path) -> Subject:
    """Return the inputs of a result file, with its map or its gain over time."""
    from meshtrace.results import load
    from meshtrace.results.coverage import CoverageMap
    from meshtrace.results.series import GainSeries
    from meshtrace.scenario import Scenario

    result = load(file)
    origin: Any = result.provenance
    if isinstance(origin, list):  # of several winds: the first
        origin = origin[0]
    if "link" not in origin:
        raise Refused(str(file), result.kind, "a result of a link over a sea")
    subject = _of_scenario(Scenario.from_provenance(origin))
    if isinstance(result, CoverageMap):
        return subject._replace(coverage=result, time=float(origin["times"][0]))
    if isinstance(result, GainSeries) and result.along == "time":
        return subject._replace(gain=result, time=float(result.time[0]))
    return subject
