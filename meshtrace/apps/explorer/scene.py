"""The explorer's 3D scene of a link over its sea; only changed parts are sent."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from meshtrace import CoverageMap, MeshSource, PhotonPaths, TriangleMesh
from meshtrace.apps.explorer.controls import State
from meshtrace.link import Link
from meshtrace.surfaces.statistics import hs, tp
from meshtrace.viz import Stage, live, parts
from meshtrace.viz.scenes import wind_of
from meshtrace.viz.stage import stage_of
from meshtrace.viz.style import RECEIVER_COLOR
from meshtrace.viz.water import SeaLight

CELLS = 120
"""Cells of the sea along a side."""

COLORS = {
    "lamp and beam": "var(--lamp)",
    "receiver and view": RECEIVER_COLOR,
    "unscattered light": "var(--received)",
    "scattered light": live.SCATTERED_COLOR,
}
"""Key of the scene: parts and their colours; lamp and unscattered light have that of the light."""

_NEW_FRAME = (0.6, 1.1)  # sizes of the stage, relative to that framed, that keep the camera
_NEW_SQUARE = (0.75, 1.25)  # half-widths, relative to that of the present sea, that keep it
_WIDEST = 4.0  # tuned: half-width of the block, over that of its link
_OFF_CENTER = 0.2  # distance of the centres, over the half-width, that keeps it


class LiveScene:
    """Scene of a link over its sea; only changed parts are sent to the page.

    Parameters
    ----------
    state : State
        Link, sea and time.

    Attributes
    ----------
    parts : dict
        All parts as the page takes them: "stage", "faces", "sea", "look", "link", "bodies", "rays",
        "map", "time".
    stage : Stage
        Box that is shown.
    """

    def __init__(self, state: State) -> None:
        self._key: Any = None
        self._made: tuple[Any, TriangleMesh] | None = None
        self._drawn: TriangleMesh | None = None
        self._faces: Any = None
        self._ring = np.empty(0, int)
        self._framed, self._framing = np.zeros(2), 0
        self._changed: set[str] = set()
        self.parts: dict[str, Any] = {"rays": b"", "map": None}
        self.update(state)

    def update(self, state: State, running: bool = False) -> None:
        """Update the parts that depend on a state, except rays and map.

        Parameters
        ----------
        state : State
            Link, sea and time.
        running : bool
            Whether time alone changed: the parts of the link stay.
        """
        if not running:
            self._place(state)
        mesh = self._mesh(state.time)
        if mesh is not self._drawn:
            self._take_sea(mesh)
        self._set("time", state.time)
        if not running:
            stage, scenario = self.stage, state.scenario
            look = live.look_part(scenario.link, self._surface, mesh, scenario.daylight)
            self._set("stage", live.stage_part(stage, scenario.link, self._framing))
            self._set("look", look)
            self._set("link", live.link_part(scenario.link, stage))
            self._set("bodies", live.bodies_part(scenario.link, stage))

    def frame_anew(self) -> None:
        """Reset the camera at the next link."""
        self._framed = np.zeros(2)

    def changes(self) -> dict[str, Any]:
        """Return the parts that changed since the last call."""
        changed = {name: self.parts[name] for name in self._changed}
        self._changed = set()
        return changed

    def show_rays(self, paths: PhotonPaths | None) -> None:
        """Show or remove paths of received light."""
        self._set("rays", b"" if paths is None else live.segments(paths).tobytes())

    def show_map(self, coverage: CoverageMap | None) -> None:
        """Show or remove a map."""
        self._set("map", None if coverage is None else live.map_part(coverage))

    def profile(self) -> list[tuple[float, float]]:
        """Return points (x, z) [m] of the waves along x through the middle of the stage."""
        assert self._drawn is not None
        vertices = self._drawn.vertices
        # the grid line next to the middle
        distance = np.abs(vertices[:, 1] - self.stage.center[1])
        line = vertices[distance < distance.min() + 1e-4 * self.stage.half]
        line = line[np.argsort(line[:, 0])]
        return [(round(float(x), 3), round(float(z), 3)) for x, _, z in line]

    def views(self, state: State) -> dict[str, Any]:
        """Return the data of the side view and the plan: limits, lamp, receiver and waves [m].

        With the colour of the light of the lamp, and the sea in words.
        """
        stage, link = self.link_stage, state.scenario.link
        (x, y), half = stage.center, stage.half
        lamp, receiver = link.transmitters[0], link.receivers[0]
        room = 0.05 * (stage.top - stage.bottom)  # for the marks of lamp and receiver
        low, high = stage.bottom - room, stage.top + room
        return {
            "side": {
                "frame": {"x0": x - half, "x1": x + half, "y0": low, "y1": high},
                "lamp": _end(lamp, (0, 2), getattr(lamp, "spread_deg", 0.0), 1.0),
                "receiver": _end(receiver, (0, 2), 0.5 * receiver.fov_deg, -1.0),
                "profile": self.profile(),
            },
            "plan": {
                "frame": {"x0": x - half, "x1": x + half, "y0": y - half, "y1": y + half},
                "lamp": _end(lamp, (0, 1), 0.0, 1.0),
                "receiver": _end(receiver, (0, 1), 0.0, 1.0),
                "wind": getattr(state.scenario.surface, "wind_direction_deg", None),
            },
            "lamp_color": live.light_shade(lamp, 0.12),
            "received_color": live.light_shade(lamp),
            "sea": self._sea,
        }

    def _set(self, name: str, value: Any) -> None:
        if name not in self.parts or self.parts[name] != value:
            self.parts[name] = value
            self._changed.add(name)

    def _place(self, state: State) -> None:
        """Adopt the link and the sea of a state."""
        if self._key == (state.moves, state.initial):
            return
        case = state.channel.case()
        self._surface, self._key = case.surface, (state.moves, state.initial)
        self.link_stage = stage_of(case.link, case.surface, None)
        wave, words = _peak_wave(case.surface)
        self._sea = words + _foam_words(case.link, wind_of(case.surface))
        # two waves of the peak, as far as the link stays large enough to be seen
        half = self.link_stage.half
        stage = self.link_stage._replace(half=max(half, min(wave, _WIDEST * half)))
        self.stage = self._on_square(stage)
        # a camera that jumps at every move of a slider would lose the reader
        sizes = np.array([self.stage.size, self.link_stage.size])
        ratio = sizes / np.maximum(self._framed, 1e-9)
        if not ((_NEW_FRAME[0] < ratio) & (ratio < _NEW_FRAME[1])).all():
            self._framed, self._framing = sizes, self._framing + 1

    def _on_square(self, stage: Stage) -> Stage:
        """Return the stage over the present square of the sea if their sizes are similar.

        A move of the link then leaves the surface, most of the data of the scene, as it is.
        """
        if not hasattr(self, "stage"):
            return stage
        (x, y), half = self.stage.center, self.stage.half
        shift = max(abs(stage.center[0] - x), abs(stage.center[1] - y))
        if _NEW_SQUARE[0] < stage.half / half < _NEW_SQUARE[1] and shift < _OFF_CENTER * half:
            return stage._replace(center=(x, y), half=half)
        return stage

    def _mesh(self, time: float) -> TriangleMesh:
        """Return the mesh of the surface at a time, the previous one if nothing has changed."""
        if not isinstance(self._surface, MeshSource):
            return self._surface
        stage = self.stage
        wanted = self._surface, time, stage.half, stage.center
        if self._made is None or self._made[0] != wanted:
            step = 2.0 * stage.half / CELLS
            self._made = wanted, self._surface.mesh(time, stage.half, step, center=stage.center)
        return self._made[1]

    def _take_sea(self, mesh: TriangleMesh) -> None:
        """Send points, normals, edge and facets of a surface, in single precision."""
        self._drawn = mesh
        if self._faces is not mesh.faces.base or self._faces is None:  # grids of a shape share them
            self._faces, self._ring = mesh.faces.base, parts.outline(mesh)[:-1]
            self._set("faces", mesh.faces.astype(np.uint32).tobytes())
        self._set("sea", live.sea_part(mesh, self._ring))


def _foam_words(link: Link, wind: tuple[float | None, float]) -> str:
    """Describe the drawn foam cover, and the cover in the gain if they differ."""
    share = SeaLight.from_link(link, None, wind).foam
    in_gain = 0.0 if link.whitecaps is None else 1.0 - link.whitecaps.transmittance
    other = f" ({100.0 * in_gain:.2g} % in the gain)" if abs(in_gain - share) > 0.1 * share else ""
    return f"foam {100.0 * share:.2g} % by Monahan{other}"


def _peak_wave(surface: Any) -> tuple[float, str]:
    """Return the length of the waves at the peak of a spectrum [m], and heights and periods."""
    spectrum = getattr(surface, "spectrum", None)
    if spectrum is None:
        return 0.0, ""
    period = tp(spectrum)
    words = f"waves Hs {hs(spectrum):.2g} m, Tp {period:.2g} s, "
    return 9.81 * period**2 / (2.0 * math.pi), words  # of deep water


def _end(part: Any, axes: tuple[int, int], half: float, sign: float) -> dict[str, Any] | None:
    """Return position and cone of a lamp or receiver in two axes; None for sun and sky."""
    if not hasattr(part, "depth") and not hasattr(part, "height"):
        return None
    i, j = axes
    across, up = (sign * part.axis[k] for k in (0, 2))
    return {
        "x": part.center[i], "y": part.center[j], "half": half, "axis": math.atan2(across, up),
        "air": part.center[2] > 0.0,
    }  # fmt: skip
