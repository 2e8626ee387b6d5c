"""Many surfaces with one set of chains: moving seas, flights, ensembles."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any, Unpack

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from meshtrace.checks import Inside, check_call
from meshtrace.engine.setup.options import StudyOptions
from meshtrace.errors import Refused, require_finite, warn
from meshtrace.fading.spectral import band_fading
from meshtrace.link import Link
from meshtrace.mesh import MeshSource, SurfaceModel
from meshtrace.models import Floats
from meshtrace.results.series import ByWavelength, GainSeries, spectral
from meshtrace.results.tallies import error_of_groups
from meshtrace.scenario import Scenario
from meshtrace.stored import SHIFTS
from meshtrace.studies.campaign import Campaign, Steps, campaign_of
from meshtrace.studies.steering import axes_of, tracker_of, with_axes
from meshtrace.uav import Flight, Route

_STATISTICS = 50  # gains, the least for a comparison with the closed form


@spectral
@check_call
def time_series(
    link: Link | Scenario,
    surface: Annotated[MeshSource | None, Inside()] = None,
    times: ArrayLike | None = None,
    *,
    flight: Flight | None = None,
    route: Route | None = None,
    wavelengths_nm: ArrayLike | None = None,
    per_lamp: bool = False,
    **run: Unpack[StudyOptions],
) -> GainSeries | ByWavelength[GainSeries]:
    """Return the gain over a moving sea, by forced detection with one set of chains.

    Parameters
    ----------
    link : Link or Scenario
        The link, or a scenario: `time_series(scenario, times)`.
    surface : MeshSource, optional
        The sea, whose phases stay while time moves its waves, or meshes in time.
    times : array_like, shape (n,)
        Times [s]; evenly spaced with a flight.
    flight : Flight, optional
        Aircraft that tilts the receiver, or the lamp of a downlink, whose own tilt has to be 0.
        The tilt acts in the cosine of the aperture and in the field of view of every photon, or
        in the pattern of the lamp.
    route : Route, optional
        Waypoints of the receiver, or the lamp of a downlink, whose own position they replace.
    wavelengths_nm : array_like, optional
        Wavelengths in vacuum [nm], in place of that of the sources. See `simulate`.
    per_lamp : bool
        Whether the result also has the gains by lamp, from the same samples.
    **run
        Options of the run, see `StudyOptions`.

    Returns
    -------
    GainSeries, or ByWavelength of them

    Raises
    ------
    Refused
        If an option is out of range, or a flight tilts a receiver that is tilted already.

    Notes
    -----
    A beam with a `Tracker` is steered at each time by what it saw before, see `studies.steer`; its
    times increase. That of a lamp in flight is steered from the tilted axis.

    All times share the chains: the Monte Carlo noise is common to them and cancels in
    differences. Unless `waves` of the meshing says otherwise, the mesh holds all waves that make
    the light of the link fade.

    From 50 gains on, the provenance holds the closed form of the scintillation index of unscattered
    light (`fading.band_fading`), which `GainSeries.summary` prints beside the measured one, and a
    warning is issued if the band of waves omits more than a tenth of the fading.

    With a flight it departs from the paper, where a separate factor h_alpha = cos(alpha)
    [alpha <= fov / 2] multiplies the gain. That factor is right for light that arrives straight
    from below. Scattered light fills a cone: the gain falls below the factor where a part of the
    cone leaves the field of view, and does not vanish at once beyond its edge. An aperture off
    the axis of the light also gains or loses by the azimuth of the tilt, which the factor omits.

    Examples
    --------
    >>> import meshtrace as mt
    >>> from meshtrace.surfaces import FlatSea
    >>> flight = mt.Flight(mt.Uav(), mt.Dryden(wind_speed=13.0))
    >>> level = mt.time_series(mt.Link(), FlatSea(), [0.0, 1.0], photons=256)
    >>> flown = mt.time_series(mt.Link(), FlatSea(), [0.0, 1.0], photons=256, flight=flight)
    >>> (flown.gain < level.gain).all()
    np.True_
    """
    if times is None and not isinstance(surface, MeshSource):
        surface, times = None, surface
    campaign = campaign_of(
        link, surface, "time_series", run, fading=True, analog=True, wavelengths_nm=wavelengths_nm
    )._replace(per_lamp=per_lamp, per_pixel=True)
    at = require_finite(times, "times", "finite times (n,) [s], n >= 1")
    flight = flight and flight.checked()
    # one time of a mesh contradicts many
    if campaign.meshing.time != 0.0:
        raise Refused("sea.time", campaign.meshing.time, "0 with times")
    steps = in_flight(campaign, at, flight, route)
    if campaign.spectral:
        return by_wavelength(campaign, steps)
    series = gain_series(campaign, steps, campaign.gains(steps))
    if steps.links is None:
        return _beside_closed_form(campaign, series)
    origin = campaign.of_flight(flight) if flight else {}
    if route is not None:
        origin["route"] = route.model_dump(mode="json")
    return replace(series, provenance=series.provenance | origin)


@spectral
@check_call
def ensemble(
    link: Link | Scenario,
    realizations: Annotated[int, Field(ge=1, le=10_000_000)],
    surface: SurfaceModel | None = None,
    *,
    wavelengths_nm: ArrayLike | None = None,
    per_lamp: bool = False,
    **run: Unpack[StudyOptions],
) -> GainSeries | ByWavelength[GainSeries]:
    """Return the gains over independent realizations of a sea.

    Parameters
    ----------
    link : Link or Scenario
        The link, or a scenario.
    realizations : int
        Realizations, each with its own random phases.
    surface : SurfaceModel with seed, optional
        The sea; by default that of the wind of the link's bubbles or whitecaps, or of 5 m/s.
    wavelengths_nm : array_like, optional
        Wavelengths in vacuum [nm], in place of that of the sources. See `simulate`.
    per_lamp : bool
        Whether the result also has the gains by lamp, from the same samples.
    **run
        Options of the run, see `StudyOptions`.

    Returns
    -------
    GainSeries, or ByWavelength of them

    Notes
    -----
    Unless `waves` of the meshing says otherwise, the mesh holds all waves that make the light of
    the link fade.

    From 50 gains on, the provenance holds the closed form of the scintillation index of unscattered
    light (`fading.band_fading`), which `GainSeries.summary` prints beside the measured one, and a
    warning is issued if the band of waves omits more than a tenth of the fading.
    """
    campaign = campaign_of(
        link, surface, "ensemble", run, fading=True, analog=True, wavelengths_nm=wavelengths_nm
    )._replace(per_lamp=per_lamp, per_pixel=True)
    if campaign.spectral:
        return by_wavelength(campaign, campaign.realizations(realizations))
    return _beside_closed_form(campaign, over_realizations(campaign, realizations))


def by_wavelength(campaign: Campaign, steps: Steps) -> ByWavelength[GainSeries]:
    """Return the gains at each wavelength of a spectral campaign over its surfaces."""
    gains = campaign.gains(steps)
    at = np.array([link.transmitters[0].wavelength_nm for link in campaign.links.values()])
    results = [gain_series(campaign, steps, gains, name) for name in campaign.links]
    return ByWavelength(at, tuple(results))


def over_realizations(campaign: Campaign, n: int) -> GainSeries:
    """Return the gains over n random phases of a campaign, see `ensemble`."""
    steps = campaign.realizations(n)
    return gain_series(campaign, steps, campaign.gains(steps))


def closed_form(link: Link, surface: Any, n: int) -> dict[str, Any]:
    """Return `fading.band_fading` as plain data, empty below 50 surfaces; warn of a short band."""
    fading = band_fading(link, surface) if n >= _STATISTICS else None
    if fading is None:
        return {}
    text = fading.warning(link.direction == "down")
    if text:
        warn(text)
    return {"closed_form": fading._asdict()}


def _beside_closed_form(campaign: Campaign, series: GainSeries) -> GainSeries:
    """Add the closed form of the scintillation index to a series; warn of a short band."""
    closed = closed_form(campaign.link, campaign.surface, len(series.coordinate))
    return replace(series, provenance=series.provenance | closed)


def in_flight(
    campaign: Campaign, times: Floats, flight: Flight | None, route: Route | None = None
) -> Steps:
    """Return the sea at times (n,) [s], and the links at each of a flight, a route or a tracker."""
    tracked = [tracker_of(link) is not None for link in campaign.links.values()]
    if flight is None and route is None and not any(tracked):
        return campaign.in_time(times)
    # a route replaces the place, a flight the tilt: both may act
    where: dict[str, Floats] = {}
    if route is not None:
        places = route.at(times, campaign.link.air_end[1].height)
        where = {"position": places[:, :2], "height": places[:, 2]}
    lean: dict[str, Floats] = {}
    if flight is not None:
        for link in campaign.links.values():
            name, end = link.air_end
            if end.tilt_deg != 0.0:
                raise Refused(f"{name}.tilt_deg", end.tilt_deg, "0: the flight tilts it")
        wind = campaign.wind_of(flight).simulate_wind(times, campaign.run.seed)
        lean["tilt_deg"], lean["tilt_azimuth_deg"] = np.degrees(flight.uav.tilt(wind))
    # links of several wavelengths move together
    moving = [
        moved(link, lean | where) if lean or where else [link] * len(times)
        for link in campaign.links.values()
    ]
    if campaign.spectral and any(tracked):
        # one beam of many colours has one axis, steered by its first
        axes = axes_of(moving[0], campaign.surface, times, campaign.run.seed)
        moving = [with_axes(links, axes) for links in moving]
    elif any(tracked):
        moving = [
            with_axes(links, axes_of(links, campaign.surface, times, campaign.run.seed))
            if steered
            else links
            for links, steered in zip(moving, tracked, strict=True)
        ]
    return campaign.in_time(times, list(zip(*moving, strict=True)))


def moved(link: Link, changes: dict[str, Floats]) -> list[Link]:
    """Return a link per row of changes to its end in the air."""
    name, end = link.air_end
    links = []
    for row in zip(*changes.values(), strict=True):
        values = {key: np.asarray(v).tolist() for key, v in zip(changes, row, strict=True)}
        links.append(link.model_copy(update={name: end.model_copy(update=values)}))
    return links


def gain_series(
    campaign: Campaign, steps: Steps, gains: Floats, name: str | None = None
) -> GainSeries:
    """Return the series of one link, by default the first, from `Campaign.gains` over the steps."""
    names = list(campaign.links)
    name = name or names[0]
    link = campaign.links[name]
    n = len(link.receivers)
    # a list of one receiver keeps its dimension
    receivers = slice(n) if isinstance(link.receiver, tuple) else 0
    gain, direct = gains[:, names.index(name), :, receivers]
    series = GainSeries(
        steps.along,
        steps.labels,
        gain.mean(axis=-1),
        error_of_groups(gain, -1),
        direct.mean(axis=-1),
        error_of_groups(gain.mean(axis=0), -1)[()],
        campaign.provenance(link),
    )
    # columns: receivers, then pairs, then pixels
    further, m = gains[0, names.index(name), :, n:], campaign.pixels
    if m > 1:
        pixels = further[:, -n * m * m :].reshape(len(gain), n, m, m, SHIFTS)
        stderr = error_of_groups(pixels, -1)
        series = replace(series, gain_by_pixel=pixels.mean(axis=-1), gain_by_pixel_stderr=stderr)
        further = further[:, : -n * m * m]
    if not campaign.per_lamp:
        return series
    pairs = further.reshape(len(gain), -1, n, SHIFTS)
    return replace(
        series,
        gain_by_lamp=pairs.mean(axis=-1),
        gain_by_lamp_stderr=error_of_groups(pairs, -1),
        gain_by_lamp_groups=pairs.mean(axis=0),
    )
