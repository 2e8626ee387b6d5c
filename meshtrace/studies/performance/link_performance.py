"""From a link to its performance: gains over many seas, tilt of the receiver, bits.

`link_performance` joins the channel gain (`ensemble`, forced detection) with the receiver
(`detector`, `budget`) and the UAV (`uav`); `depth_sweep` gives the curves of the bit error rate
over depth.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from meshtrace.comms.matching import (
    Preset,
    at_depth,
    channel_link,
    in_wind,
    ook_link,
    receiver_of,
)
from meshtrace.comms.ook import OokLink
from meshtrace.link import Link
from meshtrace.mesh import SurfaceModel
from meshtrace.studies.coupled import CoupledSeries, coupled_series
from meshtrace.studies.performance.operating_point import Figures, figures_of
from meshtrace.studies.performance.samples import Recipe
from meshtrace.studies.performance.tables import DepthSweep, LinkPerformance
from meshtrace.uav.airframe import Uav
from meshtrace.uav.wind import Dryden

__all__ = [
    "CoupledSeries",
    "DepthSweep",
    "Figures",
    "LinkPerformance",
    "channel_link",
    "coupled_series",
    "depth_sweep",
    "in_wind",
    "link_performance",
    "ook_link",
]

SWEEP_DEPTHS = tuple(float(d) for d in range(20, 95, 5))
"""Depths of `depth_sweep` [m]."""


def link_performance(
    link: Link,
    sea: SurfaceModel | None = None,
    *,
    wind_speed: float | None = None,
    bit_rate: float | Sequence[float] | None = None,
    ook: OokLink | Preset = "physical",
    limit: float = 1e-3,
    realizations: int = 200,
    photons: int = 2048,
    depths: Sequence[float] | None = None,
    uav: Uav | None = None,
    wind: Dryden | None = None,
    coupled: bool = False,
    time_step: float = 0.5,
    seed: int = 1,
    confidence: float = 0.95,
    spacing: float | None = None,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> LinkPerformance:
    """Return error rate, outage, margin and capacity of a link over a random sea.

    BER = E[BER(P h h_alpha)],  h from forced detection over independent seas

    Parameters
    ----------
    link : Link
        The link, with one receiver in the air. Bubbles and whitecaps are its own, see `in_wind`.
    sea : SurfaceModel, optional
        The sea; by default the JONSWAP sea of `wind_speed`, flat where that is 0. A sea without
        random phases is taken once, at time 0.
    wind_speed : float, optional
        Wind at 10 m [m s-1] for the default sea (5 if not given) and the default `wind`.
    bit_rate : float or sequence of float, optional
        R_b [bit s-1], by default that of `ook`.
    ook : OokLink or {"physical", "paper", "paper-ranges"}
        Transmitter electronics and receiver. "physical" is model W behind etendue-limited optics.
        "paper-ranges" is an empirical calibration (`LinkPerformance.status`): water.a is doubled.
    limit : float
        Bit error rate before decoding that counts as success, see `budget.FEC_LIMITS`.
    realizations : int
        Independent seas, or times of a coupled series, >= 2.
    photons : int
        Chains, common to all seas.
    depths : sequence of float, optional
        Depths of the transmitter [m], rising; by default that of the link.
    uav : Uav, optional
        Airframe that carries the receiver; none for a receiver at rest.
    wind : Dryden, optional
        Wind at the UAV, by default of `wind_speed` at the height of the receiver.
    coupled : bool
        Whether the tilt acts on every photon (`coupled_series`) rather than as factor h_alpha.
    time_step : float
        Time between the realizations of a coupled series [s].
    seed : int
        Seed of chains, phases, gusts and bootstrap.
    confidence : float
        Level of the intervals.
    spacing, threads
        As in `simulate`.
    progress : callable, optional
        Called with 1 after each sea.

    Returns
    -------
    LinkPerformance

    Raises
    ------
    ValueError
        If an option is out of range or does not fit the others.

    Notes
    -----
    Intervals hold the spread of the seas (bootstrap for the error rate, Wilson for the outage) and
    the Monte Carlo error that all seas have in common, by evaluating the figures at gains shifted
    by that error; the two are added in quadrature. With a UAV, 50 tilts are drawn for each sea.
    Of a coupled series as many times count as its gains are worth (`fading.effective_samples`).

    Monte Carlo noise that the seas do not share acts like additional fading: 0.2 % of the gain with
    the default chains, beside the 10 % that waves of 5 m/s cause.

    All depths use the same phases and random numbers, so that curves are smooth.

    Examples
    --------
    >>> from meshtrace.surfaces import FlatSea
    >>> performance = link_performance(Link(), FlatSea(), photons=1024)
    >>> f"{performance.at().margin_optical_db.value:.0f} dB optical"
    '35 dB optical'
    """
    _check(limit, realizations, confidence, coupled, uav)
    sea, speed = _sea(sea, wind_speed, uav is not None and wind is None)
    height = receiver_of(link).height
    rates = (None,) if bit_rate is None else [float(r) for r in np.atleast_1d(bit_rate)]
    ooks = tuple(ook_link(link, ook, rate) for rate in rates)
    wind = wind or Dryden(wind_speed=speed, height=height)
    flown = None if uav is None else (uav, wind)
    options = {"photons": photons, "spacing": spacing, "threads": threads, "progress": progress}
    recipe = Recipe(sea, realizations, flown, coupled, time_step, seed, options)
    links = _links(channel_link(link, ooks[0]), depths)
    fades = {depth: recipe.fades(at) for depth, at in links.items()}
    figures = [
        figures_of(one, depth, faded, limit, confidence, seed)
        for depth, faded in fades.items()
        for one in ooks
    ]
    origin = {
        **next(iter(fades.values())).series.provenance,
        "ook": [one.model_dump(mode="json") for one in ooks],
        "uav": uav.model_dump(mode="json") if uav else None,
        "wind": wind.model_dump(mode="json") if uav else None,
        "coupled": coupled,
        "realizations": realizations,
    }
    return LinkPerformance(
        depths=tuple(fades),
        ooks=ooks,
        figures=tuple(figures),
        fades=tuple(fades.values()),
        limit=limit,
        confidence=confidence,
        status=ooks[0].status,
        provenance=origin,
    )


def _check(
    limit: float, realizations: int, confidence: float, coupled: bool, uav: Uav | None
) -> None:
    if not 0.0 < limit < 0.5:
        raise ValueError(f"limit: {limit}, allowed 0 < limit < 0.5")
    if not 2 <= realizations <= 10_000_000:
        raise ValueError(f"realizations: {realizations}, allowed 2 <= realizations <= 10000000")
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence: {confidence}, allowed 0 < confidence < 1")
    if coupled and uav is None:
        raise ValueError("coupled: True without uav, allowed with a Uav that tilts the receiver")


def _sea(
    sea: SurfaceModel | None, wind_speed: float | None, needed: bool
) -> tuple[SurfaceModel, float]:
    """Return the sea, and the wind speed that gusts follow."""
    if sea is not None:
        if needed and wind_speed is None:
            raise ValueError("wind_speed: None, allowed with sea and uav: a speed, or a wind")
        return sea, wind_speed or 0.0
    from meshtrace.scenario import Scenario

    speed = 5.0 if wind_speed is None else wind_speed
    return Scenario.from_config({"wind_speed": speed}).surface, speed


def _links(link: Link, depths: Sequence[float] | None) -> dict[float, Link]:
    """Return the link at each depth."""
    if depths is None:
        return {float(getattr(link.transmitters[0], "depth", math.nan)): link}
    values = [float(d) for d in depths]
    if not values or not all(a < b for a, b in pairwise(values)):
        raise ValueError(f"depths: {depths}, allowed at least one depth, strictly rising [m]")
    return {d: at_depth(link, d) for d in values}


def depth_sweep(
    link: Link,
    depths: Sequence[float] = SWEEP_DEPTHS,
    *,
    bit_rate: float | Sequence[float] = (1e6, 5e6, 1e7),
    wind_speeds: Sequence[float] = (0.0, 5.0, 13.0),
    realizations: int = 50,
    **options: Any,
) -> DepthSweep:
    """Return the curves of the bit error rate over depth, each with its confidence band.

    Parameters
    ----------
    link : Link
        The link; sea, bubbles and whitecaps follow each wind (`in_wind`).
    depths : sequence of float
        Depths of the transmitter [m], rising.
    bit_rate : float or sequence of float
        R_b [bit s-1].
    wind_speeds : sequence of float
        Winds at 10 m [m s-1]; 0 is a flat sea.
    realizations : int
        Seas at each depth.
    **options
        As in `link_performance`: `ook`, `limit`, `photons`, `uav`, `coupled`, `seed`, ...

    Returns
    -------
    DepthSweep

    Examples
    --------
    >>> sweep = depth_sweep(Link(), [50.0, 55.0, 60.0], bit_rate=1e6, wind_speeds=[0.0])
    >>> f"{sweep.range_at_ber()[0, 0, 0]:.0f} m"
    '55 m'
    """
    performances = [
        link_performance(
            in_wind(link, speed),
            wind_speed=speed,
            bit_rate=bit_rate,
            depths=depths,
            realizations=realizations,
            **options,
        )
        for speed in wind_speeds
    ]
    return DepthSweep(tuple(float(u) for u in wind_speeds), tuple(performances))
