"""Downward irradiance at depths under a moving sea, fast enough for flashes of milliseconds."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache, partial
from time import process_time
from typing import Annotated, Any, Literal, Unpack, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field
from scipy.special import j1

from meshtrace import GainResult, IrradianceMap, IrradianceSeries, Meshing, background, simulate
from meshtrace.checks import check_call
from meshtrace.daylight import Daylight
from meshtrace.daylight.light import (
    SUN_RADIUS_DEG,
    default_irradiance,
    land_sunlight,
    refracted_sun,
)
from meshtrace.engine.setup.options import RunOptions
from meshtrace.errors import Described, Refused, require_finite
from meshtrace.fading import fading_band
from meshtrace.link import AirLed, IrradiancePlanes, Link, Sun, WaterReceiver
from meshtrace.models import Floats
from meshtrace.optics import Water
from meshtrace.results.daylight import PARTS
from meshtrace.results.provenance import environment
from meshtrace.scenario import Scenario
from meshtrace.studies.campaign import Campaign, campaign_of
from meshtrace.studies.caustics import gaussian, resolved_waves, turned, wave_sizes, wavenumbers
from meshtrace.studies.store import digest_of
from meshtrace.surfaces import FlatSea, Surface
from meshtrace.surfaces.waves import WaveGrid, elevation_and_slopes

_SUN_HEIGHT = 1e6  # height of a lamp in place of the sun [m]: its light is parallel
_ERROR = 1e-6  # relative error of the sums of waves (`WaveGrid`)
_SLOPES = 4.5  # standard deviations of slopes, and of elevations, that are taken into account
# Tuned, cost against accuracy (`fineness`): surface points, and cells, per blur along an axis;
# standard deviations of the tilts by waves left out, beyond which light is neglected.
_RAYS = 6.0
_CELLS = 2.0
_BLURS = 4.0
_MOST_POINTS = 64_000_000  # traced per time and depth: a bound on the work
_MOST_LINES = 2000  # of a tile along an axis: a bound on the memory
# Tuned: scattered light within this part of the depth follows the pattern; the rest is constant.
_SCATTERED = 0.05


@check_call
def irradiance_series(
    surface: Surface | Scenario,
    daylight: Daylight | None = None,
    *,
    water: Water | None = None,
    depths: ArrayLike = (1.0,),
    times: ArrayLike = (0.0,),
    collector: Annotated[float, Field(gt=0.0, lt=100.0)] = 0.05,
    below: Literal["still", "waves"] = "still",
    patch: tuple[float, float] | None = None,
    fineness: Annotated[float, Field(ge=0.1, le=10.0)] = 1.0,
    photons: Annotated[int, Field(ge=1000, le=100_000_000)] = 100_000,
    **run: Unpack[RunOptions],
) -> IrradianceSeries:
    r"""Compute the downward irradiance at depths under a moving sea.

    .. math:: E(t) = \sum_i K(x_i - x_c) T_i \, s_i \cdot dA_i \, E_\perp e^{-c l_i}
        + E_s \left[1 + \int S \left(E_0 / \bar E_0 - 1\right) d^2x\right] + E_{sky}

    Parameters
    ----------
    surface : Surface or Scenario
        The sea, a height field: not choppy; or a scenario with sea, daylight, water and seed. Waves
        of a sea whose band is not chosen are those that make light fade at the shallowest depth.
    daylight : Daylight, optional
        Light above the sea, with direct sunlight; by default that of the scenario, or a clear sky
        with the sun at a zenith angle of 30 degrees.
    water : Water, optional
        Homogeneous water, by default that of the scenario or of a link.
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
        or a depth needs more than 64 million points of the surface.

    Notes
    -----
    The sum is over patches dA_i of the surface: T_i is their transmittance (Fresnel), s_i the unit
    vector of the sunlight in air, l_i the way of the refracted ray to its place x_i in the plane,
    E_perp the irradiance across the sunlight; E_0 is the unscattered irradiance of a cell, its
    mean that under still water.

    Points of the surface at 0.45 / k of the shortest wave, and a sixth of the blur of the light,
    have exact heights and slopes (`waves.WaveGrid`); each sends its sunlight along its refracted
    ray (Snell, Fresnel), attenuated over its own way, into cells of the plane. K is the collector,
    convolved with the image of the sun's disk and with a Gaussian of the slopes of the waves left
    out: at each depth those shorter than `fading.spectral.fading_band` says. Light that meets a
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
    >>> series = mt.irradiance_series(FlatSea(), day, water=clear, depths=[1.0], times=[0.0])
    >>> round(float(series.irradiance[0, 0]), 4)
    0.9799
    """
    start = process_time()
    sea, daylight, water, scenario_options = _inputs(surface, daylight, water)
    depths = require_finite(depths, "depths", "at least one depth > 0 [m]")
    if (depths <= 0.0).any():
        raise Refused("depths", depths, "at least one depth > 0 [m]")
    times = require_finite(times, "times", "at least one time [s]")
    target = Collector(0.5 * collector, below == "waves", patch, fineness)
    _require_no_mesh(run)
    sea, bands = _resolved(sea, depths, target, water)
    options: Any = scenario_options | {"photons": photons} | dict(run)
    campaign = campaign_of(Link(water=water), sea, "irradiance_series", options)
    ray, seed = SunRay(daylight, water), campaign.run.seed
    plans = [
        DepthPlan(sea, ray, depth, band, target, ScatteredLight(ray, depth, photons, seed))
        for depth, band in zip(depths.tolist(), bands, strict=True)
    ]
    ready = process_time()
    described = {"collector": collector, "below": below, "fineness": fineness, "photons": photons}
    day = daylight.model_dump(mode="json")
    identity = described | {
        "daylight": day, "depths": depths.tolist(), "patch": patch,
        "times": digest_of(times.tolist()),
    }  # fmt: skip
    total, direct, pattern = _evaluated(campaign, plans, times, target, identity)
    origin = {
        "environment": environment(),
        "surface": sea.to_config(),
        "daylight": day,
        "water": water.model_dump(mode="json"),
        "run": described | {"seed": seed},
        "omega_max": bands,
        "surface_points": [plan.points for plan in plans],
        "spacing": [plan.spacing for plan in plans],
        "setup_cpu_seconds": ready - start,
        "cpu_seconds_per_frame": (process_time() - ready) / len(times),
    }
    sky, still = np.array([(plan.scattered.sky, plan.still) for plan in plans]).T
    return IrradianceSeries(
        times, depths, total, direct, sky, still, origin, target.cells, target.cells, pattern
    )


def _evaluated(
    campaign: Campaign,
    plans: list[DepthPlan],
    times: Floats,
    target: Collector,
    identity: dict[str, Any],
) -> tuple[Floats, Floats, Floats | None]:
    """Return irradiance and unscattered part by time and depth, and patterns by cell, if any."""
    n, cells = len(plans), 0 if target.cells is None else len(target.cells)
    # a row of a frame: irradiance and unscattered part of each depth, then cells^2 of each pattern
    shape = ((2 + cells**2) * n,)
    setup, numbers = partial(_frames, plans, times), range(len(times))
    steps = campaign.evaluate(setup, numbers, "frames", identity, lambda step: shape, "frames")
    total, direct, pattern = np.split(np.array(list(steps)), [n, 2 * n], axis=1)
    return total, direct, pattern.reshape(len(times), n, cells, cells) if cells else None


def _require_no_mesh(run: RunOptions) -> None:
    """Refuse the options of a mesh."""
    for name in ("mesh", *Meshing.model_fields):
        if (value := dict(run).get(name)) is not None:
            raise Refused(name, value, "none: the points follow from the waves")


def _inputs(
    surface: Surface | Scenario, day: Daylight | None, water: Water | None
) -> tuple[Surface, Daylight, Water, dict[str, Any]]:
    """Return the checked sea, daylight, water and run options, taken from a scenario if needed."""
    link, sea, options = Link(), cast(Any, surface), dict[str, Any]()
    if isinstance(surface, Scenario):
        link, sea = surface.link, surface.case().surface
        day = surface.daylight if day is None else day
        options = {"seed": surface.run.seed, "threads": surface.run.threads}
    water = link.water if water is None else water
    if day is None:
        nm = link.transmitters[0].wavelength_nm
        clear = default_irradiance(30.0, nm)
        day = Daylight(
            direct=clear.direct, diffuse=clear.diffuse, wavelength_nm=nm, light="clear sky"
        )
    if not isinstance(sea, Surface) or getattr(sea, "choppy", False):
        kind = "choppy" if isinstance(sea, Surface) else type(sea).__name__
        raise Refused("surface", Described(kind), "a sea (Surface) that is a height field")
    if day.direct == 0.0:
        raise Refused("daylight.direct", 0.0, "> 0: without sun the irradiance is constant")
    if water.layers is not None:
        raise Refused("water.layers", Described("given"), "homogeneous water")
    return sea, day, water, options


def _resolved(
    surface: Surface, depths: Floats, collector: Collector, water: Water
) -> tuple[Surface, list[float | None]]:
    """Return the sea with the waves that matter, and the highest frequency [rad s-1] of each depth.

    A sea whose waves are chosen already stays as it is: the frequencies are None, for all waves.
    """
    banded: Any = getattr(surface, "for_fading", None)
    if banded is None:
        return surface, [None] * len(depths)
    # `fading_band` takes a link: a lamp far above has the parallel light of the sun
    lamp = AirLed(height=_SUN_HEIGHT, half_angle_deg=60.0)
    bands: list[float | None] = []
    for depth in depths:
        receiver = WaterReceiver(depth=depth, radius=collector.radius, fov_deg=180.0)
        bands.append(fading_band(Link(transmitter=lamp, receiver=receiver, water=water), banded))
    # one sea for all depths: its shortest waves matter at the shallowest; each greater depth leaves
    # out the waves beyond its band, whose slopes blur the light (`DepthPlan`)
    resolved: Surface = banded.model_copy(update={"omega_max": max(filter(None, bands))})
    return resolved, bands


def _frames(plans: list[DepthPlan], times: Floats) -> Callable[[int], Floats]:
    """Return a function that computes the row of results of frame i.

    Irradiance and its unscattered part at each depth, then the patterns.
    """

    def frame(i: int) -> Floats:
        planes = [plan.at(float(times[i])) for plan in plans]
        total, direct, patterns = zip(*planes, strict=True)
        return np.concatenate([total, direct, *map(np.ravel, patterns)])

    return frame


class SunRay:
    """Unscattered sunlight of a day below still water.

    Attributes
    ----------
    n : float
        Index of the water, relative to the air.
    inside : ndarray, shape (3,)
        Unit vector that points up along the refracted ray, to the sun as seen in the water.
    entering : float
        Downward irradiance just below the surface [W m-2 nm-1].
    """

    def __init__(self, day: Daylight, water: Water) -> None:
        self.day, self.water, self.n = day, water, water.n / Link().n_air
        self.inside, across = refracted_sun(day, self.n)
        self.entering = across * float(self.inside[2])

    def at(self, depth: float) -> float:
        """Return the downward irradiance of unscattered light at a depth [W m-2 nm-1]."""
        return self.entering * math.exp(-self.water.c / self.inside[2] * depth)

    def entry(self, depth: float) -> tuple[float, float]:
        """Return the entry point x, y [m] at the surface of the ray to x = y = 0 at a depth."""
        x, y, z = self.inside.tolist()
        return depth * x / z, depth * y / z

    def lever(self, depth: float) -> float:
        """Return the displacement of a ray at a depth per unit of slope along its azimuth [m]."""
        cosine = float(self.inside[2])
        # derivative of Snell's law by the slope: the ray turns by 1 - cos_i / (n cos_t), and
        # depth * tan(angle) moves by depth / cos_t^2 per radian
        return depth * (1.0 - self.day.sun[2] / (self.n * cosine)) / cosine**2

    def disk(self, depth: float) -> tuple[float, float]:
        """Return the half-axes of the sun's image at a depth, along and across its azimuth [m]."""
        cosine = float(self.inside[2])
        # d(angle in water) = d(angle in air) / n, along the azimuth times cos_i / cos_t as well;
        # a slant beam of length depth / cos_t is stretched along its azimuth by 1 / cos_t
        across = math.radians(SUN_RADIUS_DEG) * depth / (self.n * cosine)
        return across * self.day.sun[2] / cosine**2, across


class Collector:
    """Disk whose irradiance is computed, at one place or at each of a square patch.

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

    def __init__(
        self, radius: float, floating: bool, patch: tuple[float, float] | None, fineness: float
    ) -> None:
        self.radius, self.floating, self.patch, self.fineness = radius, floating, patch, fineness
        self.cells: Floats | None = None  # centres along an axis of the patch [m]
        if patch is None:
            return
        half, edge = patch
        if not 0.0 < edge <= half:
            raise Refused("patch", patch, "half-length and edge of a cell [m], 0 < edge <= half")
        # n cells on either side of the middle one; 1e-9 absorbs the rounding of half / edge
        n = math.ceil(half / edge - 1e-9)
        self.cells = edge * (np.arange(2 * n + 1.0) - n)


class DepthPlan:
    """Quantities at one depth that do not change with time.

    Sunlight goes from points of the surface, on lines `x` and `y` [m], to square cells of a plane
    at the depth, the collector over the middle of one. Kernels are the weights of the cells in the
    irradiance at the collector.

    Parameters
    ----------
    sea : Surface
        The sea.
    ray : SunRay
        Sunlight in the water.
    depth : float
        Depth [m].
    band : float, optional
        Highest frequency of the waves [rad s-1]; all waves by default.
    collector : Collector
        Disk and patch.
    scattered : ScatteredLight
        Other light at the depth.
    """

    def __init__(
        self, sea: Surface, ray: SunRay, depth: float, band: float | None, collector: Collector,
        scattered: ScatteredLight,
    ) -> None:  # fmt: skip
        self.sea, self.ray, self.depth, self.collector = sea, ray, depth, collector
        self.scattered, self.still = scattered, ray.at(depth)
        self._waves, lever = resolved_waves(sea, band), ray.lever(depth)
        finest, slope, height = wave_sizes(sea, self._waves)
        # displacement of light [m] by the slopes of waves left out: standard deviations along and
        # across the wind
        missing = sea.unresolved_slopes(finest if math.isfinite(finest) else 1.0)
        variances = (0.0, 0.0) if missing is None else missing.vertex
        if band is not None:
            variances = sea.slopes_beyond(band)  # type: ignore[attr-defined]
        tilts = lever * np.sqrt(variances)
        # without slopes left out there are none along the wind
        self._wind_deg = 0.0 if missing is None else missing.direction_deg
        # depth of the lowest trough and height of the highest crest [m]
        trough = 0.0 if collector.floating else _SLOPES * height
        # a collector that comes out of the water has no irradiance below it
        if trough >= depth:
            allowed = f'> {trough:.3g} m, below all troughs, or below = "waves"'
            raise Refused("depths", depth, allowed)
        # light may enter beside the cells that it reaches: bent by a slope, of 0.4 in standard
        # deviation at most (tuned), or along a slant ray from a crest above z = 0
        displacement = _SLOPES * lever * min(slope, 0.4) + math.hypot(*ray.entry(trough))
        self._place(tilts, finest, displacement)
        self._blur(tilts)
        self._grid: WaveGrid | None = None
        if self._waves is not None:
            first_tile = self.x[: self._lines], self.y[: self._lines]
            self._grid = WaveGrid(self._waves.kx, self._waves.ky, *first_tile, _ERROR)

    def _place(self, tilts: Floats, finest: float, displacement: float) -> None:
        """Choose surface points and cells.

        Parameters
        ----------
        tilts : ndarray, shape (2,)
            Standard deviations of the displacement by waves left out [m].
        finest : float
            Greatest distance of points that represents the shortest wave [m].
        displacement : float
            Greatest displacement of light between surface and plane [m].
        """
        # spot: half-axes of the sun's image
        spot, patch, radius = self.ray.disk(self.depth), self.collector.patch, self.collector.radius
        # a uniform disk of radius r has the variance r^2 / 4 along an axis
        blur = math.sqrt(0.25 * radius**2 + 0.25 * spot[1] ** 2 + tilts.max() ** 2)
        cell = blur / _CELLS
        if patch is not None:
            # an edge of a patch cell is a whole number of these cells
            cell = patch[1] / math.ceil(patch[1] / cell)
        spacing = min(blur / _RAYS, finest)
        # a whole number per cell, for even light on still water
        spacing = cell / math.ceil(self.collector.fineness * cell / spacing)
        # unscattered light that lands farther off than `reach` [m] is not in the collector's blur;
        # scattered light follows the pattern as far as `around` [m] beyond
        reach = radius + spot[0] + _BLURS * float(tilts.max())
        around = _SCATTERED * self.depth if self.ray.water.b > 0.0 else 0.0
        # half-length of the plane; 3 cells: tuned, for the sharing of light between neighbours
        half = max(reach + around, 0.0 if patch is None else patch[0] + reach) + 3.0 * cell
        self.cell, self.cells, self._support = cell, 2 * math.ceil(half / cell), reach
        points = (
            2 * math.ceil((0.5 * self.cells * cell + displacement + 2.0 * spacing) / spacing) + 1
        )
        # tiles of equal size share one `WaveGrid`
        tiles = math.ceil(points / _MOST_LINES)
        self._lines = math.ceil(points / tiles)
        points = tiles * self._lines
        if points**2 > _MOST_POINTS:
            size = Described(f"{points:,} by {points:,} points of the sea at {self.depth:g} m")
            cure = "a wider collector, lower omega_max or smaller patch"
            raise Refused("depths", size, f"at most {_MOST_POINTS:,}: {cure}")
        lines: Floats = spacing * (np.arange(points, dtype=np.float64) - points // 2)
        # centred on the refracted ray that meets the collector
        x, y = self.ray.entry(self.depth)
        self.x, self.y, self.points = x + lines, y + lines, points**2

    def _blur(self, tilts: Floats) -> None:
        """Compute the blur kernels of unscattered and scattered light.

        As functions of the offset of a cell from the collector. The transform of the blur is the
        product of those of collector, sun's image and tilts; it is divided by that of the sharing
        of light between cells, which blurs already (cloud in cell, sinc^2).
        """
        n, cell = self.cells, self.cell
        kx, ky = wavenumbers(n, n, cell)
        disk = _disk(kx, ky, self.collector.radius)
        along, across = turned(kx, ky, math.radians(self.ray.day.sun_azimuth_deg))
        sun_axes = self.ray.disk(self.depth)
        sun = _disk(sun_axes[0] * along, sun_axes[1] * across, 1.0)
        tilt = gaussian(kx, ky, tilts, math.radians(self._wind_deg))
        shared = (np.sinc(kx * cell / (2.0 * np.pi)) * np.sinc(ky * cell / (2.0 * np.pi))) ** 2
        blur = disk * sun * tilt / shared
        shares = np.zeros((n, n))  # n is even: n - 1 cells have a middle one, at n // 2 here
        shares[1:, 1:] = self.scattered.shares(0.5 * (n - 1) * cell, n - 1)
        self._scattered_transfer = np.fft.fft2(np.fft.ifftshift(shares)) * disk
        # cells times kernel, summed, is a correlation, no convolution: the conjugate mirrors it
        self._direct_kernel, self._scattered_kernel = (
            np.fft.fftshift(np.fft.ifft2(t.conj()).real) for t in (blur, self._scattered_transfer)
        )
        lines = cell * (np.arange(n) - n // 2)
        far = np.hypot(lines[:, None], lines) > self._support + cell
        self._direct_kernel[far] = 0.0  # ripple: the disk has a sharp edge, the transform is finite
        self._direct_kernel /= self._direct_kernel.sum()
        self._direct_transfer = np.fft.fft2(np.fft.ifftshift(self._direct_kernel))

    def at(self, time: float) -> tuple[float, float, Floats]:
        """Return irradiance, its unscattered part, and the pattern over the cells of the patch."""
        sunlit, cells = self._sunlight_on_cells(time), self.collector.cells
        sunlight, constant = self.scattered.sunlight, self.scattered.sky + self.scattered.sunlight
        unscattered, variation = float((sunlit * self._direct_kernel).sum()), 0.0
        # scattered light follows the pattern of the unscattered, blurred by its own spread
        relative = sunlit / self.still - 1.0
        if sunlight > 0.0:
            variation = float((relative * self._scattered_kernel).sum())
        total = unscattered + sunlight * variation + constant
        if cells is None:
            return total, unscattered, np.zeros(0)
        pattern = np.fft.ifft2(np.fft.fft2(sunlit) * self._direct_transfer).real
        if sunlight > 0.0:
            pattern += (
                sunlight * np.fft.ifft2(np.fft.fft2(relative) * self._scattered_transfer).real
            )
        # cells in the middle of patch cells are `stride` cells apart
        stride = round(float(cells[1] - cells[0]) / self.cell)
        first = len(sunlit) // 2 - stride * (len(cells) // 2)
        part = slice(first, first + stride * len(cells), stride)
        return total, unscattered, pattern[part, part] + constant

    def _sunlight_on_cells(self, time: float) -> Floats:
        """Return the irradiance of unscattered sunlight on the cells of a plane [W m-2 nm-1]."""
        ray, cell = self.ray, self.cell
        weights = None if self._waves is None else elevation_and_slopes(self._waves, time)
        starts = range(0, len(self.x), self._lines)
        tiles = [(i, j) for i in starts for j in starts]
        # the last tile is remembered: a single one is evaluated once even where its mean height is
        # needed first, many tiles then twice
        sheet = lru_cache(maxsize=1)(partial(self._tile, time, weights))
        level = 0.0
        if self.collector.floating:
            level = float(np.mean([sheet(*tile)[0].mean() for tile in tiles]))
        power, corner = np.zeros((self.cells, self.cells)), -0.5 * (self.cells + 1) * cell
        # with this corner the collector, x = y = 0, is over the middle of cell n // 2
        for i, j in tiles:
            z, zx, zy = sheet(i, j)
            land_sunlight(
                z - level, zx, zy, (float(self.x[i]), float(self.y[j])), self.spacing,
                ray.day.sun, ray.n, ray.water.c, self.depth, (corner, corner), cell, power,
            )  # fmt: skip
        return power * (ray.day.direct / cell**2)

    def _tile(
        self, time: float, weights: NDArray[np.complex128] | None, i: int, j: int
    ) -> tuple[Floats, Floats, Floats]:
        """Return heights and slopes of the tile that begins at lines i and j."""
        if self._grid is None or self._waves is None or weights is None:
            n = self._lines
            z, zx, zy = self.sea.grid(self.x[i : i + n], self.y[j : j + n], time)
        else:
            # the grid is that of the first tile; on others the waves are shifted
            shift = self.x[i] - self.x[0], self.y[j] - self.y[0]
            # f(x + shift): each wave exp(-i k . x) is multiplied by exp(-i k . shift)
            phase = np.exp(-1j * (self._waves.kx * shift[0] + self._waves.ky * shift[1]))
            z, zx, zy = self._grid.sum(weights * phase)
        return z, zx, zy

    @property
    def spacing(self) -> float:
        """Distance of the surface points [m]."""
        return float(self.x[1] - self.x[0])


class ScatteredLight:
    """Scattered sunlight, and the light of the sky, at a depth under still water.

    Attributes
    ----------
    sunlight, sky : float
        Irradiances [W m-2 nm-1].
    """

    def __init__(self, ray: SunRay, depth: float, photons: int, seed: int) -> None:
        self._ray, self._depth, self._photons, self._seed = ray, depth, photons, seed
        day, water = ray.day, ray.water
        self.sunlight = self.sky = self._share = 0.0
        if day.diffuse > 0.0:
            link = Link(
                water=water,
                transmitter=AirLed(wavelength_nm=day.wavelength_nm),
                receiver=WaterReceiver(depth=depth, radius=0.01, fov_deg=180.0),
            )
            # a multiple of the 32 groups of the estimator
            count = 32 * max(1, photons // 32)
            sky_light = background(link, FlatSea(), day, photons=count, seed=seed, threads=1)
            # the estimate is the mean radiance over the hemisphere, weighted by cosine: E = pi L
            self.sky = math.pi * float(sky_light.part_radiance[PARTS.index("sky")])
        # shares are of the light of a sun that gives 1 W m-2 on a level plane above the sea
        self._level = day.direct * day.sun[2]
        if water.b > 0.0:
            planes = self._traced([]).planes
            assert planes is not None
            self._share = max(float(planes.e_d[0]) - ray.at(depth) / self._level, 0.0)
            self.sunlight = self._level * self._share

    def _traced(self, record: list[Any]) -> GainResult:
        """Trace a pencil of sunlight aimed at x = y = 0 of the plane.

        Each call traces the same photons, so that a map agrees with the plane.
        """
        ray, depth, day = self._ray, self._depth, self._ray.day
        pencil = Sun(
            zenith_deg=day.sun_zenith_deg, azimuth_deg=(day.sun_azimuth_deg + 180.0) % 360.0,
            # azimuth of `Sun`: where light goes to; a pencil: far narrower than any cell
            half_width=1e-6 * depth, position=ray.entry(depth),
        )  # fmt: skip
        planes = IrradiancePlanes(depths=(depth,))
        link = Link(water=ray.water, transmitter=pencil, receiver=(), planes=planes)
        return simulate(
            link, FlatSea(), estimator="analog", photons=self._photons, seed=self._seed, threads=1,
            record=record,
        )  # fmt: skip

    def shares(self, half: float, n: int) -> Floats:
        """Return the shares of the scattered light on n by n cells (odd) over |x|, |y| <= half [m].

        The unscattered ray meets the middle cell.
        """
        if self._share == 0.0:
            return np.zeros((n, n))
        step = 2.0 * half / n
        record = IrradianceMap(height=-self._depth, extent=half, step=step, axis=(0.0, 0.0, -1.0))
        irradiances = self._traced([record]).map
        assert irradiances is not None
        power = np.array(irradiances.irradiance) * step**2
        # the unscattered light of the pencil lands in the middle cell
        power[n // 2, n // 2] -= self._ray.at(self._depth) / self._level
        return np.asarray(np.maximum(power, 0.0) / self._share)


def _disk(kx: Floats, ky: Floats, radius: float) -> Floats:
    """Return the transform of the mean over a disk, 2 J1(k r) / (k r)."""
    kr = np.maximum(radius * np.hypot(kx, ky), 1e-6)  # at 0 the limit is 1
    return np.asarray(2.0 * j1(kr) / kr)
