"""Background light over time, and its mean over the seas of an ensemble."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Annotated, Any, Unpack

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from meshtrace.checks import check_call
from meshtrace.comms.background import DARK, occupancy, with_background
from meshtrace.comms.ook import OokLink, Preset
from meshtrace.comms.response import ChannelResponse
from meshtrace.daylight.light import Daylight, UnavailableDaylight
from meshtrace.engine.backward.background import background, backgrounds_over
from meshtrace.engine.setup.meshing import mesh_for, surface_config
from meshtrace.engine.setup.options import Case, Meshing, RunOptions
from meshtrace.errors import Refused, require_finite
from meshtrace.fading import resolve_band
from meshtrace.link import Link
from meshtrace.mesh import MeshSource, SeededSurface, WaveSum
from meshtrace.models import Floats
from meshtrace.results.daylight import PARTS, Background, BackgroundSeries
from meshtrace.results.gain import GainResult
from meshtrace.results.impulse import impulse_response
from meshtrace.results.tallies import error_of_groups
from meshtrace.scenario import Scenario
from meshtrace.stored import SHIFTS
from meshtrace.studies.campaign import Campaign, Steps, campaign_of
from meshtrace.studies.keys import Variant
from meshtrace.studies.series import in_flight, moved
from meshtrace.studies.store import digest_of
from meshtrace.uav import Flight

_MOST_SEAS = 16  # of the mean background of an ensemble
_MEAN_SEAS = 4  # the same where each sea has the mean
_LONGEST = 1.1  # highest frequency of the waves of a mean sea over the lowest
# k h of the shortest of these waves, h the spacing of their mesh: interpolated slopes err by
# (k h)^2 / 8, 3e-4 of slopes that are a tenth of the random ones
_LONG_WAVE = 0.05
# Largest spacing over the lever of a crossing; tuned: the quadrature of unscattered light cuts
# facets over which the slope to the receiver changes much, which takes four times as long.
_SPACING_OF_LEVER = 0.06
RAYS = 2048
"""Rays of the background over each sea of an ensemble."""


@check_call
def background_series(
    link: Link | Scenario,
    surface: MeshSource | None = None,
    daylight: Daylight | None = None,
    times: ArrayLike | None = None,
    *,
    photons: Annotated[int, Field(ge=SHIFTS, le=10_000_000)] = 1024,
    flight: Flight | None = None,
    **run: Unpack[RunOptions],
) -> BackgroundSeries:
    """Compute the background of a receiver over a moving sea, with flickering glint.

    Parameters
    ----------
    link : Link or Scenario
        The link, with one receiver.
    surface : MeshSource, optional
        The sea, as in `time_series`.
    daylight : Daylight, optional
        Light above the sea; by default that of a scenario.
    times : array_like, shape (n,)
        Times [s].
    photons : int
        Rays from the receiver, the same at all times, 32 ... 10 000 000.
    flight : Flight, optional
        Aircraft that tilts a receiver in the air; with equal seeds and times it has the tilts of
        `time_series`.
    **run
        Options of the run, see `RunOptions`.

    Returns
    -------
    BackgroundSeries

    Raises
    ------
    Refused
        If an option is out of range, or a flight tilts a receiver that is tilted already.

    Notes
    -----
    The sea is that of `time_series`. Slopes that its mesh leaves out count by their density: glint
    keeps its mean but is smoother than in nature.
    """
    campaign = campaign_of(link, surface, "background_series", run, fading=True)
    day = light_of(campaign, daylight)
    if day is None:
        raise Refused("daylight", None, "a Daylight")
    at = require_finite(() if times is None else times, "times", "at least one time [s]")
    origin = campaign.provenance() | {"daylight": day.model_dump(mode="json")}
    if flight is not None:
        flight = flight.checked()
        origin |= campaign.of_flight(flight)
    series = backgrounds(campaign, in_flight(campaign, at, flight), day, photons)
    return BackgroundSeries(
        np.asarray(at, float),
        np.array([background.part_radiance for background in series]),
        np.array([background.part_radiance_stderr for background in series]),
        origin,
    )


def light_of(campaign: Campaign, day: Daylight | None) -> Daylight | None:
    """Return the daylight of a study (default: the scenario's)."""
    configured = getattr(campaign.scenario, "daylight", None)
    return checked_daylight(configured if day is None else day, campaign.link)


def checked_daylight(day: Daylight | None, link: Link) -> Daylight | None:
    """Return daylight, if any; refuse a wavelength other than the link's."""
    if isinstance(day, UnavailableDaylight):
        raise day.refusal
    wavelength = link.transmitters[0].wavelength_nm
    if day is not None and day.wavelength_nm != wavelength:
        allowed = f"{wavelength:g}, that of the transmitter"
        raise Refused("daylight.wavelength_nm", day.wavelength_nm, allowed)
    return day


def mean_sea(link: Link, surface: Any) -> Any:
    """Return a surface with the mean background over the realizations of a sea.

    All waves but the longest are random slopes there. Over resolved waves a narrow view sees glint
    or none, and a mean takes hundreds of seas: the radiance of a view of 2 deg over a wind of 5 m/s
    scatters by a factor of about 1 from sea to sea, here by 1 %. Surfaces without a spectrum, and
    links without random slopes, keep theirs.

    Parameters
    ----------
    link : Link
        The link.
    surface : Surface or TriangleMesh
        The surface.
    """
    parts = getattr(surface, "parts", [surface])
    lowest = [part.band.omega_min for part in parts if hasattr(part, "band")]
    if not lowest or link.physics.unresolved == "none":
        return surface
    # at least one wave stays, so that the surface is a sea
    return resolve_band(link, surface, _LONGEST * max(lowest))


def mean_meshing(link: Link, sea: Any, meshing: Meshing) -> Meshing:
    """Return a meshing that is as coarse as a mean sea and the quadrature of its light allow.

    The mesh of a link has a spacing for short waves, which random slopes replace there. It stays
    where the user chose one, or where the waves need it.

    Parameters
    ----------
    link : Link
        The link.
    sea : Surface or TriangleMesh
        Its `mean_sea`.
    meshing : Meshing
        Time and resolution otherwise.
    """
    if meshing.spacing is not None or meshing.extent is not None or not isinstance(sea, WaveSum):
        return meshing
    shortest = float(np.hypot(sea.components.kx, sea.components.ky).max(initial=1e-9))
    footprint, levers = link.footprint(), [crossing.lever for crossing in link.crossings()]
    spacing = min(
        _LONG_WAVE / shortest,
        _SPACING_OF_LEVER * min(levers, default=0.0),
        footprint.coarse_spacing,
    )
    return meshing.replace(spacing=spacing) if spacing > footprint.spacing else meshing


def background_over_seas(
    campaign: Campaign, day: Daylight, seas: int, flight: Flight | None = None
) -> Background:
    """Return the mean background of an ensemble of surfaces, over its `mean_sea` if possible.

    Over up to 4 of them, else over up to 16. An aircraft tilts the receiver over each of 16: along
    a coupled flight, else by independent gusts. The standard errors hold the spread of the
    surfaces, and that of the rays they have in common.
    """
    sea = mean_sea(campaign.link, campaign.surface)
    # a receiver at rest over the mean sea: few of its realizations are enough
    held = flight is None or flight.uav.gimbal or campaign.link.direction == "down"
    most = _MEAN_SEAS if held and sea is not campaign.surface else _MOST_SEAS
    campaign = campaign._replace(surface=sea, progress=None)
    by_sea = backgrounds(campaign, _steps(campaign, seas, flight, most), day, RAYS)
    first = by_sea[0]
    if len(by_sea) == 1:
        return first
    parts = np.array([background.part_radiance for background in by_sea])
    mean = Background.of_groups(parts[:, None], first.acceptance, first.wavelength_nm)
    # all seas share their rays, whose error therefore does not fall with the number of seas
    rays = np.mean([background.part_radiance_stderr for background in by_sea], axis=0)
    rays_in_all = float(np.mean([background.radiance_stderr for background in by_sea]))
    mean = replace(
        mean,
        part_radiance_stderr=np.hypot(mean.part_radiance_stderr, rays),
        radiance_stderr=math.hypot(mean.radiance_stderr, rays_in_all),
        provenance=first.provenance,
    )
    if first.pixel_radiance is None:
        return mean
    pixels, errors = np.array([
        (background.pixel_radiance, background.pixel_radiance_stderr) for background in by_sea
    ]).swapaxes(0, 1)  # fmt: skip
    error = np.hypot(error_of_groups(pixels), errors.mean(axis=0))
    return replace(mean, pixel_radiance=pixels.mean(axis=0), pixel_radiance_stderr=error)


def _steps(campaign: Campaign, seas: int, flight: Flight | None, most: int) -> Steps:
    """Return at most `most` surfaces of an ensemble, with the links over each if they tilt."""
    link, sea, time = campaign.link, campaign.surface, campaign.meshing.time
    most = min(seas, most)
    if flight is not None and flight.coupled:
        times = flight.time_step * np.arange(seas, dtype=np.float64)
        links = in_flight(campaign, times, flight).links or ()
        # evenly over the flight: neighbours in time have nearly one tilt
        chosen = np.linspace(0, seas - 1, most).round().astype(int)
        return campaign.in_time(times[chosen], [links[i] for i in chosen])
    if isinstance(sea, SeededSurface):
        steps = campaign.realizations(most)
    else:
        steps = campaign.in_time(np.full(1 if flight is None else most, time))
    if flight is None or link.direction == "down":
        return steps
    wind = campaign.wind_of(flight).sample_wind(len(steps.labels), campaign.run.seed)
    tilt = flight.uav.tilt(wind)
    lean = {"tilt_deg": np.degrees(tilt.angle), "tilt_azimuth_deg": np.degrees(tilt.azimuth)}
    return steps._replace(links=[(tilted,) for tilted in moved(link, lean)])


def transmission_of(link: Link, base: OokLink | None) -> OokLink:
    """Return the electronics of a link; refuse an empirical factor on its water."""
    ook = OokLink.of_link(link, base or "physical")
    # an empirical factor on the water has no counterpart for the background
    if ook.channel(link) is not link:
        raise Refused("detector.preset", "paper-ranges", "a preset without empirical calibration")
    return ook


def transmission_at(
    scenario: Scenario, result: GainResult, i: int
) -> tuple[OokLink, Background | None]:
    """Return the on-off keying (OOK) to receiver i over its channel, and its background, if any.

    The impulse response of the channel follows from the arrivals that the result recorded.
    """
    # each receiver has its own view of the sky
    link = scenario.link.replace(receiver=scenario.link.receivers[i])
    ook, sky = transmission_of(link, scenario.detector), None
    # without a gain there is no response that could spread the pulses
    if result.gains[i] > 0.0 and ook.response is None:
        impulse = impulse_response(result, receiver=i)
        response = ChannelResponse.from_arrivals(impulse.delay, impulse.weight, impulse.angle)
        ook = ook.replace(response=response)
    if checked_daylight(scenario.daylight, link) is not None:
        alone = scenario.model_copy(update={"link": link})
        sky = background(alone, photons=RAYS, seed=scenario.run.seed, threads=1)
    return ook, sky


def described(ook: OokLink, background: Background) -> str:
    """Describe a background light and its counts in a transmission."""
    day = background.provenance["daylight"]
    follows = day["direct"] > 0.0 or day["light"] == "overcast sky"
    sun = f" at zenith angle {day['sun_zenith_deg']:g} deg" if follows else ""
    width = ook.optics.equivalent_width_nm
    return (
        f"{background.light_name}{sun}, {background.radiance:.3g} W m-2 sr-1 nm-1 "
        f"at {background.wavelength_nm:g} nm, "
        f"{ook.background_rate:.3g} counts/s through {width:g} nm, {occupancy(ook):.2g} for a cell "
        f"in its dead time"
    )


def electronics_of(
    campaign: Campaign, ook: OokLink | Preset | None, bit_rate: float | None
) -> OokLink | None:
    """Return the transmission of a link; the detector of a scenario replaces "physical"."""
    detector = getattr(campaign.scenario, "detector", None)
    chosen = detector if ook == "physical" and detector is not None else ook
    return None if chosen is None else OokLink.of_link(campaign.link, chosen, bit_rate)


class Lights:
    """Background light of variants of a link, and their transmissions under it.

    Parameters
    ----------
    campaign : Campaign
        The base link with its surface and options.
    seed : int, optional
        Seed of the rays, by default that of the run; equal rays for all variants.

    Notes
    -----
    Keys of the detector change the counts of a background, all others of its link but the lamp
    its radiance, too: it is computed once for each receiver, water and daylight. The surface is the
    `mean_sea` of a variant: one sea stands for all.
    """

    def __init__(self, campaign: Campaign, seed: int | None = None) -> None:
        self._campaign, self._lamp = campaign, campaign.link.transmitter
        self._seed = campaign.run.seed if seed is None else seed
        self._backgrounds: dict[str, Background] = {}

    def background(self, variant: Variant) -> Background | None:
        """Return the background of a variant, None in the dark."""
        day = checked_daylight(variant.daylight, variant.link)
        if day is None:
            return None
        # the lamp does not enter the background: its keys share one
        link = variant.link.model_copy(update={"transmitter": self._lamp})
        surface = mean_sea(link, self._campaign.surface if variant.sea is None else variant.sea)
        parts = [part.model_dump(mode="json") for part in (link, day)]
        key = digest_of([*parts, surface_config(surface)])
        if key not in self._backgrounds:
            self._backgrounds[key] = self._traced(link, surface, day)
        return self._backgrounds[key]

    def at_wavelengths(
        self, link: Link, day: Daylight, wavelengths_nm: Sequence[float]
    ) -> list[Background]:
        """Return the backgrounds of a link at wavelengths [nm], traced with common rays."""
        result = self._traced(link, mean_sea(link, self._campaign.surface), day, wavelengths_nm)
        return [result.at_wavelength(nm) for nm in wavelengths_nm]

    def _traced(self, link: Link, sea: Any, day: Daylight, wavelengths_nm: Any = None) -> Any:
        """Return the background over a sea, at wavelengths [nm] if given."""
        meshing, threads = self._campaign.meshing, self._campaign.run.threads
        return background(
            link, sea, day, photons=RAYS, seed=self._seed, mesh=meshing, threads=threads,
            wavelengths_nm=wavelengths_nm,
        )  # fmt: skip

    def exposed(self, variant: Variant) -> OokLink | None:
        """Return the transmission of a variant with the counts of its background, if any."""
        if variant.detector is None:
            return None
        measured = self.background(variant)
        return variant.detector if measured is None else with_background(variant.detector, measured)

    def text(self, variant: Variant) -> str:
        """Describe the background light of a variant, "" without a transmission."""
        if variant.detector is None:
            return ""
        measured = self.background(variant)
        return (
            DARK
            if measured is None
            else described(with_background(variant.detector, measured), measured)
        )


def error_rate(
    ook: OokLink, gain: Floats, gain_stderr: float, background: Background | None
) -> tuple[float, float]:
    """Return the bit error rate under a background light, averaged over gains, and its error.

    Parameters
    ----------
    ook : OokLink
        Transmission without the background.
    gain : ndarray, shape (n,)
        Gains over n seas.
    gain_stderr : float
        Standard error that all of them have in common.
    background : Background, optional
        Background light; None for the dark.

    Returns
    -------
    tuple of float
        Mean bit error rate, and its standard error by gain, seas and background.
    """

    def rates(step: float = 0.0, shift: float = 0.0) -> Floats:
        shifted = np.maximum(gain + step * gain_stderr, 0.0)
        exposed = ook
        if background is not None and background.radiance > 0.0:
            relative = background.radiance_stderr / background.radiance
            exposed = with_background(ook, background, max(1.0 + shift * relative, 0.0))
        return np.atleast_1d(exposed.ber(exposed.received_power(shifted)))

    values = rates()
    # central differences over one standard error
    by_gain = 0.5 * float(rates(-1.0).mean() - rates(1.0).mean())
    by_light = 0.5 * float(rates(shift=1.0).mean() - rates(shift=-1.0).mean())
    # of seas, whose gains are independent
    spread = float(error_of_groups(values)) if len(values) > 1 else 0.0
    return float(values.mean()), math.hypot(by_gain, by_light, spread)


def backgrounds(campaign: Campaign, steps: Steps, day: Daylight, photons: int) -> list[Background]:
    """Return the background over each surface."""
    origin = {"daylight": day.model_dump(mode="json")}
    identity = origin | {"steps": steps.identity(), "rays": photons}
    setup = partial(_background_numbers, campaign.alone, steps, day, photons)
    # the threads are those of the rays over one surface
    single_threaded = campaign._replace(run=campaign.run.replace(threads=1))
    name = f"background of {', '.join(campaign.links)} by {day.light}"
    side = campaign.link.pixels
    pixels = side * side if side > 1 else 0
    shape = (2 * len(PARTS) + 4 + 2 * pixels,)
    table = single_threaded.evaluate(
        setup, range(len(steps.labels)), name, identity, lambda step: shape
    )
    results = []
    for row in table:
        ends = np.cumsum([len(PARTS), len(PARTS), 4])
        parts, errors, numbers, by_pixel = np.split(row, ends)
        total, error, acceptance, wavelength = numbers.tolist()
        result = Background(parts, errors, total, error, acceptance, wavelength, origin)
        if pixels:
            values, stderr = by_pixel.reshape(2, side, side)
            result = replace(result, pixel_radiance=values, pixel_radiance_stderr=stderr)
        results.append(result)
    return results


def _background_numbers(
    campaign: Campaign, steps: Steps, day: Daylight, photons: int
) -> Callable[[int], Floats]:
    """Return a function that computes the background over surface i as one array."""

    def numbers_over(i: int) -> Floats:
        link = steps.links[i][0] if steps.links else campaign.link
        surface, time = steps.surface(i)
        case = Case(link, surface, campaign.run, campaign.meshing.replace(time=time))
        mesh, _ = mesh_for(link, surface, case.meshing)
        (seen,) = backgrounds_over(case, mesh, [link], [day], photons)
        numbers = seen.radiance, seen.radiance_stderr, seen.acceptance, seen.wavelength_nm
        columns: list[Any] = [seen.part_radiance, seen.part_radiance_stderr, numbers]
        if seen.pixel_radiance is not None and seen.pixel_radiance_stderr is not None:
            columns += [seen.pixel_radiance.ravel(), seen.pixel_radiance_stderr.ravel()]
        return np.concatenate(columns)

    return numbers_over
