"""Availability of a link over uncertain inputs: share of the time that it works, and its range."""

from __future__ import annotations

import math
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Unpack

import numpy as np
from pydantic import Field
from scipy import interpolate, optimize, special, stats

from meshtrace.checks import ErrorRate, Positive, Probability, check_call
from meshtrace.comms.background import with_background
from meshtrace.comms.budget import required_gain
from meshtrace.comms.ook import OokLink, Preset
from meshtrace.engine.setup.options import Arrivals, Case, Meshing, StudyOptions
from meshtrace.engine.simulate import simulate
from meshtrace.errors import Described, Refused
from meshtrace.fading import gamma_gamma
from meshtrace.kernels.random import realization_seed
from meshtrace.link import Link
from meshtrace.mesh import SeededSurface
from meshtrace.models import Floats
from meshtrace.parallel import held
from meshtrace.results.gain import GainResult
from meshtrace.scenario import Scenario
from meshtrace.scenario.files import Table, set_value
from meshtrace.stored import Columns, Stored, Variable
from meshtrace.studies.background import electronics_of, mean_sea
from meshtrace.studies.campaign import DEFAULT_CHAINS, Campaign, campaign_of, case_options
from meshtrace.studies.inputs import MONTHS, Axis, Input, read_inputs
from meshtrace.studies.keys import Bounds, checked_bounds
from meshtrace.studies.neighbours import depth_key, range_of
from meshtrace.studies.response_surface import ResponseSurface
from meshtrace.studies.series import over_realizations
from meshtrace.studies.sweeps import base_scenario, plain_base, transmission_at
from meshtrace.tables import text_table

PRIOR: Mapping[str, Any] = {
    "wind_speed": {"distribution": "weibull_min", "c": 2.2, "scale": 7.9, "clip": [1.0, 15.0]},
    "water.chlorophyll": {"distribution": "lognorm", "s": 0.7, "scale": 0.3, "clip": [0.03, 3.0]},
}
"""Inputs by default: wind over the open sea [m s-1], and chlorophyll [mg m-3] of most of it."""

_DAYS = np.array([31, 28.25, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31]) / 365.25
_SETS = 8  # independent sets of states, whose scatter is the Monte Carlo error
_STATES, _STATES_OF_MONTH = 512, 64  # of a set
_WEIGHED = 512  # states of an error of the surface, tuned: its time grows with their square
_STEPS = 0.1, 0.2  # of ln gain and ln variance, in the derivatives of a share
_INDICES = 1024  # states of the Sobol indices
_NODES = 17  # of a share over the parameter of the range
_SPREAD = 0.6, 1.4  # bounds of the depth over that at which median inputs close the link
_FAR = 2.0  # ratio of that depth to the one of the link from which the bounds are about the latter
_LEVELS = np.array([0.01, 0.05, 0.1, 0.25, 0.5, 0.75, 0.9, 0.95, 0.99])
_MORE_CHAINS = 8  # of the mean gain, whose error is the largest of a run
_NOISE_LEFT = 0.1  # of the variance of ln gain, at least what remains without its noise
_USELESS = math.log(2.0)  # error of ln gain from which a surface tells nothing
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
        """Input whose knowledge takes most of the variance of the margin away."""
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
            text += f"; median inputs close the link at {closing:.3g}: ask --over about it"
        return [f"{self.parameter} at {100.0 * self.target:g} % of the year: {text}", ""]

    def _notes(self) -> list[str]:
        """Warn of surfaces that are too coarse for the shares."""
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


@check_call
def availability(
    link: Link | Scenario,
    inputs: Mapping[str, Any] | str | Path | None = None,
    *,
    threshold: Positive | None = None,
    ook: OokLink | Preset = "physical",
    bit_rate: float | None = None,
    limit: ErrorRate = 1e-3,
    outage: Probability = 0.01,
    over: Bounds | None = None,
    target: Probability = 0.9,
    runs: Annotated[int, Field(ge=8, le=100_000)] = 32,
    realizations: Annotated[int, Field(ge=4, le=100_000)] = 6,
    **run: Unpack[StudyOptions],
) -> Availability:
    r"""Return the share of the time that a link works, over uncertain inputs.

    Parameters
    ----------
    link : Link or Scenario
        The link, with one receiver.
    inputs : mapping or path, optional
        Inputs by their keys in a link file, or a TOML file of them: each a frozen law of
        `scipy.stats`, samples, or a table, see Notes. By default the wind and the chlorophyll of
        the open sea, `studies.planning.PRIOR`.
    threshold : float, optional
        Gain of a working link; by default that which the transmission needs for `limit`.
    ook : OokLink or preset
        Transmission, by default that of the scenario.
    bit_rate : float, optional
        Bit rate R_b [bit s-1], by default that of the transmission.
    limit : float
        Largest bit error rate of a working link.
    outage : float
        Wanted outage by fades: the share of time in a state that may miss the need.
    over : mapping of one str to (low, high), optional
        Key, with bounds, of which the range is asked; by default the depth, about that at
        which median inputs close the link, or about that of the link where they differ twofold.
        Empty for no range.
    target : float
        Share of the year at the range.
    runs : int
        Runs to which the surfaces are fitted.
    realizations : int
        Seas of the fading of each run.
    **run
        Options of the run, see `StudyOptions`: 2048 chains by default over the seas, eight times as
        many for the mean gain; progress by run. The store keeps the runs, from which other
        thresholds follow at once.

    Returns
    -------
    Availability

    Raises
    ------
    Refused
        If an input is no law and no samples, a key or a value is not allowed, or the surface of
        the gain is wrong by a factor of two where a run is left out.

    Notes
    -----
    The table of an input has a law by its name in `scipy.stats` and its parameters, each a number
    or twelve by month (``{distribution = "weibull_min", c = 2.2, scale = 7.9}``), or ``samples``,
    or a ``file`` with the ``variable`` of a netCDF file or a column of a CSV file and its
    ``time``; ``clip = [low, high]`` limits the values. Samples at times of all months are taken by
    month. Inputs of one file are drawn at the same times; all others are independent.

    Runs at Sobol points between the 0.2 and 99.8 % quantiles give the mean gain g over a sea whose
    waves are random slopes, and the variance s^2 of ln h over seas with all waves that fade.
    Response surfaces of ln g and ln s^2, Gaussian processes with noise, give in each state x of the
    inputs

    .. math:: P(h \ge h_0 \mid x) = 1 - F((\ln h_0 - \mathrm{E} \ln h) / s)

    with F the gamma-gamma law of equal shapes, `fading.laws.probability_in_log`. The share is its
    mean over 4096 states or more. Its standard error is that of the surfaces, weighted by the
    derivative of the share, and of the states; that of finite samples is not included.

    Sobol indices (`scipy.stats.sobol_indices`) take all inputs for independent.

    Examples
    --------
    >>> import meshtrace as mt
    >>> a = mt.studies.availability(mt.Link(), {"water.a": {"samples": [0.1, 0.2, 0.4]}},
    ...                             threshold=1e-5, over={}, runs=8, realizations=4, photons=64)
    >>> f"{a.year.mean_share:.2f}"
    '0.67'
    """
    run.setdefault("photons", DEFAULT_CHAINS)
    campaign = campaign_of(link, None, "availability", run, several=False)
    campaign.require_chains()
    if len(campaign.link.receivers) != 1:
        n = Described(f"{len(campaign.link.receivers)} apertures")
        raise Refused("receiver", n, "one aperture")
    known = read_inputs(PRIOR if inputs is None else inputs)
    scenario = base_scenario(link, None)
    if threshold is None:
        electronics = electronics_of(campaign, ook, bit_rate)
        scenario = scenario.model_copy(update={"detector": electronics})
    # with the choice of waves, which a campaign fixes for one wind: each run has its own
    case = Case(scenario.link, scenario.surface, scenario.run, scenario.meshing)
    meshing = case.with_options(**case_options(run)).meshing
    names = tuple(item.name for item in known)
    study = _Runs(
        plain_base(scenario, map(_key, names)), names, campaign.run.photons, meshing,
        campaign.run.seed, realizations, threshold, limit,
    )  # fmt: skip
    closing: float | None = None
    bounds: Bounds = over or {}
    if over is None:
        depth = scenario.link.depth
        if not math.isnan(depth):
            closing = study.closing_depth(scenario.link, known)
            # a range far from the link is only named: deeper links take longer
            middle = closing if depth < _FAR * closing < _FAR**2 * depth else depth
            low, high = (factor * middle for factor in _SPREAD)
            bounds = {depth_key(scenario.link): (min(low, depth), max(high, depth))}
    study, axes = study.with_range(known, bounds)
    value = study.value(axes[-1].name) if bounds else math.nan
    sobol = stats.qmc.Sobol(len(axes), rng=campaign.run.seed)
    places = sobol.random_base2(math.ceil(math.log2(runs)))[:runs]
    values = np.transpose([axis.value(places[:, k]) for k, axis in enumerate(axes)])
    study.check(axes, values[0].tolist())
    steps = [(i, *row) for i, row in enumerate(values.tolist())]
    each = campaign.evaluate(
        lambda: study.measure, steps, "runs", {"runs": study.identity()}, lambda step: (4,), "runs"
    )
    numbers = np.array(list(each))
    if threshold is not None:
        numbers[:, 3] = threshold
    spans = {item.name: item.quantile([0.0, 0.5, 1.0]).tolist() for item in known}
    # digits of the surfaces do not depend on the threads of BLAS
    answer = held(_Answer)(study, known, axes, values, numbers, (outage, target), value)
    return held(answer.result)(
        campaign.provenance(of_study={"inputs": spans, "closing_depth": closing})
    )


def _key(name: str) -> str:
    """Return the key in a link file; the spectrum of the water has no table of its own there."""
    return name.replace("water.spectrum.", "water.")


class _Runs(NamedTuple):
    """Runs of a study, as plain data for workers."""

    config: Table
    names: tuple[str, ...]
    photons: int
    meshing: Meshing
    seed: int
    realizations: int
    threshold: float | None
    limit: float

    def with_range(self, inputs: list[Input], bounds: Bounds) -> tuple[_Runs, list[Axis]]:
        """Return the runs with the key of the range, and the axes of all."""
        axes = [item.axis() for item in inputs]
        if len(bounds) > 1:
            raise Refused("over", list(bounds), "one key")
        for name, (low, high) in checked_bounds(bounds).items():
            if _key(name) in map(_key, self.names):
                raise Refused("over", name, "a key that is no input")
            axes.append(Axis(name, low, high, False))
        return self._replace(names=tuple(axis.name for axis in axes)), axes

    def closing_depth(self, link: Link, inputs: list[Input]) -> float:
        """Return the depth [m] at which median inputs close the link."""
        at_depth = self._replace(names=(*self.names, depth_key(link)))
        medians = [float(item.quantile(0.5)) for item in inputs]

        def reserve(depth: float) -> float:
            scenario = at_depth.scenario([*medians, depth])
            result = self._mean(scenario, self.seed, 1)
            return math.log(result.gain / (self.threshold or self._need(scenario, result)))

        return range_of(reserve, link)[0]

    def check(self, axes: list[Axis], values: list[float]) -> None:
        """Refuse ends of an axis that are not allowed, before the work."""
        for k, axis in enumerate(axes):
            for end in (axis.low, axis.high):
                self.scenario([*values[:k], end, *values[k + 1 :]])

    def identity(self) -> dict[str, Any]:
        """Return what the numbers of a run depend on."""
        # another threshold takes no new runs
        limit = self.limit if self.threshold is None else None
        return {"config": self.config, "names": list(self.names), "limit": limit,
                "realizations": self.realizations}  # fmt: skip

    def scenario(self, values: Any) -> Scenario:
        """Return the scenario at values of the inputs."""
        table = deepcopy(self.config)
        for name, value in zip(self.names, values, strict=True):
            set_value(table, _key(name), value)
        return Scenario.from_config(table)

    def value(self, name: str) -> float:
        """Return the value of a key of the link; nan if it is not set."""
        item: Any = self.config
        for part in _key(name).split("."):
            item = item.get(part, math.nan) if isinstance(item, Mapping) else math.nan
        return float(item)

    def measure(self, step: tuple[Any, ...]) -> Floats:
        """Return mean gain, its error, variance of ln gain and, if asked for, the needed gain."""
        number, *values = step
        scenario = self.scenario(values)
        # each run has seas and chains of its own: common ones would bias all runs alike, unseen
        seed = realization_seed(self.seed, number)
        result = self._mean(scenario, seed, _MORE_CHAINS)
        need = math.nan if self.threshold else self._need(scenario, result)
        variance = 0.0
        if isinstance(scenario.surface, SeededSurface):
            run: StudyOptions = {
                "photons": self.photons, "mesh": self.meshing, "seed": seed, "threads": 1
            }  # fmt: skip
            variance = self._variance(campaign_of(scenario, None, "", run, fading=True))
        return np.array([result.gain, result.gain_stderr, variance, need])

    def _mean(self, scenario: Scenario, seed: int, more: int) -> GainResult:
        """Return the gain over a sea whose waves are random slopes."""
        sea = scenario.surface
        if isinstance(sea, SeededSurface):
            sea = mean_sea(scenario.link, sea.with_seed(seed))
        result = simulate(
            scenario.link, sea, photons=more * self.photons, seed=seed, threads=1,
            mesh=self.meshing.replace(waves=None),  # those of `mean_sea` stay
            record=[Arrivals()] if self.threshold is None else (),
        )  # fmt: skip
        if not result.gain > 0.0:
            raise Refused("inputs", Described("a dark link"), "links with light")
        return result

    def _need(self, scenario: Scenario, result: Any) -> float:
        """Return the gain that the transmission needs, under its background and response."""
        ook, sky = transmission_at(scenario, result, 0)
        need = required_gain(ook if sky is None else with_background(ook, sky), self.limit)
        if not math.isfinite(need):
            raise Refused("limit", self.limit, "a bit error rate that some power reaches")
        return need

    def _variance(self, campaign: Campaign) -> float:
        """Return the variance of ln gain over seas, without that of the chains of each sea."""
        series = over_realizations(campaign, self.realizations)
        logs = np.log(np.maximum(series.gain, 1e-300))
        total, n = float(logs.var(ddof=1)), len(logs)
        relative = series.gain_stderr / np.maximum(series.gain, 1e-300)
        of_all_seas = float(series.mean_stderr) / max(float(series.gain.mean()), 1e-300)
        # as in `GainSeries.fading`: the error that all seas have in common does not scatter them
        noise = max(float(np.mean(relative**2)) - of_all_seas**2, 0.0) * n / (n - 1)
        return max(total - noise, _NOISE_LEFT * total)


class _Fades:
    """Gamma-gamma laws of equal shapes, tabulated over the variance of the logarithm."""

    def __init__(self) -> None:
        shapes = np.geomspace(1e6, 0.7, 48)
        self._std = np.sqrt(2.0 * special.polygamma(1, shapes))
        self._mean = 2.0 * (special.digamma(shapes) - np.log(shapes))
        self._z = np.linspace(-12.0, 6.0, 361)
        at = np.exp(self._mean[:, None] + self._std[:, None] * self._z)
        self._below = np.array([
            gamma_gamma.cdf(h, shape, shape) for h, shape in zip(at, shapes, strict=True)
        ])  # fmt: skip
        self._table = interpolate.RegularGridInterpolator((np.log(self._std), self._z), self._below)

    def _log_std(self, log_variance: Floats) -> Floats:
        return np.clip(0.5 * log_variance, *np.log(self._std[[0, -1]]))

    def below(self, ratio: Floats, log_variance: Floats) -> Floats:
        """Return the probability of a gain below exp(ratio) times its mean."""
        log_std = self._log_std(log_variance)
        mean = np.interp(log_std, np.log(self._std), self._mean)
        z = np.clip((ratio - mean) / np.exp(log_std), self._z[0], self._z[-1])
        return np.asarray(self._table(np.stack([log_std, z], axis=-1)))

    def quantile(self, share: float, log_variance: Floats) -> Floats:
        """Return ln(gain / mean gain) at a quantile."""
        laws = zip(self._mean, self._std, self._below, strict=True)
        values = [mean + std * np.interp(share, below, self._z) for mean, std, below in laws]
        return np.interp(self._log_std(log_variance), np.log(self._std), values)


_fades = cache(_Fades)  # the tables take half a second


class _Answer:
    """Answers of the surfaces of a study.

    Parameters
    ----------
    study : _Runs
        The runs.
    inputs : list of Input
        Inputs with their values over the year.
    axes : list of Axis
        Axes of the inputs, and of the key of the range, if any, as the last.
    values, numbers : ndarray, shape (runs, axes) and (runs, 4)
        Inputs and results of the runs.
    levels : tuple of float
        Outage and target, as in `availability`.
    value : float
        Value of the key of the range for the link.
    """

    def __init__(
        self, study: _Runs, inputs: list[Input], axes: list[Axis], values: Floats,
        numbers: Floats, levels: tuple[float, float], value: float,
    ) -> None:  # fmt: skip
        self.study, self.inputs, self.axes, self.values = study, inputs, axes, values
        self.numbers, (self.outage, self.target), self.value = numbers, levels, value
        gain, stderr, variance, need = numbers.T
        # the logarithm of a sample variance of n normal numbers is biased by psi(m) - ln m, with
        # m = (n - 1) / 2
        half = 0.5 * (study.realizations - 1)
        logs = np.log(np.maximum(variance, 1e-12)) - special.digamma(half) + math.log(half)
        places = self._places(values)
        self.gain = ResponseSurface(places, np.log(gain), stderr / gain)
        # the variance of the logarithm is psi'(m)
        noise = math.sqrt(special.polygamma(1, half))
        self.fading = ResponseSurface(places, logs, noise)
        self.need = ResponseSurface(places, np.log(need), 0.0)
        if self.gain.error > _USELESS:
            wrong = Described(f"{len(gain)}, whose surface is wrong by {self.gain.error:.2g} in ln")
            raise Refused("runs", wrong, "more of them, or narrower inputs")
        self._months = max(len(item.values) for item in inputs)

    def _places(self, values: Floats) -> Floats:
        return np.transpose([axis.place(values[:, k]) for k, axis in enumerate(self.axes)])

    @cached_property
    def _states(self) -> Floats:
        """States (months, sets, n, inputs) of the inputs."""
        # inputs of one file share a column, so that they have the values of the same times
        files = [item.record or item.name for item in self.inputs]
        columns = [list(dict.fromkeys(files)).index(name) for name in files]
        n = _STATES if self._months == 1 else _STATES_OF_MONTH
        seeds = np.random.SeedSequence(self.study.seed).spawn(_SETS)
        axes, rngs = self._months * (max(columns) + 1), map(np.random.default_rng, seeds)
        shares = np.array([stats.qmc.Sobol(axes, rng=rng).random(n) for rng in rngs])
        shares = shares.reshape(_SETS, n, self._months, -1).transpose(2, 0, 1, 3)
        states = np.empty((*shares.shape[:3], len(self.inputs)))
        for month in range(self._months):
            for k, (item, column) in enumerate(zip(self.inputs, columns, strict=True)):
                known = item.of_month(month)
                at = (shares[month, :, :, column] * len(known)).astype(int)
                states[month, :, :, k] = known[at]
        return states

    def _works(self, margin: Floats, log_variance: Floats) -> Floats:
        """Return whether each state works (3, n): a share at the instant, steadily, by the mean."""
        table = _fades()
        steady = margin + table.quantile(self.outage, log_variance) >= 0.0
        return np.array([1.0 - table.below(-margin, log_variance), steady, margin >= 0.0])

    def shares(self, month: int | None, value: float) -> tuple[Floats, Floats]:
        """Return the three shares of a month or of the year, and their standard errors.

        Parameters
        ----------
        month : int, optional
            Number of the month from 0; None for the year.
        value : float
            Value of the key of the range.
        """
        months = range(self._months) if month is None else [month]
        states = self._states[months]
        weights = np.ones(len(months)) if len(months) < MONTHS else _DAYS
        weights = weights[:, None] / weights.sum() / states.shape[2]
        flat = states.reshape(-1, len(self.inputs))
        if len(self.axes) > len(self.inputs):
            flat = np.column_stack([flat, np.full(len(flat), value)])
        places = self._places(flat)
        margin = self.gain.values(places) - self.need.values(places)
        log_variance = self.fading.values(places)
        works = self._works(margin, log_variance).reshape(3, *states.shape[:3])
        by_set = (works * weights[None, :, None]).sum(axis=(1, 3))
        variance = by_set.var(axis=1, ddof=1) / _SETS
        # states spread over all months
        weighed = np.unique(np.linspace(0, len(flat) - 1, _WEIGHED).astype(int))
        share = np.broadcast_to(weights[:, None], states.shape[:3]).ravel()[weighed]
        share = share / share.sum()
        at, margin, log_variance = places[weighed], margin[weighed], log_variance[weighed]
        for surfaces, step, move in (
            ((self.gain, self.need), _STEPS[0], (1.0, 0.0)),
            ((self.fading,), _STEPS[1], (0.0, 1.0)),
        ):
            ends = [
                self._works(margin + side * step * move[0], log_variance + side * step * move[1])
                for side in (-1.0, 1.0)
            ]
            slopes = share * (ends[1] - ends[0]) / (2.0 * step)
            for surface in surfaces:
                variance += surface.errors_of_sums(at, slopes) ** 2
        return by_set.mean(axis=1), np.sqrt(variance)

    def _period(self, month: int | None) -> Period:
        value, error = (numbers.tolist() for numbers in self.shares(month, self.value))
        name = "year" if month is None else str(month + 1)
        return Period(name, value[0], error[0], value[1], error[1], value[2])

    def _influences(self) -> tuple[Influence, ...]:
        """Return the Sobol indices of the inputs at the link's value of the key of the range."""

        def quantities(values: Floats) -> Floats:
            states = values.T
            if len(self.axes) > len(self.inputs):
                states = np.column_stack([states, np.full(len(states), self.value)])
            places = self._places(states)
            gain, logs = self.gain.values(places), self.fading.values(places)
            margin = gain - self.need.values(places) + _fades().quantile(self.outage, logs)
            return np.array([gain, logs, margin])

        indices = stats.sobol_indices(
            func=quantities, n=_INDICES, dists=[_Law(item) for item in self.inputs],
            rng=np.random.default_rng(self.study.seed),
        )  # fmt: skip
        # of a constant there is no share: 0 / 0
        orders = indices.total_order, indices.first_order
        total, first = (np.nan_to_num(order).reshape(3, -1) for order in orders)
        return tuple(
            Influence(item.name, *map(float, [*total[:, k], first[2, k]]))
            for k, item in enumerate(self.inputs)
        )

    def _curves(self) -> dict[str, Any]:
        """Return the shares over the key of the range, and where they are the target."""
        names = ("curve_value", "curve_share", "curve_share_stderr", "curve_steady_share")
        if len(self.axes) == len(self.inputs):
            nothing = {"parameter": "", "range": math.nan, "range_stderr": math.nan}
            return nothing | {"steady_range": math.nan} | {k: np.full(1, math.nan) for k in names}
        axis = self.axes[-1]
        nodes = np.asarray(axis.value(np.linspace(0.0, 1.0, _NODES)))
        values, errors = np.array([self.shares(None, node) for node in nodes]).transpose(1, 2, 0)
        curves = dict(zip(names, (nodes, values[0], errors[0], values[1]), strict=True))
        reach, steady = (_crossing(nodes, curve - self.target) for curve in values[:2])
        stderr = math.nan
        if not math.isnan(reach):
            slope = interpolate.PchipInterpolator(nodes, values[0])(reach, 1)
            stderr = float(np.interp(reach, nodes, errors[0]) / max(abs(slope), 1e-300))
        reached = {"parameter": axis.name, "range": reach, "range_stderr": stderr}
        return reached | {"steady_range": steady} | curves

    def result(self, provenance: dict[str, Any]) -> Availability:
        """Return the result of the study."""
        months = range(MONTHS) if self._months == MONTHS else ()
        gain, gain_stderr, variance, need = self.numbers.T
        flat = self._states.reshape(-1, len(self.inputs))
        if len(self.axes) > len(self.inputs):
            flat = np.column_stack([flat, np.full(len(flat), self.value)])
        quantiles = np.exp(np.quantile(self.gain.values(self._places(flat)), _LEVELS))
        return Availability(
            periods=tuple(self._period(month) for month in (None, *months)),
            influences=self._influences(),
            need=float(need[0]) if np.ptp(need) == 0.0 else math.nan,
            outage=self.outage,
            target=self.target,
            value=self.value,
            **self._curves(),
            level=_LEVELS,
            gain_quantile=quantiles,
            gain_error=self.gain.error,
            fading_error=self.fading.error,
            inputs=tuple(axis.name for axis in self.axes),
            run_input=self.values,
            run_gain=gain,
            run_gain_stderr=gain_stderr,
            run_variance=variance,
            run_need=need,
            provenance=provenance,
        )


class _Law(NamedTuple):
    """Law of an input over the year, as `scipy.stats.sobol_indices` takes it."""

    item: Input

    def ppf(self, shares: Any) -> Any:
        """Return quantiles."""
        return self.item.quantile(shares)


def _crossing(nodes: Floats, values: Floats) -> float:
    """Return where a monotone interpolant of values over nodes is 0 first; nan if nowhere."""
    changes = np.flatnonzero(np.sign(values[:-1]) * np.sign(values[1:]) < 0)
    if not len(changes):
        return math.nan
    curve, first = interpolate.PchipInterpolator(nodes, values), int(changes[0])
    return float(optimize.brentq(curve, nodes[first], nodes[first + 1]))
