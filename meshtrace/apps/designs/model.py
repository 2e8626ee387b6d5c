"""Gains, backgrounds, required powers and reserves of a link and of its variations."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, cached_property
from itertools import pairwise
from typing import Any, Final

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq
from scipy.special import ndtr

from meshtrace import Background, Flight
from meshtrace.apps.candidates import Sample
from meshtrace.apps.designs.lenses import two_lenses
from meshtrace.apps.designs.page import DAY, NIGHT, PERIODS, Figures, Line, TwoLenses
from meshtrace.comms import ChannelResponse, OokLink
from meshtrace.comms.background import with_background
from meshtrace.comms.budget import link_budget
from meshtrace.comms.combining import Combining
from meshtrace.comms.response import SHORT
from meshtrace.daylight import Daylight
from meshtrace.fading.laws import probability_in_log
from meshtrace.link import Link
from meshtrace.mesh import SeededSurface
from meshtrace.models import Floats
from meshtrace.optics import Water
from meshtrace.results.tallies import error_of_groups
from meshtrace.scenario import Scenario
from meshtrace.studies import Variant
from meshtrace.studies.background import (
    Lights,
    background_over_seas,
    checked_daylight,
    described,
    mean_meshing,
    mean_sea,
)
from meshtrace.studies.campaign import Campaign, with_first
from meshtrace.studies.neighbours import DECIBELS, error_of, in_water, without_each
from meshtrace.studies.operating_point import Ensemble, FadingSamples, array_of, operating_point
from meshtrace.studies.response import light_response, through_channel
from meshtrace.uav import TiltFactors

DEFAULT_CHAINS = 512
"""Chains of a design, common to all seas and links."""

LENS: Final = "receiver.radius"
VIEW: Final = "receiver.fov_deg"
WIDTH: Final = "detector.optics.filter_width_nm"
RATE, COLOUR = "detector.bit_rate", "transmitter.wavelength_nm"
_SEAS, _RESOLVED_SEAS = 2, 6  # where each has the mean gain, and where waves are resolved
_RUN_SEAS = 16  # of a link that is run by itself
_NIGHT_SEAS = 2  # of its background, which is less than the dark counts
_VIEWS = 2.0, 3.2, 5.0, 8.5, 14.4, 24.5, 41.6, 70.7, 120.0  # [deg] of which backgrounds are found
_CLOSED = 46.0  # 200 dB stand for an eye that no power opens
_UNKNOWN_DB = 1.0  # error from which the loss by scattering has no line
_NIGHTS = ("moonless night", "moonlight")


class MeanGains:
    """Mean gains of variations of a link, relative to the link.

    Parameters
    ----------
    campaign : Campaign
        The link, its sea and options.
    seas : int
        Seas, at most.

    Notes
    -----
    The sea is the `mean_sea` of the link: random slopes have the mean gain of resolved waves, with
    a hundredth of their variance. Links that differ by their receivers are receivers of one run.
    """

    def __init__(self, campaign: Campaign, seas: int) -> None:
        self._link = campaign.link
        sea = mean_sea(campaign.link, campaign.surface)
        most = _RESOLVED_SEAS if sea is campaign.surface else _SEAS
        meshing = campaign.meshing
        if sea is not campaign.surface:
            meshing = mean_meshing(campaign.link, sea, meshing)
        self.campaign = campaign._replace(surface=sea, meshing=meshing, progress=None)
        self.steps = self.campaign.surfaces(min(seas, most))
        self.seas = len(self.steps.labels)
        self._log_ratios: dict[Link, Floats] = {self._link: np.zeros(1)}
        self._link_logs: Floats | None = None

    def log_ratio(self, link: Link, base: Link | None = None) -> tuple[float, float]:
        """Return the logarithm of the ratio of two mean gains, and its standard error."""
        self.compute([link] if base is None else [link, base])
        logs = self._log_ratios[link] - (0.0 if base is None else self._log_ratios[base])
        return float(logs[0]), error_of(logs)

    def compute(self, links: list[Link]) -> None:
        """Compute the gains of links in as few runs as possible."""
        groups: dict[Link, list[Link]] = {}
        for link in dict.fromkeys(links):
            if link not in self._log_ratios:
                groups.setdefault(link.replace("receiver", self._link.receiver), []).append(link)
        # receivers share a run: links that differ by them alone are its receivers
        for base, members in groups.items():
            if base == self._link:
                logs = self._logs([self._link, *members])
                ratios = logs[1:] - logs[0]
            else:
                if self._link_logs is None:
                    (self._link_logs,) = self._logs([self._link])
                ratios = self._logs(members) - self._link_logs
            self._log_ratios |= dict(zip(members, ratios, strict=True))

    def _logs(self, links: list[Link]) -> Floats:
        """Return the logarithms of gains (links, 1 + groups) of links with one lamp."""
        receivers = tuple(link.receivers[0] for link in links)
        whole = links[0].replace("receiver", receivers if len(links) > 1 else receivers[0])
        # shape (seas, receivers, shifts)
        gains = self.campaign.alone.for_link(whole).gains(self.steps)[0, 0]
        return log_means(np.moveaxis(gains, 1, 0))


def log_means(gains: Floats) -> Floats:
    """Return ln of mean gains (links, 1 + groups): all, then leave-one-out (`without_each`)."""
    # a floor in place of 0, whose logarithm no difference would survive
    means = [[without.mean() for without in without_each(of_link)] for of_link in gains]
    return np.log(np.maximum(np.array(means), 1e-300))


def log_quantile(gains: Floats, tilt: TiltFactors, share: float, lognormal: bool = False) -> float:
    """Return ln q with P(g h < q) = share, for gains g (n,) and a law of the tilt factor h.

    By a law with the mean and the deviation of ln g, see `probability_in_log`, or a lognormal one.
    No light is lost beside either.
    """
    # a gain of 0 has no logarithm: its share is dark, as are tilts out of view
    log_gains, factors = np.log(gains[gains > 0.0]), np.log(tilt.h[tilt.h > 0.0])
    weight = tilt.weight[tilt.h > 0.0] * (log_gains.size / gains.size)
    dark = 1.0 - float(weight.sum())
    if dark >= share:
        return -math.inf
    middle = float(log_gains.mean())
    # a narrower law is a step, of which brentq finds no root
    spread = max(float(log_gains.std(ddof=1)) if log_gains.size > 1 else 0.0, 1e-6)
    below = ndtr if lognormal else probability_in_log(spread)

    def excess(x: float) -> float:
        return dark + float(weight @ below((x - middle - factors) / spread)) - share

    # far beyond both ends of the law, as brentq needs a change of sign
    reach = 40.0 * spread + 10.0
    return float(brentq(excess, middle - reach, middle + reach, xtol=1e-9))


class Need:
    """Required power as a function of the background counts, by night or by day."""

    def __init__(self, dark: OokLink, background: Background, limit: float) -> None:
        receiver = with_background(dark, background)
        # the window of the link in its background stays in all scans, but for bit rates
        self.window = receiver.averaging_window
        self.exact = receiver.required_power(limit)
        fixed = dark.replace(window=self.window)
        self.fixed, self._floor = fixed, dark.sipm.dark_count_rate + dark.background_rate + 1.0
        # from a millionth of the present background to ten thousand times it
        # each required power is a search, and scans ask for thousands
        rates = max(receiver.background_rate, self._floor) * np.geomspace(1e-6, 1e4, 15)
        powers = [fixed.replace(background_rate=r).required_power(limit) for r in rates.tolist()]
        finite = np.isfinite(powers)
        self._most = float(rates[finite].max()) if finite.any() else -1.0
        if finite.sum() > 1:
            # ln of the need bends little over ln of the counts; the floor keeps counts of 0 in
            nodes = np.log(rates[finite] + self._floor)
            self._table = PchipInterpolator(nodes, np.log(np.array(powers)[finite]))

    def __call__(self, rate: Any) -> Floats:
        """Return the required power [W] at background count rates [s-1], inf beyond the table."""
        rate = np.asarray(rate, dtype=float)
        if self._most < 0.0:
            return np.full(rate.shape, np.inf)
        power = np.exp(self._table(np.log(np.minimum(rate, self._most) + self._floor)))
        return np.where(rate > self._most, np.inf, power)


class LinkModel:
    """Gains, backgrounds and required powers of a link and of its variations."""

    def __init__(
        self, campaign: Campaign, outage: float, limit: float, seas: int, combining: Combining
    ) -> None:
        scenario = campaign.scenario
        assert isinstance(scenario, Scenario)
        self.outage, self.limit, first = outage, limit, with_first(campaign.link)
        receiver = OokLink.of_link(first, scenario.detector or "physical")
        # `link` has the first receiver alone, of which all scans are; `whole` has all of them
        self.link, self.whole = receiver.channel(first), receiver.channel(campaign.link)
        self.array = array_of(campaign.link, receiver, combining, needs_one_view=True)
        self.campaign = campaign.for_link(self.link)
        # two samples of seas: few smooth ones for ratios of mean gains, many with waves for fading
        self.means = MeanGains(self.campaign, seas)
        # without background light, which differs by night and by day and is added where it counts
        self.dark = through_channel(receiver, self.campaign._replace(progress=None), seas)
        self._response_is_computed = receiver.response is None and self.dark.response is not None
        uav = scenario.uav if self.link.direction == "up" else None
        self.flight = None if uav is None else Flight(uav)
        self.ensemble = Ensemble(self.campaign, seas, self.flight, array=self.array)
        self.seas = seas if isinstance(campaign.surface, SeededSurface) else 1
        nm, day = self.link.transmitters[0].wavelength_nm, scenario.daylight
        night, day = Daylight.night(wavelength_nm=nm), checked_daylight(day, self.link)
        # a link file with a night says nothing about its day, which is then assumed
        if day is not None and day.light in _NIGHTS:
            night, day = day, None
        self.assumed = day is None
        self.daylights = {NIGHT: night, DAY: day or Daylight.clear_sky(30.0, wavelength_nm=nm)}
        # backgrounds are those over mean seas, too
        meshing = self.means.campaign.meshing
        self._backgrounds = Lights(self.campaign._replace(meshing=meshing, progress=None))
        self.windows: dict[str, tuple[Floats, Floats]] = {}  # shares of a bit over ln(bit rate)

    def notes(self) -> tuple[str, ...]:
        """Return remarks about the basis of the page."""
        error, few = 100.0 * self.fades.chain_error, self.means.seas
        remarks = [f"surfaces {self.seas}, of the scans {few}; error by the chains {error:.2g} %"]
        if self.assumed:
            remarks += ["no day in the link file: a clear sky, the sun at a zenith angle of 30 deg"]
        if self.flight is not None:
            share = f"{100.0 * self.fades.tilt.outage:.2g} % of them leave the field of view"
            remarks += [f"the tilts of the aircraft count as in link_performance; {share}"]
        if self.array is not None:
            text = "best values and reach are those of the first, with the gain of all as it is"
            remarks += [f"{len(self.array.optics)} receivers: {text}"]
        return tuple(remarks)

    # ---- gains ------------------------------------------------------------------------------

    @cached_property
    def _all_fades(self) -> FadingSamples:
        """Gains of all receivers of the given link, and tilt factors."""
        return self.ensemble.samples(self.whole)

    @cached_property
    def fades(self) -> FadingSamples:
        """Gains and tilt factors of the first receiver of the given link."""
        every = self._all_fades
        if self.array is None:
            return every
        series = every.series
        series = replace(
            series,
            gain=series.gain[:, 0],
            gain_stderr=series.gain_stderr[:, 0],
            gain_ballistic=series.gain_ballistic[:, 0],
            mean_stderr=float(series.mean_stderrs[0]),
        )
        return replace(every, series=series, array=None)

    @cache  # noqa: B019
    def array_gain(self, period: str) -> float:
        """Return ln of the gain of all receivers together over the first, at the outage."""
        if self.array is None:
            return 0.0
        background = self.background_by(period)
        fades = self._all_fades
        both = fades.combined(self.dark, lambda o: with_background(o, background), self.limit)
        tilt = self.fades.tilt
        all_together, first = (
            log_quantile(samples.series.gain, tilt, self.outage) for samples in (both, self.fades)
        )
        return all_together - first if math.isfinite(first) else 0.0

    def two_lenses(self) -> tuple[TwoLenses, ...]:
        """Return the diversity gain of a second lens, by its distance."""
        gains = self.fades.series.gain
        logs = np.log(gains[gains > 0.0])
        spread = float(logs.std(ddof=1)) if logs.size > 1 else 0.0
        # without fading there is nothing to gain
        if spread < 1e-3:
            return ()
        return two_lenses(self.link, self.campaign.surface, spread, self.outage)

    @cached_property
    def sample(self) -> Sample:
        """Chains of the responses, over the seas of the mean gains."""
        campaign = self.means.campaign
        reweighed: tuple[str, ...] = ()
        # the widest view of the scan: narrower ones only cut its light off
        if self.view_is_a_cut:
            reweighed = (VIEW,)
            widest = max(90.0, self.link.only_receiver.fov_deg)
            campaign = campaign.for_link(self.link.replace(VIEW, widest))
        return Sample(campaign, self.means.seas, (0.0, 0.0), None, reweighed)

    @property
    def view_is_a_cut(self) -> bool:
        """True if the arrivals in a wide field of view include those in any narrower one."""
        return self.link.physics.fov == "angle" and len(self.link.transmitters) == 1

    def colours(self, links: list[Link], index: int) -> tuple[Floats, Floats]:
        """Return log ratios and errors of links at several wavelengths, traced on common paths."""
        named = {f"{i}": link for i, link in enumerate(links)}
        campaign = self.means.campaign._replace(links=named, spectral=True)
        logs = log_means(campaign.gains(self.means.steps)[0, :, :, 0])
        logs -= logs[index]
        return logs[:, 0], np.array([error_of(row) for row in logs])

    # ---- pulses -----------------------------------------------------------------------------

    @cached_property
    def spreads(self) -> bool:
        """True if pulse spreading matters in the widest field of view."""
        if not (self._response_is_computed and self.view_is_a_cut):
            return False
        wide = self.response(self.link.replace(VIEW, 120.0))
        return self.dark.replace(response=wide).spread_in_bits >= SHORT

    @cache  # noqa: B019
    def response(self, link: Link, water: Water | None = None) -> ChannelResponse | None:
        """Return the channel response over the seas of the scans; None for a dark link."""
        lights = self.sample.some_light(Variant(link, None))
        if water is not None:
            lights = [in_water(arrivals, link.water, water) for arrivals in lights]
        return light_response(link, lights)

    def pulse_loss(self, period: str, link: Link, water: Water | None = None) -> float:
        """Return ln of the penalty of a link's pulse spreading, relative to the given link."""
        if not self.spreads:
            return 0.0
        penalty, other = (self._blurred(period, self.response(*at))
                      for at in ((self.link,), (link, water)))  # fmt: skip
        return min(other - penalty, _CLOSED) if math.isfinite(penalty) else 0.0

    @cache  # noqa: B019
    def _blurred(self, period: str, response: ChannelResponse | None) -> float:
        """Return ln of the required power behind a response, with the window of the link."""
        ook = self.dark.replace(response=response, window=self.need(period).window)
        receiver = with_background(ook, self.background_by(period))
        return math.log(receiver.required_power(self.limit))

    def _tilt(self, fov_deg: float) -> TiltFactors:
        """Return the law of the tilt factor behind a field of view."""
        if self.flight is None:
            return self.fades.tilt
        return self.campaign.tilt_factors(self.flight, fov_deg)

    @cache  # noqa: B019 - one study
    def quantile(self, fov_deg: float) -> float:
        """Return ln q of the given link with the field of view `fov_deg`."""
        return log_quantile(self.fades.series.gain, self._tilt(fov_deg), self.outage)

    @cached_property
    def quantile_stderr(self) -> float:
        """Standard error of ln q due to the seas, their law and the common chains."""
        fades = self.fades
        return self._quantile_error(fades.series.gain, fades.tilt, fades.chain_error)

    def _quantile_error(self, gains: Floats, tilt: TiltFactors, chain_error: float) -> float:
        """Return the error of ln q due to the number of seas, the law of gains and the chains."""
        n = len(gains)
        if n < 3:
            return chain_error
        left = [log_quantile(np.delete(gains, i), tilt, self.outage) for i in range(n)]
        spread = (n - 1) * float(np.var(left)) if np.isfinite(left).all() else math.nan
        # seas do not tell the law of their gains; half of the difference of two laws bounds that
        by_law, other = (log_quantile(gains, tilt, self.outage, law) for law in (False, True))
        of_law = 0.5 * abs(other - by_law) if math.isfinite(by_law) else math.nan
        return math.hypot(math.sqrt(spread), of_law, chain_error)

    # ---- lights -----------------------------------------------------------------------------

    @cache  # noqa: B019
    def background_by(self, period: str) -> Background:
        """Return the background of the given link, computed as in `link_performance`."""
        return self._background(period, self.link)

    def _background(self, period: str, link: Link) -> Background:
        """Return the background of a link over the seas."""
        seas = self.ensemble.n if period == DAY else min(self.ensemble.n, _NIGHT_SEAS)
        campaign = self.campaign.for_link(link, _name_of(link))
        campaign = campaign._replace(meshing=self.means.campaign.meshing)
        return background_over_seas(campaign, self.daylights[period], seas, self.flight)

    @cache  # noqa: B019
    def need(self, period: str) -> Need:
        """Return the required power by night or by day."""
        return Need(self.dark, self.background_by(period), self.limit)

    @cache  # noqa: B019
    def _brightness(self, period: str) -> Callable[[float], float]:
        """Return the background radiance against field of view, relative to the given link."""
        fov_deg = self.link.only_receiver.fov_deg
        # by night the dark counts are more than the background, in any view
        if period == NIGHT:
            return lambda fov: 1.0
        views = np.unique([*_VIEWS, fov_deg])
        logs = np.log([self.radiance(period, self.link.replace(VIEW, v)) for v in views.tolist()])
        logs -= logs[views == fov_deg]
        return lambda fov: math.exp(float(np.interp(math.log(fov), np.log(views), logs)))

    def radiance(self, period: str, link: Link) -> float:
        """Return the mean radiance of a link."""
        variant = Variant(link, None, daylight=self.daylights[period])
        background = self._backgrounds.background(variant)
        assert background is not None
        return max(background.radiance, 1e-300)

    # ---- reserves ---------------------------------------------------------------------------

    def reserve(
        self, period: str, log_ratio: float = 0.0, radius: float | None = None,
        fov_deg: float | None = None, width: float | None = None,
    ) -> float:  # fmt: skip
        """Return the reserve [dB] at a ratio of gains, behind the given or other optics."""
        optics = self.dark.optics
        fov = fov_deg or optics.fov_deg
        # a scan over the lens or the filter needs no backgrounds of other views
        bright = 1.0 if fov_deg is None else self._brightness(period)(fov)
        ook = self._with_optics(radius or optics.radius, fov, width or optics.filter_width_nm)
        need = self.needed(period, ook, bright)
        return self.margin_db(period, log_ratio + self.quantile(fov), ook, need)

    def needed(self, period: str, ook: OokLink, brightness: float = 1.0) -> float:
        """Return the required power [W] for a background scaled by `brightness`."""
        return float(self.need(period)(brightness * self.background_by(period).count_rate(ook)))

    @cache  # noqa: B019 - night and day scan the same optics
    def _with_optics(self, radius: float, fov_deg: float, width: float) -> OokLink:
        """Return the receiver in the dark behind other optics."""
        optics = self.dark.optics.replace(radius=radius, fov_deg=fov_deg, filter_width_nm=width)
        ook = self.dark.replace(optics=optics)
        if ook.response is not None and ook.response.angle_deg:
            # late light comes from aside: a narrower view has a shorter response
            seen = tuple(a for a in ook.response.angle_deg if a <= 0.5 * fov_deg)
            ook = ook.replace("response.angle_deg", seen)
        return ook

    def margin_db(self, period: str, log_gain: float, ook: OokLink, need: float) -> float:
        """Return the margin of a gain of the first receiver over the required one [dB]."""
        # a closed eye, or no light: no number of decibels opens it
        if math.isinf(need) or math.isinf(log_gain):
            return -math.inf
        log_gain += self.array_gain(period)
        return DECIBELS * (log_gain + math.log(float(ook.received_power(1.0)) / need))

    def at_rate(self, period: str, bit_rate: float, window: float | None = None) -> OokLink:
        """Return the receiver at another bit rate, by night or by day.

        A given window is a share of the bit; else the best one is sought.
        """
        # a window in seconds would take in the next bit at a higher rate
        if window is None and self.dark.window is not None:
            window = self.dark.window * self.dark.bit_rate / bit_rate
        dark = self.dark.replace(bit_rate=bit_rate, window=window)
        return with_background(dark, self.background_by(period))

    def brightness(self, period: str, wavelengths_nm: Sequence[float]) -> Floats:
        """Return the radiances at wavelengths [nm] over that at the wavelength of the link."""
        day, link_nm = self.daylights[period], self.link.transmitters[0].wavelength_nm
        # the night and a uniform sky have one radiance at all wavelengths
        if day.pattern == "uniform":
            return np.ones(len(wavelengths_nm))
        backgrounds = self._backgrounds.at_wavelengths(self.link, day, wavelengths_nm)
        radiance = np.maximum([background.radiance for background in backgrounds], 1e-300)
        return np.asarray(radiance / radiance[list(wavelengths_nm).index(link_nm)])

    def at_colour(self, period: str, link: Link, log_ratio: float, bright: float) -> float:
        """Return the reserve at another wavelength [dB], under the background there.

        `bright` is its radiance relative to the given link.
        """
        nm, background = link.transmitters[0].wavelength_nm, self.background_by(period)
        day = self.daylights[period].at_wavelength(nm)
        origin = background.provenance | {"daylight": day.model_dump(mode="json")}
        seen = replace(
            background, radiance=bright * background.radiance, wavelength_nm=nm, provenance=origin
        )
        dark = OokLink.of_link(link, self.dark.replace(window=self.need(period).window))
        receiver = with_background(dark, seen)
        log_ratio -= self.pulse_loss(period, self.link, link.water)
        gain = log_ratio + self.quantile(link.only_receiver.fov_deg)
        return self.margin_db(period, gain, receiver, receiver.required_power(self.limit))

    def figures(self, period: str) -> Figures:
        """Return the figures of the given link, as in `link_performance`."""
        background, seed = self.background_by(period), self.campaign.run.seed
        point = operating_point(
            self.dark, self.link.depth, self._all_fades, self.limit, 0.95, seed, background
        )
        receiver = with_background(self.dark, background)
        return Figures(
            period, described(receiver, background), point.outage, point.ber,
            point.margin_optical_db.value,
            self.margin_db(period, self.quantile(self.link.only_receiver.fov_deg), self.dark,
                        self.need(period).exact),
            _error_db(self.quantile_stderr, background), point.capacity.hard,
        )  # fmt: skip

    # ---- budget ----------------------------------------------------------------------------

    def budget(self) -> tuple[Line, ...]:
        """Return the lines of the budget, which add up to the reserve."""
        dark, tilt, mean = self.dark, self.fades.tilt, float(self.fades.series.gain.mean())
        leaned = mean * float(tilt.h @ tilt.weight)
        parts = link_budget(dark, mean, self.limit, leaned / mean)
        received = float(parts.received_dbm)
        lines = [_same("power of the lamp", parts.transmitted_dbm, unit="dBm")]
        lines += self._water_lines(float(parts.gain_db))
        lines.append(_same("tilt of the aircraft", float(parts.tilt_db)))
        lines.append(_same("lens on the detector (etendue)", parts.concentration_db))
        lines.append(_same("transmission of the filter", parts.filter_db))
        lines.append(_same("received power", received, unit="dBm", total=True))
        needs = [self._needs(period) for period in PERIODS]
        names = ("power for the limit, every photon counted", "photon detection efficiency",
                 "dark counts, crosstalk and afterpulses", "response of the channel",
                 "background light")  # fmt: skip
        for name, (night, day) in zip(names, zip(*needs, strict=True), strict=True):
            unit = "dBm" if name == names[0] else "dB"
            lines.append(Line(f"minus {name}", unit, -night, -day))
        night, day = (received - sum(row) for row in needs)
        lines.append(Line("margin of the mean", "dB", night, day, total=True))
        # the quantile over the mean: what is left of the margin when fading takes its share
        fade = DECIBELS * (self.quantile(self.link.only_receiver.fov_deg) - math.log(leaned))
        name, error = f"fading at an outage of {100.0 * self.outage:g} %", self.quantile_stderr
        lines.append(_same(name, fade, DECIBELS * error))
        if self.array is not None:
            by_night, by_day = (DECIBELS * self.array_gain(period) for period in PERIODS)
            name = f"{len(self.array.optics)} receivers together"
            lines.append(Line(name, "dB", by_night, by_day))
            night, day = night + by_night, day + by_day
        lines.append(Line("reserve", "dB", night + fade, day + fade, total=True))
        return tuple(lines)

    def _water_lines(self, gain_db: float) -> list[Line]:
        """Return the parts of the gain: geometry with the surface, absorption, scattering.

        Scattering joins the first where too few chains see the lamp through clear water.
        """
        link, chain_error_db = self.link, DECIBELS * self.fades.chain_error
        if link.water.layers is not None:
            return [_same("geometry, surface and water", gain_db, chain_error_db)]
        straight = link.replace("water.b", 0.0)
        empty = straight.replace("water.a", 0.0)
        self.means.compute([straight, empty])
        absorbed, error_a = self.means.log_ratio(straight, empty)
        scattered, error_b = self.means.log_ratio(link, straight)
        water = [_same("absorption in the water", DECIBELS * absorbed, DECIBELS * error_a)]
        name, error = "geometry, surface and scattering", error_a
        rest = gain_db - DECIBELS * absorbed
        if DECIBELS * error_b <= _UNKNOWN_DB:
            water.append(_same("scattering in the water", DECIBELS * scattered, DECIBELS * error_b))
            name, error = "geometry and surface", math.hypot(error_a, error_b)
            rest -= DECIBELS * scattered
        return [_same(name, rest, math.hypot(chain_error_db, DECIBELS * error)), *water]

    def _needs(self, period: str) -> tuple[float, ...]:
        """Return the required power of an ideal detector [dBm] and penalties of parts [dB]."""
        need = self.need(period)
        prompt = free = need.fixed.replace(response=None)
        for key in ("sipm.dark_count_rate", "sipm.p_crosstalk", "sipm.p_afterpulse"):
            free = free.replace(key, 0.0)
        # each step adds one imperfection, so that the penalties add up to the required power
        steps = (free.replace("sipm.pde", 1.0), free, prompt, need.fixed)
        powers = [ook.required_power(self.limit) for ook in steps] + [need.exact]
        levels = [DECIBELS * math.log(p / 1e-3) if math.isfinite(p) else math.inf for p in powers]
        pairs = pairwise(levels)
        return (levels[0], *(b - a if math.isfinite(a) else 0.0 for a, b in pairs))

    # ---- other links ------------------------------------------------------------------------

    @cache  # noqa: B019
    def separate_run(self, link: Link) -> tuple[float, float]:
        """Return ln q of another link and its standard error, from a separate run.

        Of another receiver along with that of the link, whose photons are spread more evenly.
        """
        ends = tuple(dict.fromkeys((*self.link.receivers, *link.receivers)))
        whole = link.replace("receiver", ends if len(ends) > 1 else ends[0])
        campaign = self.campaign.for_link(whole, f"link and {_name_of(link)}")
        # one sea alone has no spread
        steps = campaign.surfaces(max(min(self.seas, _RUN_SEAS), 2))
        gains = campaign._replace(progress=None).gains(steps)[0, 0, :, -1]  # (seas, shifts)
        means, total = gains.mean(axis=1), float(gains.mean())
        if not total > 0.0:
            return -math.inf, math.nan
        error = float(error_of_groups(gains.mean(axis=0))) / total
        tilt = self._tilt(link.receivers[0].fov_deg)
        return log_quantile(means, tilt, self.outage), self._quantile_error(means, tilt, error)

    @cache  # noqa: B019
    def reserve_of_run(self, period: str, link: Link, width: float) -> tuple[float, float]:
        """Return the reserve of a link with other optics and its error [dB], from a separate run.

        With its own background, averaging window and fading.
        """
        log, error = self.separate_run(link)
        background = self._background(period, link)
        aperture = link.only_receiver
        dark = self._with_optics(aperture.radius, aperture.fov_deg, width)
        if self.spreads:
            dark = dark.replace(response=self.response(link))
        need = with_background(dark, background).required_power(self.limit)
        return self.margin_db(period, log, dark, need), _error_db(error, background)


def _error_db(log_error: float, background: Background) -> float:
    """Return the standard error of a reserve [dB] from the errors of gain and background."""
    # the need grows as the root of the background, at most
    spread = 0.5 * background.radiance_stderr / max(background.radiance, 1e-300)
    return DECIBELS * math.hypot(log_error, spread)


def _name_of(link: Link) -> str:
    """Return the name of a link with other optics or at another depth, in the store."""
    end = link.receivers[-1]
    return f"{end.radius!r} m, {end.fov_deg!r} deg at {link.depth!r} m"


def _same(
    name: str, value: float, stderr: float = 0.0, unit: str = "dB", total: bool = False
) -> Line:
    """Return a budget line with equal values by night and by day."""
    return Line(name, unit, value, value, stderr, total)
