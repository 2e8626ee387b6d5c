"""Sensitivities: derivatives of a link's quantities by its parameters, with common chains.

Symbols: q quantity, p parameter, h gain of the link. Logarithmic derivatives are d ln q / d ln p,
or d ln q / dp of an offset or an angle, whose base may be 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property, partial
from typing import Annotated, Any, NamedTuple, Unpack

import numpy as np
from pydantic import Field

from meshtrace.checks import ErrorRate, check_call
from meshtrace.comms.ook import OokLink, Preset
from meshtrace.daylight.light import Daylight
from meshtrace.engine.parts import Light
from meshtrace.engine.setup.options import StudyOptions
from meshtrace.errors import Refused
from meshtrace.link import Link
from meshtrace.mesh import MeshSource, SeededSurface, TriangleMesh
from meshtrace.models import Floats
from meshtrace.scenario import Scenario
from meshtrace.stored import SHIFTS
from meshtrace.studies.background import Lights, electronics_of, light_of
from meshtrace.studies.campaign import Campaign, campaign_of
from meshtrace.studies.derivatives import Row, Sensitivities, Table
from meshtrace.studies.keys import Parameter, Variant, parameters
from meshtrace.studies.neighbours import (
    FADES,
    WATER,
    WINDOW,
    WINDOWS,
    Neighbours,
    Quantity,
    QuantityName,
    covariance_of,
    depth_key,
    edge_over,
    error_of,
    has_moments,
    moments,
    range_of,
    resolving_window,
)
from meshtrace.studies.response import MOST_SEAS, Responses
from meshtrace.uav import Flight, TiltFactors, Uav

DEFAULT_CHAINS = 8192
"""Chains of a study of sensitivities."""

_GAIN_STEP = 1e-3  # step in ln p over which a known dh / d ln p moves the gain: q is linear over it
_SUSPICIOUS = 3.0  # standard errors by which derivatives over two steps may differ
# Shifts compared first, and the standard errors up to which they show nothing; tuned. Their error
# is twice that of all, so that what all would show as _SUSPICIOUS is here beyond 1.5 of them.
_COMPARED, _CLEAR = 8, 1.0
_CURVATURE = 2e-3  # tuned: relative difference of the two that the curvature of q explains
MODELS: dict[str, Any] = {"ook": OokLink, "daylight": Daylight, "uav": Uav}  # beside link and sea
_HALF = 2  # places in `WINDOWS` from one to that of half its width: they shrink by sqrt(2)
_MESHES = 4  # of the base sea in memory; tuned: memory against making them again


@check_call
def sensitivities(
    link: Link | Scenario,
    surface: MeshSource | TriangleMesh | None = None,
    wrt: Sequence[str] | None = None,
    quantity: QuantityName = "gain",
    *,
    realizations: Annotated[int, Field(ge=1, le=100_000)] = 1,
    ook: OokLink | Preset | None = "physical",
    step: float | None = None,
    limit: ErrorRate = 1e-3,
    bit_rate: float | None = None,
    **run: Unpack[StudyOptions],
) -> Sensitivities:
    """Return the derivatives of a quantity of a link by its parameters.

    Parameters
    ----------
    link : Link or Scenario
        The link; of several receivers the first counts. A scenario also gives the sea and, unless
        `ook` is another one, the electronics.
    surface : MeshSource or TriangleMesh, optional
        The surface, by default as for `simulate`.
    wrt : sequence of str, optional
        Parameters by their keys in a link file, such as "water.a" and "receiver.position.0"; by
        default all continuous ones. Those are keys of the link, and of the sea if its band does
        not follow them, and by their names also those of detector, daylight and aircraft, such as
        "detector.optics.filter_width_nm", for all but the gain. "wind_speed" changes sea, whitecaps
        and bubbles together; "sea.wind_speed", "whitecaps.wind_speed" and "bubbles.wind_speed"
        are the parts.
    quantity : {"gain", "ber", "outage", "range", "margin", "capacity"}
        "range" is the depth at which the error rate, averaged over the seas, meets
        `limit`; with `ook=None` it is the depth of the link, at a fixed gain.
    realizations : int
        Number of seas: 1 is the sea as it is, several have random phases each.
    ook : OokLink or {"physical", "paper", "paper-ranges"}, optional
        Transmission, for all but the gain.
    step : float, optional
        Step of the differences, relative or in the unit of an offset or an angle; by default 1 %.
        That of a radius is 10 %, of an offset 1 % of depth plus height, of an angle 1 deg.
    limit : float
        Largest bit error rate of a working link.
    bit_rate : float, optional
        Bit rate R_b [bit s-1], by default that of the transmission.
    **run
        Options of the run, see `StudyOptions`: 8192 chains by default; progress counts parameters.

    Returns
    -------
    Sensitivities

    Raises
    ------
    Refused
        If a name is unknown or not continuous, the waves of the sea would change with a
        parameter, or forced detection does not follow the link.

    Notes
    -----
    The derivative by a or b of uniform water is a moment of the arrivals, with K scatterings and
    the path length L in the water,

        E_a = -a <L>,    E_b = <K> - b <L>;

    that by the field of view is the light that arrives at its edge: exact for unscattered light;
    for scattered light by a window with a kernel of fourth order, the widest one up to half of the
    half-angle that agrees with all narrower ones (the few arrivals between two views of nearly the
    same width, and so the difference of their gains, are mostly noise); any other is a central
    difference over links that share chains, mesh and every choice of the estimator:

        E_p = [ln q(p e^s) - ln q(p e^-s)] / (2 s).

    Standard errors are jackknives over the 32 shifts of the chains and over the seas. Differences
    are repeated over thrice the step, with a quarter of the chains and, if these differ by more
    than a standard error, with all; `suspicious` marks those that disagree by more than three
    standard errors (a discontinuity that rare chains carry). Chains of a deeper source are
    stretched with the depth. Over seas without random slopes the crossings of neighbours are
    searched on facets near those of the base, with the digits of the search of every facet. Light
    that the surface reflects back is not included. Under the daylight of a scenario each link has
    its own background, with common rays, over a sea of random slopes that has the mean of all seas;
    where it changes, other rays give its error. The aircraft
    of a scenario tilts the receiver as in `link_performance`, for all but the gain. Unless
    `waves` of the meshing says otherwise, meshes hold all waves that make the light fade for the
    error rate, the outage, the range and the capacity over several seas; gain and margin are means
    and need none of the short ones.

    For all but the gain each link has the response of the channel from its own chains, over up to
    four seas: that of the given link at other bit rates, with a soft edge at other fields of view,
    with pulses of the same delays everywhere. That of a third of the chains gives its error. It is
    left out where its rms delay spread is less than a ten-thousandth of a bit.

    Examples
    --------
    >>> import meshtrace as mt
    >>> from meshtrace.surfaces import FlatSea
    >>> s = mt.sensitivities(mt.Link(), FlatSea(), wrt=["water.a", "water.b"], photons=1024)
    >>> [round(row.elasticity, 2) for row in s.table]
    [-1.14, -0.08]
    """
    # short waves make the light fade: distributions over the seas need them, means do not. A range
    # without a transmission is that of a mean gain
    fading = realizations > 1 and quantity in FADES and (quantity != "range" or ook is not None)
    campaign = campaign_of(
        link, surface, "sensitivities", run, fading=fading, several=False, chains=DEFAULT_CHAINS
    )
    campaign.require_chains()  # before the search of a range
    if realizations > 1 and not isinstance(campaign.surface, SeededSurface):
        kind = getattr(campaign.surface, "kind", type(campaign.surface).__name__)
        raise Refused("realizations", realizations, f"1 over a surface of kind {kind}")
    estimated = Quantity(quantity, limit)
    normals = campaign.meshing.normals
    electronics = None if quantity == "gain" else electronics_of(campaign, ook, bit_rate)
    if electronics is None and quantity not in ("gain", "range"):
        raise Refused("ook", None, f"a transmission, for {quantity}")
    variant = Variant(campaign.link, campaign.surface)
    if electronics is not None:
        uav = getattr(campaign.scenario, "uav", None)
        channel = electronics.channel(campaign.link)
        variant = Variant(channel, campaign.surface, electronics, light_of(campaign, None), uav)
    # names are checked here: the search of the range takes long
    wanted = parameters(variant, wrt, step, normals)
    if quantity == "range" and variant.detector is not None:
        variant = _at_range(variant, campaign, realizations, estimated)
        # bases and steps are those at the range
        wanted = parameters(variant, [p.name for p in wanted], step, normals)
    asked = [p.name for p in wanted]
    depth = depth_key(variant.link)
    # every derivative of the range is over that by the depth, see `_of_range`
    if quantity == "range" and depth not in asked:
        wanted += parameters(variant, [depth], None, normals)
    study = Study(variant, campaign, realizations, estimated)
    derivatives = []
    with campaign.workers():
        for p in wanted:
            derivatives.append(study.derivatives(p))
            campaign.advance()
    return replace(_result(study, derivatives, asked), background_light=study.lights.text(variant))


def _first_receiver(link: Link) -> str:
    """Return the key of the first receiver."""
    return "receiver.0" if isinstance(link.receiver, tuple) else "receiver"


def _at_range(
    variant: Variant, campaign: Campaign, realizations: int, quantity: Quantity
) -> Variant:
    """Return the variant at the depth where its error rate meets the limit."""

    def reserve(depth: float) -> float:  # ln of the light over the need
        there = variant._replace(link=variant.link.at_depth(depth))
        study = Study(there, campaign, realizations, quantity, f" at {depth!r} m")
        return study.log(study.base, there)

    # a last step of Newton: what is left of the reserve, over its fall with the depth [m-1]
    depth, left, fall = range_of(reserve, variant.link)
    return variant._replace(link=variant.link.at_depth(depth + left / fall))


class _Derivative(NamedTuple):
    """Derivative d ln q / d ln p by one parameter; d ln q / dp where its steps are absolute.

    `rates`, shape (1 + shifts + seas,), holds that of all gains, those without each shift and those
    without each of several seas, for the jackknife (`covariance_of`); `bias` is a standard error
    that these do not show. `second`, `method`, `suspicious` and `notes` are those of a `Row`.
    """

    parameter: Parameter
    rates: Floats
    bias: float
    second: float
    method: str
    suspicious: bool = False
    notes: str = ""


class Study:
    """Evaluation of a quantity and its derivatives.

    Parameters
    ----------
    variant : Variant
        The base, at which derivatives are taken.
    campaign : Campaign
        Sea and options.
    realizations : int
        Number of seas; 1 is the sea as it is.
    quantity : Quantity
        The quantity.
    where : str
        Ending of the names of its loops in a store, where no two studies may have the same.
    """

    def __init__(
        self, variant: Variant, campaign: Campaign, realizations: int, quantity: Quantity,
        where: str = "",
    ) -> None:  # fmt: skip
        self.variant, self.quantity, self.where = variant, quantity, where
        self.campaign, several = campaign.for_link(variant.link), realizations > 1
        # several seas have phases of their own, and chains that serve an ensemble
        self.near = Neighbours(
            self.campaign, realizations, phases=several, fading=several, meshes_kept=_MESHES
        )
        self.lights = Lights(self.campaign)
        self._other_rays = Lights(self.campaign, self.campaign.run.seed + 1)
        self.responses = Responses(self._light, variant, aligned=True)

    def _tilt(self, variant: Variant) -> TiltFactors | None:
        """Return the law of the tilt factor of an aircraft that carries the receiver, if any."""
        if variant.uav is None or variant.link.direction == "down":
            return None
        return self.campaign.tilt_factors(Flight(variant.uav), variant.link.receivers[0].fov_deg)

    def _light(self, at: Variant) -> list[Light]:
        """Return the arrivals of a variant over up to four seas, for the response of its channel.

        At another field of view than that of the base they are those of a wider one, faded out
        across the edge.
        """
        link, base, near = at.link, self.variant.link.receivers[0], self.near
        sea = None if at.sea is self.variant.sea else at.sea
        fov = link.receivers[0].fov_deg
        soft_edge = link.physics.fov == "angle" and fov != base.fov_deg
        if soft_edge:
            wide = min((1.0 + WINDOW) * fov, 180.0)
            link = link.replace(f"{_first_receiver(link)}.fov_deg", wide)
        # [0]: the first receiver
        arrivals = [near.arrivals(link, i, sea)[0] for i in range(min(near.seas, MOST_SEAS))]
        if not soft_edge:
            return arrivals
        # a hard edge would let single arrivals in and out of the response as the field of view
        # changes
        half_angle, faded = math.radians(0.5 * fov), []
        for arrival in arrivals:
            # smooth cubic step: 1 inside, 0 outside, 1/2 at the edge, whose integral over the angle
            # is that of a hard edge; x runs from 1 to -1 over half_angle * (1 -+ WINDOW)
            x = np.clip((1.0 - arrival.angle / half_angle) / WINDOW, -1.0, 1.0)
            share = 0.5 + 0.25 * x * (3.0 - x**2)
            faded.append(arrival._replace(weight=arrival.weight * share))
        return faded

    def logs(self, gains: Floats, variant: Variant) -> Floats:
        """Return the jackknife values of ln q under the daylight, see `Quantity.logs`."""
        # the electronics behind the response of the channel, with the counts of the background
        exposed = self.lights.exposed(self.responses.behind(variant))
        return self.quantity.logs(gains, exposed, self._tilt(variant))

    def log(self, gains: Floats, variant: Variant, other: bool = False) -> float:
        """Return ln q of all gains, the first of `logs`.

        With `other` the background is that of other rays and the response that of a third of the
        chains, for the error that they cause.
        """
        lights = self._other_rays if other else self.lights
        exposed = lights.exposed(self.responses.behind(variant, other))
        return self.quantity.log(gains, exposed, self._tilt(variant))

    def logs_of(self, variant: Variant) -> Floats:
        """Return the jackknife values of ln q of a variant, with its gains."""
        return self.logs(self.gains("gains", variant), variant)

    def gains(self, name: str, *variants: Variant, shifts: int = SHIFTS) -> Floats:
        """Return the gains of variants over all seas, shape (variants * seas, shifts).

        `name` is that of the loop in a store; "base" computes those of `base`. `shifts` is the
        number of shifts, the first of all.
        """
        base_sea, near = self.variant.sea, self.near
        same = (v.sea is base_sea and v.link == self.variant.link for v in variants)
        # keys of electronics or daylight leave the gains as they are
        if all(same) and name != "base":
            return np.concatenate([self.base[:, :shifts]] * len(variants))
        inputs = [
            (variant.link, None if variant.sea is base_sea else variant.sea) for variant in variants
        ]

        def first_receiver_gains(i: int) -> Floats:
            link, surface = inputs[i // near.seas]
            return near.frozen.gains(link, near.mesh(i % near.seas, surface), shifts)[0]

        return self._evaluate(first_receiver_gains, len(inputs), name, (shifts,))

    def _evaluate(
        self, evaluate: Callable[[int], Floats], variants: int, name: str, shape: tuple[int, ...]
    ) -> Floats:
        """Return the numbers of each step, from the store where it has them.

        Shape (variants * seas, *shape): variant by variant and, within one, sea by sea.
        """
        identity = {"seas": self.near.seas, "variants": variants}
        steps, name = range(variants * self.near.seas), f"{name}{self.where}"
        campaign = self.near.campaign
        # nothing to set up, and the same shape at each step
        results = campaign.evaluate(lambda: evaluate, steps, name, identity, lambda step: shape)
        return np.array(list(results))

    @cached_property
    def base(self) -> Floats:
        """Gains of the base, shape (seas, shifts)."""
        return self.gains("base", self.variant)

    @cached_property
    def _moments(self) -> Floats:
        """Return dh / d ln a and dh / d ln b by the score function, shape (2, seas, shifts)."""
        near, link = self.near, self.variant.link

        def score_moments(i: int) -> Floats:
            return moments(link, near.arrivals(link, i)[0])

        return self._evaluate(score_moments, 1, "moments", (2, SHIFTS)).swapaxes(0, 1)

    def derivatives(self, p: Parameter) -> _Derivative:
        """Estimate the derivative by a parameter with the estimator of least noise.

        The score function for a parameter that enters only the weights of paths, the light at the
        edge for the field of view, otherwise differences with common random numbers.
        """
        link = self.variant.link
        if p.name in WATER and has_moments(link):
            return self._by_chain_rule(p, self._moments[WATER.index(p.name)], "moment")
        if p.name == f"{_first_receiver(link)}.fov_deg" and link.physics.fov == "angle":
            return self._by_view_edge(p)
        return self._by_differences(p)

    def _by_view_edge(self, p: Parameter) -> _Derivative:
        """Return the derivative by the field of view, from the light at its edge.

        Its change with a window of half the width is taken as the bias.
        """
        # shape (seas, 3, windows, shifts), see `edge_over`; [:, 0] are the derivatives dh / d ln p
        shape = 3, len(WINDOWS), SHIFTS
        edges = self._evaluate(partial(edge_over, self.near, p.name), 1, p.name, shape)
        k, resolved = resolving_window(edges)
        derivative = self._by_chain_rule(p, edges[:, 0, k], "angle")
        narrow = self._by_chain_rule(p, edges[:, 0, min(k + _HALF, len(WINDOWS) - 1)], "angle")
        bias = math.hypot(derivative.bias, float(narrow.rates[0] - derivative.rates[0]))
        notes = "" if resolved else "light at the edge varies within the narrowest window"
        return derivative._replace(bias=bias, suspicious=not resolved, notes=notes)

    def _by_chain_rule(self, p: Parameter, change: Floats, method: str) -> _Derivative:
        """Convert the derivative of the gain to the derivative of the quantity.

        d ln q / d ln p = (d ln q / dh) (dh / d ln p), with d ln q / dh by a difference over gains
        that move by so little that q is linear there. `change` is dh / d ln p (seas, shifts).
        """
        pairs = []
        for side in (-1.0, 1.0):
            # the parameter itself moves, too: daylight and electronics may depend on it
            at = p.at(self.variant, p.shifted(side * _GAIN_STEP / p.step))
            pairs.append((self.base + side * _GAIN_STEP * change, at))
        return _Derivative(p, *self._log_derivative(pairs, _GAIN_STEP), math.nan, method)

    def _log_derivative(
        self, pairs: list[tuple[Floats, Variant]], step: float
    ) -> tuple[Floats, float]:
        """Return the `rates` and the `bias` of a `_Derivative` by a central difference.

        `pairs` are gains (seas, shifts) and variant, a step below and a step above the base. The
        bias is the error that the rays of the background and the response of the channel cause
        where they change with the key, estimated by other rays and a third of the chains.
        """
        low, high = (self.logs(*pair) for pair in pairs)
        rates, sides = (high - low) / (2.0 * step), [variant for _, variant in pairs]
        backgrounds = [self.lights.background(variant) for variant in sides]
        # one background for both cancels in the difference, with its error
        same = sides[0].detector is None or backgrounds[0] is backgrounds[1]
        if same and not any(map(self.responses.spreads, sides)):
            return rates, 0.0
        other_low, other_high = (self.log(*pair, other=True) for pair in pairs)
        off = (other_high - other_low) / (2.0 * step) - float(rates[0])
        # two independent estimates differ by sqrt(2) times the error of each
        return rates, abs(off) / math.sqrt(2.0)

    def _by_differences(self, p: Parameter) -> _Derivative:
        """Return the derivative by a central difference, compared with one over a longer step.

        That is thrice the step, and at least thrice the usual one: a small step sees none of the
        discontinuities that rare chains carry.
        """
        pairs = self._pairs(p, 1.0)
        rates, bias = self._log_derivative(pairs, p.step)
        factor, step, shifts = 3.0 * max(1.0, p.usual / p.step), p.step, SHIFTS
        suspicious, notes = False, "one step: the longer one leaves the range"
        if all(p.allows(self.variant, side * factor) for side in (-1.0, 1.0)):
            step *= factor
            # where a part of the chains shows nothing over the longer step, the others need not be
            # followed there
            for shifts, most in ((_COMPARED, _CLEAR), (SHIFTS, _SUSPICIOUS)):
                few = [(gains[:, :shifts], variant) for gains, variant in pairs]
                pairs_there = self._pairs(p, factor, shifts)
                suspicious, notes = self._compared((few, p.step), (pairs_there, step), most)
                if not suspicious:
                    break
            pairs = pairs_there
        if p.origin:
            notes = f"relative to {p.name} - {p.origin:g}" + (f"; {notes}" if notes else "")
        second = self._second(pairs, step) if p.absolute else math.nan
        return _Derivative(p, rates, bias, second, "difference", suspicious, notes)

    def _pairs(
        self, p: Parameter, factor: float, shifts: int = SHIFTS
    ) -> list[tuple[Floats, Variant]]:
        """Return gains (seas, shifts) and variant some steps below and above the base."""
        sides = [p.at(self.variant, p.shifted(side * factor)) for side in (-1.0, 1.0)]
        # one loop for both: a store has one entry for each step and number of chains
        gains = self.gains(f"{p.name} {factor * p.step!r} {shifts}", *sides, shifts=shifts)
        return list(zip(gains.reshape(-1, self.near.seas, shifts), sides, strict=True))

    def _second(self, pairs: list[tuple[Floats, Variant]], step: float) -> float:
        """Return (d^2 q / dp^2) / q by the second difference over a step."""
        shifts = pairs[0][0].shape[-1]
        places = pairs[0], (self.base[:, :shifts], self.variant), pairs[1]
        low, mid, high = (self.log(*pair) for pair in places)
        # a margin and the reserve of a range are logarithms themselves
        if self.quantity.name in ("margin", "range"):
            return (high - 2.0 * mid + low) / step**2
        return (math.exp(high - mid) - 2.0 + math.exp(low - mid)) / step**2

    def _compared(
        self,
        short: tuple[list[tuple[Floats, Variant]], float],
        longer: tuple[list[tuple[Floats, Variant]], float],
        most: float,
    ) -> tuple[bool, str]:
        """Return whether derivatives over two steps differ by `most` errors, and a note about it.

        `short` and `longer` are the arguments of `_log_derivative`, with the same shifts.
        """
        (near, near_bias), (far, bias) = (self._log_derivative(*at) for at in (short, longer))
        shifts = longer[0][0][0].shape[-1]
        off = far - near
        error = math.hypot(error_of(off, shifts), near_bias, bias)
        # the error of a central difference grows as the square of its step, 9 times over thrice of
        # it: up to this much the curvature of q explains
        curvature = _CURVATURE * max(abs(float(far[0])), 1.0)
        if abs(off[0]) <= math.hypot(most * error, curvature):
            return False, ""
        return True, f"{far[0]:.5g} +- {error_of(far, shifts):.1g} over the longer step"


def _result(study: Study, derivatives: list[_Derivative], names: list[str]) -> Sensitivities:
    """Return the quantity and the table of its derivatives by the parameters of these names."""
    quantity, variant, campaign = study.quantity, study.variant, study.campaign
    logs = study.logs(study.base, variant)
    value, stderr = quantity.value(float(logs[0])), error_of(logs)  # the error is that of ln q
    if study.responses.spreads(variant):
        # the error by the response of the channel, as in `Study._log_derivative`
        off = study.log(study.base, variant, other=True) - float(logs[0])
        stderr = math.hypot(stderr, off / math.sqrt(2.0))
    if quantity.name == "range":
        depth = depth_key(variant.link)
        (by_depth,) = (d for d in derivatives if d.parameter.name == depth)
        value = variant.link.depth
        # dR / R = -(d ln q) / (d ln q / d ln depth), with q the light over the need
        stderr = abs(value * error_of(logs / by_depth.rates[0]))
        derivatives = [_of_range(derivative, by_depth) for derivative in derivatives]
    else:
        stderr *= abs(quantity.slope(value))
    derivatives = [d for d in derivatives if d.parameter.name in names]
    covariance = covariance_of(np.array([d.rates for d in derivatives]))
    covariance += np.diag([d.bias**2 for d in derivatives])
    # d quantity / d ln q; R of a range, whose derivatives are those of ln R by now
    slope = value if quantity.name == "range" else quantity.slope(value)
    factors = np.array([_elasticity_factor(d.parameter) for d in derivatives])
    errors = np.sqrt(np.diag(covariance)).tolist()
    table = Table(_row(d, error, slope) for d, error in zip(derivatives, errors, strict=True))
    provenance = campaign.provenance(variant.link)
    provenance |= {
        "quantity": quantity.name,
        "limit": quantity.limit,
        "realizations": study.near.seas,
    }
    for name, part in zip(MODELS, variant[2:], strict=True):
        provenance[name] = part and part.model_dump(mode="json")  # None of a part that is missing
    covariance *= np.outer(factors, factors)
    return Sensitivities(quantity.name, value, stderr, quantity.unit, table, covariance, provenance)


def _of_range(derivative: _Derivative, by_depth: _Derivative) -> _Derivative:
    """Convert the derivative of q, received over required light at range R, to that of R.

    The range is the depth d at which ln q(p, d) = 0: by the implicit function theorem
    d ln R / d ln p = -(d ln q / d ln p) / (d ln q / d ln d).
    """
    deeper = by_depth.rates
    if derivative is by_depth:  # the row of the depth is that of q itself, without a bias
        return derivative._replace(bias=0.0, second=-derivative.second / deeper[0])
    return derivative._replace(
        rates=-derivative.rates / deeper,
        bias=derivative.bias / deeper[0],
        second=-derivative.second / deeper[0],
    )


def _elasticity_factor(p: Parameter) -> float:
    """Return the factor from d ln q per step of p to d ln q / d ln p; 1 at a base of 0."""
    return p.base if p.absolute and p.base != 0.0 else 1.0


def _row(derivative: _Derivative, error: float, slope: float) -> Row:
    """Return the row of a derivative with its error; `slope` is d quantity / d ln q."""
    p, rate = derivative.parameter, float(derivative.rates[0])
    factor, relative = _elasticity_factor(p), rate / p.scale
    no_elasticity = p.absolute and p.base == 0.0
    return Row(
        name=p.name, base=p.base, unit=p.unit,
        elasticity=math.nan if no_elasticity else rate * factor, stderr=abs(factor) * error,
        relative=relative,
        derivative=slope * relative, derivative_stderr=abs(slope / p.scale) * error,
        second=derivative.second, method=derivative.method,
        suspicious=derivative.suspicious, notes=derivative.notes,
    )  # fmt: skip
