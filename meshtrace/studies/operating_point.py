"""Performance of a link at one depth and bit rate: gains over many seas, tilts, intervals."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple, Self

import numpy as np

from meshtrace.comms.background import widest_filter_nm, with_background
from meshtrace.comms.budget import ber_of_gains, bootstrapped_mean, link_budget, required_gain
from meshtrace.comms.capacity import Capacity, capacity
from meshtrace.comms.combining import Combining, combined_ber, equivalent_gain
from meshtrace.comms.devices import OpticalFrontEnd, photon_energy
from meshtrace.comms.ook import OokLink
from meshtrace.errors import Described, Refused
from meshtrace.fading import Estimate, effective_samples
from meshtrace.fading.distribution import wilson_interval
from meshtrace.link import Link
from meshtrace.models import Floats
from meshtrace.results.daylight import Background
from meshtrace.results.series import GainSeries
from meshtrace.studies.campaign import Campaign, Steps
from meshtrace.studies.response import MeanResponse, mean_responses, over_colours
from meshtrace.studies.series import gain_series, in_flight
from meshtrace.uav import Flight, TiltFactors

_RESAMPLES = 1000
_QUANTILES = 500  # that stand for the law of the gain in the capacity
Expose = Callable[..., OokLink]
"""Adds the background light of a receiver, or of its `pixel` (i, j), to its transmission."""


@dataclass(frozen=True, eq=False)
class FadingSamples:
    """Gains of one link over many seas, and the law of its tilt factor.

    Attributes
    ----------
    series : GainSeries
        Gains over n seas.
    tilt : TiltFactors
        Law of the tilt factor h_alpha, the same over all seas; the single value 1 without a UAV and
        where the gains contain the tilt.
    n_effective : float
        Number of independent samples.
    array : Array, optional
        Several receivers: the series then has their gains or, in one that `combined` returns, those
        of the first receiver alone with the same reserve.
    """

    series: GainSeries
    tilt: TiltFactors
    n_effective: float
    array: Array | None = None

    def combined(self, ook: OokLink, expose: Expose, limit: float) -> Self:
        """Return the samples of one receiver in place of several, see `equivalent_gain`.

        `expose` adds the background to the transmission of each receiver.
        """
        if self.array is None:
            return self
        gains = self.series.gain
        if self.series.gain_by_pixel is not None and self.array.pixels > 1:
            gains = self.series.gain_by_pixel.reshape(len(gains), -1)
        links = self.array.links(ook, expose)
        gain = equivalent_gain(links, gains, limit, self.array.combining)
        # the errors of the receivers have the same chains: they add
        mean = max(float(gains.mean(axis=0).sum()), 1e-300)
        error = float(np.sum(self.series.mean_stderr)) / mean
        series = replace(
            self.series, gain=gain, gain_stderr=error * gain, gain_ballistic=gain,
            mean_stderr=error * float(gain.mean()),
        )  # fmt: skip
        return replace(self, series=series, array=self.array._replace(gains=gains))

    def bers(self, ook: OokLink, expose: Expose, gains: Floats) -> Floats:
        """Return the error rate at each of gains (n, m) over the seas."""
        array = self.array
        if array is None or array.gains is None:
            return ber_of_gains(expose(ook), gains)
        # tilts and errors scale the gains of all receivers alike
        scale = np.divide(gains, self.series.gain[:, None], out=np.zeros_like(gains),
                          where=self.series.gain[:, None] > 0.0)  # fmt: skip
        each = scale[..., None] * array.gains[:, None]
        return combined_ber(array.links(ook, expose), each, array.combining)

    @property
    def samples(self) -> Floats:
        """Gains times tilt factors (n, m), of the probabilities `tilt.weight` over each sea."""
        return self.series.gain[:, None] * self.tilt.h

    def over_tilts(self, values: Floats) -> Floats:
        """Average values of the samples (n, m) over the tilts, shape (n,)."""
        return values @ self.tilt.weight

    @property
    def chain_error(self) -> float:
        """Relative Monte Carlo error common to all gains."""
        return float(self.series.mean_stderr) / max(float(self.series.gain.mean()), 1e-300)

    def mean_gain(self, quantile: float) -> Estimate:
        """Return the mean gain with `quantile` standard errors of seas, tilts and chains."""
        gains = self.over_tilts(self.samples)
        mean = float(gains.mean())
        # correlated times count as fewer samples
        spread = float(gains.std()) / math.sqrt(max(self.n_effective - 1.0, 1.0))
        # seas and chains are independent errors
        reach = quantile * math.hypot(spread, mean * self.chain_error)
        return Estimate(mean, max(mean - reach, 0.0), mean + reach)


class Array(NamedTuple):
    """Several receivers of one signal, or the pixels of one."""

    optics: tuple[OpticalFrontEnd, ...]
    combining: Combining
    gains: Floats | None = None  # (seas, receivers or pixels)
    pixels: int = 1  # along a side of the receiver

    def links(self, ook: OokLink, expose: Expose) -> list[OokLink]:
        """Return the transmission to each receiver or pixel, under its background."""
        if self.pixels > 1:
            return [expose(ook, pixel=pixel) for pixel in np.ndindex(self.pixels, self.pixels)]
        return [expose(ook.replace(optics=optics)) for optics in self.optics]


def pixel_array(link: Link, combining: Combining, flight: Flight | None) -> Array | None:
    """Return the pixels of the only receiver of a link as an array; None for one without.

    Each has the detector of the transmission.
    """
    if link.pixels == 1:
        return None
    if len(link.receivers) > 1:
        n = Described(f"{len(link.receivers)} apertures")
        raise Refused("receiver", n, "one aperture with pixels")
    if flight is not None and not flight.coupled:
        raise Refused("coupled", False, "True with pixels: a tilt moves the light between them")
    return Array((), combining, pixels=link.pixels)


def array_of(link: Link, ook: OokLink, combining: Combining, needs_one_view: Any) -> Array | None:
    """Return the receivers of a link as an array, None for a single one.

    With a background or an aircraft they need one view: both are computed for the first of them.
    """
    n = len(link.receivers)
    if n == 1:
        return None
    if needs_one_view:
        places = {"position", "height", "depth", "radius"}
        views = [end.model_dump(exclude=places) for end in link.receivers]
        if any(view != views[0] for view in views):
            allowed = "equal views and tilts, with daylight or an aircraft"
            raise Refused("receiver", Described("receivers of different views"), allowed)
    optics = [OokLink.of_link(link, ook, receiver=j).optics for j in range(n)]
    return Array(tuple(optics), combining)


_LEVEL = TiltFactors(np.ones(1), np.ones(1))


class Ensemble:
    """Seas, and tilts of an aircraft, over which the performance of a link is averaged.

    Parameters
    ----------
    campaign : Campaign
        The link, its sea and options.
    n : int
        Realizations of the sea, or times of a coupled flight.
    flight : Flight, optional
        Aircraft that carries the end in the air.
    wavelengths_nm : sequence of float
        Wavelengths [nm] whose links have common paths; empty for the link alone.
    computed : dict
        Gains and responses at all wavelengths, which the ensembles of these share.
    array : Array, optional
        Several receivers and their combining.
    """

    def __init__(
        self,
        campaign: Campaign,
        n: int,
        flight: Flight | None,
        wavelengths_nm: Sequence[float] = (),
        computed: dict[tuple[str, float], Any] | None = None,
        array: Array | None = None,
    ) -> None:
        self.campaign, self.n, self.flight, self.array = campaign, n, flight, array
        self._wavelengths_nm, self._computed = list(wavelengths_nm), computed

    def provenance(self) -> dict[str, Any]:
        """Return aircraft, wind and number of realizations as plain data."""
        flight = self.flight
        in_air = self.campaign.of_flight(flight) if flight else {"uav": None, "wind": None}
        coupled = flight is not None and flight.coupled
        return in_air | {"coupled": coupled, "realizations": self.n}

    def at(self, link: Link) -> Campaign:
        """Return the campaign of a link at its depth."""
        (base,) = self.campaign.links
        return self.campaign.for_link(link, f"{base} at {link.depth!r} m")

    def _paths(self, link: Link) -> Campaign:
        """Return the campaign of a link, with the links at all wavelengths that share its paths."""
        if not self._wavelengths_nm:
            return self.at(link)
        links = [link.at_wavelength(nm) for nm in self._wavelengths_nm]
        named = {_spectral_name(link): link for link in links}
        return self.campaign._replace(links=named, spectral=True)

    def _once(self, name: str, link: Link, compute: Callable[[], Any]) -> Any:
        """Compute a result for all wavelengths once, at the first request."""
        if self._computed is None:
            return compute()
        key = name, link.depth
        if key not in self._computed:
            self._computed[key] = compute()
        return self._computed[key]

    def _gains(self, link: Link) -> tuple[Campaign, Steps, Floats]:
        """Return the gains over the surfaces, with their campaign."""
        campaign, flight = self._paths(link), self.flight
        if flight is not None and flight.coupled:
            times = flight.time_step * np.arange(self.n, dtype=np.float64)
            steps = in_flight(campaign, times, flight)
        else:
            steps = campaign.surfaces(self.n)
        return campaign, steps, campaign.gains(steps)

    def samples(self, link: Link) -> FadingSamples:
        """Return gains and tilt factors of a link."""
        campaign, flight = self.at(link), self.flight
        paths, steps, gains = self._once("gains", link, partial(self._gains, link))
        name = _spectral_name(link) if self._wavelengths_nm else None
        series = gain_series(paths, steps, gains, name)
        if flight is not None and flight.coupled:
            series = replace(series, provenance=series.provenance | campaign.of_flight(flight))
            # a constant gain has no correlation to estimate
            n = effective_samples(series.gain) if np.ptp(series.gain) > 0.0 else float(self.n)
            return FadingSamples(series, _LEVEL, n, self.array)
        seas = float(len(series.gain))
        if flight is None:
            return FadingSamples(series, _LEVEL, seas, self.array)
        if link.direction == "down":
            raise Refused("coupled", False, "True for an aircraft that tilts a lamp")
        tilt = campaign.tilt_factors(flight, link.receivers[0].fov_deg)
        return FadingSamples(series, tilt, seas, self.array)

    def response(self, ook: OokLink, link: Link) -> MeanResponse | None:
        """Return the mean response of the channel over the first seas."""
        responses = self._once("responses", link, lambda: mean_responses(self._paths(link), self.n))
        nm = link.transmitters[0].wavelength_nm
        i = self._wavelengths_nm.index(nm) if self._wavelengths_nm else 0
        return over_colours(responses[i], ook, self.at(link), self.n)


def _spectral_name(link: Link) -> str:
    """Return the name of a link at one of several wavelengths, different at each depth."""
    return f"{link.transmitters[0].wavelength_nm!r} nm at {link.depth!r} m"


class OperatingPoint(NamedTuple):
    """Performance at one depth and bit rate; estimates carry their confidence intervals.

    Attributes
    ----------
    depth : float
        Depth of the transmitter [m].
    bit_rate : float
        R_b [bit s-1].
    gain : Estimate
        Mean channel gain, tilt included [1].
    received_power : Estimate
        Mean optical power on the SiPM [W], in the sense of `LedDriver.power`.
    required_power : float
        Power for the limit of the bit error rate without fading [W].
    photons_per_bit : Estimate
        Mean photons on the SiPM in a bit, ones and zeros alike [1].
    margin_optical_db, margin_electrical_db : Estimate
        Mean received over required power: 10 log10 of the optical powers, and twice that.
    ber : Estimate
        Bit error rate, averaged over the fading.
    outage : Estimate
        Probability that the bit error rate of a realization misses the limit.
    capacity : Capacity
        Hard and soft ergodic rates, hard-decision rate of all but 1 % of the fades [bit s-1].
    rms_delay_spread : Estimate
        Rms delay spread of the channel [s]; nan without light.
    dispersion_db : float
        Required power behind the response of the channel over that behind an instantaneous one:
        10 log10 of the optical powers; inf where no power reaches the limit, nan where none does
        even without the response.
    widest_filter_nm : float
        Widest filter with which the mean received power reaches the limit of the bit error rate
        under the background light [nm]; nan without background light.
    """

    depth: float
    bit_rate: float
    gain: Estimate
    received_power: Estimate
    required_power: float
    photons_per_bit: Estimate
    margin_optical_db: Estimate
    margin_electrical_db: Estimate
    ber: Estimate
    outage: Estimate
    capacity: Capacity
    rms_delay_spread: Estimate
    dispersion_db: float
    widest_filter_nm: float = math.nan


def operating_point(
    dark: OokLink, depth: float, samples: FadingSamples, limit: float, confidence: float, seed: int,
    background: Background | None = None, seen: MeanResponse | None = None,
) -> OperatingPoint:  # fmt: skip
    """Return the performance at one bit rate and depth, under a background light.

    Behind the response of the channel that was seen, unless the transmission has its own.
    """
    from scipy.special import ndtri

    quantile = float(ndtri(0.5 + 0.5 * confidence))
    dark, spread = _behind_response(dark, seen, quantile)

    def expose(
        transmission: OokLink, scale: float = 1.0, pixel: tuple[int, int] | None = None
    ) -> OokLink:
        if background is None:
            return transmission
        seen = background if pixel is None else background.of_pixel(*pixel)
        return with_background(transmission, seen, scale)

    samples = samples.combined(dark, expose, limit)
    gain = samples.mean_gain(quantile)
    power = Estimate(*dark.received_power(gain).tolist())
    array, widest = samples.array, math.nan
    # the equivalent gain is that of the first of several receivers or pixels
    ook = expose(dark) if array is None else array.links(dark, expose)[0]
    # of a single pixel the whole background tells no filter
    if background is not None and (array is None or array.pixels == 1):
        widest = (
            widest_filter_nm(dark, background, power.value, limit) if power.value > 0.0 else 0.0
        )
    ber = ber_of_samples(dark, expose, samples, quantile, confidence, seed)
    if background is not None and background.radiance != 0.0 and ber.value != 0.0:
        error = quantile * background.radiance_stderr / background.radiance
        ber = _under_uncertain_light(ber, dark, expose, samples, error)
    budget = link_budget(ook, gain, limit)
    # zeros are not dark: the extinction ratio of the lamp is finite
    low, high = ook.led.levels(power)
    photons = 0.5 * (low + high) / (ook.bit_rate * photon_energy(ook.led.wavelength))
    margins = budget.margin_optical_db, budget.margin_electrical_db
    optical, electrical = (Estimate(*margin.tolist()) for margin in margins)
    return OperatingPoint(
        depth=depth,
        bit_rate=ook.bit_rate,
        gain=gain,
        received_power=power,
        required_power=ook.required_power(limit),
        photons_per_bit=Estimate(*photons.tolist()),
        margin_optical_db=optical,
        margin_electrical_db=electrical,
        ber=ber,
        outage=outage_of_samples(ook, samples, limit, quantile, confidence),
        capacity=capacity(ook, _equal_samples(samples)),
        rms_delay_spread=spread,
        dispersion_db=_dispersion_db(ook, limit),
        widest_filter_nm=widest,
    )


def _behind_response(
    dark: OokLink, seen: MeanResponse | None, quantile: float
) -> tuple[OokLink, Estimate]:
    """Return a transmission with the response of its channel, and the rms delay spread of this."""
    if dark.response is not None:  # of the user, and without an error
        return dark, Estimate(*(3 * (dark.response.rms_spread,)))
    if seen is None:
        return dark, Estimate(math.nan, math.nan, math.nan)
    response, mean, stderr = seen
    reach = quantile * stderr
    return dark.replace(response=response), Estimate(mean, max(mean - reach, 0.0), mean + reach)


def _under_uncertain_light(
    ber: Estimate, dark: OokLink, expose: Callable[..., OokLink], samples: FadingSamples,
    error: float,
) -> Estimate:  # fmt: skip
    """Return an error rate whose interval includes a relative error of the background."""
    lights = [partial(expose, scale=max(1.0 + step, 0.0)) for step in (-error, error)]
    rates = [_mean_ber(dark, brighter, samples, samples.samples) for brighter in lights]
    return _joined_rates(*ber, *rates)


def _dispersion_db(ook: OokLink, limit: float) -> float:
    """Return the penalty of the channel's response [dB], by the optical power for the limit."""
    if ook.filters.response is None:
        return 0.0
    # the same receiver, if the channel spread no pulse
    prompt = ook.replace(response=None).required_power(limit)
    if math.isinf(prompt):
        return math.nan
    return 10.0 * math.log10(ook.required_power(limit) / prompt)


def ber_of_samples(
    ook: OokLink, expose: Expose, samples: FadingSamples, quantile: float, confidence: float,
    seed: int,
) -> Estimate:  # fmt: skip
    """Return the error rate, its intervals joined in the logarithm.

    The interval of the seas is a percentile bootstrap, stretched for correlated times.
    """
    # the gains, and the gains shifted up and down by the error of the chains
    steps = (0.0, quantile, -quantile)
    middle, *shifted = (samples.samples * math.exp(s * samples.chain_error) for s in steps)
    bers = samples.over_tilts(samples.bers(ook, expose, middle))
    over_seas = bootstrapped_mean(bers, samples.n_effective, confidence, _RESAMPLES, seed)
    # the logarithm of no error has no interval
    if over_seas.value == 0.0:
        return over_seas
    at_shifts = (_mean_ber(ook, expose, samples, gains) for gains in shifted)
    return _joined_rates(*over_seas, *at_shifts)


def _mean_ber(ook: OokLink, expose: Expose, samples: FadingSamples, gains: Floats) -> float:
    """Return the error rate of gains (n, m), averaged over seas and tilts."""
    return float(samples.over_tilts(samples.bers(ook, expose, gains)).mean())


def _equal_samples(samples: FadingSamples) -> Floats:
    """Return gains of equal probability: the samples, or quantiles of their weighted law."""
    gains = samples.samples
    weight = np.broadcast_to(samples.tilt.weight / len(gains), gains.shape)
    if gains.size <= _QUANTILES and weight.max() == weight.min():
        return gains
    # quantiles of the weighted law: the capacity takes equally probable gains
    order = np.argsort(gains, axis=None)
    weight = weight.ravel()[order]
    shares = (np.arange(_QUANTILES) + 0.5) / _QUANTILES
    return np.interp(shares, np.cumsum(weight) - 0.5 * weight, gains.ravel()[order])


def outage_of_samples(
    ook: OokLink, samples: FadingSamples, limit: float, quantile: float, confidence: float
) -> Estimate:
    """Return the outage, P(h_alpha < need / g) by the law of the tilt, averaged over the seas.

    Its interval is that of Wilson with the effective number of seas; tilts out of the field of view
    are lost over each of them, and known.
    """
    needed, gain, dark = required_gain(ook, limit), samples.series.gain, samples.tilt.outage
    # the whole curve moves with the common error of the chains
    steps = np.exp(samples.chain_error * quantile * np.array([0.0, 1.0, -1.0]))
    with np.errstate(divide="ignore"):
        missed = [samples.tilt.below(needed / (gain * step)) for step in steps]
    share, brighter, darker = (float(m.mean()) for m in missed)
    over_seas = Estimate(share, share, share)
    if len(gain) > 1 and dark < 1.0:
        seen = np.clip((missed[0] - dark) / (1.0 - dark), 0.0, 1.0)
        rate, n = float(seen.mean()), samples.n_effective
        if 0.0 < rate < 1.0 and seen.var() > 0.0:
            # shares between 0 and 1 scatter less than zeros and ones do: each sea counts for more
            # than one trial
            n *= max(rate * (1.0 - rate) / float(seen.var()), 1.0)
        interval = wilson_interval(rate, n, confidence)
        low, high = (dark + (1.0 - dark) * end for end in (interval.low, interval.high))
        over_seas = Estimate(share, min(low, share), max(high, share))
    value, low, high = _joined(*over_seas, brighter, darker)
    return Estimate(value, max(low, 0.0), min(high, 1.0))


def _joined(value: float, low: float, high: float, brighter: float, darker: float) -> Estimate:
    """Add an independent error to an interval, in quadrature on either side."""
    return Estimate(
        value,
        value - math.hypot(value - low, value - brighter),
        value + math.hypot(high - value, darker - value),
    )


def _joined_rates(*rates: float) -> Estimate:
    """Return the interval of an error rate, `_joined` in the logarithm."""
    logs = _joined(*(math.log(max(rate, 1e-300)) for rate in rates))
    return Estimate(*(math.exp(value) for value in logs))
