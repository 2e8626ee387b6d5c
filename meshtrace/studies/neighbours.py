"""Links near one link over the same seas with the same chains; their quantities with errors."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from functools import cache, cached_property, partial
from typing import Any, Literal

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq
from scipy.special import ndtr

from meshtrace.comms.budget import required_gain
from meshtrace.comms.capacity import capacity
from meshtrace.comms.ook import OokLink
from meshtrace.engine.correlated import FrozenForced
from meshtrace.engine.forced import MANY_SEAS, TypicalSea
from meshtrace.engine.parts import Light
from meshtrace.engine.setup.ends import crossing_reach
from meshtrace.engine.setup.meshing import FADING_SPACING, GAIN_SPACING, mesh_lines
from meshtrace.errors import Described, Refused
from meshtrace.fading.laws import probability_in_log
from meshtrace.kernels.random import realization_seed
from meshtrace.link import Link
from meshtrace.mesh import MeshSource, TriangleMesh
from meshtrace.models import Floats
from meshtrace.optics.water import Water
from meshtrace.stored import SHIFTS
from meshtrace.studies.campaign import Campaign
from meshtrace.studies.cluster import Restored
from meshtrace.uav import TiltFactors

QuantityName = Literal["gain", "ber", "outage", "range", "margin", "capacity"]

FADES = ("ber", "outage", "range", "capacity")
"""Quantities that depend on the distribution of the gain over seas."""

WATER = "water.a", "water.b"
"""Keys of uniform water, by which the score function gives derivatives."""

DECIBELS = 10.0 / math.log(10.0)
"""Decibels of a factor e."""

WINDOW = 0.5
"""Half-width of the widest window at the edge of the field of view, over its half-angle."""

WINDOWS = WINDOW * 2.0 ** (-0.5 * np.arange(9))
"""Half-widths of all windows."""

_EDGE_STEP = 0.01  # relative, of the field of view, for unscattered light
_NODES = 60  # of the table of the information of a bit
_POINTS = 200  # of the table of error rates
_OPEN = 0.4  # error rate about whose power the points lie where no power reaches the limit
_NEAR = 0.01  # |ln(light / need)| below which it is linear in the depth
_LEAST_FALL = 1e-3  # of a reserve over the depth [m-1], against noise of either sign
_LEAST_OUTAGES = 30
_LEAST_ARRIVALS = 100.0  # effective ones in a window
_AGREE = 2.0  # standard errors by which two windows may differ
_LEAST_SEAS = 8
_WIDER = 1.2  # reach of meshes over that of a link: its neighbours lie within
_FEW, _MANY = 8, 32  # surfaces of which facets and Embree scenes are kept, some 50 MiB each


class Neighbours(Restored):
    """Gains and light of links near one link over the same surfaces.

    Parameters
    ----------
    campaign : Campaign
        The base link, its surface and options; a surface that is a mesh is taken as it is.
        Progress is left to the study.
    seas : int
        Surfaces.
    phases : bool
        Whether each surface has phases of its own.
    fading : bool
        Whether meshes and chains are those of an ensemble.
    meshes_kept : int
        Meshes of the first surfaces that stay in memory.
    around : Link, optional
        The link that all meshes cover, by default the base link.
    """

    def __init__(
        self, campaign: Campaign, seas: int = 1, phases: bool = False, fading: bool = False,
        meshes_kept: int = 1, around: Link | None = None,
    ) -> None:  # fmt: skip
        self.campaign = campaign = campaign._replace(progress=None)
        self.seas, self.phases, self.fading, self.meshes_kept = seas, phases, fading, meshes_kept
        self.inputs = campaign.alone, seas, phases, fading, meshes_kept, around
        self._around = around or campaign.link
        self._lines: dict[str, Any] = {}
        if isinstance(campaign.surface, MeshSource):
            inputs = self._around, campaign.surface, campaign.meshing
            spacing = FADING_SPACING if fading else GAIN_SPACING
            self._lines = mesh_lines(*inputs, _WIDER * crossing_reach(self._around), spacing)
        self._meshes: list[TriangleMesh] = []
        self._meshes = [self.mesh(i) for i in range(min(seas, meshes_kept))]

    @cached_property
    def frozen(self) -> FrozenForced:
        """Chains of the base link."""
        campaign = self.campaign
        return FrozenForced(
            campaign.link,
            campaign.run.photons,
            campaign.run.seed,
            TypicalSea.of_meshes(self._meshes, MANY_SEAS if self.fading else 1.0),
            campaign.meshing.normals,
            # of more meshes than fit, in turn, none of the last is met again
            recent=max(self.meshes_kept, _FEW) if self.meshes_kept <= _MANY else _FEW,
        )

    def mesh(self, i: int, surface: Any = None) -> TriangleMesh:
        """Return the mesh of realization i of the base surface, or of a neighbouring surface."""
        if surface is None and i < len(self._meshes):
            return self._meshes[i]
        campaign = self.campaign
        made: Any = campaign.surface if surface is None else surface
        if self.phases:
            made = made.with_seed(realization_seed(campaign.run.seed, i))
        return campaign.mesh([self._around], made, campaign.meshing.time, self._lines)

    def arrivals(self, link: Link, i: int, surface: Any = None) -> list[Light]:
        """Return the rows of light at each receiver over realization i."""
        return self.frozen.arrivals(link, self.mesh(i, surface))


def has_moments(link: Link) -> bool:
    """Return whether a and b enter the weights of paths alone, as b^K exp(-(a + b) L)."""
    plain = link.bubbles is None and link.water.layers is None
    return plain and link.physics.absorption != "paper"


def moments(link: Link, arrivals: Light) -> Floats:
    """Return dh / d ln a and dh / d ln b by the score function, shape (2, shifts).

    The likelihood-ratio estimator of dh / dp is E[w d ln f / dp]. The weight of a path with K
    scatterings and the length L in the water has the factor f = b^K exp(-(a + b) L), so that

        d ln f / d ln a = -a L,    d ln f / d ln b = K - b L
    """
    length = arrivals.by_shift(arrivals.water)
    scatterings = arrivals.by_shift(arrivals.order.astype(float))
    return np.array([-link.water.a * length, scatterings - link.water.b * length])


def in_water(arrivals: Light, old: Water, new: Water) -> Light:
    """Reweight the arrivals of uniform water to another water.

    The likelihood ratio of a path is w' / w = (b' / b)^K exp(-(c' - c) L).
    """
    ratio = np.exp((old.c - new.c) * arrivals.water)
    if new.b != old.b:
        ratio *= (new.b / max(old.b, 1e-300)) ** arrivals.order
    return arrivals._replace(weight=arrivals.weight * ratio)


def edge_over(near: Neighbours, name: str, i: int) -> Floats:
    r"""Return dh / d ln fov over realization i by window and shift, with sums of its arrivals.

    Shape (3, windows, shifts): the derivative, and sums of the sizes and of the squares of the
    arrivals that it weighs.

    Unscattered light is integrated up to the edge, so that its difference over 1 % of the field of
    view, whose key is `name`, has no noise. Scattered light per angle at the edge is that within a
    window of half-width s times the half-angle, of a kernel of fourth order, whose bias grows as
    :math:`s^4` where the light is smooth over it:

    .. math:: K(x) = \tfrac{15}{32} (1 - x^2) (3 - 7 x^2), \quad
        \int K \, dx = 1, \quad \int x^2 K \, dx = 0
    """
    link = near.campaign.link
    fov = link.receivers[0].fov_deg
    # at 180 deg the step is one-sided, which the logarithms below take into account
    views = [min(fov * math.exp(side * _EDGE_STEP), 180.0) for side in (-1.0, 1.0)]
    frozen, mesh = near.frozen, near.mesh(i)
    low, high = (frozen.unscattered(link.replace(name, view), mesh)[0] for view in views)
    # all arrivals that any window weighs
    wide = frozen.arrivals(link.replace(name, min((1.0 + WINDOW) * fov, 180.0)), mesh)[0]
    # distance from the edge, over the half-angle
    off = np.degrees(wide.angle) / (0.5 * fov) - 1.0
    rates = np.empty((3, len(WINDOWS), SHIFTS))
    for k, width in enumerate(WINDOWS.tolist()):
        square = np.minimum((off / width) ** 2, 1.0)
        window = 15.0 / 32.0 * (1.0 - square) * (3.0 - 7.0 * square) / width
        window[wide.shift < 0] = 0.0  # unscattered
        rates[0, k] = wide.by_shift(window)
        rates[1, k] = wide.by_shift(np.abs(window))
        rates[2, k] = wide.by_shift(wide.weight * window**2)
    # the same for all windows: unscattered light has no noise to weigh against bias
    rates[0] += (high - low) / math.log(views[1] / views[0])
    return rates


def resolving_window(rates: Floats) -> tuple[int, bool]:
    """Return the widest window that agrees with all narrower ones, and whether any two do.

    Lepski's choice: bias shows as a difference from narrower windows beyond its error. Windows that
    rest on too few arrivals decide nothing.

    Parameters
    ----------
    rates : ndarray, shape (seas, 3, windows, shifts)
        Rows of `edge_over` over several realizations.

    References
    ----------
    Lepskii, O. V. (1991), Theory Probab. Appl. 35, 454, doi:10.1137/1135065.
    """
    change, (size, square) = rates[:, 0], rates[:, 1:].sum(axis=(0, 3))
    # effective number of arrivals, (sum |w|)^2 / sum w^2
    known = np.flatnonzero(size**2 >= _LEAST_ARRIVALS * square)
    last = int(known.max(initial=0))
    for k in range(last):
        for narrow in range(k + 1, last + 1):
            off = [group.mean() for group in without_each(change[:, k] - change[:, narrow])]
            if abs(off[0]) > _AGREE * error_of(np.array(off)):
                break
        else:
            return k, True
    return last, False


def without_each(gains: Floats) -> Iterator[Floats]:
    """Yield the samples of a delete-one jackknife of gains (seas, ..., shifts).

    All gains, then those without each shift, then those without each of several seas.
    """
    yield gains
    for i in range(gains.shape[-1]):
        yield np.delete(gains, i, axis=-1)
    if len(gains) > 1:
        for i in range(len(gains)):
            yield np.delete(gains, i, axis=0)


def error_of(values: Floats, shifts: int = SHIFTS) -> float:
    """Return the jackknife error of values[0], from values of `without_each` (1 + groups,)."""
    return math.sqrt(covariance_of(values[None], shifts)[0, 0])


def covariance_of(values: Floats, shifts: int = SHIFTS) -> Floats:
    """Return the jackknife covariance (n, n) of values[:, 0], from values (n, 1 + groups).

    var = (m - 1) / m sum_i (v_i - mean v)^2 over the m shifts, and the same over the seas
    """
    total = np.zeros((len(values), len(values)))
    for groups in (values[:, 1 : 1 + shifts], values[:, 1 + shifts :]):
        m = groups.shape[1]
        if m > 1:
            off = groups - groups.mean(axis=1, keepdims=True)
            # shifts and seas are independent sources of error: their variances add
            total += (m - 1) / m * off @ off.T
    return total


def closing_depth(
    reserve: Callable[[float], tuple[float, float]],
    known: tuple[float, float],
    depth: float,
    steps: int = 12,
    far: float = math.inf,
) -> tuple[float, float, float]:
    """Return the depth at which a reserve vanishes, the reserve there and its fall over the depth.

    By the secant method, as the reserve falls about as the depth; nan where no depth is found.

    Parameters
    ----------
    reserve : callable
        Returns the reserve at a depth [m], and the largest one that counts as none.
    known : (float, float)
        Another depth [m] and its reserve.
    depth : float
        First depth to try [m].
    steps : int
        Depths to try, at most.
    far : float
        What may be missing at the surface, by the fall found, lest the search ends.
    """
    before, above = known
    for _ in range(steps):
        (here, near), fall = reserve(depth), _LEAST_FALL
        if depth != before:
            fall = max((above - here) / (depth - before), fall)
        if abs(here) < near:
            return depth, here, fall
        if here + fall * depth < -far:
            break
        before, above = depth, here
        # a noisy reserve may send the secant anywhere
        depth = float(np.clip(depth + here / fall, 0.3 * depth, 3.0 * depth))
    return math.nan, math.nan, math.nan


def depth_key(link: Link) -> str:
    """Return the key of the depth of the end in the water."""
    return "receiver.depth" if link.direction == "down" else "transmitter.depth"


def range_of(reserve: Callable[[float], float], link: Link) -> tuple[float, float, float]:
    """Search the range of a link: a depth near it [m], the reserve there and its fall [m-1].

    `reserve` returns the logarithm of the light over the need at a depth.
    """
    above = reserve(link.depth)
    # towards the range, by a step over which the reserve is nearly linear
    first = link.depth * (1.1 if above > 0.0 else 0.9)
    closing = closing_depth(lambda depth: (reserve(depth), _NEAR), (link.depth, above), first)
    if math.isnan(closing[0]):
        raise Refused(depth_key(link), Described("no range found"), "a link with a range")
    return closing


class Quantity:
    """A quantity of a link over seas.

    Parameters
    ----------
    name : {"gain", "ber", "outage", "range", "margin", "capacity"}
        Mean gain; bit error rate averaged over the seas; probability that the bit error rate of a
        sea misses the limit; depth at which the averaged rate meets it, or else at which the mean
        gain is that of the link; mean over required gain; rate after hard decisions, averaged
        over the seas (`comms.capacity`).
    limit : float
        Bit error rate of a working link.

    Notes
    -----
    `log` is the natural logarithm of the quantity; for "range" that of the factor by which the
    light exceeds the need, whose zero is the range. `need(ook)` is the gain of a working link,
    `information(ook)` the information of a bit [bit] and `law(ook)` the logarithm of the bit error
    rate, both functions of the logarithm of the power; they are tabulated once for each
    transmission.
    """

    def __init__(self, name: QuantityName, limit: float) -> None:
        self.name, self.limit = name, limit
        self.need = cache(partial(required_gain, ber=limit))
        self.information = cache(_information)
        self.law = cache(partial(_law, limit))

    @property
    def unit(self) -> str:
        """Unit of the quantity."""
        return {"range": "m", "margin": "dB", "capacity": "bit s-1"}.get(self.name, "1")

    def log(
        self, gains: Floats, ook: OokLink | None, tilt: TiltFactors | None = None,
        weights: Floats | None = None,
    ) -> float:  # fmt: skip
        """Return the logarithm of the quantity.

        For gains (seas, shifts) with the law of a tilt factor, or for gains (seas, places, shifts)
        with the weights of the places.
        """
        means = gains.mean(axis=-1)
        self._require_light(means.min())

        def mean(values: Floats) -> float:
            return float(np.average(values, axis=-1, weights=weights).mean())

        # a range without a transmission is that of the gain itself
        if self.name == "gain" or ook is None:
            return math.log(mean(means))
        if self.name in ("margin", "outage"):
            self._require(math.isfinite(self.need(ook)))
        if self.name == "outage":
            return self._outage(means.ravel() / self.need(ook), tilt)
        if tilt is not None:
            # h and tilt are independent: each sea counts with each node of the law
            means, weights = means[:, None] * tilt.h, tilt.weight
        if self.name == "margin":
            return math.log(mean(means) / self.need(ook))
        with np.errstate(divide="ignore"):
            # ln 0 of a tilt out of the field of view is -inf, which the tables below clip
            logs = np.log(ook.received_power(means))
        if self.name == "ber":
            return math.log(mean(np.exp(self.law(ook)(logs))))
        if self.name == "capacity":
            return math.log(max(ook.bit_rate * mean(self.information(ook)(logs)), 1e-300))
        # a receiver that saturates has a second crossing at more power: rates that rise again are
        # left out, so that the root is the range
        law, spread = self.law(ook, rising=False), 30.0

        def excess(shift: float) -> float:
            return math.log(mean(np.exp(law(logs + shift))) / self.limit)

        self._require(excess(-spread) > 0.0 > excess(spread))
        return -float(brentq(excess, -spread, spread, xtol=1e-9))

    def _require_light(self, least: float) -> None:
        """Refuse a link without light over a sea."""
        if not least > 0.0:
            raise Refused("link", float(least), "a gain > 0 over each sea")

    def _require(self, reached: bool) -> None:
        """Refuse the limit if no power reaches it."""
        if not reached:
            raise Refused("limit", self.limit, "a bit error rate that some power reaches")

    def logs(
        self, gains: Floats, ook: OokLink | None, tilt: TiltFactors | None = None,
        weights: Floats | None = None,
    ) -> Floats:  # fmt: skip
        """Return the logarithm of the quantity of all gains, then without each jackknife group."""
        groups = without_each(gains)
        if weights is None and (self.name == "gain" or ook is None):
            # a mean alone, without the electronics of `log`: a study asks for thousands
            means = [group.mean(axis=-1) for group in groups]
            self._require_light(min(by_sea.min() for by_sea in means))
            return np.array([math.log(by_sea.mean()) for by_sea in means])
        return np.array([self.log(group, ook, tilt, weights) for group in groups])

    def value(self, log: float) -> float:
        """Return the quantity from its logarithm; for "range" the factor of the light."""
        return DECIBELS * log if self.name == "margin" else math.exp(log)

    def slope(self, value: float) -> float:
        """Return d quantity / d log; for "range" 1."""
        return {"margin": DECIBELS, "range": 1.0}.get(self.name, value)

    def _outage(self, ratios: Floats, tilt: TiltFactors | None) -> float:
        """Return the logarithm of the outage from gains over need by sea.

        With 30 outages at least: smoothed by a normal kernel. Otherwise by a law with the mean and
        the deviation of the logarithms, see `probability_in_log`. Each node of the tilt counts with
        its probability; no light, out of the field of view, is an outage.
        """
        h, weight = (np.ones(1), np.ones(1)) if tilt is None else (tilt.h, tilt.weight)
        # one sea: the law of the tilt alone is exact
        if len(ratios) == 1 and tilt is not None and tilt.law is not None:
            return math.log(max(float(tilt.below(1.0 / ratios)[0]), 1e-300))
        if len(ratios) < _LEAST_SEAS - 1:
            raise Refused("realizations", len(ratios), f">= {_LEAST_SEAS} for outages")
        logs, nonzero = np.log(ratios), h > 0.0
        lower, spread = np.log(h[nonzero]), float(logs.std(ddof=1))
        below = logs[:, None] + lower < 0.0
        if float((below @ weight[nonzero]).sum()) >= _LEAST_OUTAGES:
            # normal reference rule (Silverman 1986, eq. 3.28): a count of few outages has steps,
            # which derivatives do not stand
            width = 1.06 * spread * len(logs) ** -0.2
            share = ndtr(-(logs[:, None] + lower) / width).mean(axis=0)
        else:
            share = probability_in_log(spread)(-(logs.mean() + lower) / max(spread, 1e-12))
        return math.log(max(float(share @ weight[nonzero]) + float(weight[~nonzero].sum()), 1e-300))


def _tabulated(
    powers: Iterable[float], n: int, values: Callable[[Floats], Floats]
) -> Callable[[Floats], Floats] | None:
    """Return a function of ln power, interpolated between n nodes; None for a closed eye.

    The nodes reach from 9 below to 7 above the logarithm of the first finite one of the powers:
    from where the light is lost in the noise to where no error is left.
    """
    middle = next(filter(math.isfinite, powers), math.inf)
    if math.isinf(middle):
        return None
    nodes = math.log(middle) + np.linspace(-9.0, 7.0, n)
    table = PchipInterpolator(nodes, values(nodes))
    return lambda logs: table(np.clip(logs, nodes[0], nodes[-1]))


def _law(limit: float, ook: OokLink, rising: bool = True) -> Callable[[Floats], Floats]:
    """Return ln BER over ln power, tabulated about the power for the limit.

    Without `rising` rates of an overloaded receiver stay at their minimum.
    """

    def log_rates(nodes: Floats) -> Floats:
        rates = np.log(np.maximum(ook.ber(np.exp(nodes)), 1e-300))
        return rates if rising else np.minimum.accumulate(rates)

    powers = (ook.required_power(rate) for rate in (limit, _OPEN))
    table = _tabulated(powers, _POINTS, log_rates)
    return table or (lambda logs: np.full_like(logs, math.log(0.5)))


def _information(ook: OokLink) -> Callable[[Floats], Floats]:
    """Return the information of a bit [bit] over ln power, tabulated."""

    def carried(nodes: Floats) -> Floats:
        gains = np.exp(nodes) / float(ook.received_power(1.0))
        return np.array([capacity(ook, gain).hard / ook.bit_rate for gain in gains])

    return _tabulated([ook.required_power(0.1)], _NODES, carried) or np.zeros_like
