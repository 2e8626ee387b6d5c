"""Performance of a link over a random sea, and curves of the bit error rate over depth.

`link_performance` joins the channel gain (`ensemble`, forced detection) with the receiver
(`meshtrace.comms`) and the aircraft (`meshtrace.uav`); `depth_sweep` gives the curves of the bit
error rate over depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Unpack

from meshtrace.comms.background import DARK, warn_of_background, with_background
from meshtrace.comms.ook import OokLink, Preset
from meshtrace.daylight.light import Daylight
from meshtrace.engine.setup.options import StudyOptions
from meshtrace.errors import (
    Described,
    Refused,
    require_between,
    require_finite,
    require_kind,
    require_whole,
)
from meshtrace.link import Link
from meshtrace.mesh import RandomSea, SurfaceModel
from meshtrace.results.background import Background
from meshtrace.scenario import Scenario
from meshtrace.studies.background import background_over_seas, described, light_of
from meshtrace.studies.campaign import campaign_of
from meshtrace.studies.performance.operating_point import Ensemble, operating_point
from meshtrace.studies.performance.tables import DepthSweep, LinkPerformance
from meshtrace.studies.series import closed_form
from meshtrace.surfaces import sea_in_wind
from meshtrace.uav.airframe import Flight
from meshtrace.uav.wind import Dryden

SWEEP_DEPTHS = tuple(float(d) for d in range(20, 95, 5))
"""Depths of `depth_sweep` [m]."""


def link_performance(
    link: Link | Scenario,
    surface: SurfaceModel | None = None,
    *,
    bit_rate: float | Sequence[float] | None = None,
    ook: OokLink | Preset | None = None,
    depths: Sequence[float] | None = None,
    realizations: int = 200,
    wind_speed: float | None = None,
    flight: Flight | None = None,
    daylight: Daylight | None = None,
    limit: float = 1e-3,
    confidence: float = 0.95,
    **run: Unpack[StudyOptions],
) -> LinkPerformance:
    """Return error rate, outage, margin and capacity of a link over a random sea.

    BER = E[BER(P h h_alpha)],  h from forced detection over independent seas

    Parameters
    ----------
    link : Link or Scenario
        The link, with one receiver. Bubbles and whitecaps are its own, see
        `Link.in_wind`. A scenario also gives the sea, the receiver and the aircraft.
    surface : SurfaceModel, optional
        The sea; by default that of the link's wind. A sea without random phases is taken once.
    bit_rate : float or sequence of float, optional
        Bit rates R_b [bit s-1], by default that of `ook`.
    ook : OokLink or {"physical", "paper", "paper-ranges"}, optional
        Transmitter electronics and receiver. "physical", the default, is model W behind
        etendue-limited optics. "paper-ranges" is an empirical calibration
        (`LinkPerformance.status`): water.a is doubled.
    depths : sequence of float, optional
        Depths of the transmitter [m], rising, needed for the range; by default that of the link.
    realizations : int
        Independent seas, or times of a coupled flight, >= 2.
    wind_speed : float, optional
        Wind of the default sea and of a flight without one [m s-1].
    flight : Flight, optional
        Aircraft that carries the receiver, or the lamp of a downlink; none for an end at rest.
    daylight : Daylight, optional
        Light of sun and sky, moon or night, at the wavelength of the transmitter; by default that
        of a scenario, or none: every bit error rate is then that of the dark.
    limit : float
        Largest bit error rate of a working link, before decoding. See `budget.FEC_LIMITS`.
    confidence : float
        Level of the intervals.
    **run
        Options of the run, see `StudyOptions`.

    Returns
    -------
    LinkPerformance

    Raises
    ------
    Refused
        If an option is out of range or does not fit the others.

    Warns
    -----
    DaylightWarning
        If the filter is narrower than its shift over the field of view, or background light draws
        more than 10 mA of bias current.

    Notes
    -----
    Intervals hold the spread of the seas (bootstrap for the error rate, Wilson for the outage) and
    the Monte Carlo error that all seas have in common, by evaluating the figures at gains shifted
    by that error; the two are added in quadrature. With a UAV, 50 tilts are drawn for each sea.
    A coupled series counts as its effective number of gains (`fading.effective_samples`).

    Monte Carlo noise that differs between seas acts like additional fading: 0.2 % of the gain
    with the default chains, beside the 10 % that waves of 5 m/s cause.

    From 50 seas on, the provenance and `LinkPerformance.summary` hold the closed form of the
    scintillation index at the first depth (`fading.band_fading`), and a warning is issued if the
    band of waves omits more than a tenth of the fading.

    With daylight the background is the mean over up to 16 of the seas (`background`), with the
    tilts of a flight, whose error widens the intervals of the bit error rate; the flicker of glint
    within a sea does not.

    All depths use the same phases and random numbers, so that curves are smooth. Unless `waves` of
    the meshing says otherwise, meshes hold all waves that make the light fade at the first depth.

    Examples
    --------
    >>> from meshtrace.surfaces import FlatSea
    >>> performance = link_performance(Link(), FlatSea(), photons=1024)
    >>> f"{performance.at().margin_optical_db.value:.0f} dB optical"
    '35 dB optical'
    """
    require_kind(flight, Flight | None, "flight")
    if surface is None and wind_speed is not None:
        surface = sea_in_wind(wind_speed)
    campaign = campaign_of(
        _shallowest(link, depths), surface, "link_performance", fading=True, **run
    )
    link, scenario = campaign.link, campaign.scenario
    wind = getattr(scenario, "wind_speed", None) if wind_speed is None else wind_speed
    if wind is not None:  # one of several in a store
        campaign = campaign.of(link, f"wind of {wind!r} m/s")
    if scenario is not None:
        ook = scenario.detector if ook is None else ook
        flight = flight or (Flight(scenario.uav) if scenario.uav else None)
    if flight is not None:
        flight = flight.checked()
        if flight.wind is None and wind_speed is not None:
            wind_there = Dryden(wind_speed=wind_speed, height=link.air_end[1].height)
            flight = flight._replace(wind=wind_there)
    require_between(limit, 0.0, 0.5, "limit")
    require_whole(realizations, 2, 10_000_000, "realizations")
    require_between(confidence, 0.0, 1.0, "confidence")
    rates = (None,) if bit_rate is None else require_finite(bit_rate, "bit_rate", "rates [bit s-1]")
    base = "physical" if ook is None else ook
    ooks = tuple(OokLink.of_link(link, base, rate) for rate in rates)
    ensemble = Ensemble(campaign, realizations, flight)
    links = _links(ooks[0].channel(link), depths)
    fades = {depth: ensemble.samples(at) for depth, at in links.items()}
    day = light_of(campaign, daylight)
    lights = _lights(ensemble, links, day)
    points = [
        operating_point(one, depth, samples, limit, confidence, campaign.run.seed, lights[depth])
        for depth, samples in fades.items()
        for one in ooks
    ]
    light, found = DARK, next(iter(lights.values()))
    if found is not None:
        ooks = tuple(with_background(one, found) for one in ooks)
        warn_of_background(ooks[0], found)
        light = described(ooks[0], found)
        if link.direction == "down" and len(links) > 1:
            light += f", at {next(iter(links)):g} m"
    seas = realizations if isinstance(campaign.surface, RandomSea) else 1
    origin = {
        **closed_form(next(iter(links.values())), campaign.surface, seas, level=2),
        "ook": [one.model_dump(mode="json") for one in ooks],
        "daylight": day.model_dump(mode="json") if day else None,
        **ensemble.provenance(),
    }
    origin = {**next(iter(fades.values())).series.provenance, **origin}
    return LinkPerformance(
        tuple(fades), ooks, tuple(points), tuple(fades.values()), limit, confidence,
        ooks[0].status, origin, light,
    )  # fmt: skip


def _lights(
    ensemble: Ensemble, links: dict[float, Link], day: Daylight | None
) -> dict[float, Background | None]:
    """Return the background at each depth; it is that of the receiver alone."""
    if day is None:
        return dict.fromkeys(links)
    found: dict[Any, Background] = {}
    for link in links.values():
        if link.receiver not in found:
            inputs = ensemble.at(link), day, ensemble.n, ensemble.flight
            found[link.receiver] = background_over_seas(*inputs)
    return {depth: found[link.receiver] for depth, link in links.items()}


def _links(link: Link, depths: Sequence[float] | None) -> dict[float, Link]:
    """Return the link at each depth."""
    if depths is None:
        return {link.depth: link}
    allowed = "at least one depth, strictly rising [m]"
    values = require_finite(depths, "depths", allowed).tolist()
    if not all(a < b for a, b in pairwise(values)):
        raise Refused("depths", depths, allowed)
    return {d: link.at_depth(d) for d in values}


def _shallowest(link: Link | Scenario, depths: Sequence[float] | None) -> Link | Scenario:
    """Return the link, or the scenario, at the first depth: it needs the shortest waves."""
    if depths is None or not isinstance(link, Link | Scenario):
        return link
    if isinstance(link, Scenario):
        return link.model_copy(update={"link": _shallowest(link.link, depths)})
    return next(iter(_links(link, depths).values()))


def depth_sweep(
    link: Link | Scenario,
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
    link : Link or Scenario
        The link; sea, bubbles and whitecaps follow each wind (`Link.in_wind`).
    depths : sequence of float
        Depths of the transmitter [m], rising.
    bit_rate : float or sequence of float
        R_b [bit s-1].
    wind_speeds : sequence of float
        Winds at 10 m [m s-1]; 0 is a flat sea.
    realizations : int
        Seas at each depth.
    **options
        As in `link_performance`: `ook`, `limit`, `flight`, `confidence`, ...

    Returns
    -------
    DepthSweep

    Examples
    --------
    >>> sweep = depth_sweep(Link(), [50.0, 55.0, 60.0], bit_rate=1e6, wind_speeds=[0.0])
    >>> f"{sweep.range_at_ber()[0, 0, 0]:.0f} m"
    '55 m'
    """
    if not isinstance(link, Link | Scenario):
        raise Refused("link", Described(type(link).__name__), "a Link or a Scenario")
    performances = []
    speeds = require_finite(wind_speeds, "wind_speeds", "one or more wind speeds [m/s]").tolist()
    for speed in speeds:
        at: Link | Scenario
        if isinstance(link, Scenario):
            at = link.model_copy(update={"link": link.link.in_wind(speed), "wind_speed": speed})
        else:
            at = link.in_wind(speed)
        found = link_performance(
            at, sea_in_wind(speed), wind_speed=speed, bit_rate=bit_rate, depths=depths,
            realizations=realizations, **options,
        )  # fmt: skip
        performances.append(found)
    return DepthSweep(tuple(speeds), tuple(performances))
