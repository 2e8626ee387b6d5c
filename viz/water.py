"""Appearance of water: sky and sun reflected by the waves, light from below, foam.

Physical: reflection by the normals, radiance of sky and glint, colour of the light that leaves the
water, variance of the short waves, share of foam. For looks, with constants tuned by eye: colours
of the sky, shapes of the foam, brighter crests, exposure.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from matplotlib.colors import to_hex
from numpy.typing import NDArray
from scipy import fft

from meshtrace.daylight.light import Daylight
from meshtrace.daylight.patterns import sky_radiance
from meshtrace.daylight.upward import connected_glint
from meshtrace.kernels.interface import Roughness
from meshtrace.link import Link, Whitecaps
from meshtrace.mesh import TriangleMesh
from meshtrace.optics.fresnel import fresnel_reflectance
from meshtrace.optics.pure_water import pure_water_absorption, sea_water_scattering
from meshtrace.optics.water import Water

from .style import to_srgb

Floats = NDArray[Any]  # of single or double precision

RGB_NM = np.array([610.0, 545.0, 465.0])
"""Wavelengths that stand for red, green and blue [nm]."""

DEFAULT_DAY = Daylight(direct=1.42, diffuse=0.295, sun_zenith_deg=50.0, sun_azimuth_deg=150.0)
"""Sun to the left behind the sea as seen by the default camera: glitter on a part of the waves."""

DEFAULT_WATER = Water()

_LEAST_IRRADIANCE = 1e-4  # of daylight rather than moon or night [W m-2 nm-1]

# Colours of the sky relative to its radiance, red to blue: for looks.
ZENITH_RGB = np.array([0.22, 0.52, 1.15])
HORIZON_RGB = np.array([0.66, 0.86, 1.06])
CLOUD_RGB = np.array([0.93, 0.97, 1.0])
FOAM_REFLECTANCE = 0.5  # tuned
WATER_BRIGHTNESS = 3.0
"""Factor on the light out of the water, so that its colour shows: for looks."""
EXPOSURE = 4.2
"""Brightness of a white, level surface before it is compressed to the range of the screen."""

MOST_WAVENUMBER = 1000.0
"""Wavenumber at which the short waves end that reflect light as facets [rad m-1]."""

LEAST_VARIANCE = 2e-4
"""Least slope variance within a point, tuned: with less, glint would be narrower than a pixel."""


@dataclass(frozen=True)
class SeaLight:
    """Light and water that determine the colour of a sea.

    Parameters
    ----------
    day : Daylight
        Sun and sky.
    water : Water
        Water whose colour is seen from above.
    wavelength_nm : float
        Wavelength of the coefficients of `water` [nm].
    foam : float
        Share of the surface under foam, 0 ... 1.
    wind_speed : float
        Wind speed, by which foam drifts [m s-1].
    wind_direction_deg : float
        Direction the wind blows to [deg].
    """

    day: Daylight = DEFAULT_DAY
    water: Water = DEFAULT_WATER
    wavelength_nm: float = 470.0
    foam: float = 0.0
    wind_speed: float = 0.0
    wind_direction_deg: float = 0.0

    @classmethod
    def from_link(
        cls, link: Link | None, day: Daylight | None, wind: tuple[float | None, float]
    ) -> SeaLight:
        """Return the light on the sea of a link; foam follows the wind of its whitecaps or the sea.

        Foam covers 2.95e-6 U^3.52 (Monahan and O'Muircheartaigh 1980), whatever the model of the
        link: others of its models cover a fifth of the sea at 15 m/s, which no photograph shows.

        `wind` is its speed [m s-1] and the direction it blows to [deg].
        """
        speed, direction = wind[0] or 0.0, wind[1]
        caps = link.whitecaps if link is not None else None
        caps = caps or Whitecaps(wind_speed=min(speed, 30.0))
        water, nm = cls.water, cls.wavelength_nm
        if link is not None:
            water, nm = link.water, link.transmitters[0].wavelength_nm
        foam = 1.0 - caps.replace(model="monahan80").transmittance
        return cls(day or DEFAULT_DAY, water, nm, foam, speed, direction)

    @cached_property
    def upwelling(self) -> NDArray[np.float64]:
        """Water-leaving radiance over the irradiance of the sea [sr-1], red to blue.

        Notes
        -----
        L / E = 0.33 b_b / (a pi n^2), Morel and Prieur (1977). The water has coefficients at one
        wavelength: from there its absorption beyond that of pure water is continued as
        exp(-0.014 (nm - nm_0)), and its scattering by particles as 1 / nm.
        """
        nm, water, pure_b = self.wavelength_nm, self.water, sea_water_scattering(RGB_NM)
        particle_b = max(water.b - float(sea_water_scattering(self._nm)), 0.0)
        # molecules scatter half of their light backwards
        backscattering = 0.5 * pure_b + water.phase.backscatter_fraction * particle_b * nm / RGB_NM
        return np.asarray(0.33 * backscattering / (self.absorption * math.pi * water.n**2))

    @cached_property
    def absorption(self) -> NDArray[np.float64]:
        """Absorption of the water [m-1], red to blue, continued as in `upwelling`."""
        excess = max(self.water.a - float(pure_water_absorption(self._nm)), 0.0)
        shape = np.exp(-0.014 * (RGB_NM - self.wavelength_nm))
        return np.asarray(pure_water_absorption(RGB_NM) + excess * shape)

    @property
    def _nm(self) -> float:
        """Wavelength, clipped to the tables of pure water [nm]."""
        return float(np.clip(self.wavelength_nm, 400.0, 700.0))


def short_waves(
    size: float,
    n: int,
    variances: tuple[float, float],
    least: float,
    direction_deg: float = 0.0,
    time: float = 0.0,
) -> tuple[NDArray[np.float32], tuple[float, float]]:
    """Return the slopes of waves too short for a mesh, on a periodic n by n lattice.

    Parameters
    ----------
    size : float
        Edge of the lattice and longest wave [m].
    n : int
        Points along the edge; waves shorter than 3.3 of their distances are left out.
    variances : tuple of float
        Slope variances along and across the wind of all waves that the mesh leaves out.
    least : float
        Wavenumber at which the waves begin that the mesh leaves out [rad m-1].
    direction_deg : float
        Direction the wind blows to [deg].
    time : float
        Time [s], by which the waves move downwind.

    Returns
    -------
    slopes : ndarray, shape (n, n, 2)
        Slopes along x and y.
    rest : tuple of float
        Slope variances along and across the wind that the lattice leaves out.

    Notes
    -----
    Equal slope variance in every octave of wavenumbers up to 1000 rad/m, the saturated range of
    Phillips (1958), with a density 1 + lean cos(2 theta) of directions that has both variances.
    """
    k_x = 2.0 * math.pi * fft.fftfreq(n, size / n)[:, None].astype(np.float32)
    k_y = k_x.T
    k = np.hypot(k_x, k_y)
    # tuned, 0.6 of the Nyquist wavenumber: waves of two points would show the lattice
    highest, total = min(0.6 * math.pi * n / size, MOST_WAVENUMBER), sum(variances)
    least = max(least, 2.0 * math.pi / size)
    # part of the octaves of variance that the lattice has
    resolved = math.log(max(highest / least, 1.0)) / math.log(max(MOST_WAVENUMBER / least, 1.01))
    resolved = min(resolved, 1.0)
    rest = (variances[0] * (1.0 - resolved), variances[1] * (1.0 - resolved))
    band = (k >= least) & (k <= highest)
    angle = np.arctan2(k_y, k_x) - math.radians(direction_deg)
    # 1 + lean cos(2 theta) has 1/2 + lean / 4 of the slope variance along, 1/2 - lean / 4 across
    lean = np.clip(2.0 * (variances[0] - variances[1]) / max(total, 1e-12), -1.0, 1.0)
    downwind = band & (np.cos(angle) > 0.0)
    if not downwind.any() or total <= 0.0:
        return np.zeros((n, n, 2), np.float32), variances
    k = np.maximum(k, 1e-6)
    # k^-4 over the area of wavenumbers: k^2 k^-4 k dk is equal for every octave
    power = np.where(downwind, (1.0 + lean * np.cos(2.0 * angle)) / k**4, 0.0)
    # the sum is over half of the plane: the real part of such waves has half of their variance
    power *= 2.0 * resolved * total / (power * k**2).sum()
    rng = np.random.default_rng(1)
    normal = rng.standard_normal((2, n, n), dtype=np.float32)
    # omega^2 = g k + T k^3, T = 7.4e-5 m3 s-2: surface tension over density
    phase = np.sqrt(9.81 * k + 7.4e-5 * k**3) * np.float32(time)
    spectrum = np.sqrt(0.5 * power) * (normal[0] + 1j * normal[1]) * np.exp(-1j * phase)
    # the spectrum of slopes is i k times that of the elevation; ifft2 divides by n^2
    spectrum = (1j * n * n * spectrum).astype(np.complex64)
    slopes = [fft.ifft2(k_axis * spectrum).real for k_axis in (k_x, k_y)]
    return np.stack(slopes, axis=-1).astype(np.float32), rest


@lru_cache(maxsize=2)
def foam_streaks(size: float, n: int, direction_deg: float) -> NDArray[np.float32]:
    """Return periodic noise of unit variance on an n by n lattice of edge `size` [m].

    It is stretched along the wind, which blows to `direction_deg`.
    """
    rng = np.random.default_rng(2)  # another seed than that of `short_waves`
    white = fft.rfft2(rng.standard_normal((n, n), dtype=np.float32))
    k_x = 2.0 * math.pi * fft.fftfreq(n, size / n)[:, None]
    k_y = 2.0 * math.pi * fft.rfftfreq(n, size / n)[None, :]
    wind = math.radians(direction_deg)
    along = k_x * math.cos(wind) + k_y * math.sin(wind)
    across = k_y * math.cos(wind) - k_x * math.sin(wind)
    total = np.zeros((n, n))
    # three sizes of streaks, tuned: length, width [m], weight
    for length, width, weight in ((1.8, 0.16, 1.0), (0.4, 0.07, 0.7), (0.05, 0.03, 0.8)):
        blur = np.exp(-0.5 * ((along * length) ** 2 + (across * width) ** 2))
        layer = fft.irfft2(white * blur, s=(n, n))
        total += weight * layer / max(float(layer.std()), 1e-12)
    return np.asarray(total / total.std(), np.float32)


def foam_cover(streaks: Floats, heights: Floats, share: float) -> Floats:
    """Return the opacity of foam, 0 ... 1, above a half on a given share of the points.

    Parameters
    ----------
    streaks : ndarray, shape (n,)
        Noise of `foam_streaks`.
    heights : ndarray, shape (n,)
        Elevation [m]; crests have more foam than troughs.
    share : float
        Share of the surface under foam.
    """
    if share <= 0.0:
        return np.zeros_like(streaks)
    # 0.7 and 0.9 are tuned: crests against streaks, softness of the edges
    score = streaks + 0.7 * (heights - heights.mean()) / max(float(heights.std()), 1e-6)
    # a share of the points scores more than the edge
    edge = np.quantile(score, max(1.0 - share, 0.0))
    return np.asarray(np.clip(0.5 + (score - edge) / 0.9, 0.0, 1.0))


def radiance(
    points: Floats,
    slopes: Floats,
    eye: tuple[float, float, float],
    sea_light: SeaLight,
    rest: tuple[float, float],
) -> NDArray[np.float64]:
    """Return the radiance from a sea to a viewer, relative to a white, level surface.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        Points of the sea [m].
    slopes : ndarray, shape (n, 2)
        Slopes of the surface there along x and y.
    eye : tuple of float
        Place of the viewer [m].
    sea_light : SeaLight
        Light and water, without the foam.
    rest : tuple of float
        Slope variances along and across the wind within a point.

    Returns
    -------
    ndarray, shape (n, 3)
        pi L / E, red to blue, with L = rho L_sky + L_glint + (1 - rho) L_water and E the irradiance
        of the day.
    """
    day, n_water = sea_light.day, sea_light.water.n
    normal = _unit(np.column_stack([-slopes, np.ones(len(slopes), slopes.dtype)]))
    view = _unit(np.asarray(eye, points.dtype) - points)
    cosine = np.clip(np.einsum("ij,ij->i", view, normal), 0.02, 1.0)
    mirrored = 2.0 * cosine[:, None] * normal - view
    # light from below the horizon was reflected twice: approximated by the sky mirrored up
    mirrored[:, 2] = np.abs(mirrored[:, 2])
    rho = fresnel_reflectance(cosine, 1.0, n_water)
    from_sky = rho[:, None] * sky_colors(day, mirrored)
    glint = np.zeros_like(rho)
    if day.direct > 0.0:
        wind = math.radians(sea_light.wind_direction_deg)
        along, across = (math.sqrt(max(v, LEAST_VARIANCE)) for v in rest)
        rough = Roughness(along, across, math.cos(wind), math.sin(wind))
        glint = connected_glint(
            view, np.asarray(day.sun, points.dtype), normal, normal, rough, n_water
        )
        # at grazing view, where waves hide each other, the formula has no bound: 2 is tuned
        glint = day.direct * np.minimum(glint, 2.0)
    # crests glow: tuned, +-35 % per standard deviation of the elevation [m]
    crest = points[:, 2] - points[:, 2].mean()
    glow = 1.0 + 0.35 * np.clip(crest / max(float(crest.std()), 0.02), -1.5, 2.0)
    water_light = math.pi * WATER_BRIGHTNESS * (1.0 - rho) * glow
    per_white = math.pi / day.irradiance * glint
    return np.asarray(from_sky + per_white[:, None] + water_light[:, None] * sea_light.upwelling)


def sky_colors(day: Daylight, directions: Floats) -> Floats:
    """Return the sky's radiance (n, 3) relative to a white, level surface, red to blue.

    Parameters
    ----------
    day : Daylight
        Sun and sky.
    directions : ndarray, shape (n, 3)
        Unit vectors to the sky.
    """
    # tuned: 0 under clouds to 1 for a clear sky, by the share of direct light; haze at the horizon
    clear = min(4.0 * day.direct / day.irradiance, 1.0)
    haze = np.exp(-4.0 * directions[:, 2:])
    haze_rgb = CLOUD_RGB + clear * (ZENITH_RGB - CLOUD_RGB + haze * (HORIZON_RGB - ZENITH_RGB))
    relative = math.pi / day.irradiance * sky_radiance(day.sky, directions)
    return np.asarray(relative[:, None] * haze_rgb)


def is_day(day: Daylight | None) -> bool:
    """Return whether a light is daylight rather than moonlight or night."""
    return day is not None and day.irradiance >= _LEAST_IRRADIANCE


def backdrop(day: Daylight) -> tuple[str, str]:
    """Return the background colours of a scene by day: deep water below, sky above."""
    # towards the horizon all around, at an elevation of 20 degrees
    azimuth = np.linspace(0.0, 2.0 * math.pi, 16, endpoint=False)
    level, up = math.cos(math.radians(20.0)), np.full(16, math.sin(math.radians(20.0)))
    towards = np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), up])
    # a bright sky would leave nothing to the white of rays and texts: _SHADE is tuned
    sky = screen_colors(_SHADE * sky_colors(day, towards).mean(axis=0, keepdims=True))
    return _DAY_DEEP, to_hex(sky[0] / 255.0)


_SHADE = 0.5
_DAY_DEEP = "#0D3346"


def _unit(vectors: Floats) -> Floats:
    """Normalise vectors (n, 3)."""
    return np.asarray(vectors / np.sqrt(np.einsum("ij,ij->i", vectors, vectors))[:, None])


def screen_colors(radiances: Floats, foam: Floats | None = None) -> NDArray[np.uint8]:
    """Convert radiances relative to white to colours (n, 3), 0 to 255, covered by any foam."""
    if foam is not None:
        radiances = radiances + foam[:, None] * (FOAM_REFLECTANCE - radiances)
    exposed = EXPOSURE * np.maximum(radiances, 0.0)
    linear = exposed / (1.0 + exposed)  # compressed below 1: glitter stays structured
    return np.ascontiguousarray(np.rint(255.0 * to_srgb(linear)), np.uint8)


class ShadedSea:
    """Colours of a sea for any viewer, at points finer than the vertices of a gridded mesh.

    Parameters
    ----------
    mesh : TriangleMesh
        The surface.
    sea_light : SeaLight
        Light and water.
    longest : float, optional
        Longest wave that the mesh leaves out [m]; at least, and by default, five of its edges.
    time : float
        Time of the short waves and of the foam [s].
    texels : int
        Points along the sides of a grid, and of the lattice of short waves.

    Attributes
    ----------
    grid : tuple of int or None
        Vertices along the sides of the mesh; None for other meshes, coloured at their vertices.
    """

    def __init__(
        self,
        mesh: TriangleMesh,
        sea_light: SeaLight,
        longest: float | None = None,
        time: float = 0.0,
        texels: int = 1024,
    ) -> None:
        self.grid, self._light, self._texels = grid_shape(mesh), sea_light, texels
        points, normals = mesh.vertices, mesh.vertex_normals
        if self.grid is not None:
            from scipy.ndimage import zoom  # here: coloured grids alone need it

            finer = (texels / self.grid[0], texels / self.grid[1], 1.0)
            points, normals = (
                zoom(v.reshape(*self.grid, 3), finer, order=1) for v in (points, normals)
            )
        self._points = points.reshape(-1, 3).astype(np.float32)
        normals = normals.reshape(-1, 3).astype(np.float32)
        low, high = mesh.bounds[:, :2]
        size = float((high - low).max())
        variances, least = left_out(mesh, longest)
        wind = sea_light.wind_direction_deg
        slopes, self._rest = short_waves(size, texels, variances, least, wind, time)
        # steep normals count as of a z component of 0.2 at least (tuned): no slope is infinite
        self._slopes = -normals[:, :2] / np.maximum(normals[:, 2:], 0.2)
        self._slopes += self._on_lattice(slopes, low, size)
        self._foam = None
        if sea_light.foam > 0.0:
            # foam drifts downwind with the surface, at 3 % of the wind speed
            angle, drift = math.radians(wind), 0.03 * sea_light.wind_speed * time
            start = low + drift * np.array([math.cos(angle), math.sin(angle)])
            streaks = self._on_lattice(foam_streaks(size, texels, wind), start, size)
            self._foam = foam_cover(streaks, self._points[:, 2], sea_light.foam)

    def _on_lattice(self, values: Floats, start: Floats, size: float) -> Floats:
        """Sample a periodic lattice of edge `size` [m], which begins at `start`, at all points."""
        n = len(values)
        i, j = np.floor((self._points[:, :2] - start) * (n / size)).astype(np.int64).T % n
        return values[i, j]

    def colors(self, eye: tuple[float, float, float]) -> NDArray[np.uint8]:
        """Return the colours seen from a place [m], (n, 3), or (texels, texels, 3) of a grid."""
        radiances = radiance(self._points, self._slopes, eye, self._light, self._rest)
        colors = screen_colors(radiances, self._foam)
        return colors.reshape(self._texels, self._texels, 3) if self.grid else colors


def left_out(mesh: TriangleMesh, longest: float | None) -> tuple[tuple[float, float], float]:
    """Return the slope variances and the least wavenumber of the waves that a mesh leaves out.

    The variances are those along and across the wind; the wavenumber [rad m-1] is that of `longest`
    [m], but of a wave of five edges where that is longer, or by default.
    """
    edge = float(np.ptp(mesh.vertices[mesh.faces[0]], axis=0)[:2].max())
    # 5 edges: linear between vertices, such a wave has lost a quarter of its slope variance
    least = 0.4 * math.pi / max(edge, 1e-6)
    least = min(2.0 * math.pi / longest, least) if longest else least
    return (0.0, 0.0) if mesh.unresolved is None else mesh.unresolved.vertex, least


def grid_shape(mesh: TriangleMesh) -> tuple[int, int] | None:
    """Return the number of vertices along x and y of a triangulated grid, None for other meshes."""
    # vertices are numbered i ny + j; the first facet is (0, ny, ny + 1)
    ny = int(mesh.faces[0, 1])
    nx, left = divmod(len(mesh.vertices), max(ny, 1))
    if left or nx < 2 or ny < 2 or len(mesh.faces) != 2 * (nx - 1) * (ny - 1):
        return None
    within = mesh.faces - mesh.faces.min(axis=1, keepdims=True)  # offsets of corners in a cell
    return (nx, ny) if np.isin(within, (0, 1, ny - 1, ny, ny + 1)).all() else None
