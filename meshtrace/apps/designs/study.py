"""Design of a link: figures by night and by day, best values, reach and budget in one study."""

from __future__ import annotations

import math
from functools import partial
from typing import Annotated, NamedTuple, Unpack

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.interpolate import PchipInterpolator

from meshtrace.apps.designs.model import COLOUR, DEFAULT_CHAINS, LENS, RATE, VIEW, WIDTH, LinkModel
from meshtrace.apps.designs.page import DAY, PERIODS, BestValue, Design, Period, Reach
from meshtrace.apps.designs.spots import tracked_spots
from meshtrace.checks import ErrorRate, Probability, check_call
from meshtrace.comms.background import filter_shift_nm
from meshtrace.comms.capacity import capacity, hard_information
from meshtrace.comms.combining import Combining
from meshtrace.engine.setup.options import StudyOptions
from meshtrace.errors import Refused, require_keys
from meshtrace.link import Link
from meshtrace.models import Floats
from meshtrace.parallel import results_of
from meshtrace.scenario import Scenario
from meshtrace.studies import Variant
from meshtrace.studies.campaign import Campaign, campaign_of
from meshtrace.studies.keys import Bounds, checked_bounds
from meshtrace.studies.neighbours import DECIBELS, closing_depth

# Tuned: accuracy of a design against its cost.
_FLAT_DB = 0.5  # values this close to the best are as good [dB]
_POINTS = 49  # values of a scan
_NODES, _VIEWS = 4, 13  # of these, simulated ones: over other keys, and over the field of view
_FEW_COUNTS = 100.0  # mean counts in a 1 bit, below which the discrete counts bound the rate
_WINDOWS = 6  # intervals between the bit rates at which the best averaging window is sought
_COLOURS = 9  # simulated wavelengths, on common paths
_COLOURS_NM = 400.0, 650.0  # widest default bounds [nm]
OPTICS = LENS, VIEW, WIDTH
"""Keys of which the best values are also sought together."""
_RUNS = 4  # runs of the search for the greatest depth
_BIT_RATES = 1e3, 1e9  # bounds of the search for the greatest bit rate [bit s-1]
_NEAR_DB = 0.3  # a reserve that counts as none at the greatest depth, unless its error is larger
_FAR_DB = 3.0  # power missing at the surface, extrapolated, from which no depth is sought


@check_call
def design(
    scenario: Scenario,
    *,
    outage: Probability = 0.01,
    limit: ErrorRate = 1e-3,
    bounds: Bounds | None = None,
    realizations: Annotated[int, Field(ge=8, le=100_000)] = 64,
    combining: Combining = "maximal",
    **run: Unpack[StudyOptions],
) -> Design:
    """Answer the questions of a system designer about a link on one page.

    reserve = 10 log10(q / need),  P(g h_alpha < q) = outage

    Here g is the channel gain, h_alpha the tilt factor of the aircraft, and `need` the gain at
    which the bit error rate is `limit`.

    Parameters
    ----------
    scenario : Scenario
        The link with one receiver, or several of one view, its sea, detector ("physical" by
        default), aircraft and daylight (a clear sky with the sun at a zenith angle of 30 deg by
        default).
    outage : float
        Share of the time that may fail.
    limit : float
        Largest bit error rate of a working link, before decoding.
    bounds : mapping of str to (low, high), optional
        Bounds of the best values by key, in place of the default ones.
    realizations : int
        Seas of the figures; links in a separate run have at most 16 of them.
    combining : {"selection", "equal", "maximal"}
        How several receivers are combined, see `comms.combining.combined_ber`.
    **run
        Options of the run, see `StudyOptions`: 512 chains by default.

    Returns
    -------
    Design

    Raises
    ------
    Refused
        If an option is out of range, or `bounds` has a key that is not scanned.

    Notes
    -----
    Figures are those of `link_performance`. The quantile q follows from a gamma-gamma law of equal
    shapes with the mean and the deviation of ln g over the seas, and from the law of the tilt
    factor h_alpha of the aircraft; half the difference of a lognormal law joins its error. Scans
    are of mean gains with common random numbers over a sea of random slopes, those over the
    wavelength over common paths, with the light of the same model at each; the shape of the law of
    g and, but for bit rates, the averaging window are those of the given link. The best lens, view
    and filter together are run by themselves, with laws and window of their own. Responses of the
    channel follow the scans by their chains: a narrower field of view or a shallower lamp has a
    shorter one. An interference filter is no narrower than its shift at the edge of the field of
    view (`comms.background.filter_shift_nm`). The best bit rate R carries most after hard
    decisions, R (1 - H2(BER)) at the quantile q (`comms.capacity`); the wavelength is scanned in
    water with a spectrum. Lines of the budget add up to the reserve: the water's part is that of
    the light that reaches the receiver, by runs without scattering, with and without absorption.

    Several receivers count as the first of them, with a line of the budget for what all together
    gain over it; best values and reach are those of the first with that gain. The table of two
    lenses states what a second one, whose counts add, would gain by diversity: correlations are
    those of `fading.gain_correlation`, and the law of ln g that of the quantile q, with a Gaussian
    copula.

    Examples
    --------
    >>> import meshtrace as mt
    >>> page = mt.design(mt.Scenario.from_toml("wind_speed = 0.0"), photons=64)
    >>> page.closes("night")
    True
    """
    run.setdefault("photons", DEFAULT_CHAINS)
    # without the waves of fading, which such a link lacks
    campaign_of(scenario, None, "design", run, several=False).require_chains()
    campaign = campaign_of(scenario, None, "design", run, fading=True, several=False)
    with campaign.workers():
        study = _Study(campaign, outage, limit, realizations, combining)
        return _page(study, campaign, bounds)


def _page(study: _Study, campaign: Campaign, ranges: Bounds | None) -> Design:
    """Return the page of a study; independent parts share the threads, the longest first."""
    bounds = study.bounds(ranges)
    study.prepare(bounds)
    # the scans of lens, view and filter are shared with the search for all three together
    alone = [key for key in bounds if key not in OPTICS]
    (by_key, together), night, day, *others = results_of(
        campaign.threads,
        partial(study.optics, bounds),
        *(partial(study.greatest_depth, period) for period in PERIODS),
        *(partial(study.scans, key, bounds[key]) for key in alone),
        *(partial(study.figures, period) for period in PERIODS),
        study.budget,
        study.two_lenses,
    )
    *scans_alone, by_night, by_day, budget, lenses = others
    by_key |= dict(zip(alone, scans_alone, strict=True))
    scans = [scan for key in bounds for scan in by_key[key]]
    reach = [
        row
        for period, depth in zip(PERIODS, (night, day), strict=True)
        for row in study.reach(period, depth, scans)
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
        two_lenses=lenses,
        status=study.dark.status,
        spots=tracked_spots(campaign.link, campaign.surface, campaign.threads),
        provenance=campaign.provenance(campaign.link)
        | study.ensemble.provenance()
        | {
            "ook": study.dark.model_dump(mode="json"),
            "daylight": study.daylights[DAY].model_dump(mode="json"),
        },
    )


class Scan(NamedTuple):
    """Reserves over the values of a key."""

    choice: BestValue
    values: Floats
    reserves: Floats


class _Study(LinkModel):
    """Reserves over the values of each key, the best of them, reach and budget."""

    def bounds(self, ranges: Bounds | None) -> dict[str, tuple[float, float]]:
        """Return the bounds of each scanned key, in the unit of the key.

        The default ones are factors about the values of the link, tuned.
        """
        name, end = self.link.air_end
        x = end.position[0]
        radius, span = self.link.only_receiver.radius, 0.5 * (end.height + self.link.depth)
        bounds = {
            LENS: (radius / 4.0, 4.0 * radius),
            VIEW: (2.0, 120.0),
            WIDTH: (1.0, 40.0),
            f"{name}.position.0": (x, x + span),
            f"{name}.height": (0.5 * end.height, 2.0 * end.height),
            RATE: (0.1 * self.dark.bit_rate, min(30.0 * self.dark.bit_rate, 1e10)),
        }
        spectrum = self.link.water.spectrum
        if spectrum is not None and len(self.link.transmitters) == 1:
            low, high = spectrum.limits_nm
            bounds[COLOUR] = max(low, _COLOURS_NM[0]), min(high, _COLOURS_NM[1])
        elif ranges and COLOUR in ranges:
            self.link.at_wavelength(ranges[COLOUR][0])  # raises `Refused` with the reason
        require_keys({} if ranges is None else ranges, bounds, "bounds")
        return bounds | checked_bounds(ranges or {})

    def scans(self, key: str, bounds: tuple[float, float]) -> list[Scan]:
        """Scan the reserve over the values of a key, by night and by day where both exist."""
        values = self._values(key, bounds)
        if key == RATE:
            return [self._bit_rates(period, values) for period in PERIODS]
        if key == COLOUR:
            return self._colours(values)
        logs, errors = self._logs(key, values)
        # radius, field of view and filter width of `reserve`: None stands for those of the link
        optics = [[v if name == key else None for name in OPTICS] for v in values.tolist()]
        scans = []
        for period in PERIODS:
            pairs = zip(logs[period], optics, strict=True)
            reserves = [self.reserve(period, log, *changed) for log, changed in pairs]
            scans.append(self._scan(period, key, values, np.array(reserves), DECIBELS * errors))
        return scans

    def _values(self, key: str, bounds: tuple[float, float]) -> Floats:
        """Return the values of a scan, the link's among them."""
        present = self._present(key)
        spaced = np.linspace if key.endswith("position.0") else np.geomspace
        values = spaced(*bounds, _POINTS)
        # a gain is counted from the value of the link, which must be among those of the scan
        if bounds[0] <= present <= bounds[1]:
            values[np.abs(values - present).argmin()] = present
        return values

    def _present(self, key: str) -> float:
        """Return the value of a key of the link or of the detector."""
        return float(Variant(self.link, None, self.dark).value(key))

    def _logs(self, key: str, values: Floats) -> tuple[dict[str, Floats], Floats]:
        """Return ln of gain ratios to the given link, by night and by day, and their errors.

        The ratios are less the power that the response of the channel costs (`pulse_loss`).
        """
        if key == WIDTH:
            return dict.fromkeys(PERIODS, np.zeros(len(values))), np.zeros(len(values))
        linear = key.endswith("position.0")
        abscissa = values if linear else np.log(values)
        # tuned: each pulse loss takes a search for a power; over the view every other node has one
        stride, links, nodes = 2 if key == VIEW else 1, self._at(key, values), abscissa[_nodes(key)]
        logs, errors = np.array([self.means.log_ratio(link) for link in links]).T
        by_period: dict[str, Floats] = dict.fromkeys(PERIODS, _through(nodes, logs, abscissa))
        if key == LENS:  # which changes no delays
            return by_period, np.interp(abscissa, nodes, errors)
        for period in PERIODS:
            losses = np.array([self.pulse_loss(period, link) for link in links[::stride]])
            by_period[period] = by_period[period] - _through(nodes[::stride], losses, abscissa)
        return by_period, np.interp(abscissa, nodes, errors)

    def _at(self, key: str, values: Floats) -> list[Link]:
        """Return the links at the nodes of a scan."""
        base = Variant(self.link, None)
        return [base.set(key, value).link for value in values[_nodes(key)].tolist()]

    def prepare(self, bounds: Bounds) -> None:
        """Compute gains, required powers and channel response, shared by the parts of the page."""
        keys = (key for key in bounds if key not in (WIDTH, RATE, COLOUR))
        links = [link for key in keys for link in self._at(key, self._values(key, bounds[key]))]
        results_of(
            self.campaign.threads,
            lambda: self.fades,
            partial(self.means.compute, links),  # in few runs, with common random numbers
            *(partial(self.need, period) for period in PERIODS),
            lambda: self.spreads and self.response(self.link),  # cached; only if pulses spread
        )

    def _bit_rates(self, period: Period, values: Floats) -> Scan:
        """Return the reserves over bit rates; the best has the largest rate of hard decisions."""
        # standard error of ln q, and ln q
        error = self.quantile_stderr
        gain = self.quantile(self.link.only_receiver.fov_deg)
        nodes = values[:: len(values) // _WINDOWS]
        # the best window is sought at a few rates: as a share of the bit it changes slowly
        shares = [self.at_rate(period, v).averaging_window * v for v in nodes.tolist()]
        self.windows[period] = np.log(nodes), np.array(shares)
        ooks = [self.at_rate(period, v, self.window_at(period, v)) for v in values.tolist()]
        # the search for the required power is costly, the reserve smooth: every other rate does
        coarse = [
            self.margin_db(period, gain, ook, ook.required_power(self.limit)) for ook in ooks[::2]
        ]
        reserves = np.interp(np.log(values), np.log(values[::2]), coarse)
        carried, shares_within_error, together = [], [], gain + self.array_gain(period)
        for ook in ooks:
            # at the quantile, then one standard error below and above it
            powers = ook.received_power(np.exp(together + error * np.array([0.0, -1.0, 1.0])))
            share, *shares_at_ends = hard_information(ook.ber(powers)).tolist()
            if ook.levels(powers[0])[1] * ook.bit_time < _FEW_COUNTS:
                # a Gaussian BER may claim more than the full counts carry: `capacity` bounds it
                share = capacity(ook, [math.exp(together)]).hard / ook.bit_rate
            carried.append(share * ook.bit_rate)
            shares_within_error.append(shares_at_ends)
        # half of the difference in dB is the error; floors stand for a rate of 0
        low, high = 5.0 * np.log10(np.maximum(np.array(shares_within_error), 1e-9)).T
        merit = 10.0 * np.log10(np.maximum(carried, 1e-3))
        return self._scan(period, RATE, values, reserves, np.abs(high - low), merit)

    def window_at(self, period: Period, bit_rate: float) -> float:
        """Return the averaging window at a bit rate, interpolated in the scan [s]."""
        return float(np.interp(math.log(bit_rate), *self.windows[period])) / bit_rate

    def _colours(self, values: Floats) -> list[Scan]:
        """Return the reserves over wavelengths from common paths, by night and by day."""
        link_nm = self.link.transmitters[0].wavelength_nm
        nodes = np.unique([*np.linspace(values[0], values[-1], _COLOURS), link_nm])
        links = [self.link.at_wavelength(nm) for nm in nodes.tolist()]
        logs, errors = self.colours(links, int(np.searchsorted(nodes, link_nm)))
        scans = []
        for period in PERIODS:
            try:
                brightness = self.brightness(period, nodes.tolist())
                by_colour = zip(links, logs, brightness.tolist(), strict=True)
                reserves = [self.at_colour(period, *colour) for colour in by_colour]
            except Refused:  # irradiances of one wavelength
                continue
            curve = _through(nodes, np.array(reserves), values)
            bars = DECIBELS * np.interp(values, nodes, errors)
            scans.append(self._scan(period, COLOUR, values, curve, bars))
        return scans

    def _least_width(self, fov_deg: float) -> float:
        """Return the shift of an interference filter at the edge of a view [nm]."""
        return filter_shift_nm(self.link.transmitters[0].wavelength_nm, 0.5 * fov_deg)

    def _scan(
        self, period: Period, key: str, values: Floats, reserves: Floats, errors: Floats,
        merit: Floats | None = None,
    ) -> Scan:  # fmt: skip
        """Return a scan with its best value: highest reserve or, if given, highest `merit`."""
        present = self._present(key)
        permitted, notes = np.ones(len(values), bool), []
        score, at_present = reserves, self.reserve(period)
        if merit is not None:
            score, at_present = merit, float(np.interp(math.log(present), np.log(values), merit))
        if key == WIDTH:
            # a filter narrower than its shift at the edge of the view would lose light from there
            least = self._least_width(self.link.only_receiver.fov_deg)
            permitted = values >= min(least, values[-1])
            score = reserves = np.where(permitted, reserves, math.nan)
            notes.append(f"shift at the edge of the view {least:.2g} nm")
        best = int(np.argmax(np.where(permitted, score, -np.inf)))
        # values that the errors cannot tell from the best one are as good
        as_good = permitted & (score >= score[best] - np.maximum(_FLAT_DB, errors))
        low, high = _around(as_good, best)
        if best in (0, len(values) - 1) and values[best] != present:
            notes.append("at the bound")
        if merit is not None:
            notes.append(f"{10.0 ** (0.1 * merit[best]) / 1e6:.3g} Mbit/s after hard decisions")
        gained = score[best] - at_present if math.isfinite(at_present) else math.nan
        unit = {"deg": "deg", "nm": "nm", "rate": "bit s-1"}.get(key.rpartition("_")[2], "m")
        flat = float(values[low]), float(values[high])
        choice = BestValue(period, key, unit, present, float(values[best]), float(gained),
                           float(errors[best]), flat, "; ".join(notes))  # fmt: skip
        return Scan(choice, values, reserves)

    def optics(self, bounds: Bounds) -> tuple[dict[str, list[Scan]], list[BestValue]]:
        """Scan lens, view and filter separately, and find their best combination."""
        alone = {key: self.scans(key, bounds[key]) for key in OPTICS}
        return alone, [row for period in PERIODS for row in self._together(period, bounds)]

    def _together(self, period: Period, bounds: Bounds) -> tuple[BestValue, ...]:
        """Return the best combination of lens, view and filter, evaluated in a separate run."""
        radii, views = (self._values(key, bounds[key]) for key in (LENS, VIEW))
        by_radius, by_view = (
            self._logs(key, x)[0][period] for key, x in ((LENS, radii), (VIEW, views))
        )
        radii, views, by_radius, by_view = (x[::2] for x in (radii, views, by_radius, by_view))
        # logarithms of both ratios are added, as if lens and view were independent: the separate
        # run tells how far they are
        least = bounds[WIDTH][0]
        reserves = np.array([
            [
                self.reserve(period, r + v, radius=radius, fov_deg=view,
                             width=max(least, self._least_width(view)))
                for view, v in zip(views.tolist(), by_view, strict=True)
            ]
            for radius, r in zip(radii.tolist(), by_radius, strict=True)
        ])  # fmt: skip
        i, j = np.unravel_index(int(np.argmax(reserves)), reserves.shape)
        as_good = reserves >= reserves[i, j] - _FLAT_DB
        best = {"radius": float(radii[i]), "fov_deg": float(views[j])}
        width = max(least, self._least_width(best["fov_deg"]))
        link = self.link.replace(LENS, best["radius"]).replace(VIEW, best["fov_deg"])
        reserve, error = self.reserve_of_run(period, link, width)
        gained = reserve - self.reserve(period)
        note = f"by a separate run; {reserves[i, j]:+.1f} dB by the scans"
        widths = [max(least, self._least_width(v)) for v in views[as_good.any(axis=0)].tolist()]
        optics = self.dark.optics
        table = (
            (LENS, "m", optics.radius, best["radius"], radii[as_good.any(axis=1)]),
            (VIEW, "deg", optics.fov_deg, best["fov_deg"], views[as_good.any(axis=0)]),
            (WIDTH, "nm", optics.filter_width_nm, width, np.array(widths)),
        )
        return tuple(
            BestValue(period, key, unit, present, value, gained, error,
                   (float(flat.min()), float(flat.max())), note)
            for key, unit, present, value, flat in table
        )  # fmt: skip

    def reach(self, period: Period, greatest: tuple[float, str], scans: list[Scan]) -> list[Reach]:
        """Return the value of each key at which the link just closes, all others unchanged."""
        reserve = self.reserve(period)
        end = "receiver" if self.link.direction == "down" else "transmitter"
        depth, note = greatest
        power = 1e3 * self.dark.led.power
        # the reserve is in dB of received power, which is linear in that of the lamp
        least_power = power * 10.0 ** (-reserve / 10.0) if math.isfinite(reserve) else math.nan
        reaches = [
            Reach(period, f"{end}.depth", "m", self.link.depth, depth, "at most", note),
            Reach(period, "transmitter.power_mw", "mW", power, least_power, "at least"),
            Reach(period, "detector.bit_rate", "bit s-1", self.dark.bit_rate,
                  self._bit_rate(period, scans), "at most"),
        ]  # fmt: skip
        for choice, values, reserves in scans:
            if choice.period == period and choice.key != RATE:
                reaches.append(_closing(choice, values, reserves))
        return reaches

    def _bit_rate(self, period: Period, scans: list[Scan]) -> float:
        """Return the greatest bit rate that closes [bit s-1] by bisection, to 1 %; nan for none."""
        # the scan brackets ln(rate) by its last rate that closes and the next one, as noise and
        # echoes may leave rates below that do not; margins of 2 % for its interpolation
        scan = next(s for s in scans if (s.choice.key, s.choice.period) == (RATE, period))
        least, most = np.log(_BIT_RATES)
        rates = np.log(scan.values)
        rates = np.concatenate([[min(least, rates[0])], rates, [max(most, rates[-1])]])
        last = int(np.flatnonzero(scan.reserves >= 0.0).max(initial=-1)) + 1
        low, high = float(rates[last]) - 0.02, float(rates[last + 1]) + 0.02
        gain = self.quantile(self.link.only_receiver.fov_deg)

        def closes(log_rate: float) -> bool:
            rate = math.exp(log_rate)
            ook = self.at_rate(period, rate, self.window_at(period, rate))
            return self.margin_db(period, gain, ook, ook.required_power(self.limit)) >= 0.0

        if not closes(low):
            return math.nan
        while high - low > 0.01:  # no secant: a closed eye has no finite reserve
            middle = 0.5 * (low + high)
            low, high = (middle, high) if closes(middle) else (low, middle)
        return math.exp(low)

    def greatest_depth(self, period: Period) -> tuple[float, str]:
        """Return the greatest depth that closes [m], and the reserve of a run there.

        The runs begin at the depth that would close if the law of the fading stayed.
        """
        start = self.link.depth, self.reserve(period)
        if math.isinf(start[1]):
            return math.nan, "no power closes it"

        def by_means(depth: float) -> tuple[float, float]:
            log = self.quantile(self.link.only_receiver.fov_deg)
            log += self.means.log_ratio(self.link.at_depth(depth))[0]
            return self._at_depth(period, depth, log), _NEAR_DB

        def by_run(depth: float) -> tuple[float, float]:
            log, error = self.separate_run(self.link.at_depth(depth))
            return self._at_depth(period, depth, log), max(_NEAR_DB, DECIBELS * error)

        # another depth for the secant, above that of the link (tuned)
        first = start[0] * (0.9 if start[1] >= 0.0 else 0.7)
        try:
            # ratios of means are cheap, and bring the search near to where runs of many seas begin
            depth, *_ = closing_depth(by_means, start, first, far=_FAR_DB)
            if math.isnan(depth):
                return math.nan, "none below the waves"
            depth, above, _ = closing_depth(by_run, start, depth, _RUNS)
        except Refused:  # in the troughs of the waves
            return math.nan, "none below the waves"
        if math.isnan(depth):
            return math.nan, "no depth found"
        error = DECIBELS * self.separate_run(self.link.at_depth(depth))[1]
        return depth, f"a run there: {above:+.1f} +- {error:.1f} dB"

    def _at_depth(self, period: Period, depth: float, log_quantile: float) -> float:
        """Return the reserve at a depth [dB]; a submerged receiver sees the background there."""
        # a receiver in the air has its background whatever the depth of the lamp
        brightness = 1.0
        if self.link.direction == "down" and period == DAY:
            brightness = self.radiance(period, self.link.at_depth(depth))
            brightness /= self.radiance(period, self.link)
        pulse_loss = self.pulse_loss(period, self.link.at_depth(depth))
        needed = self.needed(period, self.dark, brightness)
        return self.margin_db(period, log_quantile - pulse_loss, self.dark, needed)


def _nodes(key: str) -> NDArray[np.intp]:
    """Select the values of a scan to simulate, both ends included."""
    count = _VIEWS if key == VIEW else _NODES
    return np.linspace(0, _POINTS - 1, count).round().astype(np.intp)


def _around(allowed: NDArray[np.bool_], i: int) -> tuple[int, int]:
    """Return the first and the last index of the run of true values that contains i."""
    others = np.flatnonzero(~allowed)
    low = others[others < i].max(initial=-1) + 1
    return int(low), int(others[others > i].min(initial=len(allowed)) - 1)


def _through(places: Floats, values: Floats, at: Floats) -> Floats:
    """Interpolate finite values smoothly; -inf where fewer than two are finite."""
    finite = np.isfinite(values)
    if finite.sum() < 2:
        return np.full(len(at), -math.inf)
    return np.asarray(PchipInterpolator(places[finite], values[finite])(at))


def _closing(choice: BestValue, values: Floats, reserves: Floats) -> Reach:
    """Return the value of a key nearest to the link's at which the link just closes.

    If the link itself closes, that is the value up to which it closes; for a lens down to which.
    """
    period, key, unit, present = choice[:4]
    closes, at_present = reserves >= 0.0, int(np.abs(values - present).argmin())
    if not closes.any():
        return Reach(period, key, unit, present, math.nan, "at most")
    # of several ranges that close the one next to the present value is the least change
    start = min(np.flatnonzero(closes).tolist(), key=lambda k: abs(k - at_present))
    low, high = _around(closes, start)
    # whether the closing values end with an upper bound, "at most"
    rising = start < at_present or (start == at_present and key != LENS)
    last, beyond, first = (high, high + 1, low) if rising else (low, low - 1, high)
    value, note = float(values[last]), "end of the scan"
    if 0 <= beyond < len(values):
        note = ""
        if math.isfinite(reserves[beyond]):
            # linear interpolation to a reserve of 0
            fraction = reserves[last] / (reserves[last] - reserves[beyond])
            value += float(fraction * (values[beyond] - values[last]))
    if key == COLOUR:
        note = f"{'from' if rising else 'to'} {values[first]:.0f} nm"
    return Reach(period, key, unit, present, value, "at most" if rising else "at least", note)
