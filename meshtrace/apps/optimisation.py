"""Best link within bounds: sample averages with common random numbers, and its validation."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated, Any, Literal, NamedTuple, Unpack

import numpy as np
from pydantic import Field

from meshtrace import Flight, MeshSource, TriangleMesh
from meshtrace.apps.candidates import REWEIGHED, Custom, Goal, Objective, Sample
from meshtrace.checks import ErrorRate, NonNegative, Probability, check_call
from meshtrace.comms import OokLink
from meshtrace.comms.ook import Preset
from meshtrace.engine.setup.options import StudyOptions
from meshtrace.errors import Refused
from meshtrace.link import Link
from meshtrace.models import Floats
from meshtrace.scenario import Scenario
from meshtrace.stored import Stored, Variable
from meshtrace.studies import Variant
from meshtrace.studies.background import Lights, electronics_of, light_of
from meshtrace.studies.campaign import DEFAULT_CHAINS, Campaign, campaign_of
from meshtrace.studies.keys import Bounds, Parameter, checked_bounds, parameters
from meshtrace.studies.neighbours import DECIBELS, FADES, error_of
from meshtrace.tables import text_table


class Validation(NamedTuple):
    """Best link and start over fresh seas, hover errors and chains.

    Attributes
    ----------
    best, start : float
        The quantity of either.
    difference, stderr : float
        Cost of the start minus that of the best, and its standard error: logarithms, or m.
    improved : bool
        Whether the difference is at least two standard errors.
    """

    best: float
    start: float
    difference: float
    stderr: float
    improved: bool


@dataclass(frozen=True, eq=False, repr=False)
class Optimum(Stored, kind="optimum", title="meshtrace optimum"):
    """Best link of an optimisation.

    Attributes
    ----------
    objective : str
        "gain", "outage", "range", "margin", "capacity" or "custom".
    value : float
        The quantity of the best link over the common seas: mean gain, outage, range [m], margin
        [dB], capacity [bit s-1]; of "custom" the minimum.
    stderr : float
        Standard error of the value; of an outage that of `cost`.
    cost : float
        What was minimised: -ln(gain), the quantile of -ln(gain / need), -range [m], -ln(capacity).
    variables : tuple of str
        Names of the variables.
    values, start : ndarray, shape (n,)
        Variables of the best link and of the start.
    bounds, flatness : ndarray, shape (n, 2)
        Bounds, and the interval of each variable in which the cost is within one standard error
        of the best.
    candidates, costs : ndarray, shape (m, n) and (m,)
        Variables of all candidates in their order, and what was minimised.
    validation : Validation
        Comparison on fresh seeds.
    notes : tuple of str
        Variables at a bound, and whether there is an improvement.
    provenance : dict
        Versions and configuration, with the best link.
    """

    objective: str
    value: Annotated[float, Variable(name="quantity")]
    stderr: Annotated[float, Variable(name="quantity_stderr")]
    cost: float
    variables: Annotated[tuple[str, ...], Variable("variable", name="variable")]
    values: Annotated[Floats, Variable("variable", name="optimum_value")]
    start: Annotated[Floats, Variable("variable", name="optimum_start")]
    bounds: Annotated[Floats, Variable("variable", "end", name="optimum_bounds")]
    flatness: Annotated[Floats, Variable("variable", "end", name="optimum_flatness")]
    candidates: Annotated[Floats, Variable("candidate", "variable", name="optimum_history")]
    costs: Annotated[Floats, Variable("candidate", name="optimum_cost")]
    validation: Validation
    notes: tuple[str, ...] = ()
    provenance: dict[str, Any] = field(default_factory=dict)

    @property
    def history(self) -> Floats:
        """Variables and cost of all candidates, shape (m, n + 1)."""
        return np.column_stack([self.candidates, self.costs])

    @property
    def best(self) -> Link:
        """The best link; `changes` has the keys of its detector as well."""
        return Link.model_validate(self.provenance["best"])

    @property
    def changes(self) -> dict[str, float]:
        """Values of the best link by key, for `Scenario.load`."""
        return dict(zip(self.variables, self.values.tolist(), strict=True))

    def _headline(self) -> str:
        shown = ", ".join(
            f"{n} = {v:.4g}" for n, v in zip(self.variables, self.values, strict=True)
        )
        return f"{self.objective} {self.value:.4g} at {shown}"

    def summary(self) -> str:
        """Return variables, values and validation as text for a terminal."""
        head = ("variable", "start", "best", "flat from", "to", "bounds")
        of_values = [
            (name, f"{s:.4g}", f"{v:.4g}", f"{f[0]:.4g}", f"{f[1]:.4g}", f"{b[0]:g} .. {b[1]:g}")
            for name, s, v, f, b in zip(
                self.variables, self.start, self.values, self.flatness, self.bounds, strict=True
            )
        ]
        check = self.validation
        verb = "lost" if check.difference < 0.0 else "gained"
        change = f"{abs(check.difference):.3g} +- {check.stderr:.1g}"
        # costs that are logarithms of a ratio of powers read as decibels
        if self.objective in ("gain", "margin", "outage"):
            change = f"{DECIBELS * abs(check.difference):.2f} +- {DECIBELS * check.stderr:.2f} dB"
        reached = f"{self.objective} {self.value:.4g} after {len(self.history)} candidates"
        checked = f"fresh seeds: best {check.best:.4g}, start {check.start:.4g}, {verb} {change}"
        return "\n".join([reached, "", text_table(of_values, head), "", checked, *self.notes])


Method = Literal["auto", "bounded", "cobyqa", "global"]

Constraint = Callable[[Variant], float]
_FRESH = 1_000_003  # added to the seed for the validation
_GRID = 7  # candidates of one variable before the bounded search
_MOST = 6  # variables of COBYQA
_AT_BOUND = 0.01  # of the range of a variable
_HALVINGS = 4  # of the search for the flat interval
_FINEST = 0.005  # of the range of a variable, resolution of the searches
_FOV = "receiver.fov_deg"


@check_call
def optimize(
    link: Link | Scenario,
    surface: MeshSource | TriangleMesh | None = None,
    bounds: Bounds | None = None,
    objective: Objective | Custom = "outage",
    constraints: Sequence[Constraint] = (),
    hover_std: tuple[NonNegative, NonNegative] = (0.0, 0.0),
    *,
    flight: Flight | None = None,
    realizations: Annotated[int, Field(ge=1, le=100_000)] = 64,
    method: Method = "auto",
    ook: OokLink | Preset | None = "physical",
    bit_rate: float | None = None,
    limit: ErrorRate = 1e-3,
    quantile: Probability = 0.01,
    **run: Unpack[StudyOptions],
) -> Optimum:
    """Return the best link within bounds.

    Parameters
    ----------
    link : Link or Scenario
        The start, with one receiver and, if that is in the water, one lamp.
    surface : MeshSource or TriangleMesh, optional
        The surface, by default as for `simulate`.
    bounds : mapping of str to (low, high)
        Variables by their keys in a link file, such as receiver.fov_deg and
        detector.optics.filter_width_nm, with bounds.
    objective : {"outage", "gain", "range", "margin", "capacity"} or callable
        Quantity to improve. "outage" minimises the `quantile` of -ln(gain / need), "gain" and
        "margin" maximise means, "range" the depth at which the averaged error rate meets `limit`,
        "capacity" the rate after hard decisions. A callable takes (candidate, gains, weights)
        and returns a number to minimise; `Variant` has the parts of a candidate.
    constraints : sequence of callable
        Functions of a candidate (`Variant`) that are >= 0 where it is allowed.
    hover_std : (float, float)
        Standard deviations of the place of the end in the air along x and y [m].
    flight : Flight, optional
        Aircraft that tilts the end in the air; a fixed mount unless `uav.gimbal`.
    realizations : int
        Seas, each with 12 places; over a surface without random phases the number of places.
    method : {"auto", "bounded", "cobyqa", "global"}
        Method of the search. "bounded" takes one variable, "cobyqa" up to six, with constraints,
        "global" is differential evolution; "auto" is the first of them that fits.
    ook : OokLink or preset, optional
        Transmission, for all but the gain.
    bit_rate : float, optional
        Bit rate R_b [bit s-1], by default that of the transmission.
    limit : float
        Largest bit error rate of a working link.
    quantile : float
        Quantile of the gain for "outage".
    **run
        Options of the run, see `StudyOptions`: 2048 chains by default, common to all candidates;
        progress by candidate. The store keeps the gains of candidates, which another objective uses
        again.

    Returns
    -------
    Optimum

    Raises
    ------
    Refused
        If a variable is unknown or its bounds are not allowed, or the method does not fit.

    Notes
    -----
    The same seas, places, tilts and chains serve every candidate (sample average approximation), so
    that the cost is a deterministic, nearly smooth function. The optimum of a sample is optimistic:
    `validation` compares it with the start on fresh ones. Fields of view come from the angles of
    arrival of one run, and half angles from its directions of emission. Under the daylight of a
    scenario each candidate has its own background, with common rays, over a sea of random slopes
    that has the mean of all seas. Keys of the detector need no
    new light. Each candidate has the response of the channel from its own chains, over up to four
    seas with their places and tilts, unless the rms delay spread of the start is less than a
    ten-thousandth of a bit. Unless `waves` of the meshing says otherwise, meshes hold all waves
    that make the light of the start fade for the outage and the range over several seas; gain and
    margin need none of the short ones.

    Examples
    --------
    >>> import meshtrace as mt
    >>> from meshtrace.surfaces import FlatSea
    >>> o = mt.optimize(mt.Link(), FlatSea(), {"transmitter.half_angle_deg": (3.0, 30.0)},
    ...                 objective="gain", realizations=1, photons=256)
    >>> o.notes[0]
    'transmitter.half_angle_deg is at the bound 3'
    """
    run.setdefault("photons", DEFAULT_CHAINS)
    # quantiles feel the short waves that make light fade; means hardly do
    fading = realizations > 1 and objective in FADES
    campaign = campaign_of(link, surface, "optimize", run, fading=fading, several=False)
    campaign.require_chains()  # before candidates are evaluated
    flight = campaign.flight(flight)
    electronics = electronics_of(campaign, ook, bit_rate)
    if electronics is None and objective in ("outage", "range", "margin", "capacity"):
        raise Refused("ook", None, f"a transmission, for {objective}")
    if electronics is not None:
        campaign = campaign.for_link(electronics.channel(campaign.link))
    day = None if electronics is None else light_of(campaign, None)
    start = Variant(campaign.link, None, electronics, day, flight and flight.uav)
    lights = Lights(campaign)
    goal = Goal(objective, quantile, lights, limit)
    variables, ends = _variables(campaign, start, bounds)
    draw = partial(Sample, realizations=realizations, hover_std=hover_std, flight=flight)
    search = _Search(campaign, goal, start, variables, ends, draw)
    with campaign.workers():
        optimum = search.optimum(tuple(constraints), method)
    if electronics is None or objective == "gain":
        return optimum
    background = lights.text(search.variant(optimum.values))
    return replace(optimum, notes=(*optimum.notes, f"background light: {background}"))


def _variables(
    campaign: Campaign, start: Variant, ranges: Bounds | None
) -> tuple[list[Parameter], Floats]:
    """Return the variables and their bounds (n, 2)."""
    if not ranges:
        raise Refused("bounds", ranges, "a table of names and bounds (low, high)")
    bounds = np.array(list(checked_bounds(ranges).values()))
    variables = parameters(start, list(ranges), None, campaign.meshing.normals, "bounds")
    for p, pair in zip(variables, bounds, strict=True):
        for end in pair.tolist():
            p.at(start, end)
    return variables, bounds


class _Search:
    """Search for the best candidate; all candidates share the sample that `draw` makes."""

    def __init__(
        self, campaign: Campaign, goal: Goal, start: Variant, variables: list[Parameter],
        bounds: Floats, draw: Callable[..., Sample],
    ) -> None:  # fmt: skip
        self.campaign, self.goal, self.start, self._draw = campaign, goal, start, draw
        self.variables, self.bounds = variables, bounds
        names, link = [p.name for p in variables], campaign.link
        self._log = np.array([not p.absolute for p in variables]) & (bounds[:, 0] > 0.0)
        self._widest = float(bounds[names.index(_FOV), 1]) if _FOV in names else None
        # values of these keys weigh the arrivals of one run again, without new light
        self._reweighed = tuple(name for name in REWEIGHED if name in names)
        # arrivals have an angle and a direction of emission: neither another cut nor more lamps
        if link.physics.fov != "angle" or isinstance(link.transmitter, tuple):
            self._reweighed = ()
        if link.direction == "down":  # facets are as wide as the spot of a lamp in the air
            self._reweighed = tuple(name for name in self._reweighed if name == _FOV)
        self._sample = self._new_sample(campaign.run.seed)
        self._history: dict[tuple[float, ...], Floats] = {}
        # a start outside of the bounds begins at their nearest point
        self._start = np.clip([p.base for p in variables], *bounds.T)

    def _new_sample(self, seed: int) -> Sample:
        link, run = self.campaign.link, self.campaign.run.replace(seed=seed)
        # a narrower view only cuts light off, so that the widest one serves all candidates
        if self._widest is not None:
            link = link.replace(_FOV, self._widest)
        return self._draw(self.campaign.for_link(link)._replace(run=run), reweighed=self._reweighed)

    def _values(self, x: Floats) -> Floats:
        """Return the variables of a point of the unit cube."""
        low, high = self.bounds.T
        x = np.clip(x, 0.0, 1.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            # the logarithm of a range that ends at 0 is no number; such a range is linear
            logs = low * (high / low) ** x
        return np.where(self._log, logs, low + x * (high - low))

    def _place(self, values: Floats) -> Floats:
        """Return the point of the unit cube of variables."""
        low, high = self.bounds.T
        with np.errstate(divide="ignore", invalid="ignore"):
            logs = np.log(values / low) / np.log(high / low)
        return np.where(self._log, logs, (values - low) / (high - low))

    def variant(self, values: Floats) -> Variant:
        """Return the candidate with values of the variables."""
        return self.start.at(zip(self.variables, values.tolist(), strict=True))

    def _costs(self, values: Floats, sample: Sample | None = None) -> Floats:
        """Return the costs of a candidate: of all gains, and of the groups of the jackknife."""
        return self.goal.costs(self.variant(values), sample or self._sample)

    def _cost(self, x: Any) -> float:
        """Return the cost of a point of the unit cube, kept in the history."""
        values = self._values(np.atleast_1d(np.asarray(x, dtype=float)))
        key = tuple(values.tolist())
        # scipy asks for some points again, and each costs gains over all seas
        if key not in self._history:
            self._history[key] = self._costs(values)
            self.campaign.advance()
        return float(self._history[key][0])

    def optimum(self, constraints: tuple[Constraint, ...], method: str) -> Optimum:
        """Return the best candidate with its flatness and validation."""
        n = len(self.variables)
        if method == "auto":
            method = "bounded" if n == 1 and not constraints else "cobyqa"
            method = "global" if n > _MOST else method
        # scipy's bounded search knows neither
        if method == "bounded" and (n > 1 or constraints):
            allowed = "cobyqa or global, for several variables or constraints"
            raise Refused("method", method, allowed)
        if method == "cobyqa" and n > _MOST:
            raise Refused("method", method, f"global, for more than {_MOST} variables")
        # the start is a candidate whatever the search tries, so that the best is never worse
        self._cost(self._place(self._start))
        getattr(self, f"_{method}")(constraints)
        # COBYQA and the start may leave candidates that break a constraint in the history
        feasible = {k: v for k, v in self._history.items()
                    if all(g(self.variant(np.array(k))) >= -1e-9 for g in constraints)}  # fmt: skip
        if not feasible:
            raise Refused("constraints", "no candidate", "constraints that some candidate meets")
        best, costs = min(feasible.items(), key=lambda item: float(item[1][0]))
        return self._result(np.array(best), float(costs[0]), error_of(costs))

    def _bounded(self, constraints: Any) -> None:
        """Search one variable: a grid, then the interval around its best point."""
        from scipy.optimize import minimize_scalar

        # a bounded search sees one minimum; the grid says in which interval the lowest one lies
        grid = np.linspace(0.0, 1.0, _GRID)
        best = int(np.argmin([self._cost(x) for x in grid]))
        ends = float(grid[max(best - 1, 0)]), float(grid[min(best + 1, _GRID - 1)])
        minimize_scalar(self._cost, bounds=ends, method="bounded", options={"xatol": _FINEST})

    def _cobyqa(self, constraints: tuple[Constraint, ...]) -> None:
        """Search several variables with constraints, without derivatives."""
        from scipy.optimize import Bounds, minimize

        n = len(self.variables)
        limits = [{"type": "ineq", "fun": lambda x, g=g: g(self.variant(self._values(x)))}
                  for g in constraints]  # fmt: skip
        options = {"initial_tr_radius": 0.25, "final_tr_radius": _FINEST, "maxfev": 40 + 25 * n}
        minimize(
            self._cost, self._place(self._start), method="COBYQA", options=options,
            bounds=Bounds(np.zeros(n), np.ones(n)), constraints=limits,
        )  # fmt: skip

    def _global(self, constraints: tuple[Constraint, ...]) -> None:
        """Search by differential evolution; candidates that break a constraint are not run."""
        from scipy.optimize import differential_evolution

        def cost(x: Floats) -> float:
            at = self.variant(self._values(x))
            broken = sum(max(-float(g(at)), 0.0) for g in constraints)
            # above any cost, and less the nearer the constraints are: evolution finds the way back
            return 1e9 * (1.0 + broken) if broken else self._cost(x)

        differential_evolution(
            cost, [(0.0, 1.0)] * len(self.variables), seed=self.campaign.run.seed,
            polish=False, popsize=6, maxiter=20,
        )  # fmt: skip

    def _flat(self, best: Floats, cost: float, stderr: float) -> Floats:
        """Return the interval of each variable with costs within one standard error (n, 2)."""
        # all candidates share their samples: costs are smooth, and halving finds where they cross
        x0 = self._place(best)
        ends = np.empty((len(best), 2))
        for i in range(len(best)):
            for side in (0, 1):
                inside, outside = float(x0[i]), float(side)
                at = x0.copy()
                at[i] = outside
                if self._cost(at) <= cost + stderr:
                    inside = outside
                for _ in range(_HALVINGS if inside != outside else 0):
                    at[i] = 0.5 * (inside + outside)
                    if self._cost(at) <= cost + stderr:
                        inside = float(at[i])
                    else:
                        outside = float(at[i])
                at[i] = inside
                ends[i, side] = self._values(at)[i]
        return ends

    def _result(self, best: Floats, cost: float, stderr: float) -> Optimum:
        """Return the optimum with its validation on fresh seeds."""
        campaign, goal, at = self.campaign, self.goal, self.variant(best)
        tried = dict(self._history)  # those of the flat intervals come later
        flatness = self._flat(best, cost, stderr)
        # the best of many candidates is best by luck, too: only new samples tell its true gain
        fresh = self._new_sample((campaign.run.seed + _FRESH) % 2**64)
        notes, new, old = [], self._costs(best, fresh), self._costs(self._start, fresh)
        difference, error = float(old[0] - new[0]), error_of(old - new)
        improved = bool(difference > 2.0 * error) if error > 0.0 else difference > 0.0
        new_quantity = goal.quantity(at, float(new[0]), fresh)
        old_quantity = goal.quantity(self.variant(self._start), float(old[0]), fresh)
        # an optimum at a bound says that the bound, not the physics, has chosen
        for p, place, ends in zip(self.variables, self._place(best), self.bounds, strict=True):
            for side, end in enumerate(ends):
                if abs(place - side) < _AT_BOUND:
                    notes.append(f"{p.name} is at the bound {end:g}")
        if not improved:
            notes.append("no improvement found")
        # the outage of a sample is a step function: the error of its smooth cost stands for it
        error_of_value = goal.error(cost, stderr)
        value = goal.quantity(at, cost, self._sample)
        return Optimum(
            objective=goal.name,
            value=value,
            stderr=stderr if math.isnan(error_of_value) else error_of_value,
            cost=cost,
            variables=tuple(p.name for p in self.variables),
            values=best,
            start=self._start,
            bounds=self.bounds,
            flatness=flatness,
            candidates=np.array(list(tried)),
            costs=np.array([costs[0] for costs in tried.values()]),
            validation=Validation(new_quantity, old_quantity, difference, error, improved),
            notes=tuple(notes),
            provenance=campaign.provenance() | {"best": at.link.model_dump(mode="json")},
        )
