"""Choice of the estimators of the scattered light, receiver by receiver.

Chains that are aimed at the aperture are efficient where a lamp lights much of the surface and
light arrives by small angles; for beams narrower than the spread by random slopes, large angles
and many scatterings joined photons are. Pilots of both over still water decide; those of the
chains also allot their numbers to the orders. A closed estimate says whether light that the
surface reflects first is worth photons of its own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine.chains.aimed import AimedChains
from meshtrace.engine.chains.sets import TURBID, ChainDrawer, Request, poisson_law
from meshtrace.engine.gains import Gains, Method
from meshtrace.engine.setup.arrays import mean_water
from meshtrace.engine.setup.ends import ForcedLink, across, lamp_intensity
from meshtrace.kernels.tally import SCATTERED
from meshtrace.link import Link, WaterReceiver
from meshtrace.link.sources import AirLamp
from meshtrace.models import Floats
from meshtrace.optics.fresnel import fresnel_reflectance
from meshtrace.quadrature import gauss_legendre
from meshtrace.stored import SHIFTS

PILOT = 128
"""Chains of each order in the first pilot."""
# chains that bring light, below which a pilot of as many times the chains replaces it, and pilots
# of an order at most
_PILOT_HITS, _PILOT_GROWTH, _PILOT_STEPS = 4, 4, 3
_FLOOR = 0.2  # share of the chains allotted by the Poisson law alone

PILOT_PHOTONS = 8192
"""Joined photons of a pilot."""

PER_CHAIN, REFLECTED_PER_CHAIN = 8.0, 2.0
"""Joined photons in place of a chain, and for light that the surface reflects first alone."""
ANALOG_PER_CHAIN = 32.0
"""Analog photons in place of a chain: about the time of the joined ones."""
_SHARED_PER_CHAIN = 1.0  # in place of a chain that would serve other wavelengths

_EFFICIENT = 4.0  # relative variance of a chain up to which no other estimator is tried
_COST = 3.0  # time of a chain over that of a joined photon
_TURBID_COST = 2.0  # the same in turbid water, times the scatterings on the way
_ANALOG_COST = 8.0  # time of a chain or joined photon over that of an analog one: 5 to 40
_TAIL = 6.0  # variance of chains and joined photons in long runs over that of pilots: 1 to 14
_HALF = 0.5  # of the light of the photons: chains that see less are not trusted, however sure
_SURE = 10.0  # means over standard errors: that of 100 equal samples
_DOUBT = 3.5  # standard errors by which the pilots may differ: beyond, chains miss light


class Pilot(NamedTuple):
    """Statistics of pilot chains over a flat sea, by receiver and order from 1 on."""

    chains: Floats  # (receivers, orders)
    mean: Floats  # (receivers, orders)
    spread: Floats  # (receivers, orders) standard deviation of one chain

    @classmethod
    def of_orders(cls, table: Floats) -> Pilot:
        """Return the pilot of statistics (orders, 4, receivers), see `pilot_statistics`."""
        chains, mean, spread, _ = table.transpose(1, 2, 0)
        return cls(chains, mean, spread)

    def select(self, receivers: NDArray[np.bool_]) -> Pilot:
        """Select receivers by a mask."""
        return Pilot(*(array[receivers] for array in self))

    def joined(self, power: Floats) -> Pilot:
        """Return the pilot of a receiver in the water from those of its targets, the lamps.

        `power` (targets,) has their shares of the power.
        """
        return Pilot(self.chains[:1], (power @ self.mean)[None], (power @ self.spread)[None])

    def at_wavelengths(self, ratios: Floats, gain: Floats) -> tuple[Pilot, Floats]:
        """Return the pilot and the gain of each receiver at each wavelength, one row each.

        Light of order K goes with the power K of the ratio of the scattering coefficients; the
        attenuation is about the same for all orders.
        """
        orders = self.mean.shape[1]
        power = ratios[:, None, None] ** np.arange(1, orders + 1)
        direct = np.maximum(gain - self.mean.sum(axis=1), 0.0)
        mean, spread = power * self.mean, power * self.spread
        columns = (np.broadcast_to(self.chains, mean.shape), mean, spread)
        # -1 cannot stand for the rows where water that does not scatter leaves no orders
        pilot = Pilot(*(x.reshape(mean.shape[0] * mean.shape[1], orders) for x in columns))
        return pilot, (direct + mean.sum(axis=2)).ravel()


def pilot_statistics(
    drawer: ChainDrawer,
    surfaces: Sequence[ChainDrawer | AimedChains],
    targets: Sequence[int],
    request: Request,
) -> list[Floats]:
    """Return number, mean, deviation and hits of pilot chains of one order, over each surface.

    Of shape (wavelengths, 4, targets); targets that few chains reach get more of them.
    """
    # each surface repeats the targets that its own chains reach too rarely
    statistics = [np.zeros((surface.wavelengths, 4, len(targets))) for surface in surfaces]
    few = [list(range(len(targets))) for _ in surfaces]
    for step in range(_PILOT_STEPS):
        # a later pilot replaces the earlier one: joining both would favour those that saw light
        per_shift = request.per_shift * _PILOT_GROWTH**step
        wanted = request._replace(per_shift=per_shift, key=(*request.key, 2 + step))
        chains = drawer.draw(wanted, [targets[i] for i in sorted(set().union(*few))])
        for surface, of_surface, indices in zip(surfaces, statistics, few, strict=True):
            for i in indices:
                score = surface.aim(request.source, targets[i], chains).score
                of_surface[:, 0, i] = score.shape[-1]
                of_surface[:, 1, i] = score.mean(axis=-1)
                of_surface[:, 2, i] = score.std(axis=-1)
                of_surface[:, 3, i] = np.count_nonzero(score, axis=-1)
        few = [
            [i for i in indices if of_surface[:, 3, i].max() < _PILOT_HITS]
            for of_surface, indices in zip(statistics, few, strict=True)
        ]
        if not any(few):
            break
    return statistics


def allotment(
    photons: int, expected: float, pilot: Pilot, gain: Floats, number: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return the number of chains of each order and shift.

    Parameters
    ----------
    photons : int
        Chains in all.
    expected : float
        Scatterings expected on the way.
    found : Pilot
        Pilot of the receivers that rest on the chains.
    gain : ndarray, shape (receivers,)
        Gain of each receiver, which its errors are compared with.
    number : ndarray of int, shape (receivers,)
        Number of receivers that each stands for.

    Notes
    -----
    The sum over the receivers of the squared relative errors is smallest for
    n_K ~ sqrt(sum_r (sigma_rK / h_r)^2 / cost_K). A share of the chains follows the Poisson law
    of the number of scatterings instead: an order that its pilot missed keeps a share.
    """
    order = np.arange(1, pilot.mean.shape[1] + 1)
    # sum_K sigma_K^2 / n_K is smallest in a given time for n_K ~ sigma_K / cost_K^(1/2)
    cost = 1.0 + 0.3 * order
    scale = np.maximum(gain, 1e-300)[:, None]
    # sorted, so that rounding does not depend on the order of the receivers
    squares = number[:, None] * np.square(pilot.spread / scale)
    share = np.sqrt(np.sort(squares / cost, axis=0).sum(axis=0))
    law = poisson_law(max(expected, 1e-6))[order]
    law = law / max(law.sum(), 1e-300)
    total = share.sum()
    mixed = law if total == 0.0 else (1.0 - _FLOOR) * share / total + _FLOOR * law
    return np.maximum(np.ceil(mixed * photons / SHIFTS), 2).astype(np.int64)


class ScatteredPilot(NamedTuple):
    """Mean of the scattered gain and variance of one sample, by receiver."""

    mean: Floats
    variance: Floats
    stderr: Floats

    def select(self, receivers: NDArray[np.bool_]) -> ScatteredPilot:
        """Select receivers by a mask."""
        return ScatteredPilot(*(row[receivers] for row in self))

    @classmethod
    def of_photons(cls, photons: Gains) -> ScatteredPilot:
        """Return the pilot of joined photons, without light that the surface reflects first."""
        mean = photons.parts[SCATTERED]
        square = photons.square[SCATTERED] * photons.samples[SCATTERED]
        return cls(mean, square - mean**2, photons.part_stderr[SCATTERED])


def chain_pilot(pilots: list[Pilot], link: ForcedLink) -> ScatteredPilot:
    """Combine the pilots of the sources, for the optimal allotment of chains.

    With n_K ~ sigma_K the variance times the number of chains is (sum_K sigma_K)^2.
    """
    mean = link.by_receiver(np.array([p.mean.sum(axis=1) for p in pilots]))
    spread = link.by_receiver(np.array([p.spread.sum(axis=1) for p in pilots]))
    noise = [(p.spread**2 / np.maximum(p.chains, 1)).sum(axis=1) for p in pilots]
    # variances of independent sources add, with squared shares of the power
    square = link._replace(power=link.power**2).by_receiver(np.array(noise))
    return ScatteredPilot(mean, spread**2, np.sqrt(square))


def is_clear(chains: ScatteredPilot) -> NDArray[np.bool_]:
    """Return the receivers that chains serve well enough to skip the comparison.

    Tails of chains that miss the aperture may be so small that their variance underflows.
    """
    square = chains.mean**2
    return (square > np.finfo(float).tiny) & (chains.variance <= _EFFICIENT * square)


def chain_cost(expected: float) -> float:
    """Return the time of a chain relative to a joined photon.

    In turbid water photons are scattered many times more than light on the way.
    """
    return _COST if expected < TURBID else _TURBID_COST / expected


def choose(chains: ScatteredPilot, photons: ScatteredPilot, expected: float = 0.0) -> list[Method]:
    """Choose the estimator with the smaller variance times time for each receiver.

    Chains that miss much of the light have a small variance: where the photons find twice
    the light or more than chance allows, or few chains bring all of it, chains are not trusted.
    With many scatterings `expected` on the way few photons bring much of the light: twice the
    light counts there only beyond two of their standard errors.
    """
    # chains that miss light show no variance for it: only the other estimator can tell
    missed = photons.mean - chains.mean > _DOUBT * np.hypot(photons.stderr, chains.stderr)
    certain = 2.0 * photons.stderr if expected >= TURBID else 0.0
    missed |= (chains.mean < _HALF * photons.mean) & (photons.mean - chains.mean > certain)
    slower = chains.variance * chain_cost(expected) > photons.variance
    few = chains.mean < _SURE * chains.stderr
    # relative errors compared crosswise: a mean may be 0
    surer = photons.stderr * chains.mean < chains.stderr * photons.mean
    better = (photons.mean > 0.0) & (missed | slower | (few & surer) | (chains.mean <= 0.0))
    return ["joined" if b else "chains" for b in better]


def prefer_analog(pilot: ScatteredPilot, largest: float, chosen: Sequence[Method]) -> list[Method]:
    """Return the estimators, analog photons where their variance times time is smaller.

    Parameters
    ----------
    pilot : ScatteredPilot
        Pilot of the chosen estimator of each receiver.
    largest : float
        Largest score of a photon, that of the shortest way.
    chosen : sequence of Method
        The better of chains and joined photons.

    Notes
    -----
    A score in [0, w] of mean h has a variance of h (w - h) at most [1]_, so that analog photons
    need no pilot of their own. Pilots of few samples miss the tail of samples that are aimed:
    their variance is that of a pilot times `_TAIL`. Ties go to the chosen ones.

    References
    ----------
    .. [1] R. Bhatia and C. Davis, American Mathematical Monthly 107 (2000) 353,
       doi:10.1080/00029890.2000.12005203.
    """
    sure = np.maximum(pilot.mean - pilot.stderr, 0.0)  # a heavy sample raises the mean
    # both sides times the mean, which may be 0: analog has the variance mean (w - mean) at most
    analog = np.maximum(largest - sure, 0.0) * pilot.mean**2
    better = _ANALOG_COST * _TAIL * pilot.variance * sure > analog
    return ["analog" if b else m for b, m in zip(better, chosen, strict=True)]


def samples_for(
    rtol: float, pilot: ScatteredPilot, gain: Floats, largest: float, method: Sequence[Method]
) -> float:
    """Return the chains, or photons over those in place of one, for a relative error of each gain.

    Parameters
    ----------
    rtol : float
        Relative standard error, > 0.
    pilot : ScatteredPilot
        Pilot of the chosen estimator of each receiver.
    gain : ndarray, shape (receivers,)
        Gain of each receiver with its unscattered light.
    largest : float
        Largest score of an analog photon.
    method : sequence of {"chains", "joined", "analog"}
        Estimator of each receiver.
    """
    names = np.array(method)
    variance = np.where(names == "analog", pilot.mean * largest, pilot.variance)
    each = np.select([names == "joined", names == "analog"], [PER_CHAIN, ANALOG_PER_CHAIN], 1.0)
    share = np.divide(variance, gain**2 * each, out=np.zeros(len(names)), where=gain > 0.0)
    return float(share.max()) / rtol**2


def choose_common(
    chains: list[ScatteredPilot], photons: list[ScatteredPilot], expected: Floats
) -> tuple[list[Method], float]:
    """Choose one estimator for all wavelengths, given a pilot of each and the scatterings expected.

    Returns the estimators by receiver, and the joined photons in place of a chain.

    The one with the smaller sum of relative variances; chains that are not trusted at a wavelength
    are left for it. Where chains would serve some wavelengths photons are fewer, for about twice
    the time of a run of these.
    """
    if len(chains) == 1:
        return choose(chains[0], photons[0], float(expected[0])), PER_CHAIN
    # chosen: photons are the better at some wavelength; every: at all; missed: not for their time
    # alone, but because chains are not trusted
    receivers = len(chains[0].mean)
    chosen, missed = np.zeros(receivers, bool), np.zeros(receivers, bool)
    total, every = np.zeros((2, receivers)), np.ones(receivers, bool)
    for chained, seen, number in zip(chains, photons, expected.tolist(), strict=True):
        vote = np.array([m == "joined" for m in choose(chained, seen, number)])
        chosen, every = chosen | vote, every & vote
        missed |= vote & (chained.variance * chain_cost(number) <= seen.variance)
        with np.errstate(all="ignore"):
            both = [chained.variance / chained.mean**2, seen.variance / seen.mean**2 / PER_CHAIN]
        total += np.nan_to_num(both, nan=1e300, posinf=1e300)
    joined = chosen & (missed | (total[1] < total[0]))
    method: list[Method] = ["joined" if b else "chains" for b in joined]
    return method, PER_CHAIN if every[joined].all() else _SHARED_PER_CHAIN


_RINGS, _AZIMUTHS = 48, 12  # rays of a source in the closed estimate
LITTLE = 1e-3
"""Share of a gain below which light that is reflected first may be left out."""
MEASURED = 0.2 * LITTLE
"""Estimated share from which on photons measure it: beside tilted lamps estimates are up to five
times too low."""
MUCH = 0.02
"""The same from which on it has all of its photons; below they are fewer in proportion."""


def returned_gain(link: Link) -> Floats:
    r"""Estimate the gain of light that leaves the water after a reflection at the surface.

    For light that goes down, the gain of light that is reflected at the surface before it arrives,
    by the same estimate of the reversed light.

    Returns
    -------
    ndarray, shape (receivers,)
        Gain over a flat sea.

    Notes
    -----
    Rays of equal power leave each source. Over the distance D to the surface they fall as
    :math:`e^{-a D} / (1 + b_b D)`. The share :math:`1 - e^{-2 b_b D}` of them is diffuse at the
    surface, which reflects :math:`r = 2 \int_0^1 \mu R(\mu) d\mu` of diffuse light, with the
    Fresnel reflectance R. Water returns the share of Kubelka and Munk (1931),

    .. math::
        R = (1 - \sqrt{1 - x^2}) / x, \quad x = b_b / (a + b_b),

    as Lambert's light from a depth of about 1 / (2 (a + b_b)), of which 1 - r leaves. Diffuse
    light is wider, as if from 3/4 of the depth of the source deeper: a factor chosen to agree
    with analog photons. Layers count with their means above the source and with the largest x;
    bubbles and waves are left out.

    Against analog photons scored from their second crossing on, and the difference of analog
    photons with `reflected="trace"` and "kill" (field of view 179 deg, r = 1 m, LED 60 deg and
    a = 0.1 / m unless named; in brackets the standard error of the last digits):

    ==================  =======  =====================  =============  ===============
    phase function      b [1/m]  depth                  of the gain    closed / analog
    ==================  =======  =====================  =============  ===============
    isotropic           0.5      3 m                    8.4(3) %       0.87(3)
    g = -0.5            0.5      3 m                    11.3(3) %      0.91(3)
    isotropic           0.5      10 m                   9.2(4) %       1.61(7)
    g = -0.5            0.5      10 m                   12.3(14) %     2.2(2)
    isotropic           0.05     10 m                   0.47(9) %      1.1(2)
    g = -0.5            0.05     10 m                   0.72(5) %      1.35(9)
    isotropic           0.5      10 m, waves of 8 m/s   9.3(8) %       1.55(12)
    isotropic           0.05     10 m, waves of 8 m/s   0.44(8) %      1.2(2)
    g = -0.5            0.05     10 m, waves of 8 m/s   0.94(7) %      1.03(8)
    isotropic, LED 10   0.05     10 m                   0.032(5) %     2.2(4)
    ==================  =======  =====================  =============  ===============

    It lies between 1/1.5 and 3 times the analog one there. It has not been compared where light
    arrives by scattering alone: few analog photons return there.
    """
    receivers = link.receivers
    gain = np.zeros(len(receivers))
    if link.physics.reflected != "trace":
        return gain
    water, back = link.water, link.water.phase.backscatter_fraction
    layers = [(0.0, water.a, water.b)] if water.layers is None else list(water.layers)
    x = max(back * b / max(a + back * b, 1e-12) for _, a, b in layers)
    # (1 - (1 - x^2)^(1/2)) / x without cancellation at small x (Kubelka and Munk, see above)
    albedo = x / (1.0 + math.sqrt(1.0 - x * x))
    down = link.direction == "down"
    # radiance over n^2 is conserved across the surface
    scale = (water.n / link.n_air) ** 2 if down else 1.0
    total = sum(t.power_mw for t in link.transmitters)
    nodes, weights = gauss_legendre(64)
    mu = 0.5 * (nodes + 1.0)  # of diffuse light from below: reflectance 0.47 at n = 1.33
    diffuse_reflectance = float((weights * mu * fresnel_reflectance(mu, water.n, link.n_air)).sum())
    # geometric series of reflections between water and surface
    out = albedo * (1.0 - diffuse_reflectance) / (1.0 - albedo * diffuse_reflectance)
    for (i, end), source in product(enumerate(receivers), link.transmitters):
        low_end: Any = end if down else source
        high_end: Any = source if down else end
        etendue = 1.0  # of an aperture in the water, whose light is reversed [m2 sr]
        if down:
            etendue = (math.pi * end.radius * math.sin(math.radians(end.fov_deg) / 2.0)) ** 2
        depth = -low_end.center[2]
        a, b = mean_water(water, depth)
        # an even source in the water is seen as if from this depth: the half of 1 / (a + b_b)
        below = 0.5 / max(a + back * b, 1e-12)
        rays = _rays(low_end)
        length = depth / rays[:, 2]
        unturned = np.exp(-2.0 * back * b * length)
        power = scale * source.power_mw / total / (_RINGS * _AZIMUTHS) * out
        arriving = power * np.exp(-a * length) / (1.0 + back * b * length)
        mirrored = arriving * unturned * fresnel_reflectance(rays[:, 2], water.n, link.n_air)
        diffuse = arriving * (1.0 - unturned) * diffuse_reflectance
        for sent, low in ((mirrored, below), (diffuse, below + 0.75 * depth)):
            place = rays[:, :2] * ((depth + below) / rays[:, 2:]) + low_end.position
            gain[i] += etendue * float(sent @ _seen(high_end, place, low))
    return gain


def _rays(source: Any) -> Floats:
    """Return directions of equal power, as of a Lambertian source, that go up."""
    u = (np.arange(_RINGS) + 0.5) / _RINGS
    cosine = 1.0 - 2.0 * u
    axis = np.array(source.axis)
    if isinstance(source, WaterReceiver):
        axis = -axis
        cosine = np.sqrt(1.0 - u * math.sin(math.radians(source.fov_deg) / 2.0) ** 2)
    elif source.spread_deg < 90.0:
        # a Lambertian source falls to half at its half-angle: cos^m = 1/2
        order = -math.log(2.0) / math.log(math.cos(math.radians(source.spread_deg)))
        # inverse of the cumulative distribution of (m + 1) cos^m
        cosine = u ** (1.0 / (order + 1.0))
    azimuth = 2.0 * math.pi * (np.arange(_AZIMUTHS) + 0.5) / _AZIMUTHS
    c, f = (v.ravel() for v in np.meshgrid(cosine, azimuth, indexing="ij"))
    s = np.sqrt(np.maximum(1.0 - c * c, 0.0))
    e1, e2 = (np.array(e) for e in across(tuple(axis.tolist())))
    rays = c[:, None] * axis + (s * np.cos(f))[:, None] * e1 + (s * np.sin(f))[:, None] * e2
    # the way of a grazing ray is a hundred depths and more
    return rays[rays[:, 2] > 0.01]


def _seen(receiver: Any, place: Floats, below: float) -> Floats:
    """Return the share of Lambert's power that leaves each place and is received.

    At a lamp, which is reached backwards, the light of its pattern per area [sr-1 m-2].
    """
    away = np.column_stack([place - receiver.center[:2], np.full(len(place), -below)])
    away[:, 2] -= receiver.center[2]
    distance = np.linalg.norm(away, axis=1)
    rise = -away[:, 2] / distance
    if isinstance(receiver, AirLamp):
        intensity = lamp_intensity(receiver, away @ np.array(receiver.axis) / distance)
        return np.asarray(intensity * rise / (math.pi * distance**2))
    # Lambert's law at the place, cos / pi, and the projected area of the aperture
    view = -(away @ np.array(receiver.axis)) / distance
    seen = view > math.cos(math.radians(receiver.fov_deg) / 2.0)
    area = math.pi * receiver.radius**2
    return np.asarray(np.where(seen, area * view * rise / (math.pi * distance**2), 0.0))


def counts(returned: Floats, gain: Floats, share: float = LITTLE) -> NDArray[np.bool_]:
    """Return whether light that is reflected first exceeds a share of each gain > 0."""
    return (returned > share * gain) & (gain > 0.0)
