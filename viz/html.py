"""Export of a scene as a self-contained interactive web page."""

from __future__ import annotations

import html
import io
import json
import re
import zipfile
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
import pyvista as pv
from matplotlib.colors import to_hex, to_rgb
from trame_vtk.modules.vtk.serializers import (
    SynchronizationContext,
    extract_array_hash,
    initialize_serializers,
    reference_id,
    serialize,
)
from trame_vtk.tools.vtksz2html import write_html

from meshtrace.errors import Refused
from meshtrace.files import atomic

from .checks import checked
from .stage import Scene
from .style import INK, SKY

_HEAD, _LIGHTS = (
    (Path(__file__).parent / f"page_{part}.html").read_text(encoding="utf-8")
    for part in ("head", "lights")
)


@checked
def save_html(plotter: pv.Plotter, path: str | Path, title: str = "meshtrace") -> Path:
    """Write a scene as a self-contained interactive web page.

    Parameters
    ----------
    plotter : Scene or pyvista.Plotter
        Plotter or scene. Texts of a `Scene` face the present camera.
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
        If the suffix is not .html or .htm.
    """
    path = Path(path)
    if path.suffix not in (".html", ".htm"):
        raise Refused("path", str(path), "a file name in .html")
    page = _exported(plotter)
    head = Template(_HEAD).substitute(title=html.escape(title), ink=INK)
    page = re.sub(r"<title>.*?</title>", lambda _: head, page, count=1)
    page = re.sub(r"https://kitware\.github\.io/vtk-js/icon/[^`\"']*", "data:,", page)
    body = _about(plotter, title)
    page = page.replace("<body>", f"<body>\n{body}", 1).replace("</body>", f"{_LIGHTS}</body>")
    with atomic(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return path


def _exported(plotter: pv.Plotter) -> str:
    """Return the viewer page with the scene, texts as 3D letters, without colour bars."""
    bars = list(plotter.scalar_bars.values())
    for bar in bars:
        bar.SetVisibility(False)
    letters = _letters(plotter) if isinstance(plotter, Scene) else None
    plain: Any = {"scalars": "tint", "rgb": True, "lighting": False, "render": False}
    actor = letters and plotter.add_mesh(letters, **plain)
    page = io.StringIO()
    write_html(_packed(plotter.render_window), page)
    for bar in bars:
        bar.SetVisibility(True)
    if actor:
        plotter.remove_actor(actor, render=False)
    return page.getvalue()


def _packed(window: Any) -> bytes:
    """Return a render window as a zip file for the viewer.

    The export of pyvista does the same but starts a web server.
    """
    initialize_serializers()
    context = SynchronizationContext()
    context.set_ignore_last_dependencies(True)
    state = serialize(None, window, reference_id(window), context, 1)
    camera = window.GetRenderers().GetFirstRenderer().GetActiveCamera()
    state["extra"] = {
        "vtkRefId": reference_id(window),
        "centerOfRotation": camera.GetFocalPoint(),
        "camera": reference_id(camera),
    }
    arrays = {
        entry["hash"]: {**entry, "content": context.get_cached_data_array(entry["hash"], False)}
        for entry in extract_array_hash(state)
    }
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("index.json", json.dumps({"hashes": arrays, "scene": state}))
    return packed.getvalue()


def _letters(scene: Scene) -> pv.PolyData | None:
    """Return the texts of a scene as flat letters that face the camera, light ones in water."""
    towards = np.subtract(scene.camera.position, scene.camera.focal_point)
    towards /= np.linalg.norm(towards)
    right = np.cross((0.0, 0.0, 1.0), towards)
    right /= np.linalg.norm(right)
    frame = np.stack([right, np.cross(towards, right), towards])
    size, words = 0.021 * scene.stage.size, []
    for point, text, align in scene.texts:
        # the letters that VTK has as solids are those of ASCII
        word = pv.Text3D(text.replace("°", " deg"), depth=0.0)
        x0, x1 = word.bounds[:2]
        shift = {"left": -x0, "center": 0.0, "right": -x1}[align]
        word.points = size * (word.points + np.array([shift, 0.0, 0.0])) @ frame + point
        drowned = point[2] < 0.0 and scene.stage.contains(tuple(point))
        tint = 255.0 * np.array(to_rgb(SKY if drowned else INK))
        word.point_data["tint"] = np.tile(tint.astype(np.uint8), (word.n_points, 1))
        words.append(word)
    return pv.merge(words) if words else None


def _about(plotter: pv.Plotter, title: str) -> str:
    """Return heading, caption, colour bars and key as HTML."""
    key: dict[str, str] = getattr(plotter, "key", {})
    rows = "".join(
        f'<li><i style="background:{color}"></i>{html.escape(label)}</li>'
        for label, color in key.items()
    )
    bars = "".join(_bar(name, bar) for name, bar in plotter.scalar_bars.items())
    # the viewer empties its container: in a container of its own the rest stays
    return (
        '<div class="content"></div>'
        f'<div id="about"><h1>{html.escape(title)}</h1>'
        f"<p>{html.escape(getattr(plotter, 'caption', ''))}</p>"
        "<p>drag to turn, wheel to zoom, shift and drag to move</p>"
        f"{bars}<ul>{rows}</ul></div>"
    )


def _bar(title: str, bar: Any) -> str:
    """Return a colour bar as HTML."""
    table = bar.GetLookupTable()
    low, high = table.GetRange()
    shades = [to_hex(table.map_value(float(value))) for value in np.linspace(low, high, 12)]
    gradient = f"linear-gradient(to right, {', '.join(shades)})"
    return (
        f"<p>{html.escape(' '.join(title.split()))}"
        f'<span class="bar" style="display:block;background:{gradient}"></span>'
        f'<span class="ends"><span>{low:.3g}</span><span>{high:.3g}</span></span></p>'
    )
