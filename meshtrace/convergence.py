"""Whether a gain still depends on the mesh, on the time step or on the band of waves.

A study repeats one gain with a finer and finer discretisation and common random numbers: the
same scattering chains are aimed over every surface, so that differences of 1e-4 show under a
Monte Carlo error of 1e-3. To the gains g at steps h it fits

    g(h) = g_0 + C h^p

for the order p and the value g_0 at vanishing step (Richardson), and beside it stands the gain
over the exact sum of waves, with the same chains.
"""

from __future__ import annotations

import json
import math
import os
import time as clock
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from meshtrace.bvh import EmbreeIntersector
from meshtrace.kernels import analytic
from meshtrace.kernels.aiming import Emitter, Scene
from meshtrace.kernels.chains import Chains
from meshtrace.link import Link
from meshtrace.mesh import SurfaceModel, TriangleMesh
from meshtrace.result import FORMAT_VERSION, Fate
from meshtrace.simulate import mesh_for, provenance
from meshtrace.transport.analog import run_analog
from meshtrace.transport.forced import SHIFTS, ForcedDetection, crossing_reach

if TYPE_CHECKING:
    import xarray as xr

    from meshtrace.scenario import Scenario

Floats = NDArray[np.float64]
Normals = Literal["vertex", "facet"]
Progress = Callable[[int], None]

DEFAULT_SPACINGS = (2.0, 1.0, 0.5, 0.25, 0.125, 0.0625)
"""Mesh spacings [m] of a study: each halves the one before, so that the grid lines nest."""

_MARGIN = 2.0  # [m], mesh beyond the farthest crossing to the receiver
_PROBES = 64  # per axis: where slopes are compared
_ANALOG_PHOTONS = 16_384  # of the share of total reflection
_REPLICATES = 2000  # of the bootstrap
_LEVEL = 0.95
_QUADRATURE_ERROR = 1e-5  # relative, of the unscattered light through the exact surface
_ORDERS = np.linspace(0.5, 6.0, 1101)  # of the fit


class Interval(NamedTuple):
    """Estimate and its 95 % interval."""

    value: float
    low: float
    high: float


class Fit(NamedTuple):
    """The law g_0 + C h^p fitted to a study."""

    order: Interval
    gain: Interval
    coefficient: float


class Reference(NamedTuple):
    """The gain over the exact surface, with the chains of the study."""

    samples: Floats  # (shifts,) gain of each shift of the chains
    ballistic: float
    quadrature_error: float  # of the unscattered gain
    slope_variance: float

    @property
    def gain(self) -> float:
        """Gain over the exact surface."""
        return float(self.samples.mean())


class Costs(NamedTuple):
    """Seconds that one surface took, by kind of normals and step."""

    mesh: Floats
    bvh: Floats
    evaluation: Floats


@runtime_checkable
class WaveSum(SurfaceModel, Protocol):
    """A sea that is a sum of plane waves."""

    @property
    def components(self) -> Any:
        """Amplitudes, frequencies, wave vectors and phases as arrays."""
        ...


@dataclass(frozen=True, eq=False)
class ConvergenceStudy:
    """Gain of one link against a step that should not matter.

    Attributes
    ----------
    parameter : {"spacing", "time_step", "omega_max"}
        What was refined.
    values : ndarray, shape (n,)
        Its values, from coarse to fine: spacing [m], time step [s] or band limit [rad s-1].
    normals : tuple of str, shape (kinds,)
        Normals of the mesh.
    samples : ndarray, shape (kinds, n, repeats, shifts)
        Gain by repeat (placement of the mesh, or realization) and shift of the chains.
    ballistic : ndarray, shape (kinds, n, repeats)
        Unscattered gain.
    scatter : ndarray, shape (kinds, n)
        What a single surface errs by around the mean error of its step: standard deviation over
        placements of the mesh, or over realizations of the difference to the widest band, or
        rms error of linear interpolation in time.
    slope_variance, total_reflection : ndarray, shape (kinds, n)
        Mean square slope that light meets; share of the photons arriving from below that are
        totally reflected. nan where it was not asked for.
    costs : Costs
        Seconds for mesh, BVH and gain of one surface.
    reference : Reference or None
        The exact surface.
    tolerance : float
        Relative error that `recommended` is about.
    provenance : dict
        Versions, configuration and seeds.
    """

    parameter: Literal["spacing", "time_step", "omega_max"]
    values: Floats
    normals: tuple[Normals, ...]
    samples: Floats
    ballistic: Floats
    scatter: Floats
    slope_variance: Floats
    total_reflection: Floats
    costs: Costs
    reference: Reference | None = None
    tolerance: float = 1e-3
    provenance: dict[str, Any] = field(default_factory=dict)

    @property
    def step(self) -> Floats:
        """What goes to zero: the values, or one over the band limit."""
        return 1.0 / self.values if self.parameter == "omega_max" else self.values

    @property
    def gain(self) -> Floats:
        """Gain, shape (kinds, n), mean over the repeats."""
        return self.samples.mean(axis=(2, 3))

    @property
    def gain_stderr(self) -> Floats:
        """Monte Carlo standard error of the gain, which all steps have in common."""
        return _stderr(self.samples.mean(axis=2))

    @cached_property
    def _differences(self) -> Floats:
        """Gain minus that of the exact surface or the finest step, (kinds, n, shifts)."""
        mean = self.samples.mean(axis=2)
        anchor = mean[:, -1:] if self.reference is None else self.reference.samples
        return mean - anchor

    @property
    def anchor(self) -> Floats:
        """Gain that differences are taken from, shape (kinds,): exact, or of the finest step."""
        return self.gain[:, 0] - self.difference[:, 0]

    @property
    def difference(self) -> Floats:
        """Gain minus `anchor`, shape (kinds, n)."""
        return self._differences.mean(axis=2)

    @property
    def difference_stderr(self) -> Floats:
        """Standard error of `difference`: what the common chains leave of the Monte Carlo error."""
        return _stderr(self._differences)

    @cached_property
    def fits(self) -> dict[str, Fit]:
        """The fitted law of each kind of normals, with the gain as `Fit.gain`.

        Notes
        -----
        Least squares, weighted by the standard errors of the differences and a misfit in
        proportion to h^2: what the law leaves out is a share of the error itself. Intervals
        join a bootstrap over the shifts of the chains with that misfit, known from n - 3
        residuals (Student). They leave out `gain_stderr`, which exact and meshed gains share.

        References
        ----------
        L. Eça and M. Hoekstra, J. Comput. Phys. 262, 104 (2014), doi:10.1016/j.jcp.2014.01.006.
        """
        return {
            kind: _fit(self.step, self._differences[k], float(self.anchor[k]))
            for k, kind in enumerate(self.normals)
        }

    @property
    def error(self) -> Floats:
        """Error of one surface, shape (kinds, n): hypot(g - g_0, scatter).

        g_0 is the gain over the exact surface, or else the fitted one.
        """
        if self.reference is None:
            target = np.array([self.fits[kind].gain.value for kind in self.normals])
        else:
            target = self.anchor
        return np.hypot(self.gain - target[:, None], np.nan_to_num(self.scatter))

    def recommended(self, tolerance: float | None = None) -> dict[str, float]:
        """Return the coarsest value that errs by less than a tolerance, for each kind of normals.

        Parameters
        ----------
        tolerance : float, optional
            Relative error of one surface; by default that of the study.

        Returns
        -------
        dict of str to float
            Interpolated between the values of the study; nan if none of them is fine enough.
        """
        limit = self.tolerance if tolerance is None else _positive("tolerance", tolerance)
        steps = [_largest_step(self.step, row, limit) for row in self.error / self.gain[:, -1:]]
        values = [1.0 / s if self.parameter == "omega_max" else s for s in steps]
        return dict(zip(self.normals, values, strict=True))

    def to_dataset(self) -> xr.Dataset:
        """Return the study as an xarray Dataset with units and provenance."""
        import xarray as xr

        from meshtrace.fields import attrs

        dims, by_value = ("normals", self.parameter), (self.parameter,)
        one = {"units": "1"}
        variables: dict[str, Any] = {
            "gain": (dims, self.gain, attrs("gain")),
            "gain_stderr": (dims, self.gain_stderr, attrs("gain_stderr")),
            "gain_ballistic": (dims, self.ballistic.mean(axis=2), attrs("gain_ballistic")),
            "difference": (dims, self.difference, one),
            "difference_stderr": (dims, self.difference_stderr, one),
            "scatter": (dims, self.scatter, one),
            "error": (dims, self.error, one),
            "mss": (dims, self.slope_variance, attrs("mss")),
            "total_reflection": (dims, self.total_reflection, one),
        }
        for name, seconds in self.costs._asdict().items():
            variables[f"{name}_time"] = (dims, seconds, {"units": "s"})
        for name in ("order", "gain"):
            limits = np.array([getattr(self.fits[kind], name) for kind in self.normals])
            variables[f"fitted_{name}"] = (("normals", "limit"), limits, one)
        variables["recommended"] = ("normals", list(self.recommended().values()))
        if self.reference is not None:
            variables["exact_gain"] = ((), self.reference.gain, attrs("gain"))
            variables["exact_gain_ballistic"] = (
                (),
                self.reference.ballistic,
                attrs("gain_ballistic"),
            )
            variables["exact_mss"] = ((), self.reference.slope_variance, attrs("mss"))
        units = {"spacing": "m", "time_step": "s", "omega_max": "rad s-1"}[self.parameter]
        coordinates = {
            "normals": list(self.normals),
            "limit": ["value", "low", "high"],
            self.parameter: (by_value, self.values, {"units": units}),
        }
        return xr.Dataset(
            variables,
            coordinates,
            {
                "title": f"meshtrace convergence in {self.parameter}",
                "format_version": FORMAT_VERSION,
                "kind": "convergence",
                "tolerance": self.tolerance,
                "provenance": json.dumps(self.provenance),
            },
        )

    def save(self, path: str | Path) -> None:
        """Write the study as netCDF."""
        self.to_dataset().to_netcdf(path, engine="h5netcdf")

    def summary(self) -> str:
        """Return the study as a table of text, errors in percent of the gain."""
        unit = {"spacing": "m", "time_step": "s", "omega_max": "rad/s"}[self.parameter]
        blocks = [self._table(k, kind, unit) for k, kind in enumerate(self.normals)]
        return "\n\n".join(blocks)

    def _table(self, k: int, kind: str, unit: str) -> str:
        name = f"{self.parameter} [{unit}]"
        base = "the exact surface" if self.reference else "the finest"
        lines = [
            f"{kind} normals, differences from {base} in percent",
            f"{name:>18}{'gain':>12}{'difference':>12}{'stderr':>9}{'scatter':>9}"
            f"{'slope var.':>12}{'total refl.':>12}{'mesh s':>8}{'BVH s':>8}{'gain s':>8}",
        ]
        percent = 100.0 / self.anchor[k]
        for j, value in enumerate(self.values):
            lines.append(
                f"{value:>18g}{self.gain[k, j]:>12.4e}{percent * self.difference[k, j]:>+12.4f}"
                f"{percent * self.difference_stderr[k, j]:>9.4f}"
                f"{percent * self.scatter[k, j]:>9.4f}{self.slope_variance[k, j]:>12.6f}"
                f"{self.total_reflection[k, j]:>12.5f}"
                + "".join(f"{seconds[k, j]:>8.3f}" for seconds in self.costs)
            )
        order, gain, _ = self.fits[kind]
        lines.append(f"order {order.value:.2f} ({order.low:.2f} to {order.high:.2f}, 95 %)")
        lines.append(f"Richardson {gain.value:.5e} ({gain.low:.5e} to {gain.high:.5e}, 95 %)")
        if self.reference is not None:
            inside = "inside" if gain.low <= self.reference.gain <= gain.high else "outside"
            lines.append(f"exact surface {self.reference.gain:.5e}, {inside} that interval")
        best = self.recommended()[kind]
        said = f"finer than {self.values[-1]:g}" if math.isnan(best) else f"{best:.3g}"
        lines.append(
            f"Monte Carlo error of all {100.0 * self.gain_stderr[k, -1] / self.gain[k, -1]:.2g} %; "
            f"{self.parameter} for an error of {100.0 * self.tolerance:g} %: {said} {unit}"
        )
        return "\n".join(lines)


def convergence_study(
    link: Link,
    sea: SurfaceModel,
    spacings: Sequence[float] = DEFAULT_SPACINGS,
    normals: Sequence[Normals] = ("vertex", "facet"),
    *,
    photons: int = 2048,
    seed: int = 1,
    time: float = 0.0,
    placements: int = 16,
    reference: Literal["analytic"] | None = "analytic",
    tolerance: float = 1e-3,
    receiver: int = 0,
    threads: int | None = None,
    progress: Progress | None = None,
) -> ConvergenceStudy:
    """Return how the gain over a sea depends on the spacing of its mesh.

    Parameters
    ----------
    link : Link
        The link.
    sea : SurfaceModel
        The sea, triangulated uniformly over all that light can cross to the receiver.
    spacings : sequence of float
        At least four mesh spacings [m].
    normals : sequence of {"vertex", "facet"}
        Normals of the mesh.
    photons : int
        Scattering chains, common to all meshes.
    seed : int
        Key of the random numbers.
    time : float
        Time of the sea [s].
    placements : int
        Meshes of each spacing, moved against the sea by parts of a cell; 1 keeps one mesh, whose
        lines go through the origin.
    reference : "analytic" or None
        Whether to find the gain over the exact sum of waves too.
    tolerance : float
        Relative error that the recommended spacing is about.
    receiver : int
        Index of the receiver.
    threads : int, optional
        Threads, all cores by default; the result does not depend on them.
    progress : callable, optional
        Called with 1 after each mesh.

    Returns
    -------
    ConvergenceStudy

    Raises
    ------
    ValueError
        If an option is out of range, or the exact surface is asked for and the sea is not a
        sum of waves.

    Notes
    -----
    The aperture sees the unscattered light through a patch of a few centimetres, mostly on one
    facet. There the curvature of a mesh is wrong by O(h), up or down by chance of where the
    facet lies. The mean over placements is free of it and converges as h^2; what one
    placement errs by is `scatter`.

    Examples
    --------
    >>> import meshtrace as mt
    >>> from meshtrace.surfaces import SinusoidalSea
    >>> wave = SinusoidalSea(amplitude=0.05, wavelength=4.0)
    >>> study = convergence_study(
    ...     mt.Link(), wave, (1.0, 0.5, 0.25, 0.125), ("vertex",), photons=256
    ... )
    >>> 1.6 < study.fits["vertex"].order.value < 2.2
    True
    """
    values = _falling("spacings", spacings)
    kinds = _kinds(normals)
    _positive("tolerance", tolerance)
    if placements < 1:
        raise ValueError(f"placements: {placements!r}, allowed placements >= 1")
    if reference not in ("analytic", None):
        raise ValueError(f"reference: {reference!r}, allowed 'analytic' or None")
    exact = _wave_sum(sea) if reference else None
    chains = _Chains(link, photons, seed, kinds, receiver, _crest(link, sea, time))
    shifts = _placements(placements)

    def measure(job: tuple[float, Floats]) -> _Measured:
        spacing, shift = job
        start = clock.perf_counter()
        mesh = _nested_mesh(link, sea, time, spacing, shift)
        return chains.measure(mesh, clock.perf_counter() - start, photons=_ANALOG_PHOTONS)

    jobs = list(product(values, shifts))
    rows = _mapped(measure, jobs, threads, progress)
    samples, ballistic, slopes, reflected, costs = _stacked(rows, len(values))
    run = {
        "estimator": "forced", "photons": photons, "seed": seed, "time": time,
        "spacings": list(values), "normals": list(kinds), "placements": placements,
        "receiver": receiver,
    }  # fmt: skip
    return ConvergenceStudy(
        parameter="spacing",
        values=np.array(values),
        normals=kinds,
        samples=samples,
        ballistic=ballistic,
        scatter=_spread(samples.mean(axis=3)),
        slope_variance=slopes.mean(axis=2),
        total_reflection=reflected.mean(axis=2),
        costs=costs,
        reference=chains.exact(exact, time, values[-1]) if exact else None,
        tolerance=tolerance,
        provenance=provenance(link, sea.to_config(), run),
    )


def time_step_study(
    link: Link,
    sea: SurfaceModel,
    steps: Sequence[float],
    *,
    duration: float,
    start: float = 0.0,
    normals: Sequence[Normals] = ("vertex",),
    photons: int = 2048,
    seed: int = 1,
    spacing: float | None = None,
    tolerance: float = 1e-2,
    receiver: int = 0,
    threads: int | None = None,
    progress: Progress | None = None,
) -> ConvergenceStudy:
    """Return how the mean gain over a moving sea depends on the time step.

    Parameters
    ----------
    link : Link
        The link.
    sea : SurfaceModel
        The sea.
    steps : sequence of float
        At least four time steps [s], all multiples of the shortest.
    duration : float
        Length of the series [s], a multiple of every step.
    start : float
        Its beginning [s].
    spacing : float, optional
        Spacing of the mesh [m], by default that of `Link.footprint`.
    normals, photons, seed, tolerance, receiver, threads, progress
        As in `convergence_study`.

    Returns
    -------
    ConvergenceStudy
        `gain` is the mean over the series (trapezoidal rule), `scatter` the rms error of
        linear interpolation between its times.
    """
    values, kinds = _falling("steps", steps), _kinds(normals)
    finest = 0.5 * values[-1]
    strides = [_whole("steps", value / finest) for value in values]
    n = _whole("duration", _positive("duration", duration) / finest)
    for value, stride in zip(values, strides, strict=True):
        if n % stride:
            raise ValueError(f"duration: {duration!r}, allowed multiples of the step {value:g} s")
    chains = _Chains(link, photons, seed, kinds, receiver, _crest(link, sea, start))

    def measure(i: int) -> _Measured:
        began = clock.perf_counter()
        mesh = mesh_for(chains.link, sea, start + i * finest, None, spacing, chains.reach)[0]
        return chains.measure(mesh, clock.perf_counter() - began)

    frames, ballistic, slopes, reflected, costs = _stacked(
        _mapped(measure, range(n + 1), threads, progress), 1
    )
    by_shift = frames[:, 0]  # (kinds, frames, shifts)
    each = by_shift.mean(axis=2)
    shape = len(kinds), len(values)
    run = {
        "estimator": "forced", "photons": photons, "seed": seed, "start": start,
        "duration": duration, "steps": list(values), "spacing": spacing, "normals": list(kinds),
        "receiver": receiver,
    }  # fmt: skip
    return ConvergenceStudy(
        parameter="time_step",
        values=np.array(values),
        normals=kinds,
        samples=np.stack([_time_mean(by_shift, s) for s in strides], axis=1)[:, :, None],
        ballistic=np.stack([_time_mean(ballistic[:, 0], s) for s in strides], axis=1)[:, :, None],
        scatter=np.stack([_interpolation_error(each, s) for s in strides], axis=1),
        slope_variance=np.broadcast_to(slopes.mean(axis=2), shape),
        total_reflection=np.broadcast_to(reflected.mean(axis=2), shape),
        costs=Costs(*(np.broadcast_to(seconds, shape) for seconds in costs)),
        tolerance=_positive("tolerance", tolerance),
        provenance=provenance(link, sea.to_config(), run),
    )


def band_limit_study(
    link: Link,
    sea: SurfaceModel,
    omega_max: Sequence[float],
    *,
    realizations: int = 16,
    normals: Sequence[Normals] = ("vertex",),
    photons: int = 2048,
    seed: int = 1,
    time: float = 0.0,
    spacing: float = 0.1,
    tolerance: float = 1e-2,
    receiver: int = 0,
    threads: int | None = None,
    progress: Progress | None = None,
) -> ConvergenceStudy:
    """Return how the mean gain over a random sea depends on its shortest waves.

    Parameters
    ----------
    link : Link
        The link.
    sea : SurfaceModel
        A sea with `omega_max` and random phases.
    omega_max : sequence of float
        At least four band limits [rad s-1].
    realizations : int
        Realizations of the phases, common to all limits: a wider band adds waves to those of a
        narrower one.
    spacing : float
        Spacing of the mesh [m]; a few to the shortest wave.
    normals, photons, seed, time, tolerance, receiver, threads, progress
        As in `convergence_study`.

    Returns
    -------
    ConvergenceStudy
        Its step is 1 / omega_max.

    Notes
    -----
    The mean square slope of a spectrum with an omega^-5 tail grows as log omega_max: without a
    model of the waves left out there is nothing that this study could converge to.
    """
    values = _falling("omega_max", omega_max)[::-1]
    kinds = _kinds(normals)
    if realizations < 1:
        raise ValueError(f"realizations: {realizations!r}, allowed realizations >= 1")
    copy, fields = getattr(sea, "model_copy", None), getattr(type(sea), "model_fields", {})
    if copy is None or not {"omega_max", "seed"} <= set(fields):
        raise ValueError(f"sea: {type(sea).__name__}, allowed a random sea with omega_max")
    chains = _Chains(link, photons, seed, kinds, receiver, _crest(link, sea, time))
    nothing = np.zeros(2)

    def measure(job: tuple[float, int]) -> _Measured:
        limit, i = job
        began = clock.perf_counter()
        phases = int(np.random.SeedSequence([seed, i]).generate_state(1)[0])
        wide = copy(update={"omega_max": limit, "seed": phases})
        mesh = _nested_mesh(link, wide, time, _positive("spacing", spacing), nothing)
        return chains.measure(mesh, clock.perf_counter() - began, photons=_ANALOG_PHOTONS)

    jobs = list(product(values, range(realizations)))
    rows = _mapped(measure, jobs, threads, progress)
    samples, ballistic, slopes, reflected, costs = _stacked(rows, len(values))
    gain = samples.mean(axis=3)
    run = {
        "estimator": "forced", "photons": photons, "seed": seed, "time": time,
        "omega_max": list(values), "realizations": realizations, "spacing": spacing,
        "normals": list(kinds), "receiver": receiver,
    }  # fmt: skip
    return ConvergenceStudy(
        parameter="omega_max",
        values=np.array(values),
        normals=kinds,
        samples=samples,
        ballistic=ballistic,
        scatter=_spread(gain - gain[:, -1:]),
        slope_variance=slopes.mean(axis=2),
        total_reflection=reflected.mean(axis=2),
        costs=costs,
        tolerance=_positive("tolerance", tolerance),
        provenance=provenance(link, sea.to_config(), run),
    )


def study_scenario(
    scenario: Scenario, spacings: Sequence[float] = DEFAULT_SPACINGS, **options: Any
) -> ConvergenceStudy:
    """Return the convergence study of a link file, see `convergence_study` for the options.

    Raises
    ------
    ScenarioError
        If the surface is a mesh from a file, or an option is out of range.
    """
    from meshtrace.scenario import ScenarioError

    sea = scenario.surface
    if not isinstance(sea, SurfaceModel):
        raise ScenarioError("sea.mesh: a mesh as it is, allowed: a sea, which has any spacing")
    defaults = {
        "seed": scenario.run.seed,
        "time": scenario.sampling.time,
        "threads": scenario.run.threads,
        "reference": "analytic" if isinstance(sea, WaveSum) else None,
    }
    try:
        return convergence_study(scenario.link, sea, spacings, **{**defaults, **options})
    except ValueError as error:
        raise ScenarioError(str(error)) from error


class _Measured(NamedTuple):
    """What one surface gave, each by kind of normals."""

    samples: Floats  # (kinds, shifts)
    ballistic: Floats
    slope_variance: Floats
    total_reflection: Floats
    seconds: Floats  # (3, kinds) mesh, BVH, gain


class _Chains:
    """One set of chains for every surface of a study."""

    def __init__(
        self,
        link: Link,
        photons: int,
        seed: int,
        kinds: tuple[Normals, ...],
        receiver: int,
        crest: float,
    ) -> None:
        if not 0 <= receiver < len(link.receivers):
            raise ValueError(f"receiver: {receiver!r}, allowed 0..{len(link.receivers) - 1}")
        if not photons >= 1:
            raise ValueError(f"photons: {photons!r}, allowed photons >= 1")
        self.link = link.model_copy(update={"receiver": link.receivers[receiver]})
        self.reach = crossing_reach(self.link)
        self._seed = seed
        self._made = (photons, seed), crest
        self._forced = {
            kind: ForcedDetection(self.link, photons, seed, kind, 1, crest) for kind in kinds
        }

    def measure(self, mesh: TriangleMesh, mesh_seconds: float, photons: int = 0) -> _Measured:
        """Return what a mesh gives; `photons` are for the share of total reflection."""
        start = clock.perf_counter()
        intersector = EmbreeIntersector(mesh, 1)
        bvh_seconds = clock.perf_counter() - start
        rows = []
        for kind, forced in self._forced.items():
            start = clock.perf_counter()
            parts = forced.evaluate(mesh, intersector)
            seconds = mesh_seconds, bvh_seconds, clock.perf_counter() - start
            rows.append(
                (
                    parts.ballistic[0] + parts.scattered[0],
                    parts.ballistic[0],
                    _slope_variance(intersector, kind, self.reach),
                    _total_reflection(self.link, intersector, kind, photons, self._seed),
                    seconds,
                )
            )
        samples, ballistic, slopes, reflected, seconds_by_kind = zip(*rows, strict=True)
        return _Measured(
            np.array(samples),
            np.array(ballistic),
            np.array(slopes),
            np.array(reflected),
            np.array(seconds_by_kind).T,
        )

    def exact(self, sea: WaveSum, time: float, spacing: float) -> Reference:
        """Return the gain over the sum of waves; a mesh of some spacing names the crossings."""
        (photons, seed), crest = self._made
        forced = _OverWaves(self.link, photons, seed, "vertex", 1, crest)
        scattered, ballistic, error = forced.over(sea, time, spacing)
        x, y = _probes(self.reach)
        slope_x, slope_y = sea.slopes(x, y, time)
        return Reference(
            ballistic + scattered, ballistic, error, float(np.mean(slope_x**2 + slope_y**2))
        )


class _OverWaves(ForcedDetection):
    """The same chains over the sum of waves itself."""

    def over(self, sea: WaveSum, time: float, spacing: float) -> tuple[Floats, float, float]:
        """Return scattered gain by shift, unscattered gain and its error."""
        mesh = _nested_mesh(self.link, sea, time, spacing, np.zeros(2))
        aimed, waves = self._over(mesh), _waves(sea, time)
        scattered, direct = np.zeros(SHIFTS), np.zeros(2)
        for power, emitter, strata in zip(self._power, self._emitters, self._strata, strict=True):
            scene = aimed._scene(emitter, self._targets[0])
            for stratum in strata:
                _, arrivals = aimed.aim(emitter, self._targets[0], 0, stratum, keep=True)
                score = np.zeros(len(stratum.audit))
                analytic.move_crossings(
                    stratum.chains, arrivals, waves, scene, score,
                    np.zeros(analytic.N_COUNTERS, np.int64),
                )  # fmt: skip
                scattered += power * score.reshape(SHIFTS, -1).mean(axis=1)
            lit = mesh.faces[np.flatnonzero(aimed.facet_gains(emitter, self._targets[0]))]
            crossings = mesh.vertices[lit].mean(axis=1)
            coarse, fine = (_direct(waves, scene, crossings, n) for n in (4, 8))
            if abs(fine - coarse) > _QUADRATURE_ERROR * fine:  # a caustic lies on the aperture
                coarse, fine = self._finely_meshed(sea, time, emitter, crossings, spacing)
            direct += power * np.array([fine, abs(fine - coarse)])
        return scattered, float(direct[0]), float(direct[1])

    def _finely_meshed(
        self, sea: WaveSum, time: float, emitter: Emitter, crossings: Floats, spacing: float
    ) -> tuple[float, float]:
        """Return the unscattered gain of two meshes where light crosses, the finer extrapolated.

        The image of a mesh adds up at a caustic, where the light on a point has no bound.
        """
        low, high = crossings[:, :2].min(axis=0), crossings[:, :2].max(axis=0)
        extent = 0.5 * float((high - low).max()) + 2.0 * spacing
        center = tuple(0.5 * (low + high))
        gains = []
        for parts in (8, 16):
            mesh = sea.mesh(time, extent, max(spacing / parts, extent / 500.0), center=center)
            gains.append(self._over(mesh).ballistic(emitter, self._targets[0]))
        return gains[1], gains[1] + (gains[1] - gains[0]) / 3.0


def _direct(waves: analytic.Waves, scene: Scene, crossings: Floats, rings: int) -> float:
    """Return the unscattered gain by quadrature over the aperture."""
    points = _aperture_points(rings)
    score, room = np.zeros(len(points.weight)), np.empty((len(crossings), 2))
    ray, forward = np.zeros(3), np.array([0.0, 0.0, 1.0])
    analytic.direct_light(points, crossings, waves, scene, ray, forward, room, score)
    return float(score.sum())


def _aperture_points(rings: int) -> Chains:
    """Return points of the unit disk with weights that add to 1, as chains that never scatter.

    Gauss-Legendre in the square of the radius, equal steps in azimuth.
    """
    node, weight = np.polynomial.legendre.leggauss(rings)
    radius, azimuths = np.sqrt(0.5 * (1.0 + node)), 3 * rings
    azimuth = 2.0 * math.pi * (np.arange(azimuths) + 0.5) / azimuths
    disk = radius[:, None, None] * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    n = rings * azimuths
    return Chains(
        vertex=np.zeros((n, 0, 3)),
        kind=np.zeros((n, 0), np.int8),
        last=np.zeros((n, 3)),
        path=np.zeros(n),
        weight=np.repeat(0.5 * weight / azimuths, azimuths),
        disk=disk.reshape(n, 2),
    )


def _waves(sea: WaveSum, time: float) -> analytic.Waves:
    waves = sea.components
    return analytic.Waves(
        np.ascontiguousarray(waves.amplitude),
        np.ascontiguousarray(waves.kx),
        np.ascontiguousarray(waves.ky),
        waves.omega * time + waves.phase,
    )


def _nested_mesh(
    link: Link, sea: SurfaceModel, time: float, spacing: float, shift: Floats
) -> TriangleMesh:
    """Return a uniform mesh over all crossings, `shift` in periods of its triangles off the origin.

    Without a shift the lines lie at the multiples of the spacing, so that they nest when it halves.
    """
    cells = math.ceil((crossing_reach(link) + _MARGIN) / spacing) + 1
    x, y = 2.0 * spacing * shift
    mesh = sea.mesh(time, cells * spacing, spacing, center=(float(x), float(y)))
    return mesh_for(link, mesh)[0]  # refuses one that does not suit the link


def _crest(link: Link, sea: SurfaceModel, time: float) -> float:
    """Return about how high the sea rises where light crosses [m]."""
    return float(_nested_mesh(link, sea, time, 0.5, np.zeros(2)).bounds[1, 2])


def _placements(n: int) -> Floats:
    """Return shifts of a mesh in periods of its triangles (two cells), (n, 2): a lattice."""
    if n == 1:
        return np.zeros((1, 2))
    step = next(a for a in range(round(n / 1.618), n + 1) if math.gcd(a, n) == 1)
    k = np.arange(n)
    return np.stack([(k + 0.5) / n, (step * k / n + 0.5 / n) % 1.0], axis=1) - 0.5


def _probes(reach: float) -> tuple[Floats, Floats]:
    """Return the points (x, y) at which slopes are compared."""
    axis = reach * ((2.0 * np.arange(_PROBES) + 1.0) / _PROBES - 1.0)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    return x.ravel(), y.ravel()


def _slope_variance(intersector: EmbreeIntersector, kind: Normals, reach: float) -> float:
    """Return the mean square slope of the normals that light meets, along plus across."""
    x, y = _probes(reach)
    mesh = intersector.mesh
    top = np.full(len(x), mesh.bounds[1, 2] + 1.0)
    down = np.broadcast_to((0.0, 0.0, -1.0), (len(x), 3))
    hits = intersector.intersect(np.stack([x, y, top], axis=1), down)
    seen = hits.facet >= 0
    facet, u, v = hits.facet[seen], hits.u[seen, None], hits.v[seen, None]
    if kind == "facet":
        normal = mesh.face_normals[facet]
    else:
        a, b, c = (mesh.vertex_normals[mesh.faces[facet, i]] for i in range(3))
        normal = (1.0 - u - v) * a + u * b + v * c
    return float(np.mean((normal[:, 0] ** 2 + normal[:, 1] ** 2) / normal[:, 2] ** 2))


def _total_reflection(
    link: Link, intersector: EmbreeIntersector, kind: Normals, photons: int, seed: int
) -> float:
    """Return the share of the photons coming from below that are totally reflected."""
    if photons == 0:
        return math.nan
    physics = link.physics.model_copy(
        update={"reflected": "kill", "second_hit": "ignore", "absorption": "analog"}
    )
    sums = run_analog(
        link.model_copy(update={"physics": physics}),
        intersector,
        photons=photons,
        seed=seed,
        normals=kind,
    )
    # a photon counts as landed if any of its light leaves: what counts as reflected left none
    reflected = int(sums.count[Fate.REFLECTED])
    met = reflected + int(sums.count[Fate.LANDED]) + int(sums.count[Fate.RECEIVED])
    return reflected / met if met else math.nan


def _fit(step: Floats, differences: Floats, anchor: float) -> Fit:
    """Fit g_0 + C h^p to differences (n, shifts) from an anchor, with 95 % intervals."""
    n, shifts = differences.shape
    h = step / step[0]
    y = differences.mean(axis=1)
    order, offset, slope = _least_squares(h, y[None], h**2)
    left = (y - offset - slope * h**order) / h**2
    misfit = math.sqrt(np.sum(left**2) / (n - 3)) * h**2
    sigma = np.hypot(_stderr(differences), misfit) + 1e-300
    order, offset, slope = _least_squares(h, y[None], sigma)
    rng = np.random.default_rng(n * shifts)
    resampled = differences[:, rng.integers(shifts, size=(_REPLICATES, shifts))].mean(axis=2).T
    # the size of the misfit is itself known from n - 3 residuals only: Student's distribution
    scale = np.sqrt((n - 3) / rng.chisquare(n - 3, (_REPLICATES, 1)))
    noise = resampled - y + misfit * scale * rng.standard_normal((_REPLICATES, n))
    orders, offsets, _ = _least_squares(h, offset + slope * h**order + noise, sigma)
    tail = 0.5 * (1.0 - _LEVEL)
    limits = np.quantile([orders, offsets], (tail, 1.0 - tail), axis=1)
    return Fit(
        Interval(float(order[0]), *map(float, limits[:, 0])),
        Interval(anchor + float(offset[0]), *(anchor + float(v) for v in limits[:, 1])),
        float(slope[0] * step[0] ** -order[0]),
    )


def _least_squares(h: Floats, y: Floats, sigma: Floats) -> tuple[Floats, Floats, Floats]:
    """Return p, g_0 and C for each row of y (rows, n), errors in proportion to sigma.

    For a given order the law is linear: the best order is looked up on a fine grid.
    """
    weight = (sigma / sigma.max()) ** -2
    weight /= weight.sum()
    power = h ** _ORDERS[:, None]
    power_mean = power @ weight
    power = power - power_mean[:, None]
    mean = y @ weight
    covariance = (weight * (y - mean[:, None])) @ power.T  # (rows, orders)
    variance = (weight * power**2).sum(axis=1)
    best = np.argmax(covariance**2 / variance, axis=1)
    slope = covariance[np.arange(len(y)), best] / variance[best]
    return _ORDERS[best], mean - slope * power_mean[best], slope


def _largest_step(step: Floats, error: Floats, limit: float) -> float:
    """Return the largest step from which on all errors stay below a limit, nan if none does."""
    worst = np.maximum(np.maximum.accumulate(error[::-1])[::-1], 1e-300)
    if not worst[-1] <= limit:
        return math.nan
    if worst[0] <= limit:
        return float(step[0])
    j = int(np.argmax(worst <= limit))
    share = math.log(limit / worst[j]) / math.log(worst[j - 1] / worst[j])
    return float(step[j] * (step[j - 1] / step[j]) ** share)


def _time_mean(frames: Floats, stride: int) -> Floats:
    """Return the mean over the times, axis 1, by the trapezoidal rule on every stride-th."""
    return np.trapezoid(frames[:, ::stride], dx=stride, axis=1) / (frames.shape[1] - 1)


def _interpolation_error(frames: Floats, stride: int) -> Floats:
    """Return the rms error of linear interpolation between every stride-th of (kinds, times)."""
    times = np.arange(frames.shape[1])
    guess = np.stack([np.interp(times, times[::stride], row[::stride]) for row in frames])
    between = times % stride != 0
    return np.sqrt(np.mean((frames - guess)[:, between] ** 2, axis=1))


def _stderr(samples: Floats) -> Floats:
    """Return the standard error of the mean over the shifts, the last axis."""
    return samples.std(axis=-1, ddof=1) / math.sqrt(samples.shape[-1])


def _spread(gain: Floats) -> Floats:
    """Return the standard deviation over the repeats, the last axis; nan for a single one."""
    if gain.shape[-1] == 1:
        return np.full(gain.shape[:-1], math.nan)
    return gain.std(axis=-1, ddof=1)


Job = TypeVar("Job")


def _mapped(
    measure: Callable[[Job], _Measured],
    jobs: Iterable[Job],
    threads: int | None,
    progress: Progress | None,
) -> list[_Measured]:
    """Return the result of every job, in their order."""
    rows = []
    with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
        for row in pool.map(measure, jobs):
            rows.append(row)
            if progress is not None:
                progress(1)
    return rows


def _stacked(rows: list[_Measured], steps: int) -> tuple[Floats, Floats, Floats, Floats, Costs]:
    """Return samples (kinds, steps, repeats, shifts), three more of its kind, and mean costs."""

    def by_step(name: str) -> Floats:
        values = np.stack([getattr(row, name) for row in rows])
        return np.moveaxis(values.reshape(steps, -1, *values.shape[1:]), 2, 0)

    seconds = np.stack([row.seconds for row in rows])  # (jobs, 3, kinds)
    means = seconds.reshape(steps, -1, *seconds.shape[1:]).mean(axis=1)
    return (
        by_step("samples"),
        by_step("ballistic"),
        by_step("slope_variance"),
        by_step("total_reflection"),
        Costs(*(means[:, i].T for i in range(3))),
    )


def _falling(name: str, values: Sequence[float]) -> list[float]:
    """Return values from large to small."""
    given = sorted((_positive(name, value) for value in values), reverse=True)
    if len(given) < 4 or len(set(given)) < len(given):
        raise ValueError(f"{name}: {list(values)}, allowed at least four different values")
    return given


def _wave_sum(sea: SurfaceModel) -> WaveSum:
    if not isinstance(sea, WaveSum):
        raise ValueError(
            f"reference: 'analytic' for {type(sea).__name__}, allowed None: not a sum of waves"
        )
    return sea


def _kinds(normals: Sequence[Normals]) -> tuple[Normals, ...]:
    kinds = tuple(dict.fromkeys(normals))
    if not kinds or not set(kinds) <= {"vertex", "facet"}:
        raise ValueError(f"normals: {normals!r}, allowed vertex and facet")
    return kinds


def _positive(name: str, value: float) -> float:
    if not (math.isfinite(value) and value > 0.0):
        raise ValueError(f"{name}: {value!r}, allowed finite, > 0")
    return float(value)


def _whole(name: str, ratio: float) -> int:
    """Return the integer that a ratio is up to rounding."""
    if abs(ratio - round(ratio)) > 1e-9 * ratio:
        raise ValueError(f"{name}: {ratio:g} half-steps, allowed multiples of the shortest step")
    return round(ratio)
