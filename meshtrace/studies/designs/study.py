"""Design of a link: figures by night and by day, best values, reach and budget in one study."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from itertools import pairwise
from typing import Unpack

import numpy as np

from meshtrace.engine.setup.options import StudyOptions
from meshtrace.errors import Described, Refused, require_between, require_whole
from meshtrace.models import Floats
from meshtrace.parallel import results_of
from meshtrace.scenario import Scenario
from meshtrace.studies.campaign import Campaign, campaign_of
from meshtrace.studies.designs.model import COLOUR, DEFAULT_CHAINS, LENS, RATE
from meshtrace.studies.designs.page import DAY, LIGHTS, BestValue, Design, Line, Reach
from meshtrace.studies.designs.scans import OPTICS, Bounds, Scan, Scans

_DEPTHS, _SECANTS = 4, 6  # steps of the search for the greatest depth by runs, and by mean gains
_LEAST_SLOPE = 1e-3  # of the reserve over the depth [dB m-1]
_BIT_RATES = 1e3, 1e9  # of the search for the greatest one
_NEAR_DB = 0.3  # reserve, or its error, of a depth that counts as the greatest
_UNKNOWN_DB = 1.0  # error from which the loss by scattering has no line
_FAR_DB = 3.0  # short at the surface, by chains, where no depth is sought
_DB = 10.0 / math.log(10.0)


def design(
    scenario: Scenario,
    *,
    outage: float = 0.01,
    limit: float = 1e-3,
    over: Mapping[str, tuple[float, float]] | None = None,
    realizations: int = 64,
    **run: Unpack[StudyOptions],
) -> Design:
    """Answer the questions of a system designer about a link on one page.

    reserve = 10 log10(q / need),  P(g h_alpha < q) = outage

    Parameters
    ----------
    scenario : Scenario
        The link with one receiver, its sea, detector ("physical" by default), aircraft and
        daylight (a clear sky with the sun at a zenith angle of 30 deg by default).
    outage : float
        Share of the time that may fail.
    limit : float
        Largest bit error rate of a working link, before decoding.
    over : mapping of str to (low, high), optional
        Bounds of the best values by key, in place of the default ones.
    realizations : int
        Seas of the figures; a link that is run by itself has 16 of them.
    **run
        Options of the run, see `StudyOptions`: 512 chains by default.

    Returns
    -------
    Design

    Raises
    ------
    Refused
        If an option is out of range, or `over` has a key that is not scanned.

    Notes
    -----
    Figures are those of `link_performance`. The quantile q follows from a lognormal law with the
    mean and the variance of the gains g over the seas, and from the tilt factors h_alpha of the
    aircraft. Scans are of mean gains with common random numbers over a sea of random slopes, those
    over the wavelength over common paths, with the light of the same model at each; the shape of
    the law of g and, but for bit rates, the averaging window are those of the given link. The best
    lens, view and filter together are run by themselves, with laws and window of their own.
    Responses of the channel follow the scans by their chains: a narrower field of view or a
    shallower lamp has a shorter one. An interference filter is no narrower than its shift at the
    edge of the field of view (`comms.background.filter_shift_nm`). The best bit rate R carries most
    after hard decisions, R (1 - H2(BER)) at the quantile q (`comms.capacity`); the wavelength is
    scanned in water with a spectrum. Lines of the budget add up to the reserve: the water's part is
    that of the light that reaches the receiver, by runs without scattering, with and without
    absorption.

    Examples
    --------
    >>> import meshtrace as mt
    >>> page = mt.design(mt.Scenario.from_toml("wind_speed = 0.0"), photons=64)
    >>> page.closes("night")
    True
    """
    if not isinstance(scenario, Scenario):
        raise Refused("scenario", Described(type(scenario).__name__), "a Scenario")
    require_between(outage, 0.0, 1.0, "outage")
    require_between(limit, 0.0, 0.5, "limit")
    require_whole(realizations, 8, 100_000, "realizations")
    options: StudyOptions = {"photons": DEFAULT_CHAINS, **run}
    campaign = campaign_of(scenario, None, "design", True, several=False, **options)
    with campaign.workers():
        return _page(_Study(campaign, outage, limit, realizations), campaign, over)


def _page(study: _Study, campaign: Campaign, over: Bounds | None) -> Design:
    """Return the page of a study; independent parts share the threads, the longest first."""
    bounds = study.bounds(over)
    study.prepare(bounds)
    alone = [key for key in bounds if key not in OPTICS]
    (by_key, together), night, day, *others = results_of(
        campaign.threads,
        partial(study.optics, bounds),
        *(partial(study.greatest_depth, light) for light in LIGHTS),
        *(partial(study.scans, key, bounds[key]) for key in alone),
        *(partial(study.figures, light) for light in LIGHTS),
        study.budget,
    )
    *rows, by_night, by_day, budget = others
    by_key |= dict(zip(alone, rows, strict=True))
    scans = [scan for key in bounds for scan in by_key[key]]
    reach = [
        row
        for light, depth in zip(LIGHTS, (night, day), strict=True)
        for row in study.reach(light, depth, scans)
    ]
    return Design(
        outage=study.outage,
        limit=study.limit,
        figures=(by_night, by_day),
        choices=tuple(scan.choice for scan in scans),
        together=tuple(together),
        reach=tuple(reach),
        budget=budget,
        scanned=np.array([scan.values for scan in scans]),
        reserves=np.array([scan.reserves for scan in scans]),
        notes=study.notes(),
        status=study.dark.status,
        provenance={
            **campaign.provenance(campaign.link),
            **study.ensemble.provenance(),
            "ook": study.dark.model_dump(mode="json"),
            "daylight": study.days[DAY].model_dump(mode="json"),
        },
    )


class _Study(Scans):
    """Reach and budget of a link."""

    def reach(self, light: str, greatest: tuple[float, str], scans: list[Scan]) -> list[Reach]:
        """Return the values of keys, each alone, at which the link just closes."""
        own = self.reserve(light)
        end = "receiver" if self.link.direction == "down" else "transmitter"
        depth, note = greatest
        power = 1e3 * self.dark.led.power
        rows = [
            Reach(light, f"{end}.depth", "m", self.link.depth, depth, "at most", note),
            Reach(light, "transmitter.power_mw", "mW", power,
                  power * 10.0 ** (-own / 10.0) if math.isfinite(own) else math.nan, "at least"),
            Reach(light, "detector.bit_rate", "bit s-1", self.dark.bit_rate,
                  self._bit_rate(light, scans), "at most"),
        ]  # fmt: skip
        for choice, values, reserves in scans:
            if choice.light == light and choice.key != RATE:
                rows.append(_closing(choice, values, reserves))
        return rows

    def _bit_rate(self, light: str, scans: list[Scan]) -> float:
        """Return the greatest bit rate that closes [bit s-1], near the scan's."""
        known = next(s for s in scans if (s.choice.key, s.choice.light) == (RATE, light))
        rates, near = np.log(known.values), known.reserves >= 0.0
        low = float(rates[near].max(initial=math.log(_BIT_RATES[0]))) - 0.02
        high = float(rates[~near].min(initial=math.log(_BIT_RATES[1]))) + 0.02
        gain = self.quantile(self.link.only_receiver.fov_deg)

        def closes(log_rate: float) -> bool:
            rate = math.exp(log_rate)
            ook = self.at_rate(light, rate, self.window_at(light, rate))
            return self.above(gain, ook, ook.required_power(self.limit)) >= 0.0

        if not closes(low):
            return math.nan
        while high - low > 0.01:  # a closed eye has no reserve to interpolate
            middle = 0.5 * (low + high)
            low, high = (middle, high) if closes(middle) else (low, middle)
        return math.exp(low)

    def greatest_depth(self, light: str) -> tuple[float, str]:
        """Return the greatest depth that closes [m], and the reserve of a run there."""
        above = self.reserve(light)
        if math.isinf(above):
            return math.nan, "no power closes it"
        try:
            depth = self._depth_by_means(light)
        except Refused:  # in the troughs of the waves
            depth = math.nan
        if math.isnan(depth):
            return math.nan, "none below the waves"
        known = [(self.link.depth, above)]
        for _ in range(_DEPTHS):
            try:
                log, error = self.apart(self.link.at_depth(depth))
            except Refused:
                return math.nan, "none below the waves"
            above = self._at_depth(light, depth, log)
            if abs(above) < max(_NEAR_DB, _DB * error):
                return depth, f"a run there: {above:+.1f} +- {_DB * error:.1f} dB"
            d0, a0 = known[-1]
            slope = _LEAST_SLOPE
            if depth != d0:
                slope = max((a0 - above) / (depth - d0), slope)
            known.append((depth, above))
            depth = float(np.clip(depth + above / slope, 0.3 * depth, 3.0 * depth))
        return math.nan, "no depth found"

    def _depth_by_means(self, light: str) -> float:
        """Return the depth that closes if the law of the fading stays [m]; nan for none.

        The secant method in the depth, as the reserve falls about as it.
        """
        own = self.link.depth, self.reserve(light)
        (d0, a0), depth = own, own[0] * (0.9 if own[1] >= 0.0 else 0.7)
        for _ in range(_SECANTS):
            there = self.link.at_depth(depth)
            log = self.quantile(self.link.only_receiver.fov_deg) + self.means.ratio(there)[0]
            above = self._at_depth(light, depth, log)
            if abs(above) < _NEAR_DB:
                break
            slope = max((a0 - above) / (depth - d0), _LEAST_SLOPE)
            if above + slope * depth < -_FAR_DB:
                return math.nan
            d0, a0 = depth, above
            depth = float(np.clip(depth + above / slope, 0.3 * depth, 3.0 * depth))
        return depth

    def _at_depth(self, light: str, depth: float, log_quantile: float) -> float:
        """Return the reserve at a depth [dB]; a receiver in the water has its light there."""
        bright = 1.0
        if self.link.direction == "down" and light == DAY:
            bright = self.radiance(light, self.link.at_depth(depth))
            bright /= self.radiance(light, self.link)
        need = float(self.need(light)(self.rate(light, self.dark, bright)))
        lost = self.pulse_loss(light, self.link.at_depth(depth))
        return self.above(log_quantile - lost, self.dark, need)

    def budget(self) -> tuple[Line, ...]:
        """Return the lines of the budget, which add up to the reserve."""
        dark, gains, tilt = self.dark, self.fades.series.gain, self.fades.h_alpha
        mean, leaned = float(gains.mean()), float((gains[:, None] * tilt).mean())
        received = _DB * math.log(float(dark.received_power(leaned)) / 1e-3)
        lines = [_same("power of the lamp", _DB * math.log(dark.led.power / 1e-3), unit="dBm")]
        lines += self._water_lines(_DB * math.log(mean))
        optics = dark.optics
        shares = (
            ("tilt of the aircraft", leaned / mean),
            ("lens on the detector (etendue)", optics.concentration_efficiency(dark.sipm.area)),
            ("transmission of the filter", dark.filter_share),
        )
        lines += [_same(name, _DB * math.log(share)) for name, share in shares]
        lines.append(_same("received power", received, unit="dBm", total=True))
        needs = [self._needs(light) for light in LIGHTS]
        names = ("power for the limit, every photon counted", "photon detection efficiency",
                 "dark counts, crosstalk and afterpulses", "response of the channel",
                 "background light")  # fmt: skip
        for name, (night, day) in zip(names, zip(*needs, strict=True), strict=True):
            unit = "dBm" if name == names[0] else "dB"
            lines.append(Line(f"minus {name}", unit, -night, -day))
        night, day = (received - sum(row) for row in needs)
        lines.append(Line("margin of the mean", "dB", night, day, total=True))
        fade = _DB * (self.quantile(self.link.only_receiver.fov_deg) - math.log(leaned))
        share = f"{100.0 * self.outage:g} %"
        lines.append(_same(f"fading at an outage of {share}", fade, _DB * self.quantile_stderr))
        lines.append(Line("reserve", "dB", night + fade, day + fade, total=True))
        return tuple(lines)

    def _water_lines(self, gain_db: float) -> list[Line]:
        """Return the parts of the gain: geometry with the surface, absorption, scattering.

        Scattering joins the first where too few chains see the lamp through clear water.
        """
        link, chain = self.link, _DB * self.fades.chain_error
        if link.water.layers is not None:
            return [_same("geometry, surface and water", gain_db, chain)]
        straight = link.replace("water.b", 0.0)
        empty = straight.replace("water.a", 0.0)
        self.means.find([straight, empty])
        absorbed, error_a = self.means.ratio(straight, empty)
        scattered, error_b = self.means.ratio(link, straight)
        if _DB * error_b > _UNKNOWN_DB:
            rest, error = gain_db - _DB * absorbed, math.hypot(chain, _DB * error_a)
            return [
                _same("geometry, surface and scattering", rest, error),
                _same("absorption in the water", _DB * absorbed, _DB * error_a),
            ]
        rest, error = gain_db - _DB * (scattered + absorbed), math.hypot(error_a, error_b)
        return [
            _same("geometry and surface", rest, math.hypot(chain, _DB * error)),
            _same("absorption in the water", _DB * absorbed, _DB * error_a),
            _same("scattering in the water", _DB * scattered, _DB * error_b),
        ]

    def _needs(self, light: str) -> tuple[float, ...]:
        """Return the required power of an ideal detector [dBm] and penalties of parts [dB]."""
        need = self.need(light)
        quiet = {"sipm.dark_count_rate": 0.0, "sipm.p_crosstalk": 0.0, "sipm.p_afterpulse": 0.0}
        prompt = need.fixed.replace(response=None)
        free = prompt
        for key, value in quiet.items():
            free = free.replace(key, value)
        steps = (free.replace("sipm.pde", 1.0), free, prompt, need.fixed)
        powers = [ook.required_power(self.limit) for ook in steps] + [need.exact]
        levels = [_DB * math.log(p / 1e-3) if math.isfinite(p) else math.inf for p in powers]
        pairs = pairwise(levels)
        return (levels[0], *(b - a if math.isfinite(a) else 0.0 for a, b in pairs))


def _closing(choice: BestValue, values: Floats, reserves: Floats) -> Reach:
    """Return the closing value of a key nearest to the link's.

    The value up to which it closes, down to which for a lens, if that of the link closes.
    """
    light, key, unit, given = choice[:4]
    closes, own = reserves >= 0.0, int(np.abs(values - given).argmin())
    if not closes.any():
        return Reach(light, key, unit, given, math.nan, "at most")
    if closes[own]:
        step, i = -1 if key == LENS else 1, own
        while 0 <= i + step < len(values) and closes[i + step]:
            i += step
    else:
        i = min(np.flatnonzero(closes).tolist(), key=lambda k: abs(k - own))
        step = 1 if i < own else -1
    far, other = i + step, i
    while 0 <= other - step < len(values) and closes[other - step]:
        other -= step
    value, note = float(values[i]), "end of the scan"
    if 0 <= far < len(values):
        note = ""
        if math.isfinite(reserves[far]):
            share = reserves[i] / (reserves[i] - reserves[far])
            value += float(share * (values[far] - values[i]))
    if key == COLOUR:
        note = f"{'from' if step > 0 else 'to'} {values[other]:.0f} nm"
    return Reach(light, key, unit, given, value, "at most" if step > 0 else "at least", note)


def _same(
    name: str, value: float, stderr: float = 0.0, unit: str = "dB", total: bool = False
) -> Line:
    """Return a line that is the same by night and by day."""
    return Line(name, unit, value, value, stderr, total)
