"""Downward irradiance at depths under a moving sea, fast enough for flashes of milliseconds."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from time import process_time
from typing import Any, Literal, NamedTuple, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import j1

from meshtrace.daylight.light import SUN_RADIUS_DEG, Daylight
from meshtrace.engine.backward.background import background
from meshtrace.engine.setup.meshing import GAIN_SPACING
from meshtrace.engine.setup.options import IrradianceMap, RunOptions, require_options
from meshtrace.engine.simulate import simulate
from meshtrace.errors import (
    Described,
    Refused,
    require_between,
    require_finite,
    require_kind,
    require_pair,
    require_whole,
    require_word,
)
from meshtrace.fading.resolving import fading_band
from meshtrace.kernels.sunlight import land_sunlight
from meshtrace.link import AirLed, IrradiancePlanes, Link, Sun, WaterReceiver
from meshtrace.models import Floats
from meshtrace.optics.fresnel import fresnel_reflectance
from meshtrace.optics.water import Water
from meshtrace.results.background import PARTS
from meshtrace.results.irradiance import IrradianceSeries
from meshtrace.results.provenance import environment
from meshtrace.studies.campaign import campaign_of
from meshtrace.studies.store import digest_of
from meshtrace.surfaces import FlatSea, Surface
from meshtrace.surfaces.surface import WaveSurface
from meshtrace.surfaces.waves import WaveComponents, WaveGrid, elevation_and_slopes

_SUN_HEIGHT = 1e6  # [m], of a lamp in place of the sun
_ERROR = 1e-6  # of the sums of waves
_SLOPES = 4.5  # standard deviations of the slopes that may bend light onto the collector
_RAYS = 6.0  # over the blur
_CELLS = 2.0  # over the blur
_BLURS = 4.0  # standard deviations of tilts
_MOST_POINTS = 4_000_000  # of a grid
_SCATTERED = 0.05  # of the depth: the part of the scattered light that follows the pattern


class _SunRay(NamedTuple):
    """Unscattered sunlight below still water."""

    n: float  # of the water, relative to the air
    zenith: float  # cosine of the angle to the vertical, in the air
    sine: float  # in the water
    cosine: float
    turn: float  # azimuth of the sun [rad]
    entering: float  # irradiance that enters the water [W m-2 nm-1]
    attenuation: float  # along the depth [m-1]

    @classmethod
    def of(cls, day: Daylight, water: Water) -> _SunRay:
        """Return the sunlight of a day in a water."""
        n = water.n / Link().n_air
        sine = math.sin(math.radians(day.sun_zenith_deg)) / n
        cosine = math.sqrt(1.0 - sine**2)
        entering = day.direct * day.sun[2]
        entering *= 1.0 - float(fresnel_reflectance(day.sun[2], 1.0, n))
        turn = math.radians(day.sun_azimuth_deg)
        return cls(n, day.sun[2], sine, cosine, turn, entering, water.c / cosine)

    def at(self, depth: float) -> float:
        """Return the downward irradiance at a depth [W m-2 nm-1]."""
        return self.entering * math.exp(-self.attenuation * depth)

    def entry(self, depth: float) -> tuple[float, float]:
        """Return the point of the surface from which light comes to a depth below the origin."""
        away = depth * self.sine / self.cosine
        return away * math.cos(self.turn), away * math.sin(self.turn)

    def lever(self, depth: float) -> float:
        """Return the displacement of the light at a depth by a unit of slope [m]."""
        return depth * (1.0 - self.zenith / (self.n * self.cosine)) / self.cosine**2

    def disk(self, depth: float) -> tuple[float, float]:
        """Return the half-axes of the image of the sun at a depth, along and across its light."""
        across = math.radians(SUN_RADIUS_DEG) * depth / (self.n * self.cosine)
        return across * self.zenith / self.cosine**2, across


class _Collector(NamedTuple):
    """Disk at a depth on which the irradiance is wanted, and the patch about it."""

    radius: float
    floating: bool
    patch: tuple[float, float] | None
    fineness: float


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


class _DepthPlan(NamedTuple):
    """Data that all frames of a depth share."""

    depth: float
    ray: _SunRay
    floating: bool
    waves: WaveComponents | None  # None: a surface that is no sum of waves
    grid: WaveGrid | None
    grids: _Grids
    kernels: _Kernels
    still: float  # irradiance of unscattered sunlight
    scattered: _Scattered


def irradiance_series(
    surface: Surface,
    daylight: Daylight,
    *,
    water: Water | None = None,
    depths: ArrayLike = (1.0,),
    times: ArrayLike = (0.0,),
    collector: float = 0.05,
    below: Literal["still", "waves"] = "still",
    patch: tuple[float, float] | None = None,
    fineness: float = 1.0,
    photons: int = 100_000,
    workers: int | str | None = None,
    **run: Unpack[RunOptions],
) -> IrradianceSeries:
    r"""Return the downward irradiance at depths under a moving sea.

    .. math:: E(t) = \sum_i K(x_i - x_c) T_i \, s_i \cdot dA_i \, E_\perp e^{-c l_i}
        + E_s \left[1 + \int S \left(E_0 / \bar E_0 - 1\right) d^2x\right] + E_{sky}

    Parameters
    ----------
    surface : Surface
        The sea, a height field: not choppy. Waves of a sea whose band is not chosen are those that
        make light fade at the shallowest depth.
    daylight : Daylight
        Light above the sea, with direct sunlight.
    water : Water, optional
        Homogeneous water, by default that of a link.
    depths : array_like
        Depths of the collector below still water [m], > 0; more than 4.5 standard deviations of
        the elevation, unless `below` is "waves".
    times : array_like
        Times [s].
    collector : float
        Diameter of the collector [m].
    below : {"still", "waves"}
        Zero of the depths: still water, or the mean height of the waves over the collector, as
        of one that hangs from a float.
    patch : (float, float), optional
        Half-length of a square about the collector and edge of its cells [m]: the result has the
        irradiance that the collector would have there.
    fineness : float
        Factor on the number of surface points along an axis, for studies of convergence.
    photons : int
        Photons of the scattered light of each depth, and of the sky.
    workers : int or str, optional
        Processes in place of threads, or the address or file of a running dask scheduler.
    **run
        Options of the run, see `RunOptions`, but `mesh`: the points follow from the waves. The
        seed is that of the photons; waves have that of their sea. Progress is by frame.

    Returns
    -------
    IrradianceSeries

    Raises
    ------
    Refused
        If a parameter is out of range, the sea is choppy, the water has layers, there is no sun,
        or a grid would have more than four million points.

    Notes
    -----
    Points of the surface at 0.45 / k of the shortest wave, and a sixth of the blur of the light,
    have exact heights and slopes (`waves.WaveGrid`); each sends its sunlight along its refracted
    ray (Snell, Fresnel), attenuated over its own way, into cells of the plane. K is the collector,
    convolved with the image of the sun's disk and with a Gaussian of the slopes of the waves left
    out: at each depth those shorter than `fading.resolving.fading_band` says. Light that meets a
    second wave, or a wave's shadow, is not followed.

    Sunlight scattered in the water, E_s, has the mean of photons under still water; its spread S
    about the unscattered ray, from the same photons, blurs the pattern. What of S lies outside of
    the cells is constant, as is the light of the sky (photons traced backwards under still water).

    Examples
    --------
    >>> import meshtrace as mt
    >>> from meshtrace.surfaces import FlatSea
    >>> day = mt.Daylight(direct=1.0, diffuse=0.0, sun_zenith_deg=0.0)
    >>> clear = mt.Water(a=0.0, b=0.0)
    >>> found = mt.irradiance_series(FlatSea(), day, water=clear, depths=[1.0], times=[0.0])
    >>> round(float(found.irradiance[0, 0]), 4)
    0.9799
    """
    start = process_time()
    water = Link().water if water is None else water
    depths, times = _checked(surface, daylight, water, depths, times)
    require_between(collector, 0.0, 100.0, "collector", "()")
    require_between(fineness, 0.1, 10.0, "fineness", "[]")
    require_whole(photons, 1000, 100_000_000, "photons")
    if run.get("mesh") is not None:
        raise Refused("mesh", run["mesh"], "none: the points follow from the waves")
    require_options(run, RunOptions)
    require_word(below, ("still", "waves"), "below")
    if patch is not None:
        half, edge = require_pair(patch, "patch", "half-length and edge of a cell [m]")
        if not 0.0 < edge <= half:
            raise Refused("patch", patch, "half-length and edge of a cell [m], 0 < edge <= half")
    sea, bands = _resolved(surface, depths, collector, water)
    options: dict[str, Any] = {"photons": photons, "workers": workers, **run}
    campaign = campaign_of(Link(water=water), sea, "irradiance_series", **options)
    seed = campaign.run.seed
    disk = _Collector(0.5 * collector, below == "waves", patch, fineness)
    ray, plans = _SunRay.of(daylight, water), []
    for depth, band in zip(depths.tolist(), bands, strict=True):
        scattered = _scattered_light(daylight, water, ray, depth, photons, seed)
        plans.append(_plan(sea, ray, depth, band, disk, scattered))
    ready, cells = process_time(), None if patch is None else _patch_cells(patch)
    described = {"collector": collector, "below": below, "fineness": fineness, "photons": photons}
    identity = {
        **described,
        "daylight": daylight.model_dump(mode="json"),
        "depths": depths.tolist(),
        "patch": patch,
        "times": digest_of(times.tolist()),
    }
    setup = partial(_frames, sea, daylight, water, plans, cells, times)
    found = np.array(list(campaign.over(setup, range(len(times)), "frames", identity, "frames")))
    total, direct, pattern = np.split(found, [len(depths), 2 * len(depths)], axis=1)
    origin = {
        "environment": environment(),
        "surface": sea.to_config(),
        "daylight": daylight.model_dump(mode="json"),
        "water": water.model_dump(mode="json"),
        "run": {**described, "seed": seed},
        "omega_max": list(bands),
        "surface_points": [len(p.grids.x) * len(p.grids.y) for p in plans],
        "spacing": [float(p.grids.x[1] - p.grids.x[0]) for p in plans],
        "setup_cpu_seconds": ready - start,
        "cpu_seconds_per_frame": (process_time() - ready) / len(times),
    }
    return IrradianceSeries(
        times,
        depths,
        total,
        direct,
        np.array([p.scattered.sky for p in plans]),
        np.array([p.still for p in plans]),
        origin,
        cells,
        cells,
        None if cells is None else pattern.reshape(len(times), len(depths), len(cells), -1),
    )


def _checked(
    surface: Any, day: Any, water: Any, depths: ArrayLike, times: ArrayLike
) -> tuple[Floats, Floats]:
    """Return depths and times; refuse a sea, light or water without a pattern."""
    if not isinstance(surface, Surface) or getattr(surface, "choppy", False):
        kind = "choppy" if isinstance(surface, Surface) else type(surface).__name__
        raise Refused("surface", Described(kind), "a sea (Surface) that is a height field")
    require_kind(day, Daylight, "daylight")
    require_kind(water, Water, "water")
    if day.direct == 0.0:
        raise Refused("daylight.direct", 0.0, "> 0: without sun the irradiance is constant")
    if water.layers is not None:
        raise Refused("water.layers", Described("given"), "homogeneous water")
    deep = np.atleast_1d(require_finite(depths, "depths", "at least one depth > 0 [m]"))
    if not deep.size or (deep <= 0.0).any():
        raise Refused("depths", depths, "at least one depth > 0 [m]")
    at = np.atleast_1d(require_finite(times, "times", "at least one time [s]"))
    return deep.astype(float), at.astype(float)


def _resolved(
    surface: Surface, depths: Floats, collector: float, water: Water
) -> tuple[Surface, list[float | None]]:
    """Return the sea with the waves that matter, and the highest frequency of each depth."""
    whole: Any = getattr(surface, "for_fading", None)
    if whole is None:
        return surface, [None] * len(depths)
    lamp = AirLed(height=_SUN_HEIGHT, half_angle_deg=60.0)
    bands: list[float | None] = []
    for depth in depths:
        disk = WaterReceiver(depth=depth, radius=0.5 * collector, fov_deg=180.0)
        bands.append(fading_band(Link(transmitter=lamp, receiver=disk, water=water), whole))
    resolved: Surface = whole.model_copy(update={"omega_max": max(filter(None, bands))})
    return resolved, bands


def _scattered_light(
    day: Daylight, water: Water, ray: _SunRay, depth: float, photons: int, seed: int
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


def _plan(
    sea: Surface,
    ray: _SunRay,
    depth: float,
    band: float | None,
    collector: _Collector,
    scattered: _Scattered,
) -> _DepthPlan:
    """Return the grids and kernels of a depth."""
    waves, shortest, slope = _waves(sea, band)
    lever = ray.lever(depth)
    if band is not None:
        tilts = np.sqrt(sea.slopes_beyond(band)) * lever  # type: ignore[attr-defined]
    else:
        missing = sea.unresolved_slopes(GAIN_SPACING / shortest if shortest else 1.0)
        tilts = lever * np.sqrt((0.0, 0.0) if missing is None else missing.vertex)
    trough = 0.0 if collector.floating else _SLOPES * _height(waves)
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
    return _DepthPlan(
        depth, ray, collector.floating, waves, grid, grids, kernels, ray.at(depth), scattered
    )


def _grids(
    depth: float,
    ray: _SunRay,
    collector: _Collector,
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


def _waves(sea: Surface, band: float | None) -> tuple[WaveComponents | None, float, float]:
    """Return the waves up to a frequency, the largest wavenumber and the rms slope."""
    if not isinstance(sea, WaveSurface):
        flat = isinstance(sea, FlatSea)
        return None, 0.0, 0.0 if flat else 0.3
    waves = sea.components
    kept = waves.amplitude != 0.0
    if band is not None:
        kept &= waves.omega <= band * (1.0 + 1e-9)
    waves = WaveComponents(*(a[kept] for a in waves))
    k = np.hypot(waves.kx, waves.ky)
    slope = math.sqrt(0.5 * float(np.square(waves.amplitude * k).sum()))
    return waves, float(k.max(initial=0.0)), min(slope, 0.4)


def _height(waves: WaveComponents | None) -> float:
    return 0.0 if waves is None else math.sqrt(0.5 * float(np.square(waves.amplitude).sum()))


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


def _frames(
    sea: Surface,
    day: Daylight,
    water: Water,
    plans: list[_DepthPlan],
    cells: Floats | None,
    times: Floats,
) -> Callable[[int], Floats]:
    """Return the function that gives the numbers of a frame by its number, in a row.

    Irradiance and its unscattered part at each depth, then the patterns.
    """

    def frame(i: int) -> Floats:
        total, direct, patterns = [], [], []
        for plan in plans:
            light = _landed(sea, day, water, plan, float(times[i]))
            unscattered, follows = float((light * plan.kernels.direct).sum()), 0.0
            if plan.scattered.sunlight > 0.0:
                relative = light / plan.still - 1.0
                follows = float((relative * plan.kernels.scattered).sum())
            rest = plan.scattered.sky + plan.scattered.sunlight
            total.append(unscattered + plan.scattered.sunlight * follows + rest)
            direct.append(unscattered)
            if cells is not None:
                patterns.append((_pattern(plan, light, cells) + rest).ravel())
        return np.concatenate([total, direct, *patterns])

    return frame


def _pattern(plan: _DepthPlan, light: Floats, cells: Floats) -> Floats:
    """Return the sunlight of the collector over a patch, less the mean of scattered light."""
    found = np.fft.ifft2(np.fft.fft2(light) * plan.kernels.transfer).real
    if plan.scattered.sunlight > 0.0:
        relative = np.fft.fft2(light / plan.still - 1.0) * plan.kernels.scattered_transfer
        found += plan.scattered.sunlight * np.fft.ifft2(relative).real
    stride = round(float(cells[1] - cells[0]) / plan.grids.cell)
    first = len(light) // 2 - stride * (len(cells) // 2)
    part = slice(first, first + stride * len(cells), stride)
    return np.asarray(found[part, part])


def _landed(sea: Surface, day: Daylight, water: Water, plan: _DepthPlan, time: float) -> Floats:
    """Return the irradiance of unscattered sunlight on the cells of a plane."""
    x, y, cells, cell, _ = plan.grids
    if plan.grid is None or plan.waves is None:
        z, zx, zy = sea.grid(x, y, time)
    else:
        z, zx, zy = plan.grid.sum(elevation_and_slopes(plan.waves, time))
    if plan.floating:
        z = z - z.mean()
    light = np.zeros((cells, cells))
    corner, low = (float(x[0]), float(y[0])), -0.5 * (cells + 1) * cell
    # the collector is over the middle of a cell
    land_sunlight(
        z, zx, zy, corner, float(x[1] - x[0]), day.sun, plan.ray.n, water.c, plan.depth,
        (low, low), cell, light,
    )  # fmt: skip
    return light * (day.direct / cell**2)


def _patch_cells(patch: tuple[float, float]) -> Floats:
    """Return the centres of the cells of a patch along an axis."""
    half, step = patch
    n = math.ceil(half / step - 1e-9)
    return step * (np.arange(2 * n + 1.0) - n)
