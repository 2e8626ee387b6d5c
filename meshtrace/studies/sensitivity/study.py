"""Derivatives of the gain, the error rate, the outage, the range and the margin of a link."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, NamedTuple, Unpack

import numpy as np

from meshtrace.comms.ook import OokLink, Preset
from meshtrace.daylight.light import Daylight
from meshtrace.engine.parts import Light
from meshtrace.engine.setup.options import StudyOptions
from meshtrace.errors import (
    Described,
    Refused,
    require_between,
    require_keys,
    require_pair,
    require_whole,
)
from meshtrace.link import Link
from meshtrace.mesh import MeshSource, SeededSurface, TriangleMesh
from meshtrace.models import Floats
from meshtrace.scenario import Scenario
from meshtrace.stored import SHIFTS
from meshtrace.studies.background import Lights, electronics_of, light_of
from meshtrace.studies.campaign import Campaign, campaign_of
from meshtrace.studies.keys import Parameter, Variant, parameters
from meshtrace.studies.neighbours import (
    Neighbours,
    covariance_of,
    error_of,
    has_moments,
    moments,
)
from meshtrace.studies.response import MOST_SEAS, Responses
from meshtrace.studies.sensitivity.quantity import FADES, Of, Quantity
from meshtrace.studies.sensitivity.result import DECIBELS, Row, Sensitivities, Table
from meshtrace.uav import Flight, Uav, h_alpha

DEFAULT_CHAINS = 8192
"""Chains of a study of sensitivities."""

_TILTS, _TILTS_OF_ONE = 50, 2000  # of the aircraft over each sea
_DIRECT = 1e-3  # step at which exact derivatives of the gain act on other quantities
_DOUBT = 3.0  # standard errors by which two steps may differ
_BEND = 2e-3  # of the elasticity, by which they may differ as the square of the step
_KEPT = 4  # meshes of the base sea that stay in memory
_WINDOW = 0.5  # half-width of the window at the edge of the field of view, over its half-angle
_EDGE_STEP = 0.01  # relative, of the field of view, for unscattered light


def sensitivities(
    link: Link | Scenario,
    surface: MeshSource | TriangleMesh | None = None,
    wrt: Sequence[str] | None = None,
    of: Of = "gain",
    *,
    realizations: int = 1,
    ook: OokLink | Preset | None = "physical",
    step: float | None = None,
    limit: float = 1e-3,
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
    of : {"gain", "ber", "outage", "range", "margin", "capacity"}
        Quantity. "range" is the depth at which the error rate, averaged over the seas, meets
        `limit`; with `ook=None` it is the depth of the link, at a fixed gain.
    realizations : int
        Seas; 1 is the sea as it is, more have their own phases.
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
        Options of the run, see `StudyOptions`: 8192 chains by default, progress by parameter.

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
    By a and b in uniform water the derivative is a moment of the arrivals, with K scatterings
    and the path L in the water,

        E_a = -a <L>,    E_b = <K> - b <L>;

    by the field of view it is the light that arrives at its edge: of unscattered light exactly, of
    scattered light by a window of half the half-angle, with a kernel of fourth order (the few
    arrivals between two views of nearly the same width, and so the difference of their gains, are
    mostly noise); otherwise a central difference over links that share chains, mesh and every
    choice of the estimator:

        E_p = [ln q(p e^s) - ln q(p e^-s)] / (2 s).

    Standard errors are jackknives over the 32 shifts of the chains and over the seas. Differences
    are repeated over thrice the step; `suspicious` marks those that disagree by more than three
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
    require_whole(realizations, 1, 100_000, "realizations")
    fading = realizations > 1 and of in FADES and (of != "range" or ook is not None)
    campaign = campaign_of(
        link, surface, "sensitivities", fading, several=False, chains=DEFAULT_CHAINS, **run
    )
    if realizations > 1 and not isinstance(campaign.surface, SeededSurface):
        kind = getattr(campaign.surface, "kind", type(campaign.surface).__name__)
        raise Refused("realizations", realizations, f"1 over a surface of kind {kind}")
    require_between(limit, 0.0, 0.5, "limit")
    quantity = Quantity(of, limit)
    normals = campaign.meshing.normals
    electronics = None if of == "gain" else electronics_of(campaign, ook, bit_rate)
    if electronics is None and of not in ("gain", "range"):
        raise Refused("ook", None, f"a transmission, for {of}")
    variant = Variant(campaign.link, campaign.surface)
    if electronics is not None:
        variant = with_all_parts(campaign, electronics)
    names = parameters(variant, wrt, step, normals)
    default = {p.name: p.step for p in parameters(variant, [p.name for p in names], None, normals)}
    if of == "range" and variant.detector is not None:
        variant = _at_range(variant, campaign, realizations, quantity)
        names = parameters(variant, [p.name for p in names], step, normals)
    asked = [p.name for p in names]
    depth = _depth_key(variant.link)
    if of == "range" and depth not in asked:
        names += parameters(variant, [depth], None, normals)
    study = Study(variant, campaign, realizations, quantity, default)
    with np.errstate(divide="ignore"), campaign.workers():
        found = [study.derivatives(p, campaign.progress) for p in names]
    return replace(_result(study, found, asked), light=study.lights.text(variant))


def with_all_parts(campaign: Campaign, electronics: OokLink) -> Variant:
    """Return the start of a study with the transmission, daylight and aircraft of a scenario."""
    scenario, link = campaign.scenario, electronics.channel(campaign.link)
    day = light_of(campaign, None)
    return Variant(link, campaign.surface, electronics, day, getattr(scenario, "uav", None))


def _first(link: Link) -> str:
    """Return the key of the first receiver."""
    return "receiver.0" if isinstance(link.receiver, tuple) else "receiver"


def _depth_key(link: Link) -> str:
    """Return the key of the depth of the end in the water."""
    return "receiver.depth" if link.direction == "down" else "transmitter.depth"


def _at_range(
    variant: Variant, campaign: Campaign, realizations: int, quantity: Quantity
) -> Variant:
    """Return the variant at the depth of an error rate equal to the limit."""
    depth = variant.link.depth
    for _ in range(12):
        study = Study(variant, campaign, realizations, quantity, {}, f" at {depth!r} m")
        p = parameters(variant, [_depth_key(campaign.link)], None, campaign.meshing.normals)[0]
        excess = study.log(study.gains("search", variant), variant)
        rate = study.derivatives(p, None).rates[0]
        # ln gain is nearly linear in the depth and its logarithm together
        new = depth * (1.0 + max(min(-excess / rate, 1.0), -0.5))
        done = abs(new - depth) < 1e-3 * depth
        depth = new
        variant = variant._replace(link=variant.link.at_depth(depth))
        if done:
            return variant
    raise Refused(_depth_key(campaign.link), Described("no range found"), "a link with a range")


def edge_over(near: Neighbours, name: str, i: int) -> Floats:
    """Return dh / d ln fov over realization i by shift, shape (shifts,).

    Unscattered light is integrated up to the edge, so that its difference over 1 % of the field of
    view, whose key is `name`, has no noise; scattered light is that within a window about the edge.
    """
    link = near.campaign.link
    fov = link.receivers[0].fov_deg
    views = [min(fov * math.exp(side * _EDGE_STEP), 180.0) for side in (-1.0, 1.0)]
    low, high = (near.unscattered(link.replace(name, view), i)[0] for view in views)
    wide = link.replace(name, min((1.0 + _WINDOW) * fov, 180.0))
    change = edge_of_view(near.light(wide, i)[0], 0.5 * fov)
    return change + (high - low) / math.log(views[1] / views[0])


def edge_of_view(light: Light, half_deg: float) -> Floats:
    r"""Return dh / d ln fov of scattered light by shift, half_deg the half-angle.

    The light per angle at the edge is that within a window of half-width s half_deg, s = 1/2,
    of a kernel of fourth order, whose bias grows as :math:`s^4`:

    .. math:: K(x) = \tfrac{15}{32} (1 - x^2) (3 - 7 x^2), \quad
        \int K \, dx = 1, \quad \int x^2 K \, dx = 0
    """
    off = (np.degrees(light.angle) / half_deg - 1.0) / _WINDOW
    square = np.minimum(off**2, 1.0)
    window = 15.0 / 32.0 * (1.0 - square) * (3.0 - 7.0 * square) / _WINDOW
    return light.by_shift(np.where(light.shift >= 0, window, 0.0))


class _Rates(NamedTuple):
    """Logarithmic derivatives of a quantity by one parameter.

    `rates` holds that of all gains, those without each shift, and those without each sea; `bias`
    belongs to the error.
    """

    parameter: Parameter
    rates: Floats
    second: float
    method: str
    suspicious: bool
    notes: str
    bias: float = 0.0


@dataclass(eq=False)
class Study:
    """Evaluation of a quantity and its derivatives."""

    variant: Variant
    campaign: Campaign
    realizations: int
    quantity: Quantity
    steps: dict[str, float]  # usual ones, by parameter
    where: str = ""

    def __post_init__(self) -> None:
        self.campaign, several = self.campaign.of(self.variant.link), self.realizations > 1
        self.near = Neighbours(
            self.campaign, self.realizations, phases=several, fading=several, kept=_KEPT
        )
        self.lights = Lights(self.campaign)
        self._other_rays = Lights(self.campaign, self.campaign.run.seed + 1)
        self.responses = Responses(self._light, self.variant, common=True)

    @cached_property
    def _winds(self) -> Floats:
        """Return the winds at the aircraft, shape (seas, tilts, 3)."""
        seas = self.near.seas
        tilts = _TILTS if seas > 1 else _TILTS_OF_ONE
        wind = self.campaign.wind_of(Flight())
        return wind.sample_wind(seas * tilts, self.campaign.run.seed).reshape(seas, tilts, 3)

    def _tilt(self, variant: Variant) -> Floats | None:
        """Return the tilt factors of an aircraft that carries the receiver, shape (seas, tilts)."""
        if variant.uav is None or variant.link.direction == "down":
            return None
        fov = math.radians(variant.link.receivers[0].fov_deg)
        return h_alpha(variant.uav.tilt(self._winds).angle, fov)

    def _light(self, at: Variant) -> list[Light]:
        """Return the light of a variant over some seas.

        Of another field of view that of a wider one, cut off by a soft edge.
        """
        link, base, near = at.link, self.variant.link, self.near
        sea = None if at.sea is self.variant.sea else at.sea
        fov, angle = link.receivers[0].fov_deg, link.physics.fov == "angle"
        soft = angle and fov != base.receivers[0].fov_deg
        if soft:
            wide = min((1.0 + _WINDOW) * fov, 180.0)
            link = link.replace(f"{_first(link)}.fov_deg", wide)
        found = [near.light(link, i, sea)[0] for i in range(min(near.seas, MOST_SEAS))]
        if not soft:
            return found
        half, lights = math.radians(0.5 * fov), []
        for light in found:
            inside = np.clip((1.0 - light.angle / half) / _WINDOW, -1.0, 1.0)
            share = 0.5 + 0.25 * inside * (3.0 - inside**2)
            lights.append(light._replace(weight=light.weight * share))
        return lights

    def logs(self, gains: Floats, variant: Variant) -> Floats:
        """Return the logarithms of the quantity, see `Quantity.logs`, under the light of day."""
        lit = self.lights.lit(self.responses.behind(variant))
        return self.quantity.logs(gains, lit, self._tilt(variant))

    def log(self, gains: Floats, variant: Variant, other: bool = False) -> float:
        """Return the first of `logs`, or its value by other rays and a third of the chains."""
        lights = self._other_rays if other else self.lights
        lit = lights.lit(self.responses.behind(variant, other))
        return self.quantity.log(gains, lit, self._tilt(variant))

    def gains(self, name: str, *variants: Variant) -> Floats:
        """Return the gains of variants over all seas, shape (variants * seas, shifts)."""
        base, near = self.variant.sea, self.near
        if all(one.sea is base and one.link == self.variant.link for one in variants):
            if name != "base":  # keys that change no light
                return np.concatenate([self.base] * len(variants))
        inputs = [(one.link, None if one.sea is base else one.sea) for one in variants]

        def of_first(i: int) -> Floats:
            link, surface = inputs[i // near.seas]
            return near.gains(link, i % near.seas, surface)[0]

        return self._over(of_first, len(inputs), name)

    def _over(self, evaluate: Callable[[int], Floats], variants: int, name: str) -> Floats:
        steps = variants * self.near.seas
        return self.near.over(evaluate, steps, f"{name}{self.where}", variants=variants)

    @cached_property
    def base(self) -> Floats:
        """Gains of the base, shape (seas, shifts)."""
        return self.gains("base", self.variant)

    @cached_property
    def _moments(self) -> Floats:
        """Return dh / d ln a and dh / d ln b, shape (2, seas, shifts)."""
        near, link = self.near, self.variant.link

        def both(i: int) -> Floats:
            found = moments(link, near.light(link, i)[0])
            return np.array([found["water.a"], found["water.b"]])

        return self._over(both, 1, "moments").swapaxes(0, 1)

    def derivatives(self, p: Parameter, progress: Callable[[int], None] | None) -> _Rates:
        """Return the derivatives by a parameter."""
        link = self.variant.link
        if p.name in ("water.a", "water.b") and has_moments(link):
            gains = self._moments[int(p.name == "water.b")]
            found = self._exactly(p, gains, "moment")
        elif p.name == f"{_first(link)}.fov_deg" and link.physics.fov == "angle":
            gains = self._over(partial(edge_over, self.near, p.name), 1, p.name)
            found = self._exactly(p, gains, "angle")
        else:
            found = self._differences(p)
        if progress is not None:
            progress(1)
        return found

    def _exactly(self, p: Parameter, change: Floats, method: str) -> _Rates:
        """Return the derivatives of the quantity by the chain rule, from dh (seas, shifts)."""
        base, variant = self.base, self.variant
        sides = [p.at(variant, p.shifted(side * _DIRECT / p.step)) for side in (-1.0, 1.0)]
        gains = base - _DIRECT * change, base + _DIRECT * change
        found, bias = self._rates(gains, sides, _DIRECT)
        return _Rates(p, found, math.nan, method, False, "", bias)

    def _rates(
        self, gains: Iterable[Floats], sides: list[Variant], step: float
    ) -> tuple[Floats, float]:
        """Return the derivative of the logarithm: of all, without each shift, without each sea.

        `gains` are those (seas, shifts) at a step to either side of the base. The second number is
        the error by the rays of a background that changes with the key, and by the response of the
        channel, from other rays and a part of the chains.
        """
        pairs = list(zip(gains, sides, strict=True))
        low, high = (self.logs(*pair) for pair in pairs)
        found, seen = (high - low) / (2.0 * step), [self.lights.background(s) for s in sides]
        same = sides[0].detector is None or seen[0] is seen[1]
        if same and not any(map(self.responses.spreads, sides)):
            return found, 0.0
        other = [self.log(*pair, other=True) for pair in pairs]
        off = (other[1] - other[0]) / (2.0 * step) - float(found[0])
        return found, abs(off) / math.sqrt(2.0)

    def _differences(self, p: Parameter) -> _Rates:
        """Return central differences over a step, compared with differences over a longer step."""
        variant = self.variant
        factors = [1.0, self._longer(p)]
        sides = []
        for factor in factors:
            try:
                sides += [p.at(variant, p.shifted(side * factor)) for side in (-1.0, 1.0)]
            except Refused:  # the longer step leaves the range
                break
        name = f"{p.name} {p.step!r}"
        gains = self.gains(name, *sides).reshape(-1, self.near.seas, SHIFTS)
        found, biases = [], []
        for k in range(0, len(gains), 2):
            step = factors[k // 2] * p.step
            rates, bias = self._rates(gains[k : k + 2], sides[k : k + 2], step)
            found.append(rates)
            biases.append(bias)
        suspicious, notes = self._compared(found, math.hypot(*biases))
        if p.origin:
            notes = f"relative to {p.name} - {p.origin:g}" + (f"; {notes}" if notes else "")
        second = self._second(p, gains, sides)
        return _Rates(p, found[0], second, "difference", suspicious, notes, biases[0])

    def _longer(self, p: Parameter) -> float:
        """Return the steps of a repeated difference: thrice, and at least thrice the usual one.

        A small step sees none of the discontinuities that rare chains carry.
        """
        return 3.0 * max(1.0, self.steps.get(p.name, p.step) / p.step)

    def _compared(self, found: list[Floats], by_rays: float) -> tuple[bool, str]:
        """Return the disagreement of the derivatives over two steps, if any."""
        if len(found) < 2:
            return False, "one step: the longer one leaves the range"
        off = found[1] - found[0]
        error = math.hypot(error_of(off), by_rays)
        bend = _BEND * max(abs(float(found[1][0])), 1.0)
        if abs(off[0]) <= math.hypot(_DOUBT * error, bend):
            return False, ""
        longer = f"{found[1][0]:.5g} +- {error_of(found[1]):.1g} over the longer step"
        return True, longer

    def _second(self, p: Parameter, gains: Floats, sides: list[Variant]) -> float:
        """Return the second derivative of the quantity over itself, for offsets and angles."""
        if not p.absolute:
            return math.nan
        k = 2 if len(gains) > 2 else 0
        steps = p.step * (self._longer(p) if k else 1.0)
        pairs = (gains[k], sides[k]), (self.base, self.variant), (gains[k + 1], sides[k + 1])
        low, mid, high = (self.log(*pair) for pair in pairs)
        if self.quantity.of in ("margin", "range"):
            return (high - 2.0 * mid + low) / steps**2
        return (math.exp(high - mid) - 2.0 + math.exp(low - mid)) / steps**2


def _result(study: Study, found: list[_Rates], asked: list[str]) -> Sensitivities:
    """Return the table of the derivatives."""
    quantity, variant, campaign = study.quantity, study.variant, study.campaign
    logs = study.logs(study.base, variant)
    value, stderr = quantity.value(float(logs[0])), error_of(logs)
    if study.responses.spreads(variant):
        off = study.log(study.base, variant, other=True) - float(logs[0])
        stderr = math.hypot(stderr, off / math.sqrt(2.0))
    rates, biases = np.array([one.rates for one in found]), np.array([one.bias for one in found])
    if quantity.of == "range":
        # at a fixed need: dR / R = -(d ln q / d ln p) / (d ln q / d ln d)
        depth = _depth_key(variant.link)
        deeper = rates[[one.parameter.name for one in found].index(depth)]
        value = variant.link.depth
        stderr = abs(value * error_of(logs / deeper[0]))
        rates = np.where([[one.parameter.name == depth] for one in found], rates, -rates / deeper)
        biases = np.where([one.parameter.name == depth for one in found], 0.0, biases / deeper[0])
        found = [one._replace(second=-one.second / deeper[0]) for one in found]
    else:
        stderr *= abs(quantity.slope(value))
    kept = [i for i, one in enumerate(found) if one.parameter.name in asked]
    covariance = covariance_of(rates[kept]) + np.diag(biases[kept] ** 2)
    errors = np.sqrt(np.diag(covariance))
    pairs = [
        _row(found[i], float(rates[i, 0]), float(error), quantity, value)
        for i, error in zip(kept, errors, strict=True)
    ]
    rows, factors = zip(*pairs, strict=True)
    covariance *= np.outer(factors, factors)
    origin = campaign.provenance(variant.link)
    origin |= {"of": quantity.of, "limit": quantity.limit, "realizations": study.near.seas}
    parts: dict[str, Any] = {"ook": variant.detector, "daylight": variant.daylight}
    parts["uav"] = variant.uav
    origin |= {name: part and part.model_dump(mode="json") for name, part in parts.items()}
    return Sensitivities(quantity.of, value, stderr, quantity.unit, Table(rows), covariance, origin)


def _row(
    one: _Rates, rate: float, error: float, quantity: Quantity, value: float
) -> tuple[Row, float]:
    """Return the row of a parameter, and its logarithmic derivative over the rate."""
    p = one.parameter
    relative = rate / p.scale
    factor = p.base if p.absolute and p.base != 0.0 else 1.0
    elasticity = math.nan if p.absolute and p.base == 0.0 else rate * factor
    slope = value if quantity.of == "range" else quantity.slope(value)
    elastic = elasticity, abs(factor) * error, relative
    derived = slope * relative, abs(slope / p.scale) * error, one.second
    notes = one.method, one.suspicious, one.notes
    return Row(p.name, p.base, p.unit, *elastic, *derived, *notes), factor


class Swing(NamedTuple):
    """Change of a quantity at a lower and a higher value of a parameter.

    Attributes
    ----------
    name, unit : str
        Parameter and its unit.
    values : (float, float)
        The two values.
    change, stderr : (float, float)
        Change of the quantity [dB, or m for "range"] and its standard error.
    """

    name: str
    unit: str
    values: tuple[float, float]
    change: tuple[float, float]
    stderr: tuple[float, float]


def swings(
    s: Sensitivities, change: float | Mapping[str, tuple[float, float]] = 0.1
) -> list[Swing]:
    """Return the changes of the quantity of a study over given intervals of its parameters.

    Parameters
    ----------
    s : Sensitivities
        Its link, sea, chains and quantity are used again.
    change : float or mapping of str to (low, high)
        Relative change of all parameters to either side, or the values of some. Offsets and
        angles change by `change` times depth plus height, and `change` times 10 deg.

    Returns
    -------
    list of Swing
        The largest first.

    Notes
    -----
    Each end is a run, not a product of derivatives. For "range" the depth follows the change of
    the light by the derivative by the depth, and a second run at the new depth corrects it.

    Raises
    ------
    Refused
        If a parameter is not in the table, or the study was one over a mesh.
    """
    if not isinstance(s, Sensitivities):
        raise Refused("s", Described(type(s).__name__), "Sensitivities")
    swing = _Swings(s)
    names = [row.name for row in s.table]
    if isinstance(change, Mapping):
        require_keys(change, names)
        ends = {
            name: require_pair(pair, f"change.{name}", "(low, high)")
            for name, pair in change.items()
        }
    else:
        change = require_between(change, 0.0, 1.0, "change")
        ends = {name: swing.ends(name, change) for name in names}
    found = []
    for name, pair in ends.items():
        (low, low_error), (high, high_error) = (swing.change(name, end) for end in pair)
        unit = s.table[name].unit
        found.append(Swing(name, unit, pair, (low, high), (low_error, high_error)))
    return sorted(found, key=lambda one: -max(map(abs, one.change)))


class _Swings:
    """Study of a result, set up again."""

    def __init__(self, s: Sensitivities) -> None:
        origin: dict[str, Any] = s.provenance
        scenario = Scenario.from_provenance(origin)
        kinds: dict[str, Any] = {"ook": OokLink, "daylight": Daylight, "uav": Uav}
        parts = (origin[name] and kind.model_validate(origin[name]) for name, kind in kinds.items())
        variant = Variant(scenario.link, scenario.surface, *parts)
        inputs: Any = scenario.surface, scenario.run, scenario.meshing
        campaign = Campaign({"link": scenario.link}, *inputs)
        self._quantity = Quantity(s.of, origin["limit"])  # type: ignore[arg-type]
        self._study = Study(variant, campaign, origin["realizations"], self._quantity, {})
        self._base = self._logs(variant)
        names = [row.name for row in s.table]
        found = parameters(variant, names, None, scenario.meshing.normals)
        self._parameters = {p.name: p for p in found}
        self._rate = 0.0
        if s.of == "range":
            depth = [_depth_key(scenario.link)]
            p = parameters(variant, depth, None, scenario.meshing.normals)[0]
            sides = [self._logs(p.at(variant, p.shifted(k)))[0] for k in (-1.0, 1.0)]
            self._rate = (sides[1] - sides[0]) / (2.0 * p.step * p.base)

    def _logs(self, variant: Variant) -> Any:
        """Return the logarithm of the quantity: of all gains, and of the groups."""
        return self._study.logs(self._study.gains("gains", variant), variant)

    def ends(self, name: str, change: float) -> tuple[float, float]:
        """Return the two values of a parameter."""
        p = self._parameters[name]
        if p.absolute:
            far = change * p.step / (0.01 if p.unit == "m" else 0.1)
            return p.base - far, p.base + far
        return p.origin + p.scale * (1.0 - change), p.origin + p.scale * (1.0 + change)

    def change(self, name: str, value: float) -> tuple[float, float]:
        """Return the change of the quantity at a value of a parameter, and its error."""
        variant = self._parameters[name].at(self._study.variant, value)
        off = self._logs(variant) - self._base
        if self._quantity.of != "range":
            return DECIBELS * float(off[0]), DECIBELS * error_of(off)
        moved = -off / self._rate
        depth = variant.link.depth + float(moved[0])
        there = variant._replace(link=variant.link.at_depth(depth))
        rest = self._logs(there) - self._base
        moved = moved[0] - rest / self._rate
        return float(moved[0]), error_of(moved)
