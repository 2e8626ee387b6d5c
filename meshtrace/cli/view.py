"""The command that shows links, results and meshes."""

import math
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import typer

import meshtrace as mt
from meshtrace.cli import console
from meshtrace.cli import options as opt
from meshtrace.cli.application import command
from meshtrace.cli.options import flag, value
from meshtrace.errors import MISSING, Described, Refused, extra, require_between, require_finite

_MESH_SUFFIXES = (".stl", ".ply", ".obj")
_MOST_PATHS, _MOST_FRAMES = 100_000, 10_000

Inputs = dict[str, Any]  # arguments of a view


def _pixels(text: str) -> tuple[int, int]:
    """Parse a size "1600x1000"."""
    sides = text.lower().split("x")
    if len(sides) != 2 or not all(side.isdecimal() and 16 <= int(side) <= 10_000 for side in sides):
        raise Refused("", text, "WIDTHxHEIGHT as in 1600x1000, 16 to 10000 pixels each")
    return int(sides[0]), int(sides[1])


@command()
def view(
    changes: opt.Changes,
    file: Annotated[Path | None, typer.Argument(metavar="[FILE]", help="Link (.toml), result (.nc) "
        "or mesh (.stl, .ply, .obj); default: the paper's link.")] = None,
    screenshot: Annotated[Path | None, value("A.PNG", "Write a picture; no window.")] = None,
    html: Annotated[Path | None, value("A.HTML", "Write an interactive web page.")] = None,
    movie: Annotated[Path | None, value("A.MP4",
        "Write a movie (.mp4, .gif) of the sea and the gain.")] = None,
    pattern: Annotated[Path | None, value("A.MP4", "Write a picture (.png) or movie of the light "
        "pattern on the receiver's plane.")] = None,
    export: Annotated[Path | None, value("PATH", "Write surface, bodies, receivers and paths: "
        "a folder of VTK files, or a .glb, .gltf or .obj.")] = None,
    paths: Annotated[int | None, value("N", "Photon paths beside received light [default: 500; "
        "movie: 0].", low=0, high=_MOST_PATHS)] = None,
    received: Annotated[int | None, value("N",
        "Paths of received light.", low=1, high=_MOST_PATHS)] = None,
    map_: Annotated[int | None, value("N",
        "Photons of a coverage map at receiver height.", "--map", low=1)] = None,
    time: Annotated[float | None, value("S", "Time of the sea [s].")] = None,
    frames: Annotated[int, value("N", "Frames of the movie.", low=2, high=_MOST_FRAMES)] = 300,
    frame_rate: Annotated[float | None, value("N",
        "Frames per second, at natural speed [default: 30].")] = None,
    seed: Annotated[int, value("N", "Seed of the paths.", low=0)] = 1,
    color: Annotated[Any, value("NAME",
        "water, elevation, slope, slope_x, slope_y or plain.")] = "water",
    daylight: Annotated[Any, value("NAME",
        "Sky of the picture: clear, overcast, moon, night or none [default: of the link].")] = None,
    edges: Annotated[bool, flag("--edges", "Draw the edges of the facets.")] = False,
    extent: Annotated[float | None, value("M", "Half-width of the sea shown [m].")] = None,
    spacing: Annotated[float | None, value("M", "Mesh spacing of the sea shown [m].")] = None,
    size: Annotated[Any, value("WxH", "Pixels of the picture or window.",
        parser=_pixels)] = "1600x1000",
    transparent: Annotated[bool, flag("--transparent", "Picture without a background.")] = False,
) -> None:  # fmt: skip
    """Show a link, a result or a mesh: in a window, or as a picture, page, movie or 3D files."""
    # a view without a movie would not check it
    if frame_rate is not None:
        require_between(frame_rate, 0.0, math.inf, "--frame-rate", allowed="numbers > 0")
    with extra("viz", "viz"):
        from meshtrace.viz import SceneStyle
        from meshtrace.viz import view as show
        from meshtrace.viz.show import require_outputs
    style = SceneStyle(color=color, edges=edges, extent=extent, spacing=spacing,
                       window_size=size, transparent=transparent)  # fmt: skip
    inputs = _subject(file, changes) | opt.without_none({"coverage": map_, "time": time})
    # before the gain is computed
    outputs = {"screenshot": screenshot, "html": html, "movie": movie, "pattern": pattern,
               "export": export}  # fmt: skip
    require_outputs(outputs)
    if daylight is not None:
        sky = mt.Scenario.from_toml("", changes={"daylight.model": daylight}).daylight
        inputs["daylight"] = sky
    scenario, gain = inputs.pop("scenario", None), inputs.get("gain")
    steps = len(gain.coordinate) if isinstance(gain, mt.GainSeries) else frames
    still = any((screenshot, html, export)) or not (movie or pattern)
    kernels = "" if inputs["link"] is None else "forced"
    with (
        console.progress(steps, "drawing frames", kernels=kernels) as (_, advance),
        extra("viz", "viz"),
    ):
        if still and gain is None and scenario is not None:
            # a link that cannot be simulated can be shown, without its gain
            with suppress(Refused):
                inputs["gain"] = scenario.simulate()
        written = show(
            **inputs, screenshot=screenshot, html=html, movie=movie, pattern=pattern, paths=paths,
            export=export, received=received, frames=frames, frame_rate=frame_rate, seed=seed,
            title="meshtrace" if file is None else file.name, progress=advance, style=style,
        )  # fmt: skip
    for path in written:
        typer.echo(f"written to {path}")


def _subject(file: Path | None, changes: opt.Changes) -> Inputs:
    """Return the link, the surface and the data of a file as arguments of a view."""
    from meshtrace.scenario import MeshFile

    suffix = ".toml" if file is None else file.suffix.lower()
    if suffix == ".toml":
        return _of_scenario(changes.scenario(file))
    assert file is not None
    first = changes.set_ and changes.set_[0]
    changed = {"--set": first, "--wind": changes.wind, "--trust": changes.trust,
               "--threads": changes.threads}  # fmt: skip
    for name, setting in changed.items():
        if setting:
            raise Refused(name, setting, "with a link file")
    if not file.is_file():
        raise Refused(str(file), Described("no such file"), "a link file, result or mesh")
    if suffix == ".nc":
        return _of_result(file)
    if suffix in _MESH_SUFFIXES:
        return {"link": None, "surface": MeshFile(file=str(file)).load()}
    kinds = ", ".join((".toml", ".nc", *_MESH_SUFFIXES))
    raise Refused(str(file), file.suffix, f"a file name in {kinds}")


def _of_scenario(scenario: "mt.Scenario") -> Inputs:
    from meshtrace.scenario import MeshFile

    still = isinstance(scenario.surface, MeshFile)
    surface = scenario.mesh() if still else scenario.case().surface
    return {"link": scenario.link, "surface": surface, "scenario": scenario,
            "time": scenario.meshing.time, "daylight": scenario.daylight}  # fmt: skip


def _of_result(file: Path) -> Inputs:
    """Return the inputs of a result file, with its map or its gain over time."""
    result = mt.results.load(file)
    origin: Any = result.provenance
    # results of several winds are shown in the first
    if isinstance(origin, list) and origin:
        origin = origin[0]
    if not isinstance(origin, dict) or "link" not in origin:
        raise Refused(str(file), result.kind, "a result of a link over a sea")
    try:
        # the gain of `run` is that of link files: few chains are enough for each sea of a study
        subject = _of_scenario(mt.Scenario.from_provenance(origin)) | {"scenario": None}
        if isinstance(result, mt.CoverageMap):
            times = require_finite(origin.get("times", MISSING), "times", "times [s]")
            return subject | {"coverage": result, "time": float(times.flat[0])}
    except Refused as error:
        raise error.in_file(str(file)) from None
    if isinstance(result, mt.GainResult):
        return subject | {"gain": result}
    if isinstance(result, mt.GainSeries) and result.along == "time":
        return subject | {"gain": result, "time": float(result.time[0])}
    return subject
