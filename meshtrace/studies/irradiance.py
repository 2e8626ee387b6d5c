"""Downward irradiance at depths under a moving sea, fast enough for flashes of milliseconds."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from time import process_time
from typing import Any, Literal, Unpack, cast

import numpy as np
from numpy.typing import ArrayLike

from meshtrace.daylight.light import Daylight, default_irradiance
from meshtrace.engine.setup.options import RunOptions, require_options
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
from meshtrace.fading.spectral import fading_band
from meshtrace.link import AirLed, Link, WaterReceiver
from meshtrace.models import Floats
from meshtrace.optics.water import Water
from meshtrace.results.irradiance import IrradianceSeries
from meshtrace.results.provenance import environment
from meshtrace.scenario import Scenario
from meshtrace.studies.campaign import campaign_of
from meshtrace.studies.store import digest_of
from meshtrace.studies.sunlight import Collector, DepthPlan, SunRay, scattered_light
from meshtrace.surfaces import Surface

_SUN_HEIGHT = 1e6  # [m], of a lamp in place of the sun


def irradiance_series(
    surface: Surface | Scenario,
    daylight: Daylight | None = None,
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
    >>> found = mt.irradiance_series(FlatSea(), day, water=clear, depths=[1.0], times=[0.0])
    >>> round(float(found.irradiance[0, 0]), 4)
    0.9799
    """
    start = process_time()
    sea, daylight, water, of_run = _inputs(surface, daylight, water)
    depths = require_finite(depths, "depths", "at least one depth > 0 [m]")
    if (depths <= 0.0).any():
        raise Refused("depths", depths, "at least one depth > 0 [m]")
    times = require_finite(times, "times", "at least one time [s]")
    disk = _collector(collector, below, patch, fineness)
    require_whole(photons, 1000, 100_000_000, "photons")
    if run.get("mesh") is not None:
        raise Refused("mesh", run["mesh"], "none: the points follow from the waves")
    require_options(run, RunOptions)
    sea, bands = _resolved(sea, depths, disk, water)
    options: dict[str, Any] = {**of_run, "photons": photons, "workers": workers, **run}
    campaign = campaign_of(Link(water=water), sea, "irradiance_series", **options)
    ray, seed, plans = SunRay.of(daylight, water), campaign.run.seed, []
    for depth, band in zip(depths.tolist(), bands, strict=True):
        scattered = scattered_light(daylight, water, ray, depth, photons, seed)
        plans.append(DepthPlan.of(sea, ray, depth, band, disk, scattered))
    ready = process_time()
    described = {"collector": collector, "below": below, "fineness": fineness, "photons": photons}
    identity = {
        **described,
        "daylight": daylight.model_dump(mode="json"),
        "depths": depths.tolist(),
        "patch": patch,
        "times": digest_of(times.tolist()),
    }
    setup = partial(_frames, plans, times)
    found = np.array(list(campaign.over(setup, range(len(times)), "frames", identity, "frames")))
    total, direct, pattern = np.split(found, [len(depths), 2 * len(depths)], axis=1)
    origin = {
        "environment": environment(),
        "surface": sea.to_config(),
        "daylight": identity["daylight"],
        "water": water.model_dump(mode="json"),
        "run": {**described, "seed": seed},
        "omega_max": bands,
        "surface_points": [plan.points for plan in plans],
        "spacing": [plan.spacing for plan in plans],
        "setup_cpu_seconds": ready - start,
        "cpu_seconds_per_frame": (process_time() - ready) / len(times),
    }
    sky, still = np.array([(plan.scattered.sky, plan.still) for plan in plans]).T
    cells, shape = disk.cells, (len(times), len(depths))
    return IrradianceSeries(
        times, depths, total, direct, sky, still, origin, cells, cells,
        None if cells is None else pattern.reshape(*shape, len(cells), -1),
    )  # fmt: skip


def _inputs(
    surface: Surface | Scenario, day: Daylight | None, water: Water | None
) -> tuple[Surface, Daylight, Water, dict[str, Any]]:
    """Return sea, light, water and options of a scenario, or those given; refuse unfit ones."""
    link, given, options = Link(), cast(Any, surface), dict[str, Any]()
    if isinstance(surface, Scenario):
        link, given = surface.link, surface.case().surface
        day = surface.daylight if day is None else day
        options = {"seed": surface.run.seed, "threads": surface.run.threads}
    water = link.water if water is None else water
    if day is None:
        nm = link.transmitters[0].wavelength_nm
        clear = default_irradiance(30.0, nm)._asdict()
        day = Daylight(**clear, wavelength_nm=nm, light="clear sky")
    if not isinstance(given, Surface) or getattr(given, "choppy", False):
        kind = "choppy" if isinstance(given, Surface) else type(given).__name__
        raise Refused("surface", Described(kind), "a sea (Surface) that is a height field")
    require_kind(day, Daylight, "daylight")
    require_kind(water, Water, "water")
    if day.direct == 0.0:
        raise Refused("daylight.direct", 0.0, "> 0: without sun the irradiance is constant")
    if water.layers is not None:
        raise Refused("water.layers", Described("given"), "homogeneous water")
    return given, day, water, options


def _collector(
    diameter: float, below: str, patch: tuple[float, float] | None, fineness: float
) -> Collector:
    """Return the collector, checked."""
    require_between(diameter, 0.0, 100.0, "collector", "()")
    require_between(fineness, 0.1, 10.0, "fineness", "[]")
    require_word(below, ("still", "waves"), "below")
    if patch is not None:
        allowed = "half-length and edge of a cell [m]"
        half, edge = require_pair(patch, "patch", allowed)
        if not 0.0 < edge <= half:
            raise Refused("patch", patch, f"{allowed}, 0 < edge <= half")
    return Collector(0.5 * diameter, below == "waves", patch, fineness)


def _resolved(
    surface: Surface, depths: Floats, collector: Collector, water: Water
) -> tuple[Surface, list[float | None]]:
    """Return the sea with the waves that matter, and the highest frequency of each depth."""
    whole: Any = getattr(surface, "for_fading", None)
    if whole is None:
        return surface, [None] * len(depths)
    lamp = AirLed(height=_SUN_HEIGHT, half_angle_deg=60.0)
    bands: list[float | None] = []
    for depth in depths:
        disk = WaterReceiver(depth=depth, radius=collector.radius, fov_deg=180.0)
        bands.append(fading_band(Link(transmitter=lamp, receiver=disk, water=water), whole))
    resolved: Surface = whole.model_copy(update={"omega_max": max(filter(None, bands))})
    return resolved, bands


def _frames(plans: list[DepthPlan], times: Floats) -> Callable[[int], Floats]:
    """Return the function that gives the numbers of a frame by its number, in a row.

    Irradiance and its unscattered part at each depth, then the patterns.
    """

    def frame(i: int) -> Floats:
        found = [plan.at(float(times[i])) for plan in plans]
        total, direct, patterns = zip(*found, strict=True)
        return np.concatenate([total, direct, *map(np.ravel, patterns)])

    return frame
