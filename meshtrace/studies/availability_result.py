"""Result of `availability`: shares of the time that a link works, range, influences."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, Any, NamedTuple

from meshtrace.models import Floats
from meshtrace.stored import Columns, Stored, Variable
from meshtrace.tables import text_table

_DOUBTFUL = 0.02  # standard error of a share


class Period(NamedTuple):
    """Shares of a period in which the link works.

    Attributes
    ----------
    name : str
        "year", or the number of a month.
    share, share_stderr : float
        Share of the time in which the gain meets the need, fades included, and its standard error.
    steady_share, steady_share_stderr : float
        Share of the time in whose states fades miss the need for at most the wanted outage.
    mean_share : float
        Share of the time in which the mean gain meets the need, as if there were no fades.
    """

    name: str
    share: float
    share_stderr: float
    steady_share: float
    steady_share_stderr: float
    mean_share: float


class Influence(NamedTuple):
    """Sobol indices of an input.

    Attributes
    ----------
    name : str
        Its key.
    gain_total, fading_total, margin_total : float
        Share of the variance of ln mean gain, of the logarithm of the variance of fades, and of the
        margin at the wanted outage, that remains while only this input is unknown.
    margin_first : float
        Share of the variance of that margin that vanishes once the input is known.
    """

    name: str
    gain_total: float
    fading_total: float
    margin_total: float
    margin_first: float


@dataclass(frozen=True, eq=False, repr=False)
class Availability(Stored, kind="availability", title="meshtrace availability"):
    """Share of the time that a link works, over uncertain inputs.

    Attributes
    ----------
    periods : tuple of Period
        The year, and its months if an input has months.
    influences : tuple of Influence
        Sobol indices of each input over the year.
    need : float
        Gain of a working link; nan if it differs between states.
    outage, target : float
        Wanted outage by fades within a state, and share of the year at the range.
    parameter : str
        Key whose values the curves have; empty without a range.
    value : float
        Its value for the link; nan without one.
    range, range_stderr, steady_range : float
        Value of it at which the share of the year, and the one with the wanted outage, is `target`;
        nan if it is not within the curves.
    curve_value, curve_share, curve_share_stderr, curve_steady_share : ndarray, shape (n,)
        Shares of the year over that key; a single nan without one.
    level, gain_quantile : ndarray, shape (m,)
        Quantiles of the mean gain over the states of the year.
    gain_error, fading_error : float
        Leave-one-out error of the surfaces, the noise of a run included: of ln mean gain, and of
        the logarithm of the variance of fades.
    inputs : tuple of str
        Keys of the runs.
    run_input : ndarray, shape (runs, inputs)
        Values of the runs.
    run_gain, run_gain_stderr, run_variance, run_need : ndarray, shape (runs,)
        Mean gain, its standard error, variance of the logarithm of the gain over seas, and needed
        gain.
    provenance : dict
        Versions and configuration.
    """

    periods: Annotated[tuple[Period, ...], Columns(Period, "", "period")]
    influences: Annotated[tuple[Influence, ...], Columns(Influence, "", "influence")]
    need: Annotated[float, Variable(name="gain_needed")]
    outage: float
    target: float
    parameter: str
    value: float
    range: Annotated[float, Variable(name="range_value")]
    range_stderr: Annotated[float, Variable(name="range_value_stderr")]
    steady_range: Annotated[float, Variable(name="steady_range_value")]
    curve_value: Annotated[Floats, Variable("curve_value")]
    curve_share: Annotated[Floats, Variable("curve_value")]
    curve_share_stderr: Annotated[Floats, Variable("curve_value")]
    curve_steady_share: Annotated[Floats, Variable("curve_value")]
    level: Annotated[Floats, Variable("level")]
    gain_quantile: Annotated[Floats, Variable("level", name="mean_gain_quantile")]
    gain_error: Annotated[float, Variable(name="gain_surface_error")]
    fading_error: Annotated[float, Variable(name="fading_surface_error")]
    inputs: Annotated[tuple[str, ...], Variable("input", name="input")]
    run_input: Annotated[Floats, Variable("run", "input")]
    run_gain: Annotated[Floats, Variable("run")]
    run_gain_stderr: Annotated[Floats, Variable("run")]
    run_variance: Annotated[Floats, Variable("run")]
    run_need: Annotated[Floats, Variable("run")]
    provenance: dict[str, Any] = field(default_factory=dict)

    @property
    def year(self) -> Period:
        """Shares of the year."""
        return self.periods[0]

    @property
    def months(self) -> dict[int, Period]:
        """Shares by month, 1 to 12; empty if no input has months."""
        return {int(period.name): period for period in self.periods[1:]}

    @property
    def measure_first(self) -> str:
        """Input that removes most of the variance of the margin once it is known."""
        return max(self.influences, key=lambda item: item.margin_first).name

    def _headline(self) -> str:
        year = self.year
        return f"works {100.0 * year.share:.1f} +- {100.0 * year.share_stderr:.1f} % of the time"

    def summary(self) -> str:
        """Return shares, range and influences as text for a terminal."""
        of_outage = f"outage <= {100.0 * self.outage:g} %"
        heads = ("period", "works", of_outage, "without fades")
        shares_of_periods = [
            (p.name, _percent(p.share, p.share_stderr),
             _percent(p.steady_share, p.steady_share_stderr), f"{100.0 * p.mean_share:.1f} %")
            for p in self.periods
        ]  # fmt: skip
        lines = [text_table(shares_of_periods, heads), "", *self._range_lines()]
        shares = ("mean gain", "fading", "margin", "margin if known")
        influences = [
            (i.name, *(f"{100.0 * max(x, 0.0):.1f} %" for x in (
                i.gain_total, i.fading_total, i.margin_total, i.margin_first)))
            for i in self.influences
        ]  # fmt: skip
        lines += [text_table(influences, ("share of the variance of", *shares))]
        if len(self.influences) > 1:
            lines += [f"measure {self.measure_first} first"]
        pairs = zip(self.level, self.gain_quantile, strict=True)
        quantiles = ", ".join(f"{100.0 * level:g} % {gain:.3g}" for level, gain in pairs)
        lines += ["", f"quantiles of the mean gain: {quantiles}"]
        need = f"{self.run_need.min():.4g}"
        if math.isnan(self.need):
            need += f" to {self.run_need.max():.4g}"
        lines += [
            f"gain of a working link: {need}",
            f"surfaces of {len(self.run_gain)} runs; error at a run left out, its noise included: "
            f"{100.0 * self.gain_error:.2g} % of the gain, "
            f"{100.0 * self.fading_error:.2g} % of the variance of fades",
        ]
        return "\n".join([*lines, *self._notes(), *self._origin_lines()])

    def _range_lines(self) -> list[str]:
        """Describe the range."""
        if not self.parameter:
            return []
        low, high = float(self.curve_value[0]), float(self.curve_value[-1])
        closing = self.provenance.get("run", {}).get("closing_depth")
        always = self.curve_share.min() >= self.target
        text = f"{'beyond' if always else 'not within'} {low:.4g} .. {high:.4g}"
        if not math.isnan(self.range):
            steady = "none" if math.isnan(self.steady_range) else f"{self.steady_range:.4g}"
            text = f"{self.range:.4g} +- {self.range_stderr:.2g} (with the outage: {steady})"
        elif closing is not None:
            text += f"; median inputs close the link at {closing:.3g}: ask --bounds about it"
        return [f"{self.parameter} at {100.0 * self.target:g} % of the year: {text}", ""]

    def _notes(self) -> list[str]:
        """Warn of response surfaces too coarse for the shares."""
        worst = max(self.periods, key=lambda p: p.share_stderr)
        if worst.share_stderr <= _DOUBTFUL:
            return []
        return [
            f"the surfaces are too coarse: a standard error of {100.0 * worst.share_stderr:.1f} % "
            f"({worst.name}); use more runs"
        ]

    def _origin_lines(self) -> list[str]:
        spans = self.provenance.get("run", {}).get("inputs", {})
        texts = (
            f"{name} {low:.3g}, {mid:.3g}, {high:.3g}" for name, (low, mid, high) in spans.items()
        )
        return [f"inputs (least, median, largest): {'; '.join(texts)}"] if spans else []


def _percent(share: float, stderr: float) -> str:
    # a share that no state comes near to changing still has an error
    error = f"{100.0 * stderr:.1f}" if stderr >= 5e-4 else "< 0.05"
    return f"{100.0 * share:.1f} +- {error} %"
