"""The page of a link design: verdict, figures by night and day, best values, reach, budget."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated, Any, Final, Literal, NamedTuple, TypeVar

from meshtrace.apps.designs.spots import TrackedSpot, spot_lines
from meshtrace.errors import require_word
from meshtrace.models import Floats
from meshtrace.results.provenance import water_of
from meshtrace.stored import Stored, Variable
from meshtrace.tables import text_table

Period = Literal["night", "day"]
NIGHT: Final = "night"
DAY: Final = "day"
PERIODS: tuple[Period, ...] = (NIGHT, DAY)
_WIDTH = 100  # of the sentences of a page
_NAMES = {
    "radius": "lens of radius",
    "fov_deg": "field of view",
    "filter_width_nm": "filter of",
    "depth": "depth",
    "power_mw": "power",
    "bit_rate": "bit rate",
    "0": "distance aside",
    "height": "height",
    "wavelength_nm": "wavelength",
}


class Figures(NamedTuple):
    """Figures of the link by night or by day.

    Attributes
    ----------
    period : str
        "night" or "day".
    about : str
        Background light and its counts.
    outage, ber : (float, float, float)
        Outage and mean bit error rate with their intervals of 95 %.
    margin : float
        Mean received over required power [dB].
    reserve, reserve_stderr : float
        Margin that all but the share `Design.outage` of the time has [dB], and its standard error.
    capacity : float
        Rate after hard decisions [bit s-1].
    """

    period: str
    about: str
    outage: tuple[float, float, float]
    ber: tuple[float, float, float]
    margin: float
    reserve: float
    reserve_stderr: float
    capacity: float


class BestValue(NamedTuple):
    """Best value of one key by night or by day, with all others fixed.

    Attributes
    ----------
    period, key, unit : str
        "night" or "day", key of the link file and unit.
    present, best : float
        Values of the link and of the most reserve; for a bit rate R, of the largest rate
        R (1 - H2(BER)) after hard decisions (`comms.capacity`) that all but the outage carries.
    gained, gained_stderr : float
        Reserve, or that rate, at the best value over that of the link [dB], and its standard error;
        of lens, view and filter together the error of the reserve with them.
    flat : (float, float)
        Values within 0.5 dB, or the error, of the best.
    note : str
        Remark.
    """

    period: Period
    key: str
    unit: str
    present: float
    best: float
    gained: float
    gained_stderr: float
    flat: tuple[float, float]
    note: str = ""


class Reach(NamedTuple):
    """Value of one key at which the link just closes by night or by day, with all others fixed.

    Attributes
    ----------
    period, key, unit : str
        "night" or "day", key of the link file and unit.
    present, value : float
        Value of the link, and the one at which it closes; nan for none.
    side : str
        "at most" or "at least".
    note : str
        Remark, such as the reserve of a run at the value.
    """

    period: str
    key: str
    unit: str
    present: float
    value: float
    side: str
    note: str = ""


class TwoLenses(NamedTuple):
    """Diversity gain of two lenses in place of one, at a distance.

    Attributes
    ----------
    direction : str
        "along the wind" or "across the wind".
    distance : float
        Distance of their centres [m].
    correlation : float
        Correlation of the unscattered gains [1], `fading.gain_correlation`.
    diversity_db : float
        Power that the outage needs less than with one gain of the same mean light [dB].
    enough : float
        Distance in this direction from which on the diversity gain is 90 % of that of independent
        lenses [m]; nan beyond the distances of the table.
    """

    direction: str
    distance: float
    correlation: float
    diversity_db: float
    enough: float


class Line(NamedTuple):
    """Line of the budget.

    Attributes
    ----------
    name, unit : str
        Text, and "dBm" or "dB".
    night, day : float
        Value by night or by day; a sum of those above for `total`.
    stderr : float
        Standard error, 0 for numbers of the detector.
    total : bool
        Whether the line is a sum.
    """

    name: str
    unit: str
    night: float
    day: float
    stderr: float = 0.0
    total: bool = False


Row = TypeVar("Row", BestValue, Reach)


@dataclass(frozen=True, eq=False, repr=False)
class Design(Stored, kind="design", title="meshtrace design"):
    """Answers to the questions of a system designer about one link.

    Attributes
    ----------
    outage, limit : float
        Share of the time that may fail, and bit error rate of a working link.
    figures : tuple of Figures
        By night and by day.
    choices : tuple of BestValue
        Best values, each alone.
    together : tuple of BestValue
        Best lens, field of view and filter together, by night and by day.
    reach : tuple of Reach
        Values at which the link just closes.
    budget : tuple of Line
        Lines that add up to the reserve.
    scanned, reserves : ndarray, shape (choices, points)
        Values of the scans and their reserves [dB]; nan for filters that lose light at the edge of
        the field of view.
    notes : tuple of str
        Remarks.
    status : str
        Standing of the calibration.
    provenance : dict
        Versions and configuration.
    spots : tuple of TrackedSpot
        Wander that a tracker leaves of a beam; none for a link without a beam.
    two_lenses : tuple of TwoLenses
        What a second lens gives back of the fading, against its distance; empty where the
        correlation has no closed form.
    """

    outage: float
    limit: float
    figures: tuple[Figures, ...]
    choices: tuple[BestValue, ...]
    together: tuple[BestValue, ...]
    reach: tuple[Reach, ...]
    budget: tuple[Line, ...]
    scanned: Annotated[Floats, Variable("choice", "point", name="design_value")]
    reserves: Annotated[Floats, Variable("choice", "point", name="design_reserve_db")]
    notes: tuple[str, ...] = ()
    status: str = ""
    provenance: dict[str, Any] = field(default_factory=dict)
    spots: tuple[TrackedSpot, ...] = ()
    two_lenses: tuple[TwoLenses, ...] = ()

    def at(self, period: str) -> Figures:
        """Return the figures by "night" or by "day"."""
        require_word(period, PERIODS, "period")
        return self.figures[PERIODS.index(period)]

    def choice(self, key: str, period: str = DAY) -> BestValue:
        """Return the best value of a key, alone."""
        require_word(period, PERIODS, "period")
        by_key = {choice.key: choice for choice in self.choices if choice.period == period}
        require_word(key, by_key, "key")
        return by_key[key]

    def closes(self, period: str) -> bool:
        """Return whether the reserve by night or by day is at least 0 dB."""
        return self.at(period).reserve >= 0.0

    def _headline(self) -> str:
        words = (
            f"{'closes' if self.closes(period) else 'does not close'} by {period} "
            f"({self.at(period).reserve:+.1f} dB)"
            for period in PERIODS
        )
        return ", ".join(words)

    @property
    def answer(self) -> tuple[str, ...]:
        """Sentences by night and day: whether it closes, by which optics, and the nearest that do.

        Those that belong to the sentence before begin with two spaces.
        """
        share = f"{100.0 * (1.0 - self.outage):g} % of the time"
        lines = []
        for period in PERIODS:
            reserve, error = self.at(period).reserve, self.at(period).reserve_stderr
            if math.isinf(reserve):
                lines.append(f"By {period}: no. No power closes it.")
            elif self.closes(period):
                spare = f"{reserve:.1f} +- {error:.2f} dB to spare"
                lines.append(f"By {period}: yes. It closes {share} with {spare}.")
            else:
                short = f"{-reserve:.1f} +- {error:.2f} dB short"
                lines.append(f"By {period}: no. It is {short} of closing {share}.")
            more = self._best_optics(period), self._alone(period)
            lines += [f"  {text}" for text in more if text]
        return tuple(lines)

    def _best_optics(self, period: Period) -> str:
        """Return the best lens, field of view and filter together, and the reserve with them."""
        best = [value for value in self.together if value.period == period]
        left = self.reserve_together(period)
        if math.isnan(left):
            return ""
        error = best[0].gained_stderr
        parts = ", ".join(
            f"{_NAMES[value.key.rpartition('.')[2]]} {_quantity(value.best, value.unit)}"
            for value in best
        )
        text = f"Best optics together: {parts}, which leave it {abs(left):.1f} +- {error:.1f} dB"
        if left >= 0.0:
            return f"{text} to spare."
        more = f"{10.0 ** (-0.1 * left):.3g} times the power of the lamp"
        return f"{text} short; with {more} they would close it."

    def _alone(self, period: Period) -> str:
        """Describe changes of a single key that would close a link that does not close."""
        if self.closes(period):
            return ""
        reaches = [reach for reach in self.reach if reach.period == period]
        would = [
            f"{_NAMES[r.key.rpartition('.')[2]]} {r.side} {_quantity(r.value, r.unit)}"
            for r in reaches
            if not math.isnan(r.value)
        ]
        never = [r for r in reaches if r.key.endswith("width_nm") and math.isnan(r.value)]
        texts = ["No width of the filter alone closes it."] if never and period == DAY else []
        if period == DAY and self.closes(NIGHT):
            texts.append("As it is, it closes by night.")
        if would:
            changes = "; or ".join(would)
            texts.append(f"By {period} any one of these changes would close it: {changes}.")
        return " ".join(texts)

    def reserve_together(self, period: str) -> float:
        """Return the reserve with the best lens, field of view and filter [dB]; nan for none."""
        reserve = self.at(period).reserve
        gained = [value.gained for value in self.together if value.period == period]
        return reserve + gained[0] if gained else math.nan

    def summary(self) -> str:
        """Return the page as text for a terminal."""
        wrapped = partial(textwrap.fill, width=_WIDTH, subsequent_indent="    ")
        abouts = (wrapped(f"{f.period}: {f.about}") for f in self.figures)
        best = [
            f"BEST VALUES BY {period.upper()}, each alone; flat within 0.5 dB or the error\n"
            "change is of the reserve, for a bit rate of the rate after hard decisions\n\n"
            f"{_choices_table([choice for choice in self.choices if choice.period == period])}"
            for period in PERIODS
        ]
        parts: list[tuple[str, ...]] = [
            ("ANSWER", "", *map(wrapped, self.answer)),
            ("FIGURES", "", self._figures_table(), *abouts),
            ("LENS, FIELD OF VIEW AND FILTER TOGETHER", "", *self._together_lines()),
            *((text,) for text in best),
            ("JUST CLOSES, each alone", "", *self._reach_lines()),
            ("BUDGET", "", self._budget_table()),
        ]
        if self.spots:
            parts.append(("WHICH SPOT, WHICH LATENCY", "", *spot_lines(self.spots, self.outage)))
        if self.two_lenses:
            parts.append(("TWO LENSES", "", *self._lenses_lines()))
        water = f"water: {water_of(self.provenance)}"
        parts.append(("WATER AND NOTES", "", water, *self.notes, self.status))
        return "\n\n".join("\n".join(part) for part in parts)

    def _figures_table(self) -> str:
        head = ("", "outage", "95 % interval", "mean BER", "95 % interval", "margin", "reserve",
                "capacity")  # fmt: skip
        lines = [
            (
                f.period,
                f"{f.outage[0]:.2g}",
                f"{f.outage[1]:.2g} .. {f.outage[2]:.2g}",
                f"{f.ber[0]:.2e}",
                f"{f.ber[1]:.1e} .. {f.ber[2]:.1e}",
                f"{f.margin:.1f} dB",
                f"{f.reserve:.2f} +- {f.reserve_stderr:.2f} dB",
                f"{f.capacity / 1e6:.4g} Mbit/s",
            )
            for f in self.figures
        ]
        return text_table(lines, head)

    def _together_lines(self) -> list[str]:
        """Return the table of the best optics and their gain."""
        lines = _by_key(self.together, lambda value: (f"{value.best:.3g}", _range(value.flat)))
        gains = (
            f"by {value.period} {value.gained:+.1f} dB, "
            f"reserve {self.reserve_together(value.period):+.1f} +- {value.gained_stderr:.2f} dB "
            f"{value.note}"
            for value in self.together[:: len(lines) or 1]
        )
        heads = ("key", "given", *(head for period in PERIODS for head in (period, "flat")))
        return [text_table(lines, heads), *gains]

    def _reach_lines(self) -> list[str]:
        """Return the table of the values that just close, and remarks about the depth."""

        def cell(r: Reach) -> tuple[str]:
            if math.isnan(r.value):
                return ("none",)
            note = "" if r.key.endswith(".depth") else f" {r.note}"
            return (f"{r.side} {r.value:.4g}{note}".rstrip(),)

        notes = [f"depth by {r.period}: {r.note}" for r in self.reach
                 if r.key.endswith(".depth") and r.note]  # fmt: skip
        return [text_table(_by_key(self.reach, cell), ("key", "given", *PERIODS)), *notes]

    def _lenses_lines(self) -> list[str]:
        """Format the diversity gain along and across the wind, by the distance of the lenses."""
        by_direction: dict[str, list[TwoLenses]] = {}
        for lens in self.two_lenses:
            by_direction.setdefault(lens.direction, []).append(lens)
        heads = ["apart [m]"]
        for direction in by_direction:
            heads += [f"correlation {direction}", "change"]
        lines = [
            [f"{pair[0].distance:.3g}"]
            + [cell for r in pair for cell in (f"{r.correlation:.3f}", f"{r.diversity_db:+.2f} dB")]
            for pair in zip(*by_direction.values(), strict=True)
        ]
        apart = " and ".join(
            f"beyond {lenses[-1].distance:.2g} m {direction}"
            if math.isnan(lenses[0].enough)
            else f"{lenses[0].enough:.2g} m {direction}"
            for direction, lenses in by_direction.items()
        )
        return [
            f"gained at an outage of {100.0 * self.outage:g} %, beside the light of a second lens",
            f"90 % of what independent lenses gain: {apart}", "", text_table(lines, heads),
        ]  # fmt: skip

    def _budget_table(self) -> str:
        lines = [
            (
                f"= {line.name}" if line.total else f"  {line.name}",
                f"{line.night:.2f}",
                f"{line.day:.2f}",
                # an error below the last digit shown would read as 0.00
                f"+- {line.stderr:.2f}" if line.stderr >= 0.005 else "",
                line.unit,
            )
            for line in self.budget
        ]
        return text_table(lines, ("", *PERIODS, "std. error", "unit"))


def _by_key(table: Sequence[Row], cell: Callable[[Row], Sequence[str]]) -> list[tuple[str, ...]]:
    """Return rows of text: key, value of the link, cells of night and day, "" without one."""
    lines = []
    for key in dict.fromkeys(value.key for value in table):
        by_period = {value.period: value for value in table if value.key == key}
        first = next(iter(by_period.values()))
        row = [_named(key, first.unit), f"{first.present:.4g}"]
        for period in PERIODS:
            row += cell(by_period[period]) if period in by_period else [""] * len(cell(first))
        lines.append(tuple(row))
    return lines


def _choices_table(choices: Sequence[BestValue]) -> str:
    lines = [
        (
            _named(c.key, c.unit),
            f"{c.present:.4g}",
            f"{c.best:.4g}",
            _range(c.flat),
            f"{c.gained:+.1f} +- {c.gained_stderr:.2f} dB",
            c.note,
        )
        for c in choices
    ]
    return text_table(lines, ("key", "given", "best", "flat", "change", ""))


def _named(key: str, unit: str) -> str:
    """Return a key with its unit unless it ends with it."""
    return key if key.endswith(f"_{unit.lower()}") else f"{key} [{unit}]"


def _range(flat: tuple[float, float]) -> str:
    return f"{flat[0]:.3g} .. {flat[1]:.3g}"


def _quantity(value: float, unit: str) -> str:
    """Return a value with a unit for readers."""
    if unit == "m" and value < 0.5:
        return f"{100.0 * value:.3g} cm"
    if unit == "mW" and value >= 1e3:
        return f"{1e-3 * value:.3g} W"
    if unit == "bit s-1":
        return f"{1e-6 * value:.3g} Mbit/s"
    return f"{value:.3g} {unit}"
