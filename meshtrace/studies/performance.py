"""Error rate, margin, outage, range and capacity of a link over depth and bit rate."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, Unpack

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from meshtrace.checks import ErrorRate, Probability, check_call
from meshtrace.comms.background import DARK, name_of_light, warn_of_background, with_background
from meshtrace.comms.budget import depth_at
from meshtrace.comms.combining import Combining
from meshtrace.comms.ook import OokLink, Preset
from meshtrace.comms.pulses import Eye
from meshtrace.comms.response import SHORT, ChannelResponse
from meshtrace.daylight.light import Daylight
from meshtrace.engine.setup.options import StudyOptions
from meshtrace.errors import Refused, in_ranges, require_between, require_finite, require_word
from meshtrace.fading import Estimate
from meshtrace.link import Link
from meshtrace.mesh import SeededSurface, SurfaceModel
from meshtrace.models import Floats
from meshtrace.results.daylight import Background
from meshtrace.results.provenance import water_of
from meshtrace.results.series import ByWavelength, checked_wavelengths, spectral
from meshtrace.scenario import Scenario
from meshtrace.stored import Attribute, Columns, Elsewhere, Stored, Variable, Variables
from meshtrace.studies.background import background_over_seas, described, light_of
from meshtrace.studies.campaign import campaign_of, with_first
from meshtrace.studies.operating_point import (
    Ensemble,
    FadingSamples,
    OperatingPoint,
    array_of,
    operating_point,
    pixel_array,
)
from meshtrace.studies.series import closed_form
from meshtrace.uav import Flight, tilt_outage_note

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True, eq=False, repr=False)
class LinkPerformance(Stored, kind="performance", title="meshtrace link performance"):
    """Performance of a link at one or several depths and bit rates.

    Attributes
    ----------
    depths : tuple of float
        Depths of the transmitter [m].
    ooks : tuple of OokLink
        Transmission at each bit rate.
    figures : tuple of OperatingPoint
        Figures at each depth and bit rate; the bit rates of one depth follow each other.
    fades : tuple of FadingSamples
        Gains and tilt factors at each depth; not in files, empty when loaded.
    limit : float
        Bit error rate before decoding that counts as success.
    confidence : float
        Level of all intervals.
    status : str
        What calibrates the transmission, to be shown with every figure (`OokLink.status`).
    provenance : dict
        Link, sea, receiver, seeds and versions.
    background_light : str
        Background light under which every figure holds.
    responses : tuple of ChannelResponse or None
        Response of the channel at each depth; None without light.
    """

    depths: Annotated[tuple[float, ...], Variable("depth", name="depth")]
    ooks: Annotated[tuple[OokLink, ...], Elsewhere()]
    figures: Annotated[tuple[OperatingPoint, ...], Columns(OperatingPoint, "", "depth", "bit_rate")]
    fades: Annotated[tuple[FadingSamples, ...], Elsewhere()]
    limit: Annotated[float, Attribute("ber_limit")]
    confidence: float
    status: str
    provenance: dict[str, Any] = field(default_factory=dict)
    background_light: str = DARK
    responses: Annotated[tuple[ChannelResponse | None, ...], Elsewhere()] = ()

    def _headline(self) -> str:
        first, count = self.figures[0], len(self.figures)
        conditions = f"{first.bit_rate / 1e6:g} Mbit/s, {name_of_light(self.background_light)}"
        return (
            f"BER {_error_rate(first.ber.value, 3)}{_at(first.depth)}, {conditions}; "
            f"{count} point{'s' * (count > 1)}"
        )

    @property
    def bit_rates(self) -> tuple[float, ...]:
        """Bit rates [bit s-1]."""
        return tuple(ook.bit_rate for ook in self.ooks)

    def at(self, depth: float | None = None, bit_rate: float | None = None) -> OperatingPoint:
        """Return the figures of a depth [m] and bit rate [bit s-1], by default the first.

        Raises
        ------
        ValueError
            If the performance was not computed there.
        """
        i, j = _index("depth", self.depths, depth), _index("bit_rate", self.bit_rates, bit_rate)
        # the bit rates of one depth follow each other
        return self.figures[i * len(self.ooks) + j]

    def estimates(self, name: str) -> Floats:
        """Return a figure with its limits as an array.

        Parameters
        ----------
        name : str
            An estimate of `OperatingPoint`, such as "ber".

        Returns
        -------
        ndarray, shape (depths, bit_rates, 3)
            Value, lower and upper limit.
        """
        names = [k for k, v in self.figures[0]._asdict().items() if isinstance(v, Estimate)]
        require_word(name, names, "name")
        flat = np.array([getattr(f, name) for f in self.figures])
        return flat.reshape(len(self.depths), len(self.ooks), 3)

    def range_at_ber(self, ber: ErrorRate | None = None) -> tuple[Estimate, ...]:
        """Return the greatest depth of each bit rate for an average bit error rate.

        Parameters
        ----------
        ber : float, optional
            Bit error rate, `limit` by default; see `budget.FEC_LIMITS`.

        Returns
        -------
        tuple of Estimate
            Depths [m]; nan where the curve, or that of a limit, does not cross `ber` between the
            depths computed.

        Notes
        -----
        The argument q of BER = Q(q) is interpolated over depth (PCHIP of ln q): it follows the
        gain and is far smoother than the error rate.
        """
        return self._ranges(self.estimates("ber"), self.limit if ber is None else ber)

    def _ranges(self, bers: Floats, target: float) -> tuple[Estimate, ...]:
        """Return the range of each bit rate for error rates (depths, bit_rates, 3)."""
        # value, lower and upper limit: the upper limit of the error rate gives the lower one of
        # the range
        curves = (bers[:, i, [0, 2, 1]].T for i in range(len(self.ooks)))
        return tuple(Estimate(*(_range(self.depths, ber, target) for ber in c)) for c in curves)

    def eye(self, depth: float | None = None, bit_rate: float | None = None) -> Eye:
        """Return the eye diagram at the mean received power of a depth and bit rate."""
        power = self.at(depth, bit_rate).received_power.value
        return self.transmission(depth, bit_rate).eye(power)

    def transmission(self, depth: float | None = None, bit_rate: float | None = None) -> OokLink:
        """Return the transmission of a depth and bit rate, with the response of the channel."""
        ook = self.ooks[_index("bit_rate", self.bit_rates, bit_rate)]
        response = self.responses[_index("depth", self.depths, depth)]
        return ook if ook.response is not None else ook.replace(response=response)

    def summary(self) -> str:
        """Return the performance as text for a terminal."""
        percent = f"{100.0 * self.confidence:g} %"
        lines = [
            f"{'depth':>7}{'Mbit/s':>8}{'P_rx dBm':>10}{'margin dB optical':>19}"
            f"{'electrical':>12}{'average BER':>13}{percent + ' interval':>22}{'outage':>9}"
            f"{'photons/bit':>13}{'capacity hard':>15}{'soft Mbit/s':>13}"
        ]
        lines += [_figures_line(figures) for figures in self.figures]
        if len(self.depths) > 1:
            lines += ["", self._range_heading, *self._range_lines()]
        water, *fading_lines = self._origin_lines()
        if "combining" in self.provenance:
            receiver, name = self.provenance["link"]["receiver"], self.provenance["combining"]
            single = isinstance(receiver, Mapping)  # with pixels
            which = f"{receiver['pixels'] ** 2} pixels" if single else f"{len(receiver)} receivers"
            text = f"{which} combined by {_COMBINING_NAMES[name]}; gains and powers are"
            lines += ["", f"{text} those of the first alone with the same reserve"]
        lines += [
            "",
            water,
            f"background light: {self.background_light}",
            *self._filters(),
            *self._tilts(),
        ]
        lines += [*self._spreads(), *self._overloads(), *fading_lines, self.status]
        return "\n".join(lines)

    def _filters(self) -> list[str]:
        """Describe the widest filters at the first depth, if there is background light."""
        first = [f for f in self.figures[: len(self.ooks)] if not math.isnan(f.widest_filter_nm)]
        if not first:
            return []
        words = {0.0: "none", math.inf: "any"}  # no filter is narrow enough, or every one is
        texts = ", ".join(
            f"{f.bit_rate / 1e6:g} Mbit/s "
            f"{words.get(f.widest_filter_nm, f'{f.widest_filter_nm:.3g} nm')}"
            for f in first
        )
        return [f"widest filter for BER {self.limit:g}{_at(first[0].depth)}: {texts}"]

    @property
    def _least_ber(self) -> float:
        """Least error rate at any power: half the share of tilts at which no light is received.

        A receiver without light guesses, and errs in every other bit.
        """
        return 0.5 * float(self.provenance.get("tilt_outage", 0.0))

    def _tilts(self, wind: str = "") -> list[str]:
        """Describe the share of the tilts of an aircraft that leave the field of view."""
        note = tilt_outage_note(float(self.provenance.get("tilt_outage", 0.0)), wind)
        return [note] if note else []

    def _spreads(self) -> list[str]:
        """Describe the largest delay spread of all depths, in bits, and its penalty."""
        points = [f for f in self.figures if f.rms_delay_spread.value > 0.0]
        if not points:
            return []
        depth = max(points, key=lambda f: f.rms_delay_spread.value).depth
        # a link without a depth of its own has nan, which equals nothing
        there = [f for f in points if f.depth == depth or math.isnan(depth)]
        spread = there[0].rms_delay_spread
        bits = ", ".join(
            f"{spread.value * f.bit_rate:.2g} bit at {f.bit_rate / 1e6:g} Mbit/s ({_penalty(f)})"
            for f in there
        )
        up_to = "up to " if len(self.depths) > 1 else ""
        return [
            f"rms delay spread of the channel {up_to}{1e9 * spread.value:.3g} ns "
            f"({1e9 * spread.low:.3g}..{1e9 * spread.high:.3g}){_at(depth)}: {bits}"
        ]

    @property
    def _range_heading(self) -> str:
        return f"range at BER {self.limit:g} ({100.0 * self.confidence:g} % interval)"

    def _range_lines(self, wind: str = "") -> list[str]:
        """Describe the range of each bit rate in a line that starts with the wind."""
        bers, least, start = self.estimates("ber"), self._least_ber, ""
        # where the tilt alone exceeds the limit, the range is that of the tilts with light
        if least >= self.limit:
            # BER = t / 2 + (1 - t) BER_inside with the share t of tilts out of the field of view,
            # least = t / 2
            bers = np.maximum(bers - least, 0.0) / (1.0 - 2.0 * least)
            start = "none at any power, by the tilt; within the field of view "
        # from (depths, bit_rates, 3): bers.T[0] are values without limits, (bit_rates, depths)
        table = zip(self.bit_rates, self._ranges(bers, self.limit), bers.T[0], strict=True)
        return [
            f"{wind}{rate / 1e6:>7g} Mbit/s  {start}{self._range_text(estimate, ber)}"
            for rate, estimate, ber in table
        ]

    def _range_text(self, estimate: Estimate, ber: Floats) -> str:
        """Return a range as text, or its bound if the error rates do not cross the limit.

        `ber` holds the error rates by depth.
        """
        shallower, deeper = f"< {min(self.depths):g}", f"> {max(self.depths):g}"
        # no crossing: all depths work, or none does
        if math.isnan(estimate.value):
            return f"{deeper if (ber < self.limit).all() else shallower} m"
        low = shallower if math.isnan(estimate.low) else f"{estimate.low:.1f}"
        high = deeper if math.isnan(estimate.high) else f"{estimate.high:.1f}"
        return f"{estimate.value:.1f} m  ({low}..{high})"

    def _origin_lines(self) -> list[str]:
        """Describe the water, and the closed form of the fading by the band and by all waves."""
        water = f"water: {water_of(self.provenance)}"
        closed = self.provenance.get("closed_form")
        if not closed:
            return [water]
        return [
            water,
            f"{_named(self.depths[0])}scintillation index of unscattered light "
            f"{closed['index_of_band']:.3g} up to {closed['omega_max']:.3g} rad/s, "
            f"{closed['index_of_all']:.3g} with all waves (closed form)",
        ]

    def _overloads(self) -> list[str]:
        """Return a warning of the depths at which the detector loses most counts of a 1 bit."""
        ook, lines = self.ooks[0], []
        if not ook.saturation:
            return []
        unlimited = ook.model_copy(update={"saturation": False})
        for depth, figures in zip(self.depths, self.figures[:: len(self.ooks)], strict=True):
            # counts per second during a 1 bit, without any dead time; levels are (0 bit, 1 bit)
            level = float(unlimited.levels(figures.received_power.value)[1])
            # share of them that the dead time of the cells leaves
            passed = float(ook.sipm.saturated_rate(level)) / level
            # most are lost: every gain of power is then mostly wasted
            if passed < 0.5:
                lines.append(
                    f"{_named(depth)}the SiPM saturates and passes on {100.0 * passed:.2g} % of "
                    f"the counts of a one, at {ook.sipm.bias_current(level):.2g} A: attenuate"
                )
        return in_ranges(lines)

    def _derived(self) -> Variables:
        """Return the range of each bit rate for a file."""
        if len(self.depths) == 1:
            return {}
        ranges = np.transpose(self.range_at_ber())
        names = ("range", "range_low", "range_high")
        return {name: ("bit_rate", values) for name, values in zip(names, ranges, strict=True)}

    @classmethod
    def _restored(
        cls, data: xr.Dataset, provenance: Any, derived: dict[str, Any] | None = None
    ) -> LinkPerformance:
        ooks = tuple(OokLink.model_validate(ook) for ook in provenance["ook"])
        if len(ooks) != data["bit_rate"].size:
            raise ValueError("other numbers of bit rates and transmissions")
        responses = tuple(
            response and ChannelResponse.model_validate(response)
            for response in provenance["responses"]
        )
        require_between(provenance.get("tilt_outage", 0.0), 0.0, 1.0, "tilt_outage", "[]")
        parts = {"ooks": ooks, "responses": responses, "fades": ()}
        return super()._restored(data, provenance, parts)


_COMBINING_NAMES = {"selection": "selection", "equal": "equal gain", "maximal": "maximal ratio"}
# Bit error rate below which texts give no digits: at 1 Gbit/s one error in eleven days.
_LEAST_SHOWN = 1e-15


def _index(name: str, values: tuple[float, ...], wanted: float | None) -> int:
    """Return the index of a value, by default 0; refuse a missing value."""
    if wanted is None:
        return 0
    if wanted not in values:
        raise Refused(name, wanted, ", ".join(f"{v:g}" for v in values))
    return values.index(wanted)


def _at(depth: float) -> str:
    """Return " at 5 m", or "" for a link without a single depth, see `Link.depth`."""
    return "" if math.isnan(depth) else f" at {depth:g} m"


def _named(depth: float) -> str:
    """Return "5 m: " to begin a line, or "" as for `_at`."""
    return "" if math.isnan(depth) else f"{depth:g} m: "


def _error_rate(ber: float, digits: int = 2) -> str:
    """Return a bit error rate as text; below `_LEAST_SHOWN` as a bound."""
    return f"{ber:.{digits}e}" if ber >= _LEAST_SHOWN else f"< {_LEAST_SHOWN:g}"


def _figures_line(f: OperatingPoint) -> str:
    """Return a line of the summary, with columns as wide as in its heading."""
    # decibels over 1 mW; 1e-300 in place of no power, whose logarithm is infinite
    power = 10.0 * math.log10(max(f.received_power.value, 1e-300) / 1e-3)  # [dBm]
    low, high = _error_rate(f.ber.low), _error_rate(f.ber.high)
    interval = f"{low}..{high}" if f.ber.high >= _LEAST_SHOWN else high
    depth = "-" if math.isnan(f.depth) else f"{f.depth:g} m"
    return (
        f"{depth:>7}{f.bit_rate / 1e6:>8g}{power:>10.2f}{f.margin_optical_db.value:>19.2f}"
        f"{f.margin_electrical_db.value:>12.2f}{_error_rate(f.ber.value, 3):>13}{interval:>22}"
        f"{f.outage.value:>9.2g}{f.photons_per_bit.value:>13.4g}{f.capacity.hard / 1e6:>15.4g}"
        f"{f.capacity.soft / 1e6:>13.4g}"
    )


def _penalty(f: OperatingPoint) -> str:
    """Describe the extra power that makes up for intersymbol interference."""
    if f.rms_delay_spread.value * f.bit_rate < SHORT:
        return f"below {SHORT:g} bit: taken as instantaneous"
    if math.isinf(f.dispersion_db):
        return "no power reaches the limit"
    if math.isnan(f.dispersion_db):
        return "no power reaches the limit even without it"
    return f"{f.dispersion_db:.2g} dB optical"


def _range(depths: tuple[float, ...], ber: Floats, target: float) -> float:
    """Return the depth [m] at which error rates by depth meet a target; nan without one."""
    from scipy.special import ndtri

    # q of BER = Q(q), Q the tail of the normal law: q = -ndtri(BER). `depth_at` interpolates its
    # logarithm, so that q has to be finite and above 0, and BER within 0 and 1/2.
    q = -ndtri(np.clip(ber, 1e-300, 0.5 - 1e-12))
    try:
        return depth_at(depths, q, -float(ndtri(target)))
    except ValueError:  # no crossing, or a single depth
        return math.nan


@spectral
@check_call
def link_performance(
    link: Link | Scenario,
    surface: SurfaceModel | None = None,
    *,
    bit_rate: float | Sequence[float] | None = None,
    ook: OokLink | Preset | None = None,
    depths: Sequence[float] | None = None,
    realizations: Annotated[int, Field(ge=2, le=10_000_000)] = 200,
    flight: Flight | None = None,
    daylight: Daylight | None = None,
    limit: ErrorRate = 1e-3,
    confidence: Probability = 0.95,
    combining: Combining = "maximal",
    wavelengths_nm: ArrayLike | None = None,
    **run: Unpack[StudyOptions],
) -> LinkPerformance | ByWavelength[LinkPerformance]:
    """Return error rate, outage, margin and capacity of a link over a random sea.

    BER = E[BER(P h h_alpha)]: the mean over the gain h, by forced detection over independent
    seas, and over the tilt factor h_alpha of an aircraft, with the power P of the lamp.

    Parameters
    ----------
    link : Link or Scenario
        The link, with one receiver or several (see `combining`). Bubbles and whitecaps are its own,
        see `Link.in_wind`. A scenario also gives the sea, the receiver and the aircraft.
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
    combining : {"selection", "equal", "maximal"}
        How several receivers are combined, see `comms.combining.combined_ber`.
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
    the Monte Carlo error that all seas have in common, from the figures at gains shifted by that
    error; the two are added in quadrature. The tilt of an aircraft is not sampled: its law is
    integrated over each sea (`uav.TiltLaw`), and the share of tilts beyond half of the field of
    view, with an error rate of one half at any power, is stated.
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

    Several receivers fade over the same seas, so that the correlation of their gains is that of the
    waves. Bit error rates are those of the combined receivers. Gain, power, margin and outage are
    those of the first receiver alone with the gain at which it would have their reserve at `limit`
    (`comms.combining.equivalent_gain`), rates those at this gain.

    All depths use the same phases and random numbers, so that curves are smooth. Unless `waves` of
    the meshing says otherwise, meshes hold all waves that make the light fade at the first depth.

    Examples
    --------
    >>> from meshtrace.surfaces import FlatSea
    >>> performance = link_performance(Link(), FlatSea(), photons=1024)
    >>> f"{performance.at().margin_optical_db.value:.0f} dB optical"
    '35 dB optical'
    """
    rates = (None,) if bit_rate is None else require_finite(bit_rate, "bit_rate", "rates [bit s-1]")
    at_nm = [] if wavelengths_nm is None else checked_wavelengths(wavelengths_nm)
    # gains and responses at all wavelengths have common paths: the first one computes all of them
    computed = dict[tuple[str, float], Any]() if at_nm else None

    def performance(link: Link | Scenario, day: Daylight | None) -> LinkPerformance:
        shallow = _shallowest(link, depths)
        campaign = campaign_of(shallow, surface, "link_performance", run, fading=True, analog=True)
        wind = getattr(campaign.scenario, "wind_speed", campaign.link.wind_speed)
        # names of loops in a store, which holds those of several winds and wavelengths
        name = "link" if wind is None else f"wind of {wind!r} m/s"
        if at_nm:
            name += f", {campaign.link.transmitters[0].wavelength_nm!r} nm"
        campaign = campaign.for_link(campaign.link, name)
        detector = getattr(campaign.scenario, "detector", None)
        electronics = (detector or "physical") if ook is None else ook
        ooks = tuple(OokLink.of_link(campaign.link, electronics, rate, 0) for rate in rates)
        flown = campaign.flight(flight)
        # the detectors that are combined: the pixels of a receiver, or several receivers
        array = pixel_array(campaign.link, combining, flown) or array_of(
            campaign.link, ooks[0], combining, light_of(campaign, day) or flown
        )
        campaign = campaign._replace(per_pixel=True)
        ensemble = Ensemble(campaign, realizations, flown, at_nm, computed, array)
        links = _links(ooks[0].channel(campaign.link), depths)
        return _over_depths(ensemble, links, ooks, light_of(campaign, day), limit, confidence)

    if not at_nm:
        return performance(link, daylight)
    pairs = [(link.at_wavelength(nm), daylight and daylight.at_wavelength(nm)) for nm in at_nm]
    return ByWavelength(np.array(at_nm), tuple(performance(*pair) for pair in pairs))


def _over_depths(
    ensemble: Ensemble, links: dict[float, Link], ooks: tuple[OokLink, ...], day: Daylight | None,
    limit: float, confidence: float,
) -> LinkPerformance:  # fmt: skip
    """Return the performance of a link at each depth with each transmission."""
    campaign, seed = ensemble.campaign, ensemble.campaign.run.seed
    fades = {depth: ensemble.samples(link) for depth, link in links.items()}
    backgrounds = _backgrounds(ensemble, links, day)
    # the response of the channel does not depend on the bit rate
    means = {depth: ensemble.response(ooks[0], with_first(link)) for depth, link in links.items()}
    points = [
        operating_point(
            ook, depth, samples, limit, confidence, seed, backgrounds[depth], means[depth]
        )
        for depth, samples in fades.items()
        for ook in ooks
    ]
    ooks, light_text = _under_background(ooks, backgrounds, campaign.link)
    responses = [None if mean is None else mean[0] for mean in means.values()]
    # a sea without random phases is a single sea, whatever `realizations` says
    seas = ensemble.n if isinstance(campaign.surface, SeededSurface) else 1
    shallowest = next(iter(fades.values()))
    first = next(iter(links.values()))
    provenance = (
        shallowest.series.provenance
        | closed_form(first, campaign.surface, seas)
        | {
            "ook": [ook.model_dump(mode="json") for ook in ooks],
            "daylight": day.model_dump(mode="json") if day else None,
            "responses": [response and response.model_dump(mode="json") for response in responses],
        }
    )
    if ensemble.array is not None:
        provenance["combining"] = ensemble.array.combining
    provenance |= ensemble.provenance() | {"tilt_outage": shallowest.tilt.outage}
    return LinkPerformance(
        tuple(fades), ooks, tuple(points), tuple(fades.values()), limit, confidence,
        ooks[0].status, provenance, light_text, tuple(responses),
    )  # fmt: skip


def _under_background(
    ooks: tuple[OokLink, ...], backgrounds: dict[float, Background | None], link: Link
) -> tuple[tuple[OokLink, ...], str]:
    """Return the transmissions under the background at the first depth, and a text about it."""
    depth, background = next(iter(backgrounds.items()))
    if background is None:
        return ooks, DARK
    exposed = tuple(with_background(ook, background) for ook in ooks)
    brightest = background
    if background.pixel_radiance is not None:  # each pixel has a detector of its own
        side = len(background.pixel_radiance)
        brightest = background.of_pixel(*divmod(int(background.pixel_radiance.argmax()), side))
    # the bias current is that of the detector with the most light
    warn_of_background(with_background(ooks[0], brightest), brightest)
    text = described(exposed[0], background)
    # a receiver in the water sees another background at each depth
    if link.direction == "down" and len(backgrounds) > 1:
        text += f",{_at(depth)}"
    return exposed, text


def _backgrounds(
    ensemble: Ensemble, links: dict[float, Link], day: Daylight | None
) -> dict[float, Background | None]:
    """Return the background at each depth, once for each receiver."""
    if day is None:
        return dict.fromkeys(links)
    backgrounds: dict[Any, Background] = {}
    for link in links.values():
        # the view of a receiver in the air does not depend on the depth of the lamp
        if link.receiver not in backgrounds:
            alone = ensemble.at(with_first(link))
            inputs = alone, day, ensemble.n, ensemble.flight
            backgrounds[link.receiver] = background_over_seas(*inputs)
    return {depth: backgrounds[link.receiver] for depth, link in links.items()}


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
    """Return the link or scenario at the first depth, where the shortest waves matter most."""
    if depths is None:
        return link
    if isinstance(link, Scenario):
        return link.model_copy(update={"link": _shallowest(link.link, depths)})
    return next(iter(_links(link, depths).values()))
