"""Data of a scene for the WebGL of pages: sea, water, sky and light.

The explorer sends these parts to its page and `save_html` writes them into one; `assets/scene.js`
takes them, with arrays as bytes of single precision.
"""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex, to_rgb
from scipy.special import ndtri

from meshtrace.daylight import Daylight
from meshtrace.engine.paths import PhotonPaths
from meshtrace.engine.photons.flight import Vertex
from meshtrace.link import Link
from meshtrace.link.sources import AirLamp, Source, WaterSource
from meshtrace.mesh import MeshSource, TriangleMesh
from meshtrace.optics import Water
from meshtrace.results.series import CoverageMap

from . import parts
from .scenes import longest_left_out, path_segments, wind_of
from .stage import Stage
from .style import BODY_COLORS, FATE_COLORS, PALETTE, RECEIVER_COLOR, to_srgb
from .water import (
    DEFAULT_DAY,
    DEFAULT_WATER,
    WATER_BRIGHTNESS,
    SeaLight,
    foam_streaks,
    is_day,
    left_out,
    short_waves,
    sky_colors,
)

ASSETS = Path(__file__).with_name("assets")
"""Scripts and styles of scenes in pages."""

SCATTERED_COLOR = PALETTE["purple"]
MAP_DB = 20.0
"""Range of the colours of a map below its peak [dB]."""

LAMPS = 4
"""Lamps whose beams are drawn, as in `assets/shaders.js`."""

_DUSK = Daylight(direct=0.25, diffuse=1.0, sun_zenith_deg=80.0, sun_azimuth_deg=118.0)
_DUSK_TINT, _MOON_TINT, _DAY_TINT = (0.006, 0.009, 0.016), (0.02, 0.025, 0.036), (0.9, 0.9, 0.96)
_CLOUD_TINT = (0.5, 0.52, 0.56)
_LEAST_INSIDE = (0.25, 0.32, 0.5)  # of the light in the water, which the eye would take time to see
_MOST_INSIDE = 0.02  # share of it that turbid water returns: a beam is brighter
_DIM = 0.6  # tuned: brightness of bodies, most of which lie in dark water
_TEXELS = 256
_CORE = 0.5  # share of white in rays of received light: brighter than the beam around them
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


def light_shade(source: Source, white: float = _CORE) -> str:
    """Return the colour of the light of a lamp, mixed with a share of white."""
    color = white + 0.9 * np.array(light_color(source.wavelength_nm))
    return to_hex(to_srgb(np.minimum(color, 1.0)))


def stage_part(stage: Stage, link: Link | None, framing: int = 1) -> dict[str, Any]:
    """Return the displayed box; a changed `framing` moves the camera home."""
    ends = (*link.transmitters, *link.receivers) if link is not None else ()
    # depths are read at the distance of the first end that is in the water
    low = (*stage.center, stage.bottom)
    deep = next((end.center for end in ends if end.center[2] < 0.0), low)
    return {"center": stage.center, "half": stage.half, "top": stage.top, "bottom": stage.bottom,
            "framing": framing, "pole": list(deep[:2]), "deep": -deep[2]}  # fmt: skip


def sea_part(mesh: TriangleMesh, ring: Any) -> dict[str, bytes]:
    """Return the points and normals of a surface, and the points along its edge."""
    points = mesh.vertices
    arrays = {"points": points, "normals": mesh.vertex_normals, "ring": points[ring]}
    return {key: array.astype(np.float32).tobytes() for key, array in arrays.items()}


def map_part(coverage: CoverageMap) -> dict[str, Any]:
    """Return a map as an image coloured by `map_shades`."""
    half = 0.5 * float(coverage.x[1] - coverage.x[0])
    box = [float(v) for c in (coverage.x, coverage.y) for v in (c[0] - half, c[-1] + half)]
    pixels = np.ascontiguousarray(map_shades(coverage).transpose(1, 0, 2))
    return {"bytes": pixels.tobytes(), "n": len(coverage.x), "box": box}


def map_shades(coverage: CoverageMap) -> Any:
    """Return the colours (nx, ny, 4) of a map, in decibels below its peak; dark cells are clear."""
    relative = np.maximum(coverage.gain / max(float(coverage.gain.max()), 1e-300), 1e-30)
    share = np.clip(1.0 + 10.0 * np.log10(relative) / MAP_DB, 0.0, 1.0)
    shades = (255.0 * colormaps["viridis"](share)).astype(np.uint8)
    # a dark map lets the scene below it through
    shades[..., 3] = np.rint(255.0 * np.clip(0.1 + 1.2 * share, 0.0, 0.92))
    return shades


def look_part(
    link: Link | None,
    surface: MeshSource | TriangleMesh,
    mesh: TriangleMesh,
    daylight: Daylight | None,
) -> dict[str, Any]:
    """Return the illumination of the sea, and the waves that its mesh does not resolve."""
    wind = wind_of(surface)
    # a surface without a link is looked at by day
    day, sky_color = _sky_of(daylight or (DEFAULT_DAY if link is None else None))
    sea_light = SeaLight.from_link(link, day, wind)
    angle = math.radians(wind[1])
    # a breaking crest has a vertical normal, whose slope would be infinite
    slopes = mesh.vertex_normals[:, :2] / np.maximum(mesh.vertex_normals[:, 2:], 0.2)
    variances, least = left_out(mesh, longest_left_out(surface))
    tile = _tile((float(variances[0]), float(variances[1])), least, wind[1])
    upwelling = math.pi * WATER_BRIGHTNESS * sea_light.upwelling
    inside = np.array(_LEAST_INSIDE) * min(1.0, _MOST_INSIDE / float(upwelling.max()))
    # streaks are Gaussian: foam is where they exceed the quantile of its share
    foam = 1.1 * ndtri(1.0 - sea_light.foam) if sea_light.foam > 0.0 else 100.0
    glint = 0.0 if day is _DUSK else day.direct / day.irradiance
    return {
        "waves": tile, "rest": tile["rest"], "sky": _sky_image(day), "sun": list(day.sun),
        "tint": list(sky_color),
        "inside": np.maximum(1.6 * np.array(sky_color), inside).tolist(),
        "direct": glint, "foam": float(foam),
        "upwelling": upwelling.tolist(),
        "absorption": sea_light.absorption.tolist(), "wind": [math.cos(angle), math.sin(angle)],
        "height": max(float(mesh.vertices[:, 2].std()), 0.02),
        # of the sea around the block; no wind makes the slopes of a crest that hangs over
        "steepness": min(float(slopes.var(axis=0).sum()), 0.1),
    }  # fmt: skip


@lru_cache(maxsize=4)
def _tile(variances: tuple[float, float], least: float, wind_deg: float) -> dict[str, Any]:
    """Return a periodic tile of the slopes of unresolved waves and of foam; see `left_out`.

    Red and green are the slopes x and y over `scale`, blue the sum of their squares, of which
    smaller copies of the tile keep the mean; alpha has the streaks from -4 to 4.
    """
    # two of the longest waves left out, so that the repetition is not seen
    size = 4.0 * math.pi / least
    slopes, rest = short_waves(size, _TEXELS, variances, least, wind_deg)
    scale = 4.0 * max(float(slopes.std()), 1e-4)
    slopes = np.clip(slopes / scale, -1.0, 1.0).transpose(1, 0, 2)
    streaks = foam_streaks(4.0 * size, _TEXELS, wind_deg).T
    tile = np.dstack([0.502 + 0.498 * slopes, (slopes**2).sum(axis=2), (streaks + 4) / 8])
    pixels = np.rint(255.0 * np.clip(tile, 0.0, 1.0)).astype(np.uint8)
    return {"bytes": pixels.tobytes(), "n": _TEXELS, "size": size, "scale": scale,
            "rest": list(rest)}  # fmt: skip


def _sky_of(day: Daylight | None) -> tuple[Daylight, tuple[float, float, float]]:
    """Choose the sky to draw and its brightness; night is drawn as late dusk."""
    if day is None or day.light == "moonless night":
        return _DUSK, _DUSK_TINT
    if not is_day(day):
        return day, _MOON_TINT
    if day.direct == 0.0:
        return day, _CLOUD_TINT
    low = min(max(1.3 * day.sun[2], 0.1), 1.0) ** 0.8  # the sky over the irradiance is brighter
    red, green, blue = _DAY_TINT
    return day, (low * red, low * green, low * blue)


def _sky_image(day: Daylight) -> dict[str, Any]:
    """Return the sky as an image (16, 32) of root radiances, finer near the horizon."""
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


def segments(paths: PhotonPaths) -> Any:
    """Return path segments (n, 7): both ends [m], and the kind of light.

    Kinds are 0 for unscattered and 1 for scattered received light, 2 for light that landed
    elsewhere and 3 for that which ended in the water.
    """
    points, k = path_segments(paths)
    landed = paths.final == Vertex.LANDED
    kind = np.where(paths.received, paths.length > 3, np.where(landed, 2, 3))[points, None]
    ends = paths.vertex[points, k], paths.vertex[points, k + 1]
    return np.hstack([*ends, kind]).astype(np.float32)


def link_part(link: Link | None, stage: Stage) -> dict[str, Any]:
    """Return lamps, receivers and aircraft of a link, and the colour of its first lamp."""
    if link is None:
        still = dict.fromkeys(("lamps", "receivers", "carried"), ())
        water = DEFAULT_WATER
        return still | {"color": (0, 0, 0), "index": water.n, "extinction": water.c, "loss": 0,
                        "scattering": water.b, "plane": 0, "size": stage.size, "norm": 0,
                        "colors": {"receiver": (0, 0, 0), "rays": []}}  # fmt: skip
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
    rays = [light_shade(link.transmitters[0]), SCATTERED_COLOR, *list(FATE_COLORS.values())[1:]]
    return {
        "lamps": lamps, "receivers": receivers, "carried": [list(c) for c in parts.carried(link)],
        "color": light_color(link.transmitters[0].wavelength_nm), "index": link.water.n,
        "extinction": link.water.c, "scattering": link.water.b, "loss": _loss(link.water),
        "plane": plane, "size": stage.size,
        "norm": scale * _strength(link.transmitters[0]),
        "colors": {"receiver": to_rgb(RECEIVER_COLOR), "rays": [to_rgb(color) for color in rays]},
    }  # fmt: skip


def bodies_part(link: Link, stage: Stage) -> list[dict[str, Any]]:
    """Return the facets (n, 3, 3) of each body near the stage, by their corners, and its colour."""
    shown, reach = [], stage.half * np.array([-1.0, 1.0])
    for body in link.bodies:
        vertices, faces = body.triangles()
        corners = vertices[faces]
        middle = corners[..., :2].mean(axis=1) - stage.center
        within = ((reach[0] <= middle) & (middle <= reach[1])).all(axis=1)
        color = _DIM * np.array(to_rgb(BODY_COLORS[body.reflection]))
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
    """Return the beam of a lamp as emitted ("own"), and as it appears in the water."""
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
    """Return the axis and the shape of a beam.

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
