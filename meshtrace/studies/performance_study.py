"""Performance of a link over depth, bit rate and wind: the study.

`link_performance` joins the channel gain (`ensemble`, forced detection) with the receiver
(`meshtrace.comms`) and the aircraft (`meshtrace.uav`); `depth_sweep` gives the curves of the bit
error rate over depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

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
from meshtrace.mesh import SeededSurface, SurfaceModel
from meshtrace.results.background import Background
from meshtrace.results.wavelengths import ByWavelength, checked_wavelengths, spectral
from meshtrace.scenario import Scenario
from meshtrace.studies.background import background_over_seas, described, light_of
from meshtrace.studies.campaign import Campaign, campaign_of
from meshtrace.studies.operating_point import Ensemble, SharedGains, operating_point
from meshtrace.studies.performance import DepthSweep, LinkPerformance
from meshtrace.studies.series import closed_form
from meshtrace.surfaces import sea_in_wind
from meshtrace.uav import Dryden, Flight

SWEEP_DEPTHS = tuple(float(d) for d in range(20, 95, 5))
"""Depths of `depth_sweep` [m]."""


@spectral
def link_performance(
    link: Link | Scenario,
    surface: SurfaceModel | None = None,
    *,
    bit_rate: float | Sequence[float] | None = None,
    ook: OokLink | Preset | None = None,
    depths: Sequence[float] | None = None,
    realizations: int = 200,
    flight: Flight | None = None,
    daylight: Daylight | None = None,
    limit: float = 1e-3,
    confidence: float = 0.95,
    wavelengths_nm: ArrayLike | None = None,
    **run: Unpack[StudyOptions],
) -> LinkPerformance | ByWavelength[LinkPerformance]:
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
    flight : Flight, optional
        Aircraft that carries the receiver, or the lamp of a downlink; none for an end at rest.
    daylight : Daylight, optional
        Light of sun and sky, moon or night, at the wavelength of the transmitter; by default that
        of a scenario, or none: every bit error rate is then that of the dark.
    limit : float
        Largest bit error rate of a working link, before decoding. See `budget.FEC_LIMITS`.
    confidence : float
        Level of the intervals.
    wavelengths_nm : array_like, optional
        Wavelengths [nm], in place of that of the sources, with the gains of common paths (see
        `simulate`) and the light of the same model.
    **run
        Options of the run, see `StudyOptions`.

    Returns
    -------
    LinkPerformance, or ByWavelength of them

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

    The pulses spread by the response of the channel, from the same chains over up to four of the
    seas: it enters error rates, outage and capacity by intersymbol interference where its rms
    delay spread is a thousandth of a bit or more. Below, it costs less than 0.01 dB with the
    default devices, and counts as instantaneous. Where the lamp and the water have a spectrum the
    response also holds the gain over the wavelengths that pass the filter, from common paths over
    these seas, which weighs the light on the detector; unless the optical thickness of the water
    changes by less than 0.001 over them.

    With daylight the background is the mean over the seas, of random slopes where the link has them
    (`background`), with up to 16 tilts of a flight, whose error widens the intervals of the bit
    error rate; the flicker of glint within a sea does not.

    All depths use the same phases and random numbers, so that curves are smooth. Unless `waves` of
    the meshing says otherwise, meshes hold all waves that make the light fade at the first depth.

    Examples
    --------
    >>> from meshtrace.surfaces import FlatSea
    >>> performance = link_performance(Link(), FlatSea(), photons=1024)
    >>> f"{performance.at().margin_optical_db.value:.0f} dB optical"
    '35 dB optical'
    """
    asked: dict[str, Any] = {
        "bit_rate": bit_rate, "ook": ook, "depths": depths, "realizations": realizations,
        "flight": flight, "limit": limit, "confidence": confidence, **run,
    }  # fmt: skip
    if wavelengths_nm is None:
        return _performance(link, surface, daylight=daylight, **asked)
    at = checked_wavelengths(wavelengths_nm)
    common, found = SharedGains(tuple(at), {}, {}), []
    for nm in at:
        day = daylight and daylight.at_wavelength(nm)
        one = link.at_wavelength(nm)
        found.append(_performance(one, surface, daylight=day, common=common, **asked))
    return ByWavelength(np.array(at), tuple(found))


def _performance(
    link: Link | Scenario,
    surface: SurfaceModel | None,
    *,
    bit_rate: Any,
    ook: OokLink | Preset | None,
    depths: Sequence[float] | None,
    realizations: int,
    flight: Flight | None,
    daylight: Daylight | None,
    limit: float,
    confidence: float,
    common: SharedGains | None = None,
    **run: Any,
) -> LinkPerformance:
    """Return the performance at one wavelength."""
    require_kind(flight, Flight | None, "flight")
    campaign = _campaign(_shallowest(link, depths), surface, run)
    link, scenario = campaign.link, campaign.scenario
    if scenario is not None:
        ook = scenario.detector if ook is None else ook
        flight = flight or (Flight(scenario.uav) if scenario.uav else None)
    flight = flight and flight.checked()
    require_between(limit, 0.0, 0.5, "limit")
    require_whole(realizations, 2, 10_000_000, "realizations")
    require_between(confidence, 0.0, 1.0, "confidence")
    rates = (None,) if bit_rate is None else require_finite(bit_rate, "bit_rate", "rates [bit s-1]")
    base = "physical" if ook is None else ook
    ooks = tuple(OokLink.of_link(link, base, rate) for rate in rates)
    ensemble = Ensemble(campaign, realizations, flight, common)
    links = _links(ooks[0].channel(link), depths)
    return _over_depths(ensemble, links, ooks, light_of(campaign, daylight), limit, confidence)


def _over_depths(
    ensemble: Ensemble, links: dict[float, Link], ooks: tuple[OokLink, ...], day: Daylight | None,
    limit: float, confidence: float,
) -> LinkPerformance:  # fmt: skip
    """Return the performance of a link at each depth with each transmission."""
    campaign = ensemble.campaign
    fades = {depth: ensemble.samples(at) for depth, at in links.items()}
    lights = _lights(ensemble, links, day)
    seen = {depth: ensemble.response(ooks[0], at) for depth, at in links.items()}
    points = [
        operating_point(
            one, depth, samples, limit, confidence, campaign.run.seed, lights[depth], seen[depth]
        )
        for depth, samples in fades.items()
        for one in ooks
    ]
    ooks, light = _lit(ooks, lights, campaign.link)
    responses = [None if one is None else one.response for one in seen.values()]
    seas = ensemble.n if isinstance(campaign.surface, SeededSurface) else 1
    origin = {
        **next(iter(fades.values())).series.provenance,
        **closed_form(next(iter(links.values())), campaign.surface, seas, level=2),
        "ook": [one.model_dump(mode="json") for one in ooks],
        "daylight": day.model_dump(mode="json") if day else None,
        "responses": [one and one.model_dump(mode="json") for one in responses],
        **ensemble.provenance(),
    }
    return LinkPerformance(
        tuple(fades), ooks, tuple(points), tuple(fades.values()), limit, confidence,
        ooks[0].status, origin, light, tuple(responses),
    )  # fmt: skip


def _campaign(link: Link | Scenario, surface: SurfaceModel | None, run: Any) -> Campaign:
    """Return the campaign of a link over its sea, one of several winds in a store."""
    campaign = campaign_of(link, surface, "link_performance", fading=True, **run)
    wind = getattr(campaign.scenario, "wind_speed", campaign.link.wind_speed)
    return campaign if wind is None else campaign.of(campaign.link, f"wind of {wind!r} m/s")


def _lit(
    ooks: tuple[OokLink, ...], lights: dict[float, Background | None], link: Link
) -> tuple[tuple[OokLink, ...], str]:
    """Return the transmissions under the background at the first depth, and its text."""
    depth, found = next(iter(lights.items()))
    if found is None:
        return ooks, DARK
    lit = tuple(with_background(ook, found) for ook in ooks)
    warn_of_background(lit[0], found)
    light = described(lit[0], found)
    if link.direction == "down" and len(lights) > 1:
        light += f", at {depth:g} m"
    return lit, light


def _lights(
    ensemble: Ensemble, links: dict[float, Link], day: Daylight | None
) -> dict[float, Background | None]:
    """Return the background at each depth, once for each receiver."""
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
    flight: Flight | None = None,
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
    flight : Flight, optional
        Aircraft that carries the end in the air, by default in each of the winds.
    **options
        As in `link_performance`: `ook`, `limit`, `confidence`, ...

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
        flown = flight
        if flight is not None and flight.wind is None:
            one = link.link if isinstance(link, Scenario) else link
            height = one.air_end[1].height
            flown = flight._replace(wind=Dryden(wind_speed=speed, height=height))
        found = link_performance(
            at, sea_in_wind(speed), bit_rate=bit_rate, depths=depths, realizations=realizations,
            flight=flown, **options,
        )  # fmt: skip
        performances.append(found)
    return DepthSweep(tuple(speeds), tuple(performances))
