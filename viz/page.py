"""Interactive web pages of scenes, as self-contained files."""

from __future__ import annotations

import base64
import html
import json
import zlib
from collections.abc import Sequence
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex, to_rgb
from trame_client.module import vue3

from meshtrace.daylight import Daylight
from meshtrace.engine.paths import PhotonPaths
from meshtrace.files import atomic
from meshtrace.link import Link
from meshtrace.link.sources import AirLamp, WaterSource
from meshtrace.mesh import MeshSource, TriangleMesh
from meshtrace.results.gain import GainResult
from meshtrace.results.series import CoverageMap

from . import live, parts
from .export import require_suffix, to_pyvista
from .scenes import SceneStyle, caption, light_of, shown_mesh
from .stage import stage_of
from .style import FATE_COLORS, PALETTE, RECEIVER_COLOR, water_map

_CELLS = 75  # of a sea along half of its side: finer waves are drawn as those of the explorer
_MOST_FACETS = 90_000  # of the surface: a file of 2 MB
_HINT = "Drag or arrow keys turn the scene, wheel or plus and minus zoom, Home resets."
_VUE = Path(vue3.www) / "vue.global.js"


def save_html(
    link: Link | None,
    surface: MeshSource | TriangleMesh,
    path: str | Path,
    *,
    time: float = 0.0,
    gain: GainResult | None = None,
    title: str = "meshtrace",
    paths: PhotonPaths | int | None = None,
    received: PhotonPaths | int | None = None,
    coverage: CoverageMap | int | None = None,
    seed: int = 1,
    daylight: Daylight | None = None,
    style: SceneStyle = SceneStyle(),  # noqa: B008
) -> Path:
    """Write a link over a sea as an interactive web page in one self-contained file.

    Parameters
    ----------
    link, surface, time, gain, paths, received, coverage, seed, daylight, style
        As in `scene`.
    path : path
        File, .html.
    title : str
        Heading.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    Refused
        If the suffix is not .html or .htm, or as in `scene`.

    Notes
    -----
    The page draws as the explorer does, by WebGL. It names what it leaves out of `scene`, such as
    the edges of facets.
    """
    path = require_suffix(path, (".html", ".htm"))
    stage = stage_of(link, surface, style.extent)
    mesh = shown_mesh(surface, stage, time, style.spacing or stage.half / _CELLS)
    paths, _, received, coverage = light_of(
        link, surface, stage, time, paths=paths, received=received, coverage=coverage, seed=seed
    )
    drawn, notes = _thinned(mesh), _left_out(link, style)
    if drawn is not mesh:
        notes.append(f"surface thinned from {len(mesh.faces):,} to {len(drawn.faces):,} facets")
    sea = live.sea_part(drawn, parts.outline(drawn)[:-1])
    if drawn.overhangs:
        # corners (x, y, z, 0): without the bright line that is drawn where the last is near 1
        sides = np.pad(parts.walls(drawn, stage.bottom), ((0, 0), (0, 0), (0, 1)))
        sea["sides"] = sides.astype(np.float32).tobytes()
    bars = []
    if style.color != "water":
        tints, bar = _tints(drawn, style)
        sea["tints"] = tints.astype(np.float32).tobytes()
        bars += bar
    rays = [live.segments(p) for p in (paths, received) if p is not None]
    data = {
        "stage": live.stage_part(stage, link),
        "faces": drawn.faces.astype(np.uint32).tobytes(),
        "sea": sea,
        "look": live.look_part(link, surface, drawn, daylight),
        "link": live.link_part(link, stage),
        "bodies": [] if link is None else live.bodies_part(link, stage),
        "rays": np.concatenate(rays).tobytes() if rays else b"",
        "map": None if coverage is None else live.map_part(coverage),
        "time": time,
    }
    key = _key(link, rays)
    if link is not None and link.bubbles is not None and style.bubbles:
        points = parts.bubble_points(stage, mesh, link.bubbles)
        data["dots"] = points.astype(np.float32).tobytes()
        key[parts.bubble_words(link.bubbles)] = parts.BUBBLE_COLOR
    if coverage is not None:
        bars.append(_bar("channel gain", "viridis", (0.0, float(coverage.gain.max()))))
    words = {"title": title, "caption": caption(link, surface, time, gain), "hint": _HINT,
             "notes": "; ".join(notes)}  # fmt: skip
    page = _filled(words, key, bars, _packed(data))
    with atomic(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return path


def _filled(words: dict[str, str], key: dict[str, str], bars: list[str], data: str) -> str:
    """Fill the template of the page with words, key (colours by label), colour bars and data."""
    template = Template((live.ASSETS / "page.html").read_text(encoding="utf-8"))
    scripts = [_VUE, *(live.ASSETS / name for name in ("shaders.js", "scene.js", "page.js"))]
    escaped = {name: html.escape(text) for name, text in words.items()}
    return template.substitute(
        escaped, bars="".join(bars), data=data,
        style="".join(_text(live.ASSETS / f"{name}.css") for name in ("scene", "page")),
        scripts="".join(f"<script>{_text(script)}</script>\n" for script in scripts),
        key="".join(
            f'<li><i style="background:{color}"></i>{html.escape(label)}</li>'
            for label, color in key.items()
        ),
    )  # fmt: skip


def _text(path: Path) -> str:
    # a script must not end the element that it stands in
    return path.read_text(encoding="utf-8").replace("</script", "<\\/script")


def _packed(data: dict[str, Any]) -> str:
    """Encode the parts of a scene as compressed text, with bytes as {"base64": text}."""

    def plain(value: Any) -> Any:
        if isinstance(value, bytes):
            return {"base64": base64.b64encode(value).decode()}
        raise TypeError(type(value))

    text = json.dumps(data, default=plain, separators=(",", ":"))
    return base64.b64encode(zlib.compress(text.encode(), 9)).decode()


def _thinned(mesh: TriangleMesh) -> TriangleMesh:
    """Thin a mesh to few enough facets for a page, by quadric edge collapse."""
    n = len(mesh.faces)
    if n <= _MOST_FACETS:
        return mesh
    data = to_pyvista(mesh).decimate(1.0 - _MOST_FACETS / n)
    points, faces = np.asarray(data.points, float), data.regular_faces
    a, b, c = points[faces].swapaxes(0, 1)
    area = np.cross(b - a, c - a)
    faces = faces[mesh.overhangs | (area[:, 2] > 0.0)]
    return TriangleMesh(points, faces, unresolved=mesh.unresolved, overhangs=mesh.overhangs)


def _left_out(link: Link | None, style: SceneStyle) -> list[str]:
    """List the parts of the scene that the page leaves out."""
    words = []
    if style.edges:
        words.append("edges of the facets")
    if style.path_color == "weight":
        words.append("weights of the photons")
    if link is not None:
        lamps = [s for s in link.transmitters if isinstance(s, WaterSource | AirLamp)]
        if len(lamps) < len(link.transmitters):
            words.append("the square of the sea under the sun or sky")
        if len(lamps) > live.LAMPS:
            words.append(f"beams of the lamps after the first {live.LAMPS}")
    return [f"not in this page: {', '.join(words)}"] if words else []


def _tints(mesh: TriangleMesh, style: SceneStyle) -> tuple[Any, list[str]]:
    """Return the colours (n, 3) of the vertices of a surface, and their colour bar."""
    if style.color == "plain":
        return np.broadcast_to(to_rgb(PALETTE["blue"]), mesh.vertices.shape), []
    values = np.asarray(to_pyvista(mesh).point_data[style.color])
    limits = parts.limits_of(values, style.color, style.color_limit)
    colors = water_map()((values - limits[0]) / max(limits[1] - limits[0], 1e-12))[:, :3]
    return colors, [_bar(parts.SURFACE_COLORS[style.color], water_map(), limits)]


def _key(link: Link | None, rays: Sequence[Any]) -> dict[str, str]:
    """Return the key of the scene: colours of its parts and kinds of rays by label."""
    if link is None:
        return {}
    source = link.transmitters[0]
    key = {"lamp and beam": live.light_shade(source, 0.12), "receiver and view": RECEIVER_COLOR}
    others = dict(list(FATE_COLORS.items())[1:])
    kinds = {
        "unscattered light received": live.light_shade(source),
        "scattered light received": live.SCATTERED_COLOR,
    } | {f"photons {name}": color for name, color in others.items()}
    there = np.unique(np.concatenate([r[:, 6] for r in rays])) if rays else np.zeros(0)
    names = list(kinds)
    return key | {names[int(kind)]: kinds[names[int(kind)]] for kind in there}


def _bar(title: str, colors: Any, limits: tuple[float, float]) -> str:
    """Return a colour bar as HTML."""
    shades = ", ".join(to_hex(colormaps.get_cmap(colors)(v)) for v in np.linspace(0.0, 1.0, 12))
    low, high = limits
    return (
        f'<li class="bar">{html.escape(title)} <span>{low:.3g}</span><b style="background:'
        f'linear-gradient(to right, {shades})"></b><span>{high:.3g}</span></li>'
    )
