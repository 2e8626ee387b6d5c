"""Data of the explorer's 3D scene: sea, water, sky and light as the page draws them."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from matplotlib.colors import to_hex, to_rgb
from scipy.stats import norm

from meshtrace import CoverageMap, MeshSource, PhotonPaths, TriangleMesh
from meshtrace.apps.explorer.controls import State
from meshtrace.daylight import Daylight
from meshtrace.link import Link, Source, WaterSource, Whitecaps
from meshtrace.link.sources import AirLamp
from meshtrace.models import Floats
from meshtrace.optics import Water
from meshtrace.surfaces.statistics import hs, tp
from meshtrace.viz import Stage, parts
from meshtrace.viz.scenes import longest_left_out, path_segments, wind_of
from meshtrace.viz.stage import stage_of
from meshtrace.viz.style import PALETTE, RECEIVER_COLOR, to_srgb
from meshtrace.viz.water import (
    WATER_BRIGHTNESS,
    SeaLight,
    foam_streaks,
    left_out,
    short_waves,
    sky_colors,
)

CELLS = 120
"""Cells of the sea along a side."""

SCATTERED_COLOR = PALETTE["purple"]

COLORS = {
    "lamp and beam": "var(--lamp)",
    "receiver and view": RECEIVER_COLOR,
    "unscattered light": "var(--received)",
    "scattered light": SCATTERED_COLOR,
}
"""Key of the scene: parts and their colours; lamp and unscattered light have that of the light."""

_LEAST_IRRADIANCE = 1e-4  # of daylight rather than moon or night [W m-2 nm-1]
_DUSK = Daylight(direct=0.25, diffuse=1.0, sun_zenith_deg=80.0, sun_azimuth_deg=118.0)
_DUSK_TINT, _MOON_TINT, _DAY_TINT = (0.006, 0.009, 0.016), (0.02, 0.025, 0.036), (0.9, 0.9, 0.96)
_CLOUD_TINT = (0.5, 0.52, 0.56)
_LEAST_INSIDE = (0.25, 0.32, 0.5)  # of the light in the water, which the eye would take time to see
_MOST_INSIDE = 0.02  # share of it that turbid water returns: a beam is brighter
_DIM = 0.6  # tuned: brightness of bodies, most of which lie in dark water
_TEXELS = 256
_CORE = 0.5  # share of white in rays of received light: brighter than the beam around them
_NEW_FRAME = (0.6, 1.1)  # sizes of the stage, relative to that framed, that keep the camera
_NEW_SQUARE = (0.75, 1.25)  # half-widths, relative to that of the present sea, that keep it
_WIDEST = 4.0  # tuned: half-width of the block, over that of its link
_OFF_CENTER = 0.2  # distance of the centres, over the half-width, that keeps it
_NM = (400.0, 440.0, 480.0, 510.0, 570.0, 620.0, 700.0)
_COLORS = ((0.3, 0.1, 1), (0.1, 0.25, 1), (0.1, 0.6, 1), (0.1, 1, 0.45), (0.8, 1, 0.1),
           (1, 0.4, 0.1), (1, 0.1, 0.1))  # fmt: skip


def light_color(wavelength_nm: float) -> tuple[float, float, float]:
    """Return an illustrative colour of a wavelength in linear red, green and blue.

    Examples
    --------
    >>> light_color(510.0)
    (0.1, 1.0, 0.45)
    """
    red, green, blue = (float(np.interp(wavelength_nm, _NM, c)) for c in np.transpose(_COLORS))
    return red, green, blue


def _shade(source: Source, white: float) -> str:
    """Return the colour of the light of a lamp with a share of white."""
    color = white + 0.9 * np.array(light_color(source.wavelength_nm))
    return to_hex(to_srgb(np.minimum(color, 1.0)))


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
            stage = self.stage
            link = state.scenario.link
            ends = (*link.transmitters, *link.receivers)
            # depths are read at the distance of the first end that is in the water
            low = (*stage.center, stage.bottom)
            deep = next((end.center for end in ends if end.center[2] < 0.0), low)
            self._set("stage", {"center": stage.center, "half": stage.half, "top": stage.top,
                                "bottom": stage.bottom, "framing": self._framing,
                                "pole": list(deep[:2]), "deep": -deep[2]})  # fmt: skip
            self._set("look", self._look(state, mesh))
            self._set("link", _link(link, stage))
            self._set("bodies", _bodies(link, stage))

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
        self._set("rays", b"" if paths is None else segments(paths).tobytes())

    def show_map(self, coverage: CoverageMap | None, shades: Any) -> None:
        """Show a map with its colours (n, n, 4), x first, or remove it."""
        image = None
        if coverage is not None:
            half = 0.5 * float(coverage.x[1] - coverage.x[0])
            box = [*_ends(coverage.x, half), *_ends(coverage.y, half)]
            pixels = np.ascontiguousarray(shades.transpose(1, 0, 2))
            image = {"bytes": pixels.tobytes(), "n": len(coverage.x), "box": box}
        self._set("map", image)

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
            "lamp_color": _shade(lamp, 0.12),
            "received_color": _shade(lamp, _CORE),
            "sea": self._sea,
        }

    def _set(self, name: str, value: Any) -> None:
        if name not in self.parts or self.parts[name] != value:
            self.parts[name] = value
            self._changed.add(name)

    def _place(self, state: State) -> None:
        """Take over the link and the sea of a state."""
        if self._key == (state.moves, state.initial):
            return
        case = state.channel.case()
        self._surface, self._key = case.surface, (state.moves, state.initial)
        self.link_stage = stage_of(case.link, case.surface, None)
        wave, words = _peak_wave(case.surface)
        self._foam, words_of_foam = _foam_of(case.link, wind_of(case.surface)[0])
        self._sea = words + words_of_foam
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
        """Return the stage over the present square of the sea if both are of similar size.

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
        """Take over points, normals, edge and facets of a surface, in single precision."""
        self._drawn = mesh
        if self._faces is not mesh.faces.base or self._faces is None:  # grids of a shape share them
            self._faces, self._ring = mesh.faces.base, parts.outline(mesh)[:-1]
            self._set("faces", mesh.faces.astype(np.uint32).tobytes())
        points = mesh.vertices
        arrays = {"points": points, "normals": mesh.vertex_normals, "ring": points[self._ring]}
        self._set("sea", {key: a.astype(np.float32).tobytes() for key, a in arrays.items()})

    def _look(self, state: State, mesh: TriangleMesh) -> dict[str, Any]:
        """Return the illumination of the sea and the short waves that its mesh leaves out."""
        wind = wind_of(self._surface)
        day, sky_color = _sky_of(state.scenario.daylight)
        sea_light = SeaLight.from_link(state.scenario.link, day, wind)
        angle = math.radians(wind[1])
        # a breaking crest has a vertical normal, whose slope would be infinite
        slopes = mesh.vertex_normals[:, :2] / np.maximum(mesh.vertex_normals[:, 2:], 0.2)
        variances, least = left_out(mesh, longest_left_out(self._surface))
        tile = _tile((float(variances[0]), float(variances[1])), least, wind[1])
        upwelling = math.pi * WATER_BRIGHTNESS * sea_light.upwelling
        inside = np.array(_LEAST_INSIDE) * min(1.0, _MOST_INSIDE / float(upwelling.max()))
        # streaks are Gaussian: foam is where they exceed the quantile of its share
        foam = 1.1 * norm.ppf(1.0 - self._foam) if self._foam > 0.0 else 100.0
        glint = 0.0 if day is _DUSK else day.direct / day.irradiance
        return {
            "waves": tile, "rest": tile["rest"], "sky": _sky_image(day), "sun": list(day.sun),
            "tint": list(sky_color),
            "inside": np.maximum(1.6 * np.array(sky_color), inside).tolist(),
            "direct": glint, "foam": float(foam),
            "upwelling": upwelling.tolist(),
            "absorption": sea_light.absorption.tolist(), "wind": [math.cos(angle), math.sin(angle)],
            "height": max(float(mesh.vertices[:, 2].std()), 0.02),
            "steepness": float(slopes.var(axis=0).sum()),
        }  # fmt: skip


def _foam_of(link: Link, wind_speed: float | None) -> tuple[float, str]:
    """Return the share of foam by Monahan, and in words with that which the gain has."""
    caps = link.whitecaps or Whitecaps(wind_speed=min(wind_speed or 0.0, 30.0))
    share = 1.0 - caps.replace(model="monahan80").transmittance
    in_gain = 0.0 if link.whitecaps is None else 1.0 - caps.transmittance
    other = f" ({100.0 * in_gain:.2g} % in the gain)" if abs(in_gain - share) > 0.1 * share else ""
    return share, f"foam {100.0 * share:.2g} % by Monahan{other}"


def _peak_wave(surface: Any) -> tuple[float, str]:
    """Return the length of the waves at the peak of a spectrum [m], and heights and periods."""
    spectrum = getattr(surface, "spectrum", None)
    if spectrum is None:
        return 0.0, ""
    period = tp(spectrum)
    words = f"waves Hs {hs(spectrum):.2g} m, Tp {period:.2g} s, "
    return 9.81 * period**2 / (2.0 * math.pi), words  # of deep water


@lru_cache(maxsize=4)
def _tile(variances: tuple[float, float], least: float, wind_deg: float) -> dict[str, Any]:
    """Return slopes of short waves and streaks of foam as the pixels of a tile, by `left_out`.

    Red and green are the slopes x and y over `scale`, blue the sum of their squares, of which
    smaller copies of the tile keep the mean; alpha has the streaks from -4 to 4.
    """
    # two of the longest waves left out, so that the repetition is not seen
    size = 4.0 * math.pi / least
    drawn = short_waves(size, _TEXELS, variances, least, wind_deg)
    scale = 4.0 * max(float(drawn.slopes.std()), 1e-4)
    slopes = np.clip(drawn.slopes / scale, -1.0, 1.0).transpose(1, 0, 2)
    streaks = foam_streaks(4.0 * size, _TEXELS, wind_deg).T
    tile = np.dstack([0.502 + 0.498 * slopes, (slopes**2).sum(axis=2), (streaks + 4) / 8])
    pixels = np.rint(255.0 * np.clip(tile, 0.0, 1.0)).astype(np.uint8)
    return {"bytes": pixels.tobytes(), "n": _TEXELS, "size": size, "scale": scale,
            "rest": list(drawn.rest)}  # fmt: skip


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


def segments(paths: PhotonPaths) -> Any:
    """Return path segments (n, 7): both ends [m], and 1 for scattered light."""
    points, k = path_segments(paths)
    scattered = (paths.length > 3)[points, None]
    ends = paths.vertex[points, k], paths.vertex[points, k + 1]
    return np.hstack([*ends, scattered]).astype(np.float32)


def _ends(values: Floats, half: float) -> tuple[float, float]:
    return float(values[0] - half), float(values[-1] + half)


def _sky_of(day: Daylight | None) -> tuple[Daylight, tuple[float, float, float]]:
    """Choose the sky to draw and its brightness; night is drawn as late dusk."""
    if day is None or day.light == "moonless night":
        return _DUSK, _DUSK_TINT
    if day.irradiance < _LEAST_IRRADIANCE:
        return day, _MOON_TINT
    if day.direct == 0.0:
        return day, _CLOUD_TINT
    low = min(max(1.3 * day.sun[2], 0.1), 1.0) ** 0.8  # the sky over the irradiance is brighter
    red, green, blue = _DAY_TINT
    return day, (low * red, low * green, low * blue)


def _sky_image(day: Daylight) -> dict[str, Any]:
    """Return the sky as pixels (16, 32): roots of radiances by elevation, finer at the horizon."""
    elevation = 0.5 * math.pi * (np.arange(16) / 15.0)[:, None] ** 2
    azimuth = 2.0 * math.pi * (np.arange(32) + 0.5) / 32.0
    across = np.cos(elevation) + 0.0 * azimuth
    z = np.sin(elevation) + 0.0 * azimuth
    towards = np.stack([across * np.cos(azimuth), across * np.sin(azimuth), z], axis=-1)
    color = sky_colors(day, towards.reshape(-1, 3))
    scale = float(color.max())
    pixels = np.full((512, 4), 255, np.uint8)
    # bytes of roots hold a dark sky beside a bright one
    pixels[:, :3] = np.rint(255.0 * np.sqrt(color / scale))
    return {"bytes": pixels.tobytes(), "scale": scale}


def _link(link: Link, stage: Stage) -> dict[str, Any]:
    """Return lamps, receivers and aircraft of a link, and the colour of its first lamp."""
    lamps = [_lamp(s, link) for s in link.transmitters if isinstance(s, WaterSource | AirLamp)]
    receivers = [
        {"place": r.center, "axis": r.axis, "half": 0.5 * r.fov_deg, "radius": r.radius}
        for r in link.receivers
    ]
    plane, scale = link.receivers[0].center[2], 0.0
    if lamps and lamps[0]["at"][2] * plane < 0.0:
        far, n = abs(lamps[0]["at"][2]), link.water.n
        if plane > 0.0:
            scale = (far + plane * n) ** 2 * math.exp(link.water.c * far) / n**2
        else:
            scale = (far - plane / n) ** 2 * math.exp(-link.water.c * plane)
    colors = {"receiver": RECEIVER_COLOR, "unscattered": _shade(link.transmitters[0], _CORE),
              "scattered": SCATTERED_COLOR}  # fmt: skip
    return {
        "lamps": lamps, "receivers": receivers, "carried": [list(c) for c in parts.carried(link)],
        "color": light_color(link.transmitters[0].wavelength_nm), "index": link.water.n,
        "extinction": link.water.c, "scattering": link.water.b, "loss": _loss(link.water),
        "plane": plane, "size": stage.size,
        "norm": scale * _strength(link.transmitters[0]),
        "colors": {name: to_rgb(color) for name, color in colors.items()},
    }  # fmt: skip


def _bodies(link: Link, stage: Stage) -> list[dict[str, Any]]:
    """Return corners (facets, 3, 3) of the facets of each body about the stage, and its colour."""
    shown, reach = [], stage.half * np.array([-1.0, 1.0])
    for body in link.bodies:
        vertices, faces = body.triangles()
        corners = vertices[faces]
        middle = corners[..., :2].mean(axis=1) - stage.center
        within = ((reach[0] <= middle) & (middle <= reach[1])).all(axis=1)
        color = _DIM * np.array(to_rgb(parts.BODY_COLORS[body.reflection]))
        facets = corners[within].astype(np.float32)
        shown.append({"bytes": facets.tobytes(), "color": color.tolist()})
    return shown


def _strength(source: Source) -> float:
    """Return the displayed brightness of a lamp, 1 for 100 mW."""
    return min(max((source.power_mw / 100.0) ** 0.25, 0.5), 2.0)


def _loss(water: Water) -> float:
    """Return the displayed attenuation of a beam [m-1]; forward scattering loses little."""
    return water.a + 0.1 * water.b  # a share for looks


def _lamp(source: WaterSource | AirLamp, link: Link) -> dict[str, Any]:
    """Return the beam of a lamp at its position ("own") and as it seems to start in the water."""
    half, bright = source.spread_deg, 0.4 * _strength(source)
    x, y, z = source.center
    bright *= min(math.exp(_loss(link.water) * abs(z) / 3.0), 5.0) if z < 0.0 else 1.0
    own_axis, own_shape = _beam(source.pattern, half, source.axis, abs(z), bright)
    in_place = {"at": source.center, "own": {"axis": own_axis, "shape": own_shape}}
    if z < 0.0:
        return in_place | {"place": [x, y, z, 0.0], "axis": own_axis, "shape": own_shape}
    # by Snell's law the cone of a lamp in the air has another apex in the water
    n, (u, v, w) = link.water.n / link.n_air, source.axis
    bent = (u / n, v / n, -math.sqrt(1.0 - (u * u + v * v) / n**2))
    narrow = math.degrees(math.asin(math.sin(math.radians(min(half, 89.0))) / n))
    way = z / max(-w, 0.05)
    back = way * math.tan(math.radians(min(half, 80.0))) / math.tan(math.radians(max(narrow, 0.01)))
    apex = [x + way * u - back * bent[0], y + way * v - back * bent[1], -back * bent[2], 1.0]
    axis, shape = _beam(source.pattern, narrow, bent, abs(apex[2]) * 1.5, bright)
    return in_place | {"place": apex, "axis": axis, "shape": shape}


def _beam(
    pattern: str, half: float, axis: tuple[float, float, float], way: float, bright: float
) -> tuple[list[float], list[float]]:
    """Return axis and shape of a beam.

    The shape has the power of the cosine (0: within a cone), the tangent of the drawn half-angle,
    a distance of reference [m] and the brightness.
    """
    angle = math.radians(max(min(half, 179.0), 0.2))
    power = {"led": math.log(0.5) / math.log(max(math.cos(min(angle, 1.5)), 1e-9)),
             "gaussian-beam": 4.0 / angle**2, "isotropic": 1e-3}.get(pattern, 0.0)  # fmt: skip
    # the cone ends where the light is down to 3 %
    drawn = math.acos(0.03 ** (1.0 / power)) if power > 0.0 else angle
    tangent = math.tan(min(drawn, math.radians(78.0)))
    return [*axis, math.cos(angle)], [power, tangent, max(way / 3.0, 0.05), bright]
