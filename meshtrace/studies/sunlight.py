"""Sunlight at a depth under waves: data that all times share, and the light at one of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import j1

from meshtrace.daylight.light import SUN_RADIUS_DEG, Daylight
from meshtrace.engine.backward.background import background
from meshtrace.engine.setup.meshing import GAIN_SPACING
from meshtrace.engine.setup.options import IrradianceMap
from meshtrace.engine.simulate import simulate
from meshtrace.errors import Described, Refused
from meshtrace.kernels.sources import land_sunlight
from meshtrace.link import AirLed, IrradiancePlanes, Link, Sun, WaterReceiver
from meshtrace.models import Floats
from meshtrace.optics.fresnel import fresnel_reflectance
from meshtrace.optics.water import Water
from meshtrace.results.background import PARTS
from meshtrace.surfaces import FlatSea, Surface
from meshtrace.surfaces.surface import WaveSurface
from meshtrace.surfaces.waves import WaveComponents, WaveGrid, elevation_and_slopes

_ERROR = 1e-6  # of the sums of waves
_SLOPES = 4.5  # standard deviations of the slopes that may bend light onto the collector
_RAYS = 6.0  # over the blur
_CELLS = 2.0  # over the blur
_BLURS = 4.0  # standard deviations of tilts
_MOST_POINTS = 4_000_000  # of a grid
_SCATTERED = 0.05  # of the depth: the part of the scattered light that follows the pattern


class SunRay(NamedTuple):
    """Unscattered sunlight below still water."""

    sun: tuple[float, float, float]
    direct: float  # across the sunlight in the air [W m-2 nm-1]
    n: float  # of the water, relative to the air
    sine: float  # in the water
    cosine: float
    turn: float  # azimuth of the sun [rad]
    entering: float  # irradiance that enters the water [W m-2 nm-1]
    c: float  # attenuation of the water [m-1]

    @classmethod
    def of(cls, day: Daylight, water: Water) -> SunRay:
        """Return the sunlight of a day in a water."""
        n = water.n / Link().n_air
        sine = math.sin(math.radians(day.sun_zenith_deg)) / n
        cosine = math.sqrt(1.0 - sine**2)
        entering = day.direct * day.sun[2]
        entering *= 1.0 - float(fresnel_reflectance(day.sun[2], 1.0, n))
        turn = math.radians(day.sun_azimuth_deg)
        return cls(day.sun, day.direct, n, sine, cosine, turn, entering, water.c)

    def at(self, depth: float) -> float:
        """Return the downward irradiance at a depth [W m-2 nm-1]."""
        return self.entering * math.exp(-self.c / self.cosine * depth)

    def entry(self, depth: float) -> tuple[float, float]:
        """Return the point of the surface from which light comes to a depth below the origin."""
        away = depth * self.sine / self.cosine
        return away * math.cos(self.turn), away * math.sin(self.turn)

    def lever(self, depth: float) -> float:
        """Return the displacement of the light at a depth by a unit of slope [m]."""
        return depth * (1.0 - self.sun[2] / (self.n * self.cosine)) / self.cosine**2

    def disk(self, depth: float) -> tuple[float, float]:
        """Return the half-axes of the image of the sun at a depth, along and across its light."""
        across = math.radians(SUN_RADIUS_DEG) * depth / (self.n * self.cosine)
        return across * self.sun[2] / self.cosine**2, across


class Collector(NamedTuple):
    """Disk whose irradiance is computed, and the patch about it.

    Parameters
    ----------
    radius : float
        Radius [m].
    floating : bool
        Whether its depth counts from the mean height of the waves over it.
    patch : (float, float), optional
        Half-length of the patch and edge of its cells [m].
    fineness : float
        Factor on the number of surface points along an axis.
    """

    radius: float
    floating: bool
    patch: tuple[float, float] | None
    fineness: float

    @property
    def cells(self) -> Floats | None:
        """Centres of the cells of the patch along an axis [m]."""
        if self.patch is None:
            return None
        half, step = self.patch
        n = math.ceil(half / step - 1e-9)
        return step * (np.arange(2 * n + 1.0) - n)


class _Scattered(NamedTuple):
    """Light at a depth that is not unscattered sunlight."""

    sunlight: float
    spread: Callable[[float, int], Floats] | None  # shares on the cells about the unscattered ray
    sky: float


class _Grids(NamedTuple):
    """Points of the surface and cells of a plane at a depth."""

    x: Floats
    y: Floats
    cells: int  # along an axis
    cell: float  # edge [m]
    support: float  # half-length of the light of the collector [m]


class _Kernels(NamedTuple):
    """Shares of the light of a cell in the irradiance at the collector, and their transforms."""

    direct: Floats
    scattered: Floats
    transfer: NDArray[np.complex128]
    scattered_transfer: NDArray[np.complex128]


class DepthPlan(NamedTuple):
    """Light at a depth, as far as all times share it."""

    sea: Surface
    depth: float
    ray: SunRay
    collector: Collector
    waves: WaveComponents | None  # None: a surface that is no sum of waves
    grid: WaveGrid | None
    grids: _Grids
    kernels: _Kernels
    still: float  # irradiance of unscattered sunlight
    scattered: _Scattered

    @classmethod
    def of(
        cls,
        sea: Surface,
        ray: SunRay,
        depth: float,
        band: float | None,
        collector: Collector,
        scattered: _Scattered,
    ) -> DepthPlan:
        """Return the grids and kernels of a depth, for waves up to a frequency `band` [rad s-1]."""
        waves, shortest, slope, height = _waves(sea, band)
        lever = ray.lever(depth)
        if band is not None:
            tilts = np.sqrt(sea.slopes_beyond(band)) * lever  # type: ignore[attr-defined]
        else:
            missing = sea.unresolved_slopes(GAIN_SPACING / shortest if shortest else 1.0)
            tilts = lever * np.sqrt((0.0, 0.0) if missing is None else missing.vertex)
        trough = 0.0 if collector.floating else _SLOPES * height
        if trough >= depth:
            allowed = f'> {trough:.3g} m, below all troughs, or below = "waves"'
            raise Refused("depths", depth, allowed)
        finest = GAIN_SPACING / shortest if shortest else math.inf
        bent = _SLOPES * lever * slope + trough * ray.sine / ray.cosine
        around = 0.0 if scattered.spread is None else _SCATTERED * depth
        grids = _grids(depth, ray, collector, tilts, finest, bent, around)
        wind = math.radians(getattr(sea, "_slopes_along_deg", 0.0))
        blur = _transfer(grids, collector.radius, ray.disk(depth), ray.turn, tilts, wind)
        kernels = _kernels(grids, blur, collector.radius, scattered.spread)
        grid = None if waves is None else WaveGrid(waves.kx, waves.ky, grids.x, grids.y, _ERROR)
        return cls(
            sea, depth, ray, collector, waves, grid, grids, kernels, ray.at(depth), scattered
        )

    @property
    def points(self) -> int:
        """Number of surface points."""
        return len(self.grids.x) * len(self.grids.y)

    @property
    def spacing(self) -> float:
        """Distance of the surface points [m]."""
        return float(self.grids.x[1] - self.grids.x[0])

    def at(self, time: float) -> tuple[float, float, Floats]:
        """Return irradiance, its unscattered part, and the pattern over the cells of the patch."""
        light, cells = self._landed(time), self.collector.cells
        unscattered, follows = float((light * self.kernels.direct).sum()), 0.0
        if self.scattered.sunlight > 0.0:
            relative = light / self.still - 1.0
            follows = float((relative * self.kernels.scattered).sum())
        rest = self.scattered.sky + self.scattered.sunlight
        total = unscattered + self.scattered.sunlight * follows + rest
        pattern = np.zeros(0) if cells is None else self._pattern(light, cells) + rest
        return total, unscattered, pattern

    def _pattern(self, light: Floats, cells: Floats) -> Floats:
        """Return the sunlight of the collector over a patch, less the mean of scattered light."""
        found = np.fft.ifft2(np.fft.fft2(light) * self.kernels.transfer).real
        if self.scattered.sunlight > 0.0:
            relative = np.fft.fft2(light / self.still - 1.0) * self.kernels.scattered_transfer
            found += self.scattered.sunlight * np.fft.ifft2(relative).real
        stride = round(float(cells[1] - cells[0]) / self.grids.cell)
        first = len(light) // 2 - stride * (len(cells) // 2)
        part = slice(first, first + stride * len(cells), stride)
        return np.asarray(found[part, part])

    def _landed(self, time: float) -> Floats:
        """Return the irradiance of unscattered sunlight on the cells of a plane."""
        x, y, cells, cell, _ = self.grids
        if self.grid is None or self.waves is None:
            z, zx, zy = self.sea.grid(x, y, time)
        else:
            z, zx, zy = self.grid.sum(elevation_and_slopes(self.waves, time))
        if self.collector.floating:
            z = z - z.mean()
        light = np.zeros((cells, cells))
        corner, low = (float(x[0]), float(y[0])), -0.5 * (cells + 1) * cell
        # the collector is over the middle of a cell
        land_sunlight(
            z, zx, zy, corner, self.spacing, self.ray.sun, self.ray.n, self.ray.c, self.depth,
            (low, low), cell, light,
        )  # fmt: skip
        return light * (self.ray.direct / cell**2)


def scattered_light(
    day: Daylight, water: Water, ray: SunRay, depth: float, photons: int, seed: int
) -> _Scattered:
    """Return the scattered sunlight and the light of the sky at a depth, under still water."""
    sky = 0.0
    if day.diffuse > 0.0:
        ends = {"transmitter": AirLed(wavelength_nm=day.wavelength_nm),
                "receiver": WaterReceiver(depth=depth, radius=0.01, fov_deg=180.0)}  # fmt: skip
        link, count = Link(water=water, **ends), 32 * max(1, photons // 32)
        seen = background(link, FlatSea(), day, photons=count, seed=seed, threads=1)
        sky = math.pi * float(seen.part_radiance[PARTS.index("sky")])
    if water.b == 0.0:
        return _Scattered(0.0, None, sky)
    pencil = Sun(
        zenith_deg=day.sun_zenith_deg, azimuth_deg=(day.sun_azimuth_deg + 180.0) % 360.0,
        half_width=1e-6 * depth, position=ray.entry(depth),
    )  # fmt: skip
    link = Link(
        water=water, transmitter=pencil, receiver=(), planes=IrradiancePlanes(depths=(depth,))
    )
    run = partial(
        simulate, link, FlatSea(), estimator="analog", photons=photons, seed=seed, threads=1
    )
    level = day.direct * day.sun[2]
    straight, planes = ray.at(depth) / level, run().planes
    assert planes is not None
    share = max(float(planes.e_d[0]) - straight, 0.0)
    return _Scattered(level * share, partial(_spread, run, depth, straight, share), sky)


def _spread(
    run: Callable[..., Any], depth: float, straight: float, share: float, half: float, n: int
) -> Floats:
    """Return the shares of the scattered light on n by n cells (odd) over |x|, |y| <= half [m]."""
    step = 2.0 * half / n
    record = IrradianceMap(height=-depth, extent=half, step=step, axis=(0.0, 0.0, -1.0))
    found = run(record=[record]).map
    power = np.array(found.irradiance) * step**2
    power[n // 2, n // 2] -= straight
    return np.asarray(np.maximum(power, 0.0) / max(share, 1e-300))


def _grids(
    depth: float,
    ray: SunRay,
    collector: Collector,
    tilts: Floats,
    finest: float,
    bent: float,
    around: float,
) -> _Grids:
    """Return the points of the surface and the cells of a plane.

    Waves bend light by up to `bent` [m]; cells reach `around` [m] beyond the collector's light.
    """
    disk, patch = ray.disk(depth), collector.patch
    blur = math.sqrt(0.25 * collector.radius**2 + 0.25 * disk[1] ** 2 + tilts.max() ** 2)
    cell = blur / _CELLS
    if patch is not None:
        cell = patch[1] / math.ceil(patch[1] / cell)
    spacing = min(blur / _RAYS, finest)
    spacing = cell / math.ceil(collector.fineness * cell / spacing)  # even light on still water
    support = collector.radius + disk[0] + _BLURS * float(tilts.max())
    half = max(support + around, 0.0 if patch is None else patch[0] + support) + 3.0 * cell
    cells = 2 * math.ceil(half / cell)
    points = 2 * math.ceil((0.5 * cells * cell + bent + 2.0 * spacing) / spacing) + 1
    if points**2 > _MOST_POINTS:
        found = Described(f"{points:,} by {points:,} points of the sea at {depth:g} m")
        allowed = f"at most {_MOST_POINTS:,}: a wider collector, lower omega_max or smaller patch"
        raise Refused("depths", found, allowed)
    lines: Floats = spacing * (np.arange(points, dtype=np.float64) - points // 2)
    x, y = ray.entry(depth)
    return _Grids(x + lines, y + lines, cells, cell, support)


def _kernels(
    grids: _Grids, blur: Floats, radius: float, spread: Callable[[float, int], Floats] | None
) -> _Kernels:
    """Return the kernels of unscattered light and of the pattern of scattered light.

    The light of a cell counts by the way from it to the collector.
    """
    cells, cell = grids.cells, grids.cell
    wide = np.zeros_like(blur, complex)
    if spread is not None:
        shares = np.zeros((cells, cells))
        shares[1:, 1:] = spread(0.5 * (cells - 1) * cell, cells - 1)
        shares = np.fft.ifftshift(shares)
        wide = np.fft.fft2(shares) * _disk(*_wavenumbers(cells, cell), radius)
    direct, scattered = (np.fft.fftshift(np.fft.ifft2(t.conj()).real) for t in (blur, wide))
    lines = cell * (np.arange(cells) - cells // 2)
    far = np.hypot(lines[:, None], lines) > grids.support + cell
    direct[far] = 0.0  # the ripple of a sharp edge
    direct /= direct.sum()
    transfer = np.asarray(np.fft.fft2(np.fft.ifftshift(direct)))
    return _Kernels(direct, scattered, transfer, wide)


def _waves(sea: Surface, band: float | None) -> tuple[WaveComponents | None, float, float, float]:
    """Return the waves up to a frequency, the largest wavenumber, and rms slope and height."""
    if not isinstance(sea, WaveSurface):
        flat = isinstance(sea, FlatSea)
        return None, 0.0, 0.0 if flat else 0.3, 0.0
    waves = sea.components
    kept = waves.amplitude != 0.0
    if band is not None:
        kept &= waves.omega <= band * (1.0 + 1e-9)
    waves = WaveComponents(*(a[kept] for a in waves))
    k = np.hypot(waves.kx, waves.ky)
    slope = math.sqrt(0.5 * float(np.square(waves.amplitude * k).sum()))
    height = math.sqrt(0.5 * float(np.square(waves.amplitude).sum()))
    return waves, float(k.max(initial=0.0)), min(slope, 0.4), height


def _wavenumbers(cells: int, cell: float) -> tuple[Floats, Floats]:
    k = 2.0 * math.pi * np.fft.fftfreq(cells, cell)
    kx, ky = np.meshgrid(k, k, indexing="ij")
    return kx, ky


def _disk(kx: Floats, ky: Floats, radius: float) -> Floats:
    """Return the transform of the mean over a disk."""
    r = np.maximum(radius * np.hypot(kx, ky), 1e-6)
    return np.asarray(2.0 * j1(r) / r)


def _transfer(
    grids: _Grids,
    radius: float,
    disks: Sequence[float],
    turn: float,
    tilts: Floats,
    wind: float,
) -> Floats:
    """Return the transform of collector, sun's image and tilts, less the sharing by cells."""
    cell = grids.cell
    kx, ky = _wavenumbers(grids.cells, cell)

    def turned(angle: float) -> tuple[Floats, Floats]:
        c, s = math.cos(angle), math.sin(angle)
        return kx * c + ky * s, ky * c - kx * s

    along, across = turned(turn)
    sun = _disk(disks[0] * along, disks[1] * across, 1.0)
    along, across = turned(wind)
    tilt = np.exp(-0.5 * ((tilts[0] * along) ** 2 + (tilts[1] * across) ** 2))
    shared = (np.sinc(kx * cell / (2.0 * np.pi)) * np.sinc(ky * cell / (2.0 * np.pi))) ** 2
    return np.asarray(_disk(kx, ky, radius) * sun * tilt / shared)
