"""Stage of a scene: the displayed box of sea and air, its scale, camera and lights.

Places are (x, y, z) [m], z up from still water. The numbers of the layout are tuned by eye.
"""

from __future__ import annotations

import itertools
import math
import textwrap
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np
import pyvista as pv
from matplotlib.colors import to_rgb
from numpy.typing import ArrayLike

from meshtrace.engine.paths import PhotonPaths
from meshtrace.errors import Refused, require_array
from meshtrace.link import Body, Link
from meshtrace.link.receivers import Aperture
from meshtrace.link.sources import Source
from meshtrace.mesh import MeshSource, TriangleMesh
from meshtrace.results.series import CoverageMap

from .style import CHALK, DEEP, DUSK, FONT_FILE, NIGHT, PALETTE, SLIDE

VIEW_ANGLE_DEG = 24.0
"""Full vertical angle of view of the camera [deg] (tuned: little perspective)."""

ROOM = ((-0.88, 0.72), (-0.66, 0.93))
"""Place of the stage in the window, -1 to 1 across and up: bars beside it, texts below."""

_FLAT = 0.2  # largest height over width of a stage without ruler, seen from further above

FROM_FILE = 4
"""Value of VTK_FONT_FILE: text in the font of a file."""

Side = Literal["left", "center", "right"]

Z = np.array([0.0, 0.0, 1.0])


SEA_EXTENT = 20.0
"""Half-width [m] of a scene of a sea without a link."""


class Stage(NamedTuple):
    """Box shown by a scene [m]: centre, half-width, lowest and highest z."""

    center: tuple[float, float]
    half: float
    bottom: float
    top: float

    @property
    def size(self) -> float:
        """Length [m] of the longest edge, to which symbols are scaled."""
        return max(2.0 * self.half, self.top - self.bottom)

    @property
    def ends(self) -> np.ndarray:
        """Lowest and highest corner [m], shape (2, 3)."""
        return np.reshape(self.bounds, (3, 2)).T

    @property
    def corners(self) -> np.ndarray:
        """All corners [m], shape (8, 3)."""
        return np.array(list(itertools.product(*self.ends.T)))

    def contains(self, points: ArrayLike) -> Any:
        """Return whether points [m], shape (..., 3), lie on the stage."""
        low, high = self.ends
        return ((low <= points) & (points <= high)).all(axis=-1)

    @property
    def bounds(self) -> tuple[float, float, float, float, float, float]:
        """Limits x, x, y, y, z, z [m] in the order of pyvista."""
        (x, y), h = self.center, self.half
        return (x - h, x + h, y - h, y + h, self.bottom, self.top)


def stage_of(link: Link | None, surface: MeshSource | TriangleMesh, extent: float | None) -> Stage:
    """Return a box around the sources, receivers and the surface between them.

    Without a link it is the box around a mesh, or that of `SEA_EXTENT` for a sea. `extent` [m]
    replaces the half-width. Where it is smaller than depth or height, it limits these, too: a
    close-up of the surface.
    """
    if link is None:
        if not isinstance(surface, TriangleMesh):
            half = extent or SEA_EXTENT
            # tuned: room for the highest crests (3 m) of a sea in a wind of 13 m/s, and for the
            # short waves in a close-up of it
            return Stage((0.0, 0.0), half, -0.2 * half, 0.2 * half)
        (x0, y0, low), (x1, y1, high) = surface.bounds.tolist()
        half = 0.5 * max(x1 - x0, y1 - y0)
        center = (0.5 * (x0 + x1), 0.5 * (y0 + y1))
        return Stage(center, extent or half, low - 0.1 * half, high + 0.1 * half)
    ends: tuple[Source | Aperture, ...] = (*link.transmitters, *link.receivers)
    positions = np.array([item.position for item in ends])
    least, most = positions.min(axis=0), positions.max(axis=0)
    bottom = -max((getattr(item, "depth", 0.0) for item in ends), default=0.0)
    top = max((getattr(item, "height", 0.0) for item in ends), default=0.0)
    levels = [body.triangles()[0][:, 2] for body in link.bodies]
    bottom = min([bottom, *(float(z.min()) for z in levels)])
    top = max([top, *(float(z.max()) for z in levels)])
    height = max(top - bottom, 1.0)  # of the box [m], which sets the margins
    x, y = (0.5 * (least + most)).tolist()
    half = 0.5 * float((most - least).max()) + 0.62 * height
    bottom, top = bottom - 0.04 * height, top + 0.08 * height
    if extent is None:
        return Stage((x, y), half, bottom, top)
    return Stage((x, y), extent, max(bottom, -extent), min(top, extent))


class ScenePlotter(pv.Plotter):
    """Pyvista plotter with a stage and a key to its colours.

    Parameters
    ----------
    stage : Stage
        The box shown.
    off_screen : bool, optional
        Render without a window.
    window_size : tuple of int
        Pixels.
    transparent : bool
        For pictures without a background: texts in a grey that is seen on white and on black.

    Attributes
    ----------
    stage : Stage
        The box shown.
    deep, chalk : str
        Colours of deep water, by day and night, and of texts.
    key : dict of str to str
        Meaning of the colours, for the legend and the web page.
    texts : list of (ndarray, str, str)
        Points [m] with their texts and alignments, for the web page.
    caption : str
        Line that states link, sea and gain.
    shown : dict of str to TriangleMesh, PhotonPaths, CoverageMap, Body or receiver
        Parts of the scene, for `export_scene`.
    shade : callable or None
        Function that updates the colours of the water after a move of the camera.
    """

    def __init__(
        self, stage: Stage, *, off_screen: bool | None = None, window_size: tuple[int, int] = SLIDE,
        transparent: bool = False,
    ) -> None:  # fmt: skip
        with pv.vtk_verbosity("off"):
            # without a display VTK complains, but renders nonetheless
            super().__init__(off_screen=off_screen, window_size=list(window_size), lighting="none")
        self.stage = stage
        self.key: dict[str, str] = {}
        self.texts: list[tuple[np.ndarray, str, str]] = []
        self.caption, self.deep = "", DEEP
        self.transparent, self.chalk = transparent, "#687580" if transparent else CHALK
        self.shown: dict[str, TriangleMesh | PhotonPaths | CoverageMap | Body | Aperture] = {}
        self.shade: Callable[[], None] | None = None
        self.under(None)
        self.enable_anti_aliasing("ssaa")
        # a low sun behind the waves for glint, light from above, and light from the camera
        low_sun = pv.Light(position=(0.6, 1.0, 0.55), light_type="scene light", intensity=0.75)
        above = pv.Light(position=(-0.5, -0.4, 1.0), light_type="scene light", intensity=0.45)
        for lamp in (low_sun, above, pv.Light(light_type="headlight", intensity=0.35)):
            # parallel light, as from far away
            lamp.positional = False
            self.add_light(lamp)
        look(self)

    def under(self, sky: tuple[str, str] | None) -> None:
        """Set the background: dusk, or the colours of the sky near the horizon and high up."""
        low, high = sky or (NIGHT, DUSK)
        self.deep = low if sky else DEEP
        if self.transparent:  # `save_screenshot` takes black out again
            self.set_background("black")  # type: ignore[arg-type]
        else:
            self.set_background(low, top=high)  # type: ignore[arg-type]

    def wipe(self) -> None:
        """Remove all parts; camera and lights stay."""
        self.clear_actors()
        self.shade = None
        for drawn in (self.scalar_bars, self.key, self.texts, self.shown):
            drawn.clear()

    @property
    def frame(self) -> np.ndarray:
        """Unit vectors to the right, up and towards the camera, as rows."""
        # VTK's direction is that of the view, away from the camera
        towards = -np.array(self.camera.direction)
        right = np.cross(Z, towards)  # of length 0 if the camera looks straight down
        right /= max(np.linalg.norm(right), 1e-12)
        return np.stack([right, np.cross(towards, right), towards])

    @property
    def font_size(self) -> int:
        """Height of texts [pixel], in proportion to the window."""
        return round(min(0.015 * self.window_size[0], 0.024 * self.window_size[1]))

    def write(self, text: str, left: float, bottom: float, color: str) -> None:
        """Write a text at a place in the window, 0 to 1 from the left and from the bottom."""
        self.add_text(
            text, position=(left, bottom), viewport=True, color=color, font_file=FONT_FILE,
            font_size=round(0.5 * self.font_size),
        )  # fmt: skip

    def add_tinted(
        self, part: pv.DataSet, color: Any, alpha: ArrayLike, clipped: bool = False,
        line_width: float | None = None,
    ) -> None:  # fmt: skip
        """Draw a part unshaded, with a colour and opacity (0 ... 1) for each point.

        If `clipped`, only what lies on the stage is drawn.
        """
        rgb = np.broadcast_to(
            to_rgb(color) if isinstance(color, str) else color, (part.n_points, 3)
        )
        rgba = np.column_stack([rgb, np.broadcast_to(alpha, part.n_points)])
        part.point_data["tint"] = np.rint(255.0 * rgba).astype(np.uint8)
        part = part.clip_box(self.stage.bounds, invert=False) if clipped else part
        if part.n_cells:
            self.add_mesh(part, scalars="tint", rgb=True, lighting=False, line_width=line_width)

    def bar(self, title: str) -> Any:
        """Return the options of pyvista for a colour bar in the next free place on the right."""
        place = len(self.scalar_bars)
        return {
            "title": "\n".join(textwrap.wrap(title, 14)),
            "vertical": True,
            "position_x": 0.885,
            "position_y": 0.62 - 0.36 * place,
            "width": 0.045,
            "height": 0.3,
            "title_font_size": self.font_size,
            "label_font_size": round(0.9 * self.font_size),
            "color": self.chalk,
            "n_labels": 3,
            "fmt": "%.2g",
            "use_opacity": False,
        }

    def add_scalar_bar(self, *args: Any, **options: Any) -> Any:  # type: ignore[override]
        """Add a colour bar in the font of all other texts."""
        bar = super().add_scalar_bar(*args, **options)
        if bar is None:  # pyvista has warned that there is no room for more
            return bar
        # a font that has degrees and Greek letters
        for text in (bar.GetTitleTextProperty(), bar.GetLabelTextProperty()):
            text.SetFontFamily(FROM_FILE)
            text.SetFontFile(FONT_FILE)
        bar.SetVerticalTitleSeparation(self.font_size // 2)
        return bar


def look(
    scene: ScenePlotter, azimuth_deg: float = -68.0, elevation_deg: float | None = None
) -> ScenePlotter:
    """Point the camera at the stage from an azimuth and elevation, so that it fills `ROOM`.

    The azimuth is that of the camera seen from the stage, from x towards y. The default elevation
    is 15 degrees, low enough to show the surface from above and the water below its near edge, or
    30 degrees for a flat stage such as a wide sea.
    """
    if elevation_deg is None:
        low, high = scene.stage.bottom, scene.stage.top
        elevation_deg = 15.0 if high - low > _FLAT * scene.stage.size else 30.0
    azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
    x, y, level = math.cos(azimuth), math.sin(azimuth), math.cos(elevation)
    towards, right = np.array([x * level, y * level, math.sin(elevation)]), np.array([-y, x, 0.0])
    up, corners = np.cross(towards, right), scene.stage.corners
    half_angle = math.radians(0.5 * VIEW_ANGLE_DEG)
    focus, distance = corners.mean(axis=0), 4.0 * scene.stage.size
    aspect = scene.window_size[0] / scene.window_size[1]
    # fixed point (tuned: 20 steps): how far perspective moves near corners depends on the distance
    for _ in range(20):
        half_view = (distance - (corners - focus) @ towards) * math.tan(half_angle)
        spans = []
        for axis, (low, high), scale in ((right, ROOM[0], aspect), (up, ROOM[1], 1.0)):
            # places in the window, from -1 to 1
            spots = (corners - focus) @ axis / (half_view * scale)
            spans.append((spots.max() - spots.min()) / (high - low))
            shift = 0.5 * (spots.max() + spots.min()) - 0.5 * (low + high) * spans[-1]
            focus = focus + shift * distance * math.tan(half_angle) * scale * axis
        # the stage fills the tighter of both directions
        distance *= max(spans)
    scene.camera.position = tuple(focus + distance * towards)
    scene.camera.focal_point = tuple(focus)
    scene.camera.up = tuple(Z)
    scene.camera.view_angle = VIEW_ANGLE_DEG
    scene.reset_camera_clipping_range()
    # reflections depend on the place of the camera
    if scene.shade is not None:
        scene.shade()
    return scene


def add_scale(scene: ScenePlotter) -> ScenePlotter:
    """Draw a ruler of z beside the stage, and a scale bar of round length in front of it.

    The ruler is as far from the camera as the middle of the stage, so that a lamp there appears
    level with the mark of its depth. A flat stage, such as a wide sea, has no ruler.
    """
    stage = scene.stage
    (x, y), half = stage.center, stage.half
    bar = round_length(0.6 * half)
    start = np.array([x + half - bar, y - half, stage.bottom])
    stop, up = start + np.array([bar, 0.0, 0.0]), 0.01 * stage.size * Z
    lines = [(start, stop), (start - up, start + up), (stop - up, stop + up)]
    add_labels(scene, [0.5 * (start + stop) - 2.5 * up], [f"{bar:g} m"])
    if stage.top - stage.bottom > _FLAT * stage.size:
        step = round_length(0.25 * (stage.top - stage.bottom))
        top = stage.top - 0.04 * stage.size  # above it is the name of the axis
        heights = np.arange(math.ceil(stage.bottom / step), math.floor(top / step) + 1) * step
        corner, right = _left_of_the_stage(scene)
        tick = -0.02 * stage.size * right
        lines += [(corner + stage.bottom * Z, corner + stage.top * Z)]
        lines += [(corner + z * Z, corner + z * Z + tick) for z in heights]
        places = [corner + z * Z + 1.6 * tick for z in heights]
        add_labels(scene, places, [f"{z:g}" for z in heights], align="right")
        add_labels(scene, [corner + stage.top * Z + 2.0 * up], ["z [m]"])
    segments = pv.line_segments_from_points(np.array(lines).reshape(-1, 3))
    scene.add_mesh(segments.tube(radius=0.0012 * stage.size), color=scene.chalk, lighting=False)
    return scene


def _left_of_the_stage(scene: ScenePlotter) -> tuple[np.ndarray, np.ndarray]:
    """Return the place (x, y, 0) of the ruler, left of the stage, and the unit vector right."""
    camera, ahead = np.array(scene.camera.position), np.array(scene.camera.direction)
    right, corners = scene.frame[0], scene.stage.corners
    middle = np.array([*scene.stage.center, 0.0])
    # across over ahead: the leftmost corner in perspective, at the distance of the middle
    slopes = (corners - middle) @ right / ((corners - camera) @ ahead)
    across = float(slopes.min() * ((middle - camera) @ ahead)) - 0.02 * scene.stage.size
    return middle + across * right, right


def add_compass(
    scene: ScenePlotter, wind_speed: float | None, direction_deg: float = 0.0
) -> ScenePlotter:
    """Draw an arrow along the wind in front of the stage, with the wind speed [m s-1]."""
    s = scene.stage
    length = 0.16 * s.size
    angle = math.radians(direction_deg)
    wind = np.array([math.cos(angle), math.sin(angle), 0.0])
    middle = np.array([s.center[0] - 0.5 * s.half, s.center[1] - 1.15 * s.half, 0.0])
    arrow = pv.Arrow(
        start=middle - 0.5 * length * wind, direction=wind, scale=length, tip_length=0.3,
        tip_radius=0.07, shaft_radius=0.025,
    )  # fmt: skip
    scene.add_mesh(arrow, color=PALETTE["orange"], ambient=0.4)
    text = "down-wind" if wind_speed is None else f"wind {wind_speed:g} m/s"
    add_labels(scene, [middle - 0.035 * s.size * Z], [text])
    return scene


def add_caption(scene: ScenePlotter, text: str) -> ScenePlotter:
    """Write a caption along the lower edge of the window, above the key."""
    scene.caption = text
    row = max((row for _, _, row in _key_places(scene)), default=0) + 1
    # lines break between clauses alone: spaces within them are no-break spaces
    clauses = "; ".join(clause.replace(" ", "\N{NO-BREAK SPACE}") for clause in text.split("; "))
    for line in reversed(textwrap.wrap(clauses, int(1.0 / _letter(scene)))):
        scene.write(line, 0.02, 0.02 + 1.6 * (row + 0.25) * _row(scene), scene.chalk)
        row += 1
    return scene


def add_key(scene: ScenePlotter) -> ScenePlotter:
    """Draw the legend of the colours along the lower edge."""
    for label, left, row in _key_places(scene):
        bottom = 0.02 + 1.6 * row * _row(scene)
        for shift, text, color in (
            (0.0, "\N{BLACK SQUARE}", scene.key[label]), (2.3, label, scene.chalk),
        ):  # fmt: skip
            scene.write(text, left + shift * _letter(scene), bottom, color)
    return scene


def _key_places(scene: ScenePlotter) -> list[tuple[str, float, int]]:
    """Return the labels of the key with their distance from the left and row from the bottom."""
    places, left, row = [], 0.02, 0
    for label in scene.key:
        width = (len(label) + 4.3) * _letter(scene)
        if left > 0.02 and left + width > 1.0 + 2.0 * _letter(scene):
            left, row = 0.02, row + 1
        places.append((label, left, row))
        left += width
    return places


def _letter(scene: ScenePlotter) -> float:
    """Return the mean width of a letter relative to the window."""
    return 0.53 * scene.font_size / scene.window_size[0]


def _row(scene: ScenePlotter) -> float:
    """Return the height of a text relative to the window."""
    return scene.font_size / scene.window_size[1]


def add_labels(
    scene: ScenePlotter, points: list[np.ndarray], texts: list[str], align: Side = "center"
) -> ScenePlotter:
    """Draw texts at points, upright and in front of all other parts."""
    places = require_array(points, "points", "points (n, 3)").reshape(len(points), -1)
    if not len(texts) == len(places) > 0 or places.shape[1] != 3:
        raise Refused("points", places.shape, "a point (3,) for each text")
    rays = places - scene.camera.position
    ahead = rays @ scene.camera.direction > 0.0  # VTK draws labels behind, too
    places, texts = places[ahead], [text for text, seen in zip(texts, ahead, strict=True) if seen]
    if not texts:
        return scene
    scene.texts += [(point, text, align) for point, text in zip(places, texts, strict=True)]
    scene.add_point_labels(
        places, texts, font_size=scene.font_size, font_file=FONT_FILE, bold=False,
        text_color=CHALK, shape=None, background_color=NIGHT,
        background_opacity=0.85 if scene.transparent else 0.45,
        justification_horizontal=align, justification_vertical="center",
        show_points=False, always_visible=True,
    )  # fmt: skip
    return scene


def round_length(length: float) -> float:
    """Round a length down to 1, 2 or 5 times a power of ten.

    Examples
    --------
    >>> round_length(3.75)
    2.0
    """
    power = 10.0 ** math.floor(math.log10(length))
    return float(max(m * power for m in (1.0, 2.0, 5.0) if m * power <= length * (1 + 1e-12)))


def round_range(low: float, high: float) -> tuple[float, float]:
    """Return the tightest limits around two values that are two one-digit steps apart.

    Examples
    --------
    >>> round_range(-0.63, 0.56)
    (-0.7, 0.7)
    """
    # the smallest step of one digit, such as 0.7, with multiples two steps apart around the values
    finest = math.floor(math.log10(max(high - low, 1e-6))) - 1
    for power, digit in itertools.product(range(finest, finest + 3), range(1, 10)):
        step = digit * 10.0**power
        start = math.floor(low / step + 1e-9)
        if (start + 2) * step >= high - 1e-9 * step:
            break
    return round(start * step, 12), round((start + 2) * step, 12)
