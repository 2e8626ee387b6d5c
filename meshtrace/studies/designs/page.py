"""The page of a link design: verdict, figures by light, best values, reach, budget."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, NamedTuple

from meshtrace.models import Floats
from meshtrace.results.provenance import water_of
from meshtrace.stored import Stored, Variable
from meshtrace.tables import text_table

NIGHT, DAY = "night", "day"
LIGHTS = (NIGHT, DAY)


class Figures(NamedTuple):
    """Figures of the given link under one light.

    Attributes
    ----------
    light : str
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

    light: str
    about: str
    outage: tuple[float, float, float]
    ber: tuple[float, float, float]
    margin: float
    reserve: float
    reserve_stderr: float
    capacity: float


class BestValue(NamedTuple):
    """Best value of one key under one light, all others as given.

    Attributes
    ----------
    light, key, unit : str
        Light, key of the link file and unit.
    given, best : float
        Values of the link and of the most reserve; for a bit rate R, of the largest rate
        R (1 - H2(BER)) after hard decisions (`comms.capacity`) that all but the outage carries.
    gained, gained_stderr : float
        Reserve, or that rate, at the best value over that of the link [dB], and its standard error.
    flat : (float, float)
        Values within 0.5 dB, or the error, of the best.
    note : str
        Remark.
    """

    light: str
    key: str
    unit: str
    given: float
    best: float
    gained: float
    gained_stderr: float
    flat: tuple[float, float]
    note: str = ""


class Reach(NamedTuple):
    """Value of one key at which the link just closes under one light, all others as given.

    Attributes
    ----------
    light, key, unit : str
        Light, key of the link file and unit.
    given, value : float
        Value of the link, and the one at which it closes; nan for none.
    side : str
        "at most" or "at least".
    note : str
        Remark, such as the reserve of a run at the value.
    """

    light: str
    key: str
    unit: str
    given: float
    value: float
    side: str
    note: str = ""


class Line(NamedTuple):
    """Line of the budget.

    Attributes
    ----------
    name, unit : str
        Text, and "dBm" or "dB".
    night, day : float
        Value under either light; a sum of those above for `total`.
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


@dataclass(frozen=True, eq=False, repr=False)
class Design(Stored):
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
        Best lens, field of view and filter together, by light.
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
    """

    outage: float
    limit: float
    figures: tuple[Figures, ...]
    choices: tuple[BestValue, ...]
    together: tuple[BestValue, ...]
    reach: tuple[Reach, ...]
    budget: tuple[Line, ...]
    scanned: Annotated[Floats, Variable("choice point", name="design_value")]
    reserves: Annotated[Floats, Variable("choice point", name="design_reserve_db")]
    notes: tuple[str, ...] = ()
    status: str = ""
    provenance: dict[str, Any] = field(default_factory=dict)

    kind: ClassVar[str] = "design"
    title: ClassVar[str] = "meshtrace design"
    _attributes: ClassVar[tuple[str, ...]] = (
        "outage", "limit", "figures", "choices", "together", "reach", "budget", "notes", "status",
    )  # fmt: skip

    def at(self, light: str) -> Figures:
        """Return the figures by "night" or by "day"."""
        return self.figures[LIGHTS.index(light)]

    def choice(self, key: str, light: str = DAY) -> BestValue:
        """Return the best value of a key, alone."""
        return next(one for one in self.choices if (one.key, one.light) == (key, light))

    def closes(self, light: str) -> bool:
        """Return whether the reserve under a light is at least 0 dB."""
        return self.at(light).reserve >= 0.0

    def _headline(self) -> str:
        words = (
            f"{'closes' if self.closes(light) else 'does not close'} by {light} "
            f"({self.at(light).reserve:+.1f} dB)"
            for light in LIGHTS
        )
        return ", ".join(words)

    def _verdict(self) -> list[str]:
        """Return the answer, and what would close a link that does not."""
        share = f"{100.0 * (1.0 - self.outage):g} % of the time"
        lines = []
        for light in LIGHTS:
            figures = self.at(light)
            error = f"{abs(figures.reserve):.1f} +- {figures.reserve_stderr:.2f} dB"
            if math.isinf(figures.reserve):
                lines.append(f"By {light}: no. No power closes it.")
            elif self.closes(light):
                lines.append(f"By {light}: yes. It closes {share} with {error} to spare.")
                continue
            else:
                lines.append(f"By {light}: no. It is {error} short of closing {share}.")
            filters = [r for r in self.reach if (r.light, r.key[-8:]) == (light, "width_nm")]
            if filters and math.isnan(filters[0].value):
                lines.append("  It closes at no width of the filter.")
            would = [_would(r) for r in self.reach if r.light == light and not math.isnan(r.value)]
            if light == DAY and self.closes(NIGHT):
                would.insert(0, "by night")
            both = [c for c in self.together if c.light == light]
            left = figures.reserve + both[0].gained if both else math.nan
            if left >= 0.0:
                would.append("with the lens, field of view and filter below")
            if would:
                lines.append(f"  It would close {', or '.join(would)}.")
            if left < 0.0:
                lines.append(
                    f"  The lens, field of view and filter below leave it {-left:.1f} dB short."
                )
        return lines

    def summary(self) -> str:
        """Return the page as text for a terminal."""
        parts = [
            ["ANSWER", "", *self._verdict()],
            [
                "FIGURES",
                "",
                self._figures_table(),
                *(f"{f.light}: {f.about}" for f in self.figures),
            ],
            [
                "BEST VALUES, each alone; flat within 0.5 dB or the error",
                "gained is reserve; for a bit rate it is the rate after hard decisions",
                "",
                _choices_table(self.choices),
            ],
            ["LENS, FIELD OF VIEW AND FILTER TOGETHER", "", _choices_table(self.together)],
            ["JUST CLOSES, each alone", "", self._reach_table()],
            ["BUDGET", "", self._budget_table()],
            [
                "WATER AND NOTES",
                "",
                f"water: {water_of(self.provenance)}",
                *self.notes,
                self.status,
            ],
        ]
        return "\n\n".join("\n".join(part) for part in parts)

    def _figures_table(self) -> str:
        head = ("", "outage", "95 % interval", "mean BER", "95 % interval", "margin", "reserve",
                "capacity")  # fmt: skip
        rows = [
            (
                f.light,
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
        return text_table(rows, head)

    def _reach_table(self) -> str:
        rows = [
            (
                r.light,
                r.key,
                f"{r.given:.4g}",
                "none" if math.isnan(r.value) else f"{r.side} {r.value:.4g}",
                r.unit,
                r.note,
            )
            for r in self.reach
        ]
        return text_table(rows, ("", "key", "given", "closes", "unit", ""))

    def _budget_table(self) -> str:
        rows = [
            (
                f"= {line.name}" if line.total else f"  {line.name}",
                f"{line.night:.2f}",
                f"{line.day:.2f}",
                f"+- {line.stderr:.2f}" if line.stderr else "",
                line.unit,
            )
            for line in self.budget
        ]
        return text_table(rows, ("", *LIGHTS, "std. error", "unit"))


def _would(r: Reach) -> str:
    """Return a change that closes a link as words."""
    name = {
        "radius": "a radius of the lens",
        "fov_deg": "a field of view",
        "filter_width_nm": "a width of the filter",
        "power_mw": "a power",
        "bit_rate": "a bit rate",
        "wavelength_nm": "a wavelength",
        "0": "a distance aside",
    }.get(r.key.rpartition(".")[2], f"a {r.key.rpartition('.')[2]}")
    return f"at {name} of {r.side} {r.value:.3g} {r.unit}"


def _choices_table(choices: tuple[BestValue, ...]) -> str:
    rows = [
        (
            c.light,
            c.key,
            f"{c.given:.4g}",
            f"{c.best:.4g}",
            f"{c.flat[0]:.4g} .. {c.flat[1]:.4g}",
            c.unit,
            f"{c.gained:+.1f} +- {c.gained_stderr:.2f} dB",
            c.note,
        )
        for c in choices
    ]
    return text_table(rows, ("", "key", "given", "best", "flat", "unit", "gained", ""))
