"""Shares of the time that a link works, from response surfaces of its gain and fading."""

from __future__ import annotations

import math
from functools import cache, cached_property
from typing import Any

import numpy as np
from scipy import interpolate, optimize, special, stats

from meshtrace.errors import Described, Refused
from meshtrace.fading import gamma_gamma
from meshtrace.models import Floats
from meshtrace.studies.availability_result import Availability, Influence, Period
from meshtrace.studies.availability_runs import StateRuns
from meshtrace.studies.inputs import MONTHS, Axis, Input
from meshtrace.studies.response_surface import ResponseSurface

DAYS = np.array([31, 28.25, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31]) / 365.25
_SETS = 8  # independent sets of states, whose scatter is the Monte Carlo error
_STATES, _STATES_OF_MONTH = 4096, 512  # of a set: fewer miss samples of a file by half a percent
_WEIGHED = 512  # states of an error of the surface, tuned: its time grows with their square
_STEPS = 0.1, 0.2  # of ln gain and ln variance, in the derivatives of a share
_INDICES = 1024  # states of the Sobol indices
_NODES = 17  # of a share over the parameter of the range
_LEVELS = np.array([0.01, 0.05, 0.1, 0.25, 0.5, 0.75, 0.9, 0.95, 0.99])
_USELESS = math.log(2.0)  # error of ln gain from which a surface tells nothing


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


class ShareSurfaces:
    """Response surfaces of a study, and the shares of time that follow from them.

    Parameters
    ----------
    study : StateRuns
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
        self, study: StateRuns, inputs: list[Input], axes: list[Axis], values: Floats,
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

    def _places_of_states(self, states: Floats, value: float) -> Floats:
        """Return the places of states (n, inputs) at a value of the key of the range, if any."""
        if self._has_range:
            states = np.column_stack([states, np.full(len(states), value)])
        return self._places(states)

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
        """Return shares of states (3, n): with their fades, with the outage, without fades."""
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
        weights = np.ones(len(months)) if len(months) < MONTHS else DAYS
        weights = weights[:, None] / weights.sum() / states.shape[2]
        places = self._places_of_states(states.reshape(-1, len(self.inputs)), value)
        margin = self.gain.values(places) - self.need.values(places)
        log_variance = self.fading.values(places)
        works = self._works(margin, log_variance).reshape(3, *states.shape[:3])
        by_set = (works * weights[None, :, None]).sum(axis=(1, 3))
        variance = by_set.var(axis=1, ddof=1) / _SETS
        # states spread over all months
        weighed = np.unique(np.linspace(0, len(places) - 1, _WEIGHED).astype(int))
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
            places = self._places_of_states(values.T, self.value)
            gain, logs = self.gain.values(places), self.fading.values(places)
            margin = gain - self.need.values(places) + _fades().quantile(self.outage, logs)
            return np.array([gain, logs, margin])

        indices = stats.sobol_indices(
            func=quantities, n=_INDICES, dists=self.inputs,
            rng=np.random.default_rng(self.study.seed),
        )  # fmt: skip
        # of a constant there is no share: 0 / 0
        orders = indices.total_order, indices.first_order
        total, first = (np.nan_to_num(order).reshape(3, -1) for order in orders)
        return tuple(
            Influence(item.name, *map(float, [*total[:, k], first[2, k]]))
            for k, item in enumerate(self.inputs)
        )

    @property
    def _has_range(self) -> bool:
        """Whether a range is requested; its axis is the last one."""
        return len(self.axes) > len(self.inputs)

    def _curves(self) -> tuple[Floats, Floats, Floats]:
        """Return values of the key of the range (n,), and shares there with their errors (3, n)."""
        if not self._has_range:
            return np.full(1, math.nan), np.full((3, 1), math.nan), np.full((3, 1), math.nan)
        nodes = np.asarray(self.axes[-1].value(np.linspace(0.0, 1.0, _NODES)))
        shares, errors = np.array([self.shares(None, node) for node in nodes]).transpose(1, 2, 0)
        return nodes, shares, errors

    def result(self, provenance: dict[str, Any]) -> Availability:
        """Return the result of the study."""
        months = range(MONTHS) if self._months == MONTHS else ()
        gain, gain_stderr, variance, need = self.numbers.T
        places = self._places_of_states(self._states.reshape(-1, len(self.inputs)), self.value)
        quantiles = np.exp(np.quantile(self.gain.values(places), _LEVELS))
        nodes, shares, errors = self._curves()
        reach, steady_reach = (_crossing(nodes, curve - self.target) for curve in shares[:2])
        reach_stderr = math.nan
        if not math.isnan(reach):
            slope = interpolate.PchipInterpolator(nodes, shares[0])(reach, 1)
            reach_stderr = float(np.interp(reach, nodes, errors[0]) / max(abs(slope), 1e-300))
        return Availability(
            periods=tuple(self._period(month) for month in (None, *months)),
            influences=self._influences(),
            need=float(need[0]) if np.ptp(need) == 0.0 else math.nan,
            outage=self.outage,
            target=self.target,
            parameter=self.axes[-1].name if self._has_range else "",
            value=self.value,
            range=reach,
            range_stderr=reach_stderr,
            steady_range=steady_reach,
            curve_value=nodes,
            curve_share=shares[0],
            curve_share_stderr=errors[0],
            curve_steady_share=shares[1],
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


def _crossing(nodes: Floats, values: Floats) -> float:
    """Return the first root of a monotone interpolant; nan without a root."""
    changes = np.flatnonzero(np.sign(values[:-1]) * np.sign(values[1:]) < 0)
    if not len(changes):
        return math.nan
    curve, first = interpolate.PchipInterpolator(nodes, values), int(changes[0])
    return float(optimize.brentq(curve, nodes[first], nodes[first + 1]))
