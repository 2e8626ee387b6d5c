"""Parts of convergence studies: meshes, common chains, the exact surface, the fitted law."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple, TypeGuard

import numpy as np
from scipy.optimize import brentq

from meshtrace.engine.bvh import EmbreeIntersector
from meshtrace.engine.chains import wave_sum as analytic
from meshtrace.engine.chains.sampling import Chains
from meshtrace.engine.crossing import ROOT
from meshtrace.engine.forced import ForcedDetection, TypicalSea
from meshtrace.engine.photons.analog import run_analog
from meshtrace.engine.plan import Planner
from meshtrace.engine.setup.arrays import IDENTITY, Frame
from meshtrace.engine.setup.ends import crossing_reach
from meshtrace.engine.setup.meshing import mesh_for
from meshtrace.errors import Refused, require_between, require_whole
from meshtrace.fading import Estimate
from meshtrace.kernels.scene import Scene
from meshtrace.link import Link
from meshtrace.mesh import SurfaceModel, TriangleMesh, WaveSum
from meshtrace.models import Floats
from meshtrace.quadrature import gauss_legendre
from meshtrace.results.gain import Fate
from meshtrace.results.tallies import error_of_groups
from meshtrace.stored import SHIFTS, Variable
from meshtrace.studies.campaign import Campaign
from meshtrace.studies.cluster import Restored
from meshtrace.surfaces.waves import WaveComponents

# tilted by waves, light crosses beyond its reach over still water
_MARGIN = 2.0  # [m] of mesh beyond the farthest crossing to the receiver; tuned: time, light missed
_PROBES = 64  # points on each axis of the square where slopes are compared; tuned: time, noise

Normals = Literal["vertex", "facet"]
Unresolved = Literal["tilt", "none"]


def descending(name: str, values: Sequence[float]) -> list[float]:
    """Return at least four different positive values, from large to small; refuse others."""
    steps = [require_between(value, 0.0, math.inf, name) for value in values]
    if len(steps) < 4 or len(set(steps)) < len(steps):
        raise Refused(name, list(values), "at least four different values")
    return sorted(steps, reverse=True)


def multiple_of(name: str, ratio: float) -> int:
    """Return a whole ratio as an integer; refuse others, up to rounding."""
    if abs(ratio - round(ratio)) > 1e-9 * ratio:
        raise Refused(name, f"{ratio:g} half-steps", "multiples of the shortest step")
    return round(ratio)


def nested_mesh(
    link: Link, sea: SurfaceModel, time: float, spacing: float, shift: Floats
) -> TriangleMesh:
    """Return a uniform mesh over all crossings, moved off the origin by a shift (2,).

    The shift is in periods of the triangles, two cells each. Without one the lines lie at multiples
    of the spacing, so that they nest when it halves.
    """
    # a cell more on each side, as the shift moves the mesh
    cells = math.ceil((crossing_reach(link) + _MARGIN) / spacing) + 1
    # the diagonals alternate from cell to cell: the pattern repeats after two cells
    x, y = 2.0 * spacing * shift
    mesh = sea.mesh(time, cells * spacing, spacing, center=(float(x), float(y)))
    return mesh_for(link, mesh)[0]  # refuses one that does not suit the link


def probes(reach: float) -> tuple[Floats, Floats]:
    """Return points (x, y) of a square grid, at which slopes are compared."""
    # midpoints: no probe lies on a grid line, where two facets would share it
    axis = reach * ((2.0 * np.arange(_PROBES) + 1.0) / _PROBES - 1.0)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    return x.ravel(), y.ravel()


def placement_shifts(n: int) -> Floats:
    """Return a lattice of n shifts of a mesh (n, 2), in periods of its triangles (two cells).

    The diagonals alternate: a shift by one cell along both axes gives the same triangles, so
    that the lattice fills half a square of two cells.
    """
    if n == 1:
        return np.zeros((1, 2))
    # a rank-1 lattice whose generator is near n / golden ratio: for n of Fibonacci that of least
    # discrepancy; coprime to n, so that all points differ
    step = next(a for a in range(round(n / 1.618), n + 1) if math.gcd(a, n) == 1)
    k = np.arange(n)
    along, across = (k + 0.5) / n, (step * k / n + 0.5 / n) % 1.0  # of the unit square
    # turned by 45 deg: that half is a square whose edges are the diagonals of cells
    return 0.5 * np.stack([along + across - 1.0, along - across], axis=1)


MakeMesh = Callable[[], TriangleMesh]
"""Returns one of the meshes of a study."""

ANALOG_PHOTONS = 16_384  # of the share of total reflection


class CommonChains(Restored):
    """Set of chains that all surfaces of a study share.

    Parameters
    ----------
    campaign : Campaign
        Link, sea and options.
    normals : sequence of {"vertex", "facet"}
        Kinds of normals, each with chains of its own.
    receiver : int
        Index of the receiver.
    unresolved : {"none", "tilt"}
        Slopes of the waves that each mesh leaves out.
    highest : SurfaceModel, optional
        Sea with the highest crests of all in the study, by default that of the campaign.
    """

    def __init__(
        self,
        campaign: Campaign,
        normals: Sequence[Normals],
        receiver: int,
        unresolved: Unresolved = "none",
        highest: SurfaceModel | None = None,
    ) -> None:
        link, highest = campaign.link, highest or campaign.sea
        self.kinds, self.receiver = tuple(dict.fromkeys(normals)), receiver
        if not self.kinds:
            raise Refused("normals", normals, "vertex and facet")
        self.campaign = campaign
        # a spacing of half a metre shows well enough how high crests are: chains expect collisions
        # up to there
        coarse = nested_mesh(link, highest, campaign.meshing.time, 0.5, np.zeros(2))
        self._typical = TypicalSea(float(coarse.bounds[1, 2]))
        require_whole(receiver, 0, len(link.receivers) - 1, "receiver")
        physics = link.physics.model_copy(update={"unresolved": unresolved})
        fields = {"receiver": link.receivers[receiver], "physics": physics}
        self.inputs = campaign.alone, self.kinds, receiver, unresolved, highest
        self.link = link.model_copy(update=fields)
        self.reach = crossing_reach(self.link)
        self._forced = {kind: self._chains(kind) for kind in self.kinds}

    def _chains(self, kind: Normals) -> ForcedDetection:
        """Return the chains over surfaces with one kind of normals."""
        # chains alone, as they are common to all surfaces, and all crossings of each: no noise by
        # a choice of them
        run = self.campaign.run
        planner = Planner(
            self.link, run.seed, kind, sea=self._typical, search="thorough", scattered="chains"
        )
        return ForcedDetection.following(planner, planner.plan(run.photons, planner.compare()))

    def measure(self, case: MakeMesh, photons: int = 0) -> Floats:
        """Return the numbers of a mesh for each kind of normals, shape (kinds, numbers).

        Gain by shift, unscattered gain, mean square slope, share of total reflection, and the
        seconds that mesh, BVH and gain took; `photons` are for the share of total reflection.
        """
        began = clock.perf_counter()
        mesh = case()
        meshed = clock.perf_counter()
        # built here, although the first ray would do it: its time is one of the results
        intersector = EmbreeIntersector(mesh, 1).built()
        times = meshed - began, clock.perf_counter() - meshed
        table = []
        for kind, forced in self._forced.items():
            start = clock.perf_counter()
            parts = forced.evaluate(mesh)
            seconds = *times, clock.perf_counter() - start
            slopes = _slope_variance(intersector, kind, self.reach)
            seed = self.campaign.run.seed
            reflected = _total_reflection(self.link, intersector, kind, photons, seed)
            table.append([*parts.shifts[0], parts.ballistic[0], slopes, reflected, *seconds])
        return np.array(table)

    def measure_all(
        self, cases: Sequence[MakeMesh], recorded: dict[str, Any], photons: int = ANALOG_PHOTONS
    ) -> Floats:
        """Return the numbers of `measure` for each mesh, shape (kinds, cases, numbers).

        `photons` are those of the share of total reflection, 0 for none; `recorded` holds the
        options of the study that tell its meshes from others in a store.
        """
        identity = recorded | {
            "kinds": list(self.kinds),
            "receiver": self.receiver,
            "physics": self.link.physics.model_dump(mode="json"),
        }

        def setup() -> Callable[[int], Floats]:
            return lambda i: self.measure(cases[i], photons)

        # gain by shift, then the six other numbers of `measure`
        shape = len(self.kinds), SHIFTS + 6
        # "meshes": the name of the loop in a store, and that of its steps in announcements
        results = self.campaign.evaluate(
            setup, range(len(cases)), "meshes", identity, lambda step: shape, "meshes"
        )
        return np.stack(list(results), axis=1)

    def exact(self, sea: WaveSum, spacing: float) -> Reference:
        """Return the gain over the exact sum of waves.

        The search for crossings starts from those of a mesh of a spacing [m].
        """
        forced, time = self._chains("vertex"), self.campaign.meshing.time
        # the link as arrays in a local frame, in which waves and crossings are, too
        link, mesh = forced.arrays, nested_mesh(self.link, sea, time, spacing, np.zeros(2))
        aimed, waves = forced.planner.aim_over(mesh), waves_at(sea, time, link.frame)
        # scattered gain by shift; unscattered gain and its error
        scattered, direct = np.zeros(SHIFTS), np.zeros(2)
        counters = np.zeros(len(analytic.Moved), np.int64)
        for source, power in enumerate(link.power):
            scene = aimed.scene(link.emitters[source], link.targets[0])
            for chains in map(forced.drawer.whole, forced.scattered_sets[source]):
                # Newton on the exact surface starts from the crossings of the mesh: each chain
                # keeps its crossing, and the gains differ by the surfaces alone
                _, arrivals = aimed.aim(source, 0, chains, keep=True)
                score = np.zeros(chains.number)
                analytic.move_crossings(chains.chains, arrivals, waves, scene, score, counters)
                scattered += power * score.reshape(SHIFTS, -1).mean(axis=1)
            # facets that send light straight to the aperture
            crossings = aimed.centroids[np.flatnonzero(aimed.direct_gains(source, 0))]
            # two orders of one rule: their difference bounds the error of the finer one
            coarse, fine = (_direct(waves, scene, crossings, n) for n in (4, 8))
            if abs(fine - coarse) > _QUADRATURE_ERROR * fine:  # a caustic lies on the aperture
                coarse, fine = _finely_meshed(forced, sea, time, source, crossings, spacing)
            direct += power * np.array([fine, abs(fine - coarse)])
        slope_x, slope_y = sea.slopes(*probes(self.reach), time)
        return Reference(
            samples=direct[0] + scattered,
            ballistic=float(direct[0]),
            quadrature_error=float(direct[1]),
            slope_variance=float(np.mean(slope_x**2 + slope_y**2)),
            lost=int(counters[analytic.Moved.LOST]),
        )


def _slope_variance(intersector: EmbreeIntersector, kind: Normals, reach: float) -> float:
    """Return the mean square slope of the normals that light meets, along x plus along y."""
    x, y = probes(reach)
    mesh = intersector.mesh
    # rays straight down from above all crests hit the surface at the probes
    top = np.full(len(x), mesh.bounds[1, 2] + 1.0)
    down = np.broadcast_to((0.0, 0.0, -1.0), (len(x), 3))
    hits = intersector.intersect(np.stack([x, y, top], axis=1), down)
    hit = hits.facet >= 0
    # barycentric coordinates (1 - u - v, u, v) of the corners
    facet, u, v = hits.facet[hit], hits.u[hit, None], hits.v[hit, None]
    if kind == "facet":
        normal = mesh.face_normals[facet]
    else:
        a, b, c = (mesh.vertex_normals[mesh.faces[facet, i]] for i in range(3))
        normal = (1.0 - u - v) * a + u * b + v * c
    # slopes are -n_x / n_z and -n_y / n_z
    return float(np.mean((normal[:, 0] ** 2 + normal[:, 1] ** 2) / normal[:, 2] ** 2))


def _total_reflection(
    link: Link, intersector: EmbreeIntersector, kind: Normals, photons: int, seed: int
) -> float:
    """Return the share of totally reflected photons among those from below."""
    if photons == 0:
        return math.nan
    # photons meet the surface once and keep their weight, so that they can be counted
    single_hit = {"reflected": "kill", "second_hit": "ignore", "absorption": "analog"}
    link = link.model_copy(update={"physics": link.physics.model_copy(update=single_hit)})
    sums = run_analog(link, intersector, photons=photons, seed=seed, normals=kind)
    # a photon counts as landed if any of its light leaves: a reflected one left none
    reflected = int(sums.count[Fate.REFLECTED])
    met = reflected + int(sums.count[Fate.LANDED]) + int(sums.count[Fate.RECEIVED])
    return reflected / met if met else math.nan


def spread(gain: Floats) -> Floats:
    """Return the standard deviation over the repeats, the last axis; nan for a single one."""
    if gain.shape[-1] == 1:
        return np.full(gain.shape[:-1], math.nan)
    return gain.std(axis=-1, ddof=1)


_QUADRATURE_ERROR = 1e-5  # relative, of the unscattered light through the exact surface


@dataclass(frozen=True)
class Reference:
    """The gain over the exact surface, with the chains of the study.

    Attributes
    ----------
    samples : ndarray, shape (shifts,)
        Gain by shift of the chains.
    ballistic, quadrature_error : float
        Unscattered gain, and its error.
    slope_variance : float
        Mean square slope.
    lost : int
        Crossings of the mesh next to which Newton found none of the exact surface.
    """

    samples: Annotated[Floats, Variable("shift", name="exact_samples")]
    ballistic: Annotated[float, Variable(name="exact_gain_ballistic")]
    quadrature_error: Annotated[float, Variable(name="exact_quadrature_error")]
    slope_variance: Annotated[float, Variable(name="exact_mss")]
    lost: Annotated[int, Variable(name="exact_lost")]

    @property
    def gain(self) -> float:
        """Gain over the exact surface."""
        return float(self.samples.mean())


def _finely_meshed(
    forced: ForcedDetection,
    sea: WaveSum,
    time: float,
    source: int,
    crossings: Floats,
    spacing: float,
) -> tuple[float, float]:
    """Return the unscattered gain over a fine mesh of the crossings, and that extrapolated.

    For a caustic on the aperture, where the light on a point has no bound: the light that a mesh
    sends through each facet has one, and adds up. `crossings` are in the local frame, `spacing` [m]
    is that of the mesh on which they were found.
    """
    metres = forced.arrays.frame.metres(crossings)[:, :2]
    low, high = metres.min(axis=0), metres.max(axis=0)
    extent = 0.5 * float((high - low).max()) + 2.0 * spacing
    center = tuple(0.5 * (low + high))
    gains = []
    for parts in (8, 16):  # of a spacing: h and h / 2 for the extrapolation
        # at most 500 cells to the rim, so that memory is bounded
        mesh = sea.mesh(time, extent, max(spacing / parts, extent / 500.0), center=center)
        gains.append(float(forced.planner.aim_over(mesh).direct_gains(source, 0).sum()))
    # the mesh errs as h^2: Richardson from h to h / 2 adds a third of the difference
    return gains[1], gains[1] + (gains[1] - gains[0]) / 3.0


def _direct(waves: WaveComponents, scene: Scene, crossings: Floats, rings: int) -> float:
    """Return the unscattered gain over the exact surface by quadrature over the aperture."""
    points = _aperture_points(rings)
    # room for the crossings of one point, at most one from each start
    score, roots = np.zeros(len(points.weight)), np.empty(len(crossings), ROOT)
    analytic.direct_light(points, crossings, waves, scene, roots, score)
    return float(score.sum())


def _aperture_points(rings: int) -> Chains:
    """Return points of the unit disk with weights that add to 1, as chains that never scatter.

    Gauss-Legendre in the square of the radius, equal steps in azimuth.
    """
    node, weight = gauss_legendre(rings)
    # with s = r^2 the area element r dr dphi is ds dphi / 2: a rule in s has no weight r; three
    # azimuths a ring resolve the angle as well as the ring the radius
    radius, azimuths = np.sqrt(0.5 * (1.0 + node)), 3 * rings
    azimuth = 2.0 * math.pi * (np.arange(azimuths) + 0.5) / azimuths
    disk = radius[:, None, None] * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    n = rings * azimuths
    # no vertices: the open segment starts at the source, and no random slope tilts the surface
    weights = np.repeat(0.5 * weight / azimuths, azimuths)
    return Chains.zeros(n, order=0)._replace(weight=weights, disk=disk.reshape(n, 2))


def waves_at(sea: WaveSum, time: float, frame: Frame = IDENTITY) -> WaveComponents:
    """Return the waves of a sea in a local frame, whose time 0 is `time`."""
    waves = sea.components
    amplitude, kx, ky = waves.amplitude / frame.unit, waves.kx * frame.unit, waves.ky * frame.unit
    # an origin moved by x = (x, y) changes the phase of each wave by -k.x
    phase = waves.omega * time + waves.phase - waves.kx * frame.x - waves.ky * frame.y
    return WaveComponents(*map(np.ascontiguousarray, (amplitude, waves.omega, kx, ky, phase)))


def is_wave_sum(sea: Any) -> TypeGuard[WaveSum]:
    """Return whether the elevation of a sea is a sum of waves, and the sea not choppy."""
    return isinstance(sea, WaveSum) and not getattr(sea, "choppy", False)


def wave_sum(sea: SurfaceModel) -> WaveSum:
    """Return the sea if it is a sum of waves; refuse others."""
    if not is_wave_sum(sea):
        kind = "a choppy sea" if getattr(sea, "choppy", False) else type(sea).__name__
        raise Refused("reference", f"analytic for {kind}", "None: not a sum of waves")
    return sea


_REPLICATES = 2000  # of the bootstrap; tuned: time, noise of the limits
_LEVEL = 0.95  # of the intervals
_REWEIGHTINGS = 4  # rounds of misfit and weights; tuned: time, digits
_ORDERS = np.linspace(0.5, 6.0, 1101)  # orders p that are tried, in steps of 0.005


class Fit(NamedTuple):
    """The law g_0 + C h^p fitted to a study."""

    order: Estimate
    gain: Estimate
    coefficient: float


def fit_law(step: Floats, differences: Floats, anchor: float, spread: Floats | None = None) -> Fit:
    """Fit g_0 + C h^p to differences from an anchor, with 95 % intervals.

    Parameters
    ----------
    step : ndarray, shape (n,)
        Steps h, from coarse to fine, n >= 4.
    differences : ndarray, shape (n, shifts)
        Gains less the anchor, of each shift of the chains.
    anchor : float
        Reference of the differences.
    spread : ndarray, shape (n,), optional
        Standard error of each mean besides that of the chains; the residuals may show that it is
        larger by a factor. By default it is in proportion to h^2, which the law leaves out, and
        the factor is fitted.

    Returns
    -------
    Fit
    """
    n, shifts = differences.shape
    h = step / step[0]
    y, noise = differences.mean(axis=1), error_of_groups(differences, -1)
    # errors of the steps are hypot(noise, misfit * profile), with a factor misfit >= least
    profile, least = (h**2, 0.0) if spread is None else (spread, 1.0)
    # the first fit trusts fine steps: what the law leaves out grows with the step
    sigma = h**2
    # the misfit follows from the fit and the weights of the fit from the misfit: a few rounds do
    for _ in range(_REWEIGHTINGS):
        order, offset, slope = _least_squares(h, y[None], sigma)
        misfit = max(_misfit(y - offset - slope * h**order, noise, profile), least)
        sigma = np.hypot(noise, misfit * profile) + 1e-300  # above 0: weights are 1 / sigma^2
    order, offset, slope = _least_squares(h, y[None], sigma)
    # a fixed seed: the same study has the same interval
    rng = np.random.default_rng(n * shifts)
    # bootstrap over the shifts: the same ones at all steps, (replicates, n)
    resampled = differences[:, rng.integers(shifts, size=(_REPLICATES, shifts))].mean(axis=2).T
    # a fitted misfit is itself known from n - 3 residuals only: Student's distribution
    fitted = misfit > least
    scale = np.sqrt((n - 3) / rng.chisquare(n - 3, (_REPLICATES, 1))) if fitted else 1.0
    # besides the chains, which the bootstrap resamples, each step errs by the misfit
    added = misfit * profile * scale * rng.standard_normal((_REPLICATES, n))
    orders, offsets, _ = _least_squares(h, offset + slope * h**order + resampled - y + added, sigma)
    # percentiles: the distribution of the order is skew where it is hardly known
    tail = 0.5 * (1.0 - _LEVEL)
    limits = np.quantile([orders, offsets], (tail, 1.0 - tail), axis=1)
    return Fit(
        Estimate(float(order[0]), *map(float, limits[:, 0])),
        Estimate(anchor + float(offset[0]), *(anchor + float(v) for v in limits[:, 1])),
        float(slope[0] * step[0] ** -order[0]),  # C of h^p, from that of (h / h_0)^p
    )


def _misfit(residual: Floats, noise: Floats, profile: Floats) -> float:
    """Return the m >= 0 with which errors hypot(noise, m profile) explain the residuals of a fit.

    sum r^2 / (noise^2 + m^2 profile^2) = n - 3, as R. C. Paule and J. Mandel, J. Res. Natl.
    Bur. Stand. 87, 377 (1982), doi:10.6028/jres.087.022: noise is not counted twice.
    """
    freedom = len(residual) - 3

    def excess(m: float) -> float:
        return float(np.sum(residual**2 / (noise**2 + (m * profile) ** 2 + 1e-300))) - freedom

    # without any noise the equation has this solution; noise only lowers it
    most = math.sqrt(float(np.sum((residual / profile) ** 2)) / freedom)
    if excess(0.0) <= 0.0 or excess(most) >= 0.0:
        return 0.0 if excess(0.0) <= 0.0 else most
    return float(brentq(excess, 0.0, most))


def _least_squares(h: Floats, y: Floats, sigma: Floats) -> tuple[Floats, Floats, Floats]:
    """Fit p, g_0 and C to each row of y (rows, n), with errors in proportion to sigma.

    At a fixed order the law is linear: the best order is looked up on a fine grid.
    """
    # scaled before the square: errors may be as small as 1e-300
    weight = (sigma / sigma.max()) ** -2
    weight /= weight.sum()
    power = h ** _ORDERS[:, None]
    power_mean = power @ weight
    power = power - power_mean[:, None]  # (orders, n)
    mean = y @ weight
    covariance = (weight * (y - mean[:, None])) @ power.T  # (rows, orders)
    variance = (weight * power**2).sum(axis=1)
    # the order whose straight line over h^p explains most of the variance of y
    best = np.argmax(covariance**2 / variance, axis=1)
    slope = covariance[np.arange(len(y)), best] / variance[best]
    return _ORDERS[best], mean - slope * power_mean[best], slope


def largest_step(step: Floats, error: Floats, limit: float) -> float:
    """Return the largest step at which, and below which, all errors are below a limit, or nan."""
    # from fine to coarse, the largest error so far: one that happens to cross zero at a coarse step
    # is no accuracy. Errors follow power laws, so that logarithms are interpolated
    worst = np.log(np.maximum(np.maximum.accumulate(error[::-1]), 1e-300))
    return float(np.exp(np.interp(math.log(limit), worst, np.log(step[::-1]), left=math.nan)))
