"""Pattern of unscattered light on the plane of the receiver, without noise."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Annotated, Any

import numpy as np
from scipy.interpolate import RectBivariateSpline

from meshtrace.checks import Inside, check_call
from meshtrace.engine.backward.view import optical_depth
from meshtrace.engine.setup.meshing import GAIN_SPACING
from meshtrace.engine.setup.options import Run, resolve
from meshtrace.errors import Described, Refused, require_between
from meshtrace.link import IsotropicSource, Led, Link, Receiver
from meshtrace.mesh import WaveSum
from meshtrace.models import Floats
from meshtrace.optics.fresnel import fresnel_reflectance, refract
from meshtrace.results.provenance import provenance
from meshtrace.results.series import CoverageMap
from meshtrace.surfaces import FlatSea, Surface
from meshtrace.surfaces.waves import WaveComponents

_RAYS = 5.0  # over the edge of a cell: fewer show as lines in the dark
_ROWS = 2**18  # rays that are refracted at a time
_MOST_CELLS = 2000  # along the map
_SLOPES = 4.5  # standard deviations of the slopes that may bend light onto the map


@check_call
def light_pattern(
    link: Link,
    surface: Annotated[Surface, Inside()],
    extent: float = 2.0,
    step: float = 0.01,
    *,
    time: float = 0.0,
) -> CoverageMap:
    r"""Return the gain of unscattered light over the plane of the receiver.

    Every element of the surface sends its light to the place where its refracted ray meets the
    plane. The pattern shows the caustics of the sea.

    .. math:: G(x) = \pi r^2 \sum_{x' = x} I(w) T e^{-c l}
        \left| \frac{\partial \Omega}{\partial x'} \right|

    Parameters
    ----------
    link : Link
        The link: an LED or isotropic source in the water; height, radius, axis and field of view of
        its receiver are used.
    surface : Surface
        The sea.
    extent : float
        The map covers |x|, |y| <= extent about the receiver [m], > 0.
    step : float
        Edge of a cell [m], extent / 1000 to extent / 4.
    time : float
        Time of the sea [s].

    Returns
    -------
    CoverageMap
        Gains without noise; `gain_stderr` is 0.

    Raises
    ------
    Refused
        If an option is out of range, or the link or the surface is of another kind.

    Notes
    -----
    Rays lie on a grid of a fifth of a cell, between points of the surface at 0.45 / k of its
    shortest waves (cubic splines). Their light is shared out between the four nearest cells. Waves
    that the sea leaves out blur the pattern by a Gaussian of the standard deviation
    (n - 1) h sigma along and across the wind, the displacement of steep light by their slopes
    sigma (`Physics.unresolved`). Light that meets a second wave in the air is not followed. Depths
    of layers and bubbles count from the mean level.

    Examples
    --------
    >>> import meshtrace as mt
    >>> from meshtrace.surfaces import FlatSea
    >>> pattern = mt.light_pattern(mt.Link(), FlatSea(), extent=0.1, step=0.02)
    >>> float(pattern.gain.mean().round(7))
    4.51e-05
    """
    case = resolve(link, surface)
    link, sea = case.link, case.surface
    source, receiver = pattern_ends(link, sea, extent, step)
    assert isinstance(sea, Surface)
    extent, step = float(extent), float(step)
    n = math.ceil(extent / step - 1e-9)
    shortest, slope, height = wave_sizes(sea, resolved_waves(sea))
    spacing = shortest if math.isfinite(shortest) else step
    beyond, wind = _beyond(link, sea, spacing)
    # a slope s turns the refracted ray by (n - 1) s at steep incidence, and the height is its lever
    blur = (link.water.n / link.n_air - 1.0) * receiver.height * np.sqrt(beyond) / step
    # beyond the map, so that the blur brings light in as it takes light out
    margin = math.ceil(4.0 * blur.max()) + 1
    energy = np.zeros((2 * (n + margin), 2 * (n + margin)))
    center = np.array(receiver.position)
    # points of a choppy sea are off their labels
    off = _SLOPES * height if getattr(sea, "choppy", False) else 0.0
    labels = _labels(link, step * (n + margin), spacing, slope, off)
    below = optical_depth(link, -source.center[2])
    for points, normals in _strips(sea.sheet(*labels, time), labels, step / _RAYS):
        place, flux = _landed(link, below, points, normals)
        _share_out(energy, (place - center) / step + (n + margin), flux)
    gain = math.pi * receiver.radius**2 / step**2 * _blurred(energy, blur, wind)
    gain = np.maximum(gain[margin : margin + 2 * n, margin : margin + 2 * n], 0.0)
    cells = step * (np.arange(2 * n, dtype=np.float64) - n + 0.5)
    x, y = np.add(receiver.position[0], cells), np.add(receiver.position[1], cells)
    origin = provenance(link, sea.to_config(), Run().to_config())
    origin |= {"times": [time], "extent": extent, "step": step}
    return CoverageMap(x, y, gain, np.zeros_like(gain), origin)


def pattern_ends(link: Link, surface: Any, extent: float, step: float) -> tuple[Any, Receiver]:
    """Return source and receiver of a link; refuse inputs without a pattern."""
    extent = require_between(extent, 0.0, math.inf, "extent")
    least, most = 2.0 * extent / _MOST_CELLS, 0.25 * extent
    allowed = f"{least:g} to {most:g} m, extent / 4"
    require_between(step, least, most, "step", "[]", allowed)
    source = link.transmitter
    if not isinstance(source, Led | IsotropicSource):
        kinds = ", ".join(t.kind for t in link.transmitters)
        raise Refused("transmitter", Described(kinds), "one LED or isotropic source")
    if not isinstance(surface, Surface):
        raise Refused("surface", Described(type(surface).__name__), "a sea (Surface)")
    return source, link.only_receiver


def resolved_waves(sea: Surface, highest: float | None = None) -> WaveComponents | None:
    """Return the waves of a sea up to a frequency [rad s-1]; None unless it is a sum of waves."""
    if not isinstance(sea, WaveSum):
        return None
    waves = sea.components
    resolved = waves.amplitude != 0.0
    if highest is not None:
        resolved &= waves.omega <= highest * (1.0 + 1e-9)
    return WaveComponents(*(a[resolved] for a in waves))


def wave_sizes(sea: Surface, waves: WaveComponents | None) -> tuple[float, float, float]:
    """Return the distance of points [m] that represents the waves of a sea, rms slope and height.

    The distance is infinite without waves, the height in metres.
    """
    if waves is None:
        return math.inf, 0.0 if isinstance(sea, FlatSea) else 0.3, 0.0
    k, half = np.hypot(waves.kx, waves.ky), 0.5 * np.square(waves.amplitude)
    spacing = GAIN_SPACING / float(k.max()) if k.any() else math.inf
    return spacing, math.sqrt((half * k**2).sum()), math.sqrt(half.sum())


def _beyond(link: Link, sea: Surface, spacing: float) -> tuple[Floats, float]:
    """Return variances of random slopes along and across the wind, and the wind direction [rad]."""
    slopes = sea.unresolved_slopes(spacing) if link.physics.unresolved == "tilt" else None
    if slopes is None:
        return np.zeros(2), 0.0
    if any(slopes.cumulants):
        raise Refused("slope_law", Described("not Gaussian"), "gaussian: the blur is Gaussian")
    return np.array(slopes.vertex), math.radians(slopes.direction_deg)


def _labels(
    link: Link, half: float, spacing: float, slope: float, off: float
) -> tuple[Floats, Floats]:
    """Return the grid lines of the surface whose light may reach |x|, |y| <= half [m]."""
    receiver, source = link.only_receiver, link.transmitters[0]
    n = link.water.n / link.n_air
    # of the way from the source to the receiver, small angles: depth / (depth + n h)
    share = getattr(source, "depth", 1.0) / (getattr(source, "depth", 1.0) + n * receiver.height)
    start, end = np.array(source.position), np.array(receiver.position)
    lever = (n - 1.0) * receiver.height * share
    bent = _SLOPES * lever * slope / math.sqrt(2.0)  # along one axis
    reach = share * half + bent + off + 4.0 * spacing
    lines = np.arange(-reach, reach + spacing, spacing)
    x, y = start + share * (end - start)
    return float(x) + lines, float(y) + lines


def _strips(
    sheet: tuple[Floats, Floats], labels: tuple[Floats, Floats], distance: float
) -> Iterator[tuple[Floats, Floats]]:
    """Yield points and normals (nx, ny, 3), interpolated between the points of a sheet."""
    splines = [RectBivariateSpline(*labels, a[..., i]) for a in sheet for i in range(3)]
    u, v = (np.arange(a[0], a[-1], distance) for a in labels)
    lines = max(2, _ROWS // len(v))
    for first in range(0, len(u) - 1, lines):
        at = u[first : first + lines + 1]  # with the first row of the next strip
        grid = np.stack([spline(at, v) for spline in splines], axis=-1)
        yield grid[..., :3], grid[..., 3:]


def _landed(
    link: Link, below: Callable[[Floats], Floats], points: Floats, normals: Floats
) -> tuple[Floats, Floats]:
    """Return where the light of the surface lands on the plane (m, 2), and its flux (m,).

    `below` gives the vertical optical depth from heights z down to the source.
    """
    source: Any = link.transmitter
    receiver = link.only_receiver

    def middle(a: Floats) -> Floats:
        return 0.25 * (a[:-1, :-1] + a[1:, :-1] + a[:-1, 1:] + a[1:, 1:])

    first, second = points[1:, 1:] - points[:-1, :-1], points[:-1, 1:] - points[1:, :-1]
    # half the cross product of the diagonals of a cell
    area = 0.5 * np.cross(first, second)
    at, normal = middle(points), middle(normals)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    ray = at - np.array(source.center)
    way = np.linalg.norm(ray, axis=-1)
    ray /= way[..., None]
    cos_i = np.clip((ray * normal).sum(axis=-1), 0.0, 1.0)
    n_water, n_air = link.water.n, link.n_air
    flux = _intensity(source, ray) * (ray * area).sum(axis=-1) / way**2
    # what is scattered once is not in the pattern; rays are straight through level layers
    # (1e-9 m: a wave may reach down to a shallow source)
    slant = way / np.maximum(at[..., 2] - source.center[2], 1e-9)
    flux *= np.exp(-below(at[..., 2]) * slant)
    flux *= 1.0 - fresnel_reflectance(cos_i, n_water, n_air)
    flux *= link.whitecaps.transmittance if link.whitecaps else 1.0
    out = refract(ray, normal, n_water, n_air)
    seen = (out * np.array(receiver.axis)).sum(axis=-1)
    seen_enough = seen >= math.cos(math.radians(0.5 * receiver.fov_deg))
    up = np.where(np.isfinite(out[..., 2]) & (out[..., 2] > 0.0) & seen_enough, out[..., 2], np.nan)
    place = at[..., :2] + (receiver.height - at[..., 2:]) * out[..., :2] / up[..., None]
    lands = np.isfinite(place[..., 0]) & (flux > 0.0)
    return place[lands], (flux * seen / up)[lands]


def _intensity(source: Any, ray: Floats) -> Floats:
    """Return the intensity [sr-1] per unit power along rays (..., 3)."""
    if isinstance(source, IsotropicSource):
        return np.full(ray.shape[:-1], 0.25 / math.pi)
    m, cosine = source.order, np.maximum((ray * np.array(source.axis)).sum(axis=-1), 0.0)
    return np.asarray(0.5 * (m + 1.0) / math.pi * cosine**m)


def _share_out(energy: Floats, place: Floats, flux: Floats) -> None:
    """Add fluxes to the four cells around places (m, 2), in cells from the corner of the map."""
    low = np.floor(place - 0.5)
    part, cell = place - 0.5 - low, low.astype(np.int64)
    inside = ((cell >= 0) & (cell < np.array(energy.shape) - 1)).all(axis=1)
    cell, part, flux = cell[inside], part[inside], flux[inside]
    corner = cell[:, 0] * energy.shape[1] + cell[:, 1]
    for i in (0, 1):
        for j in (0, 1):
            weight = np.abs(1 - i - part[:, 0]) * np.abs(1 - j - part[:, 1]) * flux
            at = corner + i * energy.shape[1] + j
            # bincount adds repeated indices, which indexing would not
            energy += np.bincount(at, weight, energy.size).reshape(energy.shape)


def _blurred(energy: Floats, blur: Floats, wind: float) -> Floats:
    """Return the light convolved with a Gaussian, standard deviations in cells along the wind."""
    if not blur.any():
        return energy
    lines, columns = energy.shape
    window = gaussian(*wavenumbers(lines, columns, 1.0), blur, wind)
    return np.asarray(np.fft.ifft2(np.fft.fft2(energy) * window).real)


def wavenumbers(nx: int, ny: int, cell: float) -> tuple[Floats, Floats]:
    """Return the wavenumbers of a discrete transform of cells, shape (nx, ny)."""
    along = (2.0 * math.pi * np.fft.fftfreq(n, cell) for n in (nx, ny))
    kx, ky = np.meshgrid(*along, indexing="ij")
    return kx, ky


def turned(kx: Floats, ky: Floats, angle: float) -> tuple[Floats, Floats]:
    """Return the components along an azimuth [rad] and across it."""
    c, s = math.cos(angle), math.sin(angle)
    return kx * c + ky * s, ky * c - kx * s


def gaussian(kx: Floats, ky: Floats, widths: Floats, angle: float) -> Floats:
    """Return the transform of a Gaussian, standard deviations along an azimuth and across it."""
    along, across = turned(kx, ky, angle)
    return np.asarray(np.exp(-0.5 * ((widths[0] * along) ** 2 + (widths[1] * across) ** 2)))
