"""Choose the estimator of the scattered light of each receiver.

Chains that are aimed at the aperture are efficient where a lamp illuminates much of the surface and
light is scattered by small angles. Joined photons are efficient for beams narrower than the spread
by random slopes, for large angles and for many scatterings. Pilot runs of both over still water
decide; those of chains also determine how many chains each order of scattering gets. A closed-form
estimate tells whether light that the surface reflects before it crosses is worth photons.
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
from meshtrace.engine.photons.joined import DIFFUSE
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
# A pilot with fewer contributing chains than _PILOT_HITS is replaced by one with _PILOT_GROWTH
# times the chains; _PILOT_STEPS pilots of an order at most. Tuned: time, or orders misjudged.
_PILOT_HITS, _PILOT_GROWTH, _PILOT_STEPS = 4, 4, 3
_FLOOR = 0.2  # share of the chains allotted by the Poisson law alone; tuned: noise, orders missed
_ORDER_COST = 0.3  # further time of a chain by each scattering, over that of a chain without any

PER_CHAIN, REFLECTED_PER_CHAIN = 8.0, 2.0
"""Joined photons in place of a chain: for scattered light, and for light reflected first alone."""
FEWEST_REFLECTED = 1024
"""Joined photons that follow light reflected first, if there are no fewer by the share of it."""
ANALOG_PER_CHAIN = 32.0
"""Analog photons in place of a chain: they take about as long as the joined ones."""
# Joined photons in place of a chain where chains would serve some wavelengths, see `choose_common`.
_SHARED_PER_CHAIN = 1.0

# Joined photons of a pilot; the fewer ones in water of many scatterings that turn light by small
# angles, where a photon and its copies take ten times as long. Tuned: time, or uncertain choices.
_PILOT_PHOTONS, _FEW_PILOT_PHOTONS = 8192, 2048
# Relative variance of a joined photon's light that the surface reflects first: 40 at b z = 5 to 500
# at b z = 20, Fournier-Forand. Share of its error in that of the chains; tuned: time.
_REFLECTED_VARIANCE, _ERROR_SHARE = 500.0, 0.25

# Thresholds of the choice, all tuned: time, or light that is missed.
_EFFICIENT = 4.0  # squared relative deviation of one chain up to which no other estimator is tried
_COST = 3.0  # time of a chain over that of a joined photon
_TURBID_COST = 2.0  # the same in turbid water: this, over the scatterings expected on the way
_FORWARD_COST = 4.0  # the same where light is turned little: this, over their square
_ANALOG_COST = 8.0  # time of a chain or joined photon over that of an analog one; 5 to 40
_TAIL = 6.0  # variance of aimed samples in long runs over that of their pilots; from 1 to 14
_HALF = 0.5  # chains with less than this share of the light of photons are not trusted
# Logarithm of the factor by which a pilot may understate a variance, over the relative standard
# error of its mean. Tails are heavy: at b z = 20, g = 0.9, 1300 chains show a tenth of the variance
# of 131,000. Tuned on 43 links, six pilots each: less takes chains at g = 0.9, where photons need a
# quarter of the time, more takes photons at b z = 30, Fournier-Forand, where chains need half.
_MISSED_TAIL = 40.0
_DOUBT = 3.5  # standard errors by which photons may exceed chains: beyond, chains miss light


Pilot = Floats
"""Statistics of pilot chains over still water, shape (4, receivers, orders from 1 on).

Number of chains, mean and standard deviation of their scores, and number of those that contribute.
"""


def pilot_statistics(
    drawer: ChainDrawer,
    surfaces: Sequence[ChainDrawer | AimedChains],
    targets: Sequence[int],
    request: Request,
) -> list[Floats]:
    """Return the statistics of a `Pilot` for chains of one order, by surface.

    Each array has the shape (wavelengths, 4, targets). Targets that few chains reach get more of
    them.
    """
    statistics = [np.zeros((surface.wavelengths, 4, len(targets))) for surface in surfaces]
    # indices into `targets` that each surface still needs chains for
    unsettled = [list(range(len(targets))) for _ in surfaces]
    for step in range(_PILOT_STEPS):
        # a later pilot replaces the earlier one: averaging both would be biased, as only pilots
        # without light are repeated
        per_shift = request.per_shift * _PILOT_GROWTH**step
        # keys end in a purpose: 1 for the chains of a run, from 2 on for pilots
        larger = request._replace(per_shift=per_shift, key=(*request.key, 2 + step))
        chains = drawer.draw(larger, [targets[i] for i in sorted(set().union(*unsettled))])
        for surface, table, indices in zip(surfaces, statistics, unsettled, strict=True):
            for i in indices:
                score, _ = surface.aim(request.source, targets[i], chains)
                table[:, 0, i] = score.shape[-1]
                table[:, 1, i] = score.mean(axis=-1)
                table[:, 2, i] = score.std(axis=-1)
                table[:, 3, i] = np.count_nonzero(score, axis=-1)
        unsettled = [
            [i for i in indices if table[:, 3, i].max() < _PILOT_HITS]
            for table, indices in zip(statistics, unsettled, strict=True)
        ]
        if not any(unsettled):
            break
    return statistics


def at_wavelengths(
    mean: Floats, spread: Floats, ratios: Floats, gain: Floats
) -> tuple[Floats, Floats]:
    """Return the deviations of pilot scores and the gains of receivers at all wavelengths.

    Rows go through the receivers at the first wavelength, then at the second, and so on.

    `mean` and `spread` (receivers, orders) are those of a pilot at the base, `gain` (receivers,)
    that of all light. `ratios` (wavelengths,) are scattering coefficients over that of the base.
    Light of order K scales with their power K; attenuation, about the same for all orders, is left
    out.
    """
    receivers, orders = mean.shape
    power = ratios[:, None, None] ** np.arange(1, orders + 1)
    # rounding may leave less than 0 beside the scattered light
    direct = np.maximum(gain - mean.sum(axis=1), 0.0)
    whole = direct + (power * mean).sum(axis=2)
    # no -1 for the rows: reshape cannot infer them where clear water leaves 0 orders
    return (power * spread).reshape(len(ratios) * receivers, orders), whole.ravel()


def allotment(
    photons: int, expected: float, spread: Floats, gain: Floats, number: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return the number of chains of each order, per shift of the points.

    Parameters
    ----------
    photons : int
        Chains in all.
    expected : float
        Scatterings expected on the way.
    spread : ndarray, shape (receivers, orders)
        Standard deviation of the score of one chain, for the receivers that the chains serve.
    gain : ndarray, shape (receivers,)
        Gain of each receiver, to which its errors are relative.
    number : ndarray of int, shape (receivers,)
        Number of receivers that each of them stands for.

    Notes
    -----
    In a given time the sum over receivers r of squared relative errors,
    sum_rK (sigma_rK / h_r)^2 / n_K, is smallest for n_K ~ sqrt(sum_r (sigma_rK / h_r)^2 / cost_K),
    with the gain h_r, the deviation sigma_rK of one chain of order K and its time cost_K (Neyman's
    allocation). A share of the chains follows the Poisson law of the number of scatterings instead:
    an order whose pilot saw no light gets some, too.
    """
    order = np.arange(1, spread.shape[1] + 1)
    cost = 1.0 + _ORDER_COST * order
    scale = np.maximum(gain, 1e-300)[:, None]
    # sorted, so that rounding does not depend on the order of the receivers
    squares = number[:, None] * np.square(spread / scale)
    share = np.sqrt(np.sort(squares / cost, axis=0).sum(axis=0))
    law = poisson_law(max(expected, 1e-6))[order]
    law = law / max(law.sum(), 1e-300)
    total = share.sum()
    mixed = law if total == 0.0 else (1.0 - _FLOOR) * share / total + _FLOOR * law
    # at least 2 a shift: a single chain would gain nothing from Sobol points
    return np.maximum(np.ceil(mixed * photons / SHIFTS), 2).astype(np.int64)


class ScatteredPilot(NamedTuple):
    """Statistics of the scattered gain by one estimator, by receiver."""

    mean: Floats
    variance: Floats  # of one sample
    stderr: Floats  # of the mean of the pilot

    def select(self, receivers: NDArray[np.bool_]) -> ScatteredPilot:
        """Select receivers by a mask."""
        return ScatteredPilot(*(row[receivers] for row in self))

    @classmethod
    def of_photons(cls, photons: Gains) -> ScatteredPilot:
        """Return the pilot of joined photons, without light that the surface reflects first."""
        mean = photons.parts[SCATTERED]
        # `Gains.square` is sum s^2 / n^2 over n photons with scores s; this is the mean of s^2
        square = photons.square[SCATTERED] * photons.samples[SCATTERED]
        return cls(mean, square - mean**2, photons.part_stderr[SCATTERED])

    def log_variance_bound(self) -> Floats:
        """Return the logarithm of an approximate upper bound on the relative variance.

        The pilots that are compared differ in time: the error of a mean tells how well its variance
        is known, not how efficient its estimator is.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            seen = np.log(self.variance) - 2.0 * np.log(self.mean)
            bound = seen + _MISSED_TAIL * self.stderr / self.mean
        return np.where(self.mean > 0.0, bound, np.inf)


def chain_pilot(pilots: list[Pilot], link: ForcedLink) -> ScatteredPilot:
    """Combine the pilots of the sources, as if chains were allotted optimally to the orders.

    With n_K ~ sigma_K chains of order K, the variance of the gain times the number of all chains is
    (sum_K sigma_K)^2: the variance of one sample.
    """
    mean = link.by_receiver(np.array([mean.sum(axis=1) for _, mean, _, _ in pilots]))
    spread = link.by_receiver(np.array([spread.sum(axis=1) for _, _, spread, _ in pilots]))
    noise = [(each**2 / np.maximum(n, 1)).sum(axis=1) for n, _, each, _ in pilots]
    # variances of independent sources add, with squared shares of the power
    square = link._replace(power=link.power**2).by_receiver(np.array(noise))
    return ScatteredPilot(mean, spread**2, np.sqrt(square))


def is_clear(chains: ScatteredPilot) -> NDArray[np.bool_]:
    """Return whether chains serve each receiver well enough to skip the comparison with photons."""
    # chains that miss the aperture may bring so little light that its square underflows
    square = chains.mean**2
    return (square > np.finfo(float).tiny) & (chains.variance <= _EFFICIENT * square)


def is_forward(expected: float, turn: float) -> bool:
    """Return whether light is scattered many times, but by small angles.

    `expected` scatterings on the way turn it as often as `turn`, 1 - g, times as many isotropic
    ones.
    """
    return expected >= TURBID and expected * turn <= DIFFUSE


def chain_cost(expected: float, turn: float = 1.0) -> float:
    """Return the time of a chain relative to a joined photon.

    In turbid water a photon is scattered many times more often than `expected` on the way,
    which makes photons the slower ones; most so where it `is_forward`.
    """
    if is_forward(expected, turn):
        return _FORWARD_COST / expected**2
    return _COST if expected < TURBID else _TURBID_COST / expected


def pilot_photons(expected: float, turn: float, wavelengths: int = 1) -> int:
    """Return the number of joined photons of a pilot; arguments as of `is_forward`."""
    # `choose_common` judges the sum over all wavelengths: fewer photons decide as surely
    together = wavelengths > 1 and expected >= TURBID
    return _FEW_PILOT_PHOTONS if together or is_forward(expected, turn) else _PILOT_PHOTONS


def reflected_per_chain(returned: Floats, variance: Floats) -> float:
    """Return the number of joined photons per chain that light reflected first is worth.

    With V the relative variance of one photon and r the estimated gain of that light (receivers,),
    r^2 V / n_photons is a share s^2 of `variance` / n_chains, that of the gain by chains.
    """
    with np.errstate(divide="ignore"):
        each = _REFLECTED_VARIANCE * returned**2 / (_ERROR_SHARE**2 * variance)
    return float(each.max())


def choose(
    chains: ScatteredPilot, photons: ScatteredPilot, expected: float = 0.0, turn: float = 1.0
) -> list[Method]:
    """Choose the estimator with the smaller variance times time for each receiver.

    Variances are compared by bounds, as few samples show too small ones. Chains that miss much of
    the light have a small variance. They are not trusted if photons bring twice as much light, or
    more than chance explains. With many scatterings `expected` on the way few photons bring much of
    the light: twice as much counts there only if it exceeds two of their standard errors.
    """
    missed = _misses_light(chains, photons, expected)
    cost = math.log(chain_cost(expected, turn))
    slower = chains.log_variance_bound() + cost > photons.log_variance_bound()
    better = (photons.mean > 0.0) & (missed | slower | (chains.mean <= 0.0))
    return ["joined" if b else "chains" for b in better]


def _misses_light(
    chains: ScatteredPilot, photons: ScatteredPilot, expected: float
) -> NDArray[np.bool_]:
    """Return whether chains miss light of each receiver; arguments as of `choose`."""
    # light that chains miss does not show in their variance: only photons reveal it
    excess = photons.mean - chains.mean
    missed = excess > _DOUBT * np.hypot(photons.stderr, chains.stderr)
    certain = 2.0 * photons.stderr if expected >= TURBID else 0.0
    return missed | ((chains.mean < _HALF * photons.mean) & (excess > certain))


def prefer_analog(pilot: ScatteredPilot, largest: float, chosen: Sequence[Method]) -> list[Method]:
    """Replace estimators by analog photons where these have a smaller variance times time.

    Parameters
    ----------
    pilot : ScatteredPilot
        Pilot of the chosen estimator of each receiver.
    largest : float
        Largest score w of an analog photon, that on the shortest way.
    chosen : sequence of Method
        The better of chains and joined photons.

    Notes
    -----
    A score in [0, w] of mean h has a variance of h (w - h) at most [1]_, so that analog photons
    need no pilot. Short pilots miss rare large scores of aimed samples, whose variance is taken
    `_TAIL` times larger. Ties go to `chosen`.

    References
    ----------
    .. [1] R. Bhatia and C. Davis, American Mathematical Monthly 107 (2000) 353,
       doi:10.1080/00029890.2000.12005203.
    """
    sure = np.maximum(pilot.mean - pilot.stderr, 0.0)  # a heavy sample raises the mean
    # compares relative variances, variance / mean^2 and (w - mean) / mean at most for analog
    # photons, both times mean^2 sure, as either mean may be 0
    analog = np.maximum(largest - sure, 0.0) * pilot.mean**2
    better = _ANALOG_COST * _TAIL * pilot.variance * sure > analog
    return ["analog" if b else m for b, m in zip(better, chosen, strict=True)]


def samples_for(
    rtol: float, pilot: ScatteredPilot, gain: Floats, largest: float, method: Sequence[Method]
) -> float:
    """Return the number of chains for a relative error of every gain.

    Photons count as the chains that they take the place of.

    Parameters
    ----------
    rtol : float
        Relative standard error, > 0.
    pilot : ScatteredPilot
        Pilot of the chosen estimator of each receiver.
    gain : ndarray, shape (receivers,)
        Gain of each receiver, including unscattered light.
    largest : float
        Largest score of an analog photon.
    method : sequence of {"chains", "joined", "analog"}
        Estimator of each receiver.
    """
    names = np.array(method)
    # a score in [0, w] of mean h has a variance below h w, see `prefer_analog`
    variance = np.where(names == "analog", pilot.mean * largest, pilot.variance)
    each = np.select([names == "joined", names == "analog"], [PER_CHAIN, ANALOG_PER_CHAIN], 1.0)
    share = np.divide(variance, gain**2 * each, out=np.zeros(len(names)), where=gain > 0.0)
    return float(share.max()) / rtol**2


def choose_common(
    chains: list[ScatteredPilot], photons: list[ScatteredPilot], expected: Floats, turn: float
) -> tuple[list[Method], float]:
    """Choose one estimator for all wavelengths from the pilots and expected scatterings of each.

    `turn` is 1 - g, see `is_forward`.

    Return the estimators by receiver, and the number of joined photons in place of a chain.

    Chosen is the estimator with the smaller sum of relative variances times time over the
    wavelengths, but joined photons if chains miss light at any one of them. Where chains would
    serve some of the wavelengths photons are fewer, so that they take about twice the time of the
    chains.
    """
    if len(chains) == 1:
        return choose(chains[0], photons[0], float(expected[0]), turn), PER_CHAIN
    receivers = len(chains[0].mean)
    # masks of receivers: chains miss light at some wavelength; photons are better at every one
    missed, every = np.zeros(receivers, bool), np.ones(receivers, bool)
    # relative variance times time: all wavelengths share the chains of the one that scatters most
    work, cost = np.zeros((2, receivers)), chain_cost(float(expected.max()), turn)
    for chained, seen, number in zip(chains, photons, expected.tolist(), strict=True):
        every &= [method == "joined" for method in choose(chained, seen, number, turn)]
        missed |= _misses_light(chained, seen, number)
        with np.errstate(all="ignore"):
            both = [cost * chained.variance / chained.mean**2, seen.variance / seen.mean**2]
        work += np.nan_to_num(both, nan=1e300, posinf=1e300)
    joined = missed | every | (work[1] < work[0])
    method: list[Method] = ["joined" if b else "chains" for b in joined]
    return method, PER_CHAIN if every[joined].all() else _SHARED_PER_CHAIN


_RINGS, _AZIMUTHS = 48, 12  # rays of a source in `returned_gain`, in polar angle and azimuth
LITTLE = 1e-3
"""Share of a gain below which light that the surface reflects first may be left out."""
MEASURED = 0.2 * LITTLE
"""Estimated share above which photons measure that light: the estimate may be five times too low
beside tilted lamps."""
MUCH = 0.02
"""Estimated share above which that light gets all of its photons, below it proportionally fewer."""


def returned_gain(link: Link) -> Floats:
    r"""Estimate the gain of light that leaves the water after a reflection at the surface.

    For a downlink, estimate the gain of light that the surface reflects from below before it
    arrives, by the same formulas for light that runs backwards from the receiver.

    Returns
    -------
    ndarray, shape (receivers,)
        Gain over a flat sea.

    Notes
    -----
    Rays of equal power leave each source. Over the distance D to the surface they fall as
    :math:`e^{-a D} / (1 + b_b D)`, with absorption a and backscattering :math:`b_b`.
    The share :math:`1 - e^{-2 b_b D}` of them is diffuse at the surface, which reflects
    :math:`r = 2 \int_0^1 \mu R(\mu) d\mu` of diffuse light, with the Fresnel reflectance R.
    Water returns the share of Kubelka and Munk (1931),

    .. math::
        R = (1 - \sqrt{1 - x^2}) / x, \quad x = b_b / (a + b_b),

    as Lambertian light from a depth of about 1 / (2 (a + b_b)), of which 1 - r leaves. Light that
    was diffuse at the surface spreads wider, as if it came from deeper by 3/4 of the depth of the
    source: a factor chosen to agree with analog photons. Layered water has the means of a and b
    above the source, and the largest x; bubbles and waves are left out.

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

    The estimate lies between 1/1.5 and 3 times the analog gain there. It has not been compared
    where light arrives by scattering alone: few analog photons return there.
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
    # reversed light starts in the water: radiance over n^2 is conserved across the surface
    scale = (water.n / link.n_air) ** 2 if down else 1.0
    total = sum(t.power_mw for t in link.transmitters)
    nodes, weights = gauss_legendre(64)
    # cosine of incidence, nodes mapped to (0, 1); r = 2 int mu R dmu is 0.47 at n = 1.33
    mu = 0.5 * (nodes + 1.0)
    diffuse_reflectance = float((weights * mu * fresnel_reflectance(mu, water.n, link.n_air)).sum())
    # share of light sent down that leaves: geometric series of reflections by water and surface
    out = albedo * (1.0 - diffuse_reflectance) / (1.0 - albedo * diffuse_reflectance)
    for (i, end), source in product(enumerate(receivers), link.transmitters):
        low_end: Any = end if down else source
        high_end: Any = source if down else end
        etendue = 1.0  # of an aperture in the water, A pi sin^2(fov / 2) [m2 sr], see `_seen`
        if down:
            etendue = (math.pi * end.radius * math.sin(math.radians(end.fov_deg) / 2.0)) ** 2
        depth = -low_end.center[2]
        a, b = mean_water(water, depth)
        # apparent depth of the light that the water returns, half of 1 / (a + b_b)
        below = 0.5 / max(a + back * b, 1e-12)
        rays = _rays(low_end)
        length = depth / rays[:, 2]
        unturned = np.exp(-2.0 * back * b * length)
        power = scale * source.power_mw / total / (_RINGS * _AZIMUTHS) * out
        arriving = power * np.exp(-a * length) / (1.0 + back * b * length)
        mirrored = arriving * unturned * fresnel_reflectance(rays[:, 2], water.n, link.n_air)
        diffuse = arriving * (1.0 - unturned) * diffuse_reflectance
        for sent, low in ((mirrored, below), (diffuse, below + 0.75 * depth)):
            # the ray, mirrored by the surface, has gone down by `below`: diffuse light, too
            place = rays[:, :2] * ((depth + below) / rays[:, 2:]) + low_end.position
            gain[i] += etendue * float(sent @ _seen(high_end, place, low))
    return gain


def _rays(source: Any) -> Floats:
    """Return the upward directions (rays, 3) of rays of equal power from a source.

    Sources are Lambertian with their half-angle, or isotropic; a receiver sends Lambertian light
    into its field of view.
    """
    u = (np.arange(_RINGS) + 0.5) / _RINGS
    cosine = 1.0 - 2.0 * u
    axis = np.array(source.axis)
    if isinstance(source, WaterReceiver):
        axis = -axis  # of arriving light, turned to the view
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
    # without grazing rays, whose way to the surface is a hundred depths and more
    return rays[rays[:, 2] > 0.01]


def _seen(receiver: Any, place: Floats, below: float) -> Floats:
    """Return the share of Lambertian light that leaves each place and is received.

    `place` (n, 2) are horizontal positions at the depth `below` [m]. For a lamp, reached by
    reversed light, return its intensity per area [sr-1 m-2] instead of a share.
    """
    # from the receiver to the places
    away = np.column_stack([place - receiver.center[:2], np.full(len(place), -below)])
    away[:, 2] -= receiver.center[2]
    distance = np.linalg.norm(away, axis=1)
    rise = -away[:, 2] / distance
    if isinstance(receiver, AirLamp):
        intensity = lamp_intensity(receiver, away @ np.array(receiver.axis) / distance)
        return np.asarray(intensity * rise / (math.pi * distance**2))
    # Lambert's law at the place, cos / pi [sr-1], and the projected area of the aperture
    view = -(away @ np.array(receiver.axis)) / distance
    seen = view > math.cos(math.radians(receiver.fov_deg) / 2.0)
    area = math.pi * receiver.radius**2
    return np.asarray(np.where(seen, area * view * rise / (math.pi * distance**2), 0.0))


def exceeds(returned: Floats, gain: Floats, share: float = LITTLE) -> NDArray[np.bool_]:
    """Return whether light that the surface reflects first exceeds a share of each gain > 0."""
    return (returned > share * gain) & (gain > 0.0)
