"""Convergence of a gain with the mesh of the sea or a body, the time step or the band of waves.

A study repeats one gain with a finer and finer discretisation and common random numbers: the
same scattering chains are aimed over every surface, so that differences of 1e-4 show under a
Monte Carlo error of 1e-3. To the gains g at steps h it fits

    g(h) = g_0 + C h^p

for the order p and the value g_0 at vanishing step (Richardson), and beside it stands the gain
over the exact sum of waves, with the same chains.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import product
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Unpack

import numpy as np
from pydantic import Field

from meshtrace.checks import Positive, check_call
from meshtrace.engine.setup.meshing import mesh_for
from meshtrace.engine.setup.options import Meshing, StudyOptions
from meshtrace.errors import Described, Refused, require_whole
from meshtrace.fields import attrs
from meshtrace.kernels.random import realization_seed
from meshtrace.link import Link
from meshtrace.mesh import MeshSource, SurfaceModel, TriangleMesh
from meshtrace.models import Floats
from meshtrace.results.tallies import error_of_groups
from meshtrace.scenario import Scenario
from meshtrace.stored import SHIFTS, Part, Stored, Variable
from meshtrace.studies.campaign import Steps, campaign_of
from meshtrace.studies.refinement import (
    CommonChains,
    Fit,
    Normals,
    Reference,
    Unresolved,
    descending,
    fit_law,
    is_wave_sum,
    largest_step,
    multiple_of,
    nested_mesh,
    placement_shifts,
    spread,
    wave_sum,
)

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True, eq=False, repr=False)
class ConvergenceStudy(Stored, kind="convergence", title="meshtrace convergence"):
    """Gain of one link against a parameter of the discretisation.

    Attributes
    ----------
    parameter : {"spacing", "time_step", "omega_max", "facet_size"}
        Refined parameter.
    values : ndarray, shape (n,)
        Its values, from coarse to fine: spacing [m], time step [s], band limit [rad s-1], or root
        of the mean area of the facets of a body [m].
    normals : tuple of str, shape (kinds,)
        Normals of the mesh.
    samples : ndarray, shape (kinds, n, repeats, shifts)
        Gain by repeat (placement of the mesh, or realization) and shift of the chains.
    ballistic : ndarray, shape (kinds, n, repeats)
        Unscattered gain.
    scatter : ndarray, shape (kinds, n)
        Error of a single surface around the mean error of its step: standard deviation over
        placements of the mesh, or over realizations of the difference to the widest band, or
        rms error of linear interpolation in time.
    slope_variance, total_reflection : ndarray, shape (kinds, n)
        Mean square slope that light meets; share of the photons arriving from below that are
        totally reflected. nan unless requested.
    mesh_time, bvh_time, evaluation_time : ndarray, shape (kinds, n)
        Time for mesh, BVH and gain of one surface [s].
    reference : Reference or None
        The exact surface.
    tolerance : float
        Relative error that `recommended` is about.
    provenance : dict
        Versions, configuration and seeds.
    """

    parameter: str
    values: Annotated[Floats, Variable("step", name="step")]
    normals: Annotated[tuple[Normals, ...], Variable("normals")]
    samples: Annotated[Floats, Variable("normals", "step", "repeat", "shift")]
    ballistic: Annotated[Floats, Variable("normals", "step", "repeat", name="samples_ballistic")]
    scatter: Annotated[Floats, Variable("normals", "step")]
    slope_variance: Annotated[Floats, Variable("normals", "step", name="mss")]
    total_reflection: Annotated[Floats, Variable("normals", "step")]
    mesh_time: Annotated[Floats, Variable("normals", "step")]
    bvh_time: Annotated[Floats, Variable("normals", "step")]
    evaluation_time: Annotated[Floats, Variable("normals", "step")]
    reference: Annotated[Reference | None, Part(Reference)] = None
    tolerance: float = 1e-3
    provenance: dict[str, Any] = field(default_factory=dict)

    _step_name: ClassVar[str] = "parameter"  # field that names the dimension `step` in a file

    @property
    def step(self) -> Floats:
        """Step h that goes to zero: the values, or one over the band limit [s rad-1]."""
        return 1.0 / self.values if self.parameter == "omega_max" else self.values

    @property
    def gain(self) -> Floats:
        """Gain, shape (kinds, n), mean over the repeats."""
        return self.samples.mean(axis=(2, 3))

    @property
    def gain_stderr(self) -> Floats:
        """Monte Carlo standard error of the gain, which all steps share through their chains."""
        return error_of_groups(self.samples.mean(axis=2), -1)

    @cached_property
    def _differences(self) -> Floats:
        """Gain minus the gain of the exact surface or the finest step, (kinds, n, shifts)."""
        mean = self.samples.mean(axis=2)
        # chains are common to all steps: shift by shift the difference has little noise
        anchor = mean[:, -1:] if self.reference is None else self.reference.samples
        return mean - anchor

    @property
    def anchor(self) -> Floats:
        """Gain that differences are taken from, shape (kinds,): exact, or of the finest step."""
        # gain less difference is the same at all steps: the first stands for them
        return self.gain[:, 0] - self.difference[:, 0]

    @property
    def difference(self) -> Floats:
        """Gain minus `anchor`, shape (kinds, n)."""
        return self._differences.mean(axis=2)

    @property
    def difference_stderr(self) -> Floats:
        """Standard error of `difference`, the Monte Carlo error left by the common chains."""
        return error_of_groups(self._differences, -1)

    @property
    def _placement_error(self) -> Floats | None:
        """Standard error of the means over placements, (kinds, n); None where it is fitted."""
        placements = self.samples.shape[2]
        # realizations and time steps have no placements
        placed = self.parameter == "spacing" and placements > 1
        # placements are a lattice over a cell: a mean over n of them errs as 1 / n, where one over
        # random placements would err as 1 / sqrt(n)
        return self.scatter / placements if placed else None

    @property
    def mean_stderr(self) -> Floats:
        """Standard error of `difference` by the chains and the placements, shape (kinds, n)."""
        placing = 0.0 if self._placement_error is None else self._placement_error
        return np.hypot(self.difference_stderr, placing)

    @cached_property
    def fits(self) -> dict[str, Fit]:
        """Fitted law of each kind of normals, with the gain as `Fit.gain`.

        Notes
        -----
        Least squares, weighted by the standard errors of the differences and a misfit. The
        misfit is the scatter over the placements divided by their number, which is how the mean
        over a lattice errs, or else a term in proportion to h^2 that the law leaves out; its size
        is that by which the residuals exceed their standard errors (Paule and Mandel 1982).
        Intervals join a bootstrap over the shifts of the chains with that misfit, known from
        n - 3 residuals (Student). They leave out `gain_stderr`, which exact and meshed gains
        share.

        References
        ----------
        L. Eça and M. Hoekstra, J. Comput. Phys. 262, 104 (2014), doi:10.1016/j.jcp.2014.01.006.
        """
        placing = self._placement_error
        return {
            kind: fit_law(
                self.step,
                self._differences[k],
                float(self.anchor[k]),
                None if placing is None else placing[k],
            )
            for k, kind in enumerate(self.normals)
        }

    @property
    def error(self) -> Floats:
        """Error of one surface, shape (kinds, n): hypot(g - g_0, scatter).

        g_0 is the gain over the exact surface, or else the fitted one.
        """
        if self.reference is None:
            # no exact surface: the extrapolated gain stands for it
            target = np.array([self.fits[kind].gain.value for kind in self.normals])
        else:
            target = self.anchor
        return np.hypot(self.gain - target[:, None], np.nan_to_num(self.scatter))

    def recommended(self, tolerance: Positive | None = None) -> dict[str, float]:
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
        limit = self.tolerance if tolerance is None else tolerance
        # errors are relative to the gain of the finest step, which errs least
        steps = [largest_step(self.step, row, limit) for row in self.error / self.gain[:, -1:]]
        values = [1.0 / s if self.parameter == "omega_max" else s for s in steps]
        return dict(zip(self.normals, values, strict=True))

    def _content(self) -> xr.Dataset:
        dims, unit = ("normals", self.parameter), {"units": "1"}
        variables: dict[str, Any] = {
            "gain": (dims, self.gain, attrs("gain")),
            "gain_stderr": (dims, self.gain_stderr, attrs("gain_stderr")),
            "gain_ballistic": (dims, self.ballistic.mean(axis=2), attrs("gain_ballistic")),
            "recommended": ("normals", list(self.recommended().values())),
        }
        for name in ("difference", "difference_stderr", "error"):
            variables[name] = (dims, getattr(self, name), unit)
        for name in ("order", "gain"):
            limits = np.array([getattr(self.fits[kind], name) for kind in self.normals])
            variables[f"fitted_{name}"] = (("normals", "limit"), limits, unit)
        if self.reference is not None:
            variables["exact_gain"] = ((), self.reference.gain, attrs("gain"))
        return super()._content().assign(variables).assign_coords(limit=["value", "low", "high"])

    @property
    def _unit(self) -> str:
        return attrs(self.parameter)["units"]

    def _headline(self) -> str:
        advice = ", ".join(f"{kind} {self._recommended(kind)}" for kind in self.normals)
        percent = 100.0 * self.tolerance
        return f"{self.parameter} [{self._unit}] for an error of {percent:g} %: {advice}"

    def _recommended(self, kind: Normals) -> str:
        """Return the recommended value for one kind of normals as text."""
        best = self.recommended()[kind]
        return f"finer than {self.values[-1]:g}" if math.isnan(best) else f"{best:.3g}"

    def summary(self) -> str:
        """Return the study as a table of text, errors in percent of the gain."""
        return "\n\n".join(self._table(kind) for kind in self.normals)

    def _table(self, kind: Normals) -> str:
        """Return the table of the study for one kind of normals as text."""
        k, exact = self.normals.index(kind), self.reference
        percent = 100.0 / self.anchor[k]
        columns = [
            (f"{self.parameter} [{self._unit}]", 18, "g", self.values),
            ("gain", 12, ".4e", self.gain[k]),
            ("unscattered", 12, ".4e", self.ballistic.mean(axis=2)[k]),
            ("difference", 12, "+.4f", percent * self.difference[k]),
            ("stderr", 9, ".4f", percent * self.difference_stderr[k]),
            ("scatter", 9, ".4f", percent * self.scatter[k]),
            ("slope var.", 12, ".6f", self.slope_variance[k]),
            ("total refl.", 12, ".5f", self.total_reflection[k]),
            ("mesh s", 8, ".3f", self.mesh_time[k]),
            ("BVH s", 8, ".3f", self.bvh_time[k]),
            ("gain s", 8, ".3f", self.evaluation_time[k]),
        ]
        base = "the finest" if exact is None else "the exact surface"
        lines = [f"{kind} normals, differences from {base} in percent"]
        lines.append("".join(f"{head:>{width}}" for head, width, _, _ in columns))
        for j in range(len(self.values)):
            # numbers by their digits, nan as a dash, and both flush right
            cells = [
                format("-" if math.isnan(column[j]) else format(column[j], digits), f">{width}")
                for _, width, digits, column in columns
            ]
            lines.append("".join(cells))
        if exact is not None:
            lines.append(
                # 30 blanks: the columns of difference, stderr and scatter, 12 + 9 + 9 wide
                f"{'exact surface':>18}{exact.gain:>12.4e}{exact.ballistic:>12.4e}{'':>30}"
                f"{exact.slope_variance:>12.6f}"
            )
            if exact.lost:
                lines.append(f"{exact.lost} crossings have none of the exact surface next to them")
        return "\n".join([*lines, *self._fitted_lines(kind)])

    def _fitted_lines(self, kind: Normals) -> list[str]:
        """Describe the fitted order, the limit and the recommended step in lines of text."""
        k, exact = self.normals.index(kind), self.reference
        order, gain, _ = self.fits[kind]  # without the coefficient C
        lines = [
            f"order {order.value:.2f} ({order.low:.2f} to {order.high:.2f}, 95 %)",
            f"Richardson {gain.value:.5e} ({gain.low:.5e} to {gain.high:.5e}, 95 %)",
        ]
        if exact is not None:
            inside = "inside" if gain.low <= exact.gain <= gain.high else "outside"
            lines.append(f"exact surface {exact.gain:.5e}, {inside} that interval")
        lines.append(
            f"common Monte Carlo error {100.0 * self.gain_stderr[k, -1] / self.gain[k, -1]:.2g} %; "
            f"{self.parameter} for an error of {100.0 * self.tolerance:g} %: "
            f"{self._recommended(kind)} {self._unit}"
        )
        return lines


DEFAULT_SPACINGS = (2.0, 1.0, 0.5, 0.25, 0.125, 0.0625)
"""Mesh spacings [m] of a study: each halves the one before, so that the grid lines nest."""

PLACEMENTS = 34
"""Meshes of each spacing: a Fibonacci number, whose lattice fills a cell most evenly."""

REALIZATIONS = 16
"""Realizations of the sea for each band."""


@check_call
def convergence_study(
    link: Link | Scenario,
    surface: SurfaceModel | None = None,
    spacings: Sequence[float] = DEFAULT_SPACINGS,
    normals: Sequence[Normals] = ("vertex", "facet"),
    *,
    placements: Annotated[int, Field(ge=1, le=100_000)] = PLACEMENTS,
    reference: Literal["auto", "analytic"] | None = "auto",
    tolerance: Positive = 1e-3,
    receiver: int = 0,
    unresolved: Unresolved = "none",
    **run: Unpack[StudyOptions],
) -> ConvergenceStudy:
    """Study how the gain over a sea depends on the spacing of its mesh.

    Parameters
    ----------
    link : Link or Scenario
        The link, or a scenario.
    surface : SurfaceModel, optional
        The sea, triangulated uniformly over all that light can cross to the receiver.
    spacings : sequence of float
        At least four mesh spacings [m].
    normals : sequence of {"vertex", "facet"}
        Normals of the mesh.
    placements : int
        Meshes of each spacing, moved against the sea by parts of a cell. 1 keeps one mesh, whose
        lines go through the origin.
    reference : {"auto", "analytic"}, optional
        "analytic" also computes the gain over the exact sum of waves; "auto" does so where the sea
        is one and `unresolved` is "none".
    tolerance : float
        Relative error of one surface with the recommended step.
    receiver : int
        Index of the receiver.
    unresolved : {"none", "tilt"}
        Slopes of the waves that each mesh leaves out. "none" studies the mesh itself, "tilt"
        whether the mean gain is free of it: normals tilt at random (`Physics.unresolved`).
    **run
        Options of the run, see `StudyOptions`; of its `mesh` only the time counts.

    Returns
    -------
    ConvergenceStudy

    Raises
    ------
    Refused
        If an option is out of range, or the exact surface is requested and the sea is not a
        sum of waves.

    Notes
    -----
    The aperture receives the unscattered light through a patch of a few centimetres, mostly on one
    facet. There the curvature of a mesh is wrong by O(h), with a sign that depends on the place of
    the facet. The mean over placements is free of this error and converges as h^2; `scatter` is
    the error of one placement.

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
    values = descending("spacings", spacings)
    if unresolved == "tilt" and reference == "analytic":
        raise Refused("reference", reference, "'auto' or None beside random slopes")
    campaign = campaign_of(link, surface, "convergence_study", run)
    # random slopes have no exact surface to compare with
    if reference == "auto" and (unresolved == "tilt" or not is_wave_sum(campaign.sea)):
        reference = None
    exact = wave_sum(campaign.sea) if reference else None
    chains = CommonChains(campaign, normals, receiver, unresolved)
    link, sea, time = campaign.link, campaign.sea, campaign.meshing.time
    pairs = product(values, placement_shifts(placements))
    # functions that make the meshes: of all at once the memory would be out of bounds
    cases = [partial(nested_mesh, link, sea, time, spacing, shift) for spacing, shift in pairs]
    recorded = {"spacings": values, "placements": placements, "unresolved": unresolved}
    numbers = _by_step(chains.measure_all(cases, recorded), values)
    # crossings of the finest mesh are nearest to those of the exact surface, where Newton ends
    gain_of_exact = chains.exact(exact, values[-1]) if exact else None
    # the error of a single mesh: its place against the sea is a matter of chance
    scatter = spread(numbers[..., :SHIFTS].mean(axis=3))
    return _study("spacing", values, chains, numbers, scatter, tolerance, recorded, gain_of_exact)


@check_call
def band_limit_study(
    link: Link | Scenario,
    surface: SurfaceModel | None = None,
    omega_max: Sequence[float] = (),
    *,
    realizations: Annotated[int, Field(ge=1, le=100_000)] = REALIZATIONS,
    normals: Sequence[Normals] = ("vertex",),
    tolerance: Positive = 1e-2,
    receiver: int = 0,
    unresolved: Unresolved = "none",
    **run: Unpack[StudyOptions],
) -> ConvergenceStudy:
    """Study how the mean gain over a random sea depends on its shortest waves.

    Parameters
    ----------
    link : Link or Scenario
        The link, or a scenario.
    surface : SurfaceModel, optional
        A sea with `omega_max` and random phases.
    omega_max : sequence of float
        At least four band limits [rad s-1].
    realizations : int
        Seas of each band. Their phases are common to all limits: a wider band adds waves to those
        of a narrower one.
    normals, tolerance, receiver, unresolved
        As in `convergence_study`.
    **run
        Options of the run, see `StudyOptions`. The spacing of its `mesh`, 0.1 m by default, should
        be a fraction of the shortest wavelength.

    Returns
    -------
    ConvergenceStudy
        Its step is 1 / omega_max.

    Notes
    -----
    The mean square slope of a spectrum with an omega^-5 tail grows as log omega_max: without
    random slopes for the waves left out (`unresolved="tilt"`) this study has no limit.
    """
    values = descending("omega_max", omega_max)[::-1]  # narrow to wide: coarse to fine
    campaign = campaign_of(link, surface, "band_limit_study", run)
    sea: Any = campaign.sea
    if not {"omega_max", "seed"} <= set(getattr(type(sea), "model_fields", {})):
        raise Refused("surface", Described(type(sea).__name__), "a random sea with omega_max")
    # one spacing for all bands, so that the mesh adds the same error to each; 0.1 m is also that of
    # `Link.footprint`
    spacing = campaign.meshing.spacing or 0.1
    # the widest band has the highest crests, for which the chains must allow
    widest = sea.model_copy(update={"omega_max": values[-1]})
    base, time, seed = campaign.link, campaign.meshing.time, campaign.run.seed
    chains = CommonChains(campaign, normals, receiver, unresolved, widest)

    def mesh(limit: float, i: int) -> TriangleMesh:
        band = sea.model_copy(update={"omega_max": limit, "seed": realization_seed(seed, i)})
        return nested_mesh(base, band, time, spacing, np.zeros(2))

    cases = [partial(mesh, *pair) for pair in product(values, range(realizations))]
    recorded = {"omega_max": values, "realizations": realizations, "spacing": spacing,
                "unresolved": unresolved}  # fmt: skip
    numbers = _by_step(chains.measure_all(cases, recorded), values)
    gain = numbers[..., :SHIFTS].mean(axis=3)
    # differences from the widest band with the same phases: the fading itself, which all bands
    # share, cancels
    scatter = spread(gain - gain[:, -1:])
    return _study("omega_max", values, chains, numbers, scatter, tolerance, recorded)


@check_call
def time_step_study(
    link: Link | Scenario,
    surface: SurfaceModel | None = None,
    steps: Sequence[float] = (),
    *,
    duration: Positive | None = None,
    normals: Sequence[Normals] = ("vertex",),
    tolerance: Positive = 1e-2,
    receiver: int = 0,
    **run: Unpack[StudyOptions],
) -> ConvergenceStudy:
    """Study how the mean gain over a moving sea depends on the time step.

    Parameters
    ----------
    link : Link or Scenario
        The link, or a scenario.
    surface : SurfaceModel, optional
        The sea.
    steps : sequence of float
        At least four time steps [s], all multiples of the shortest.
    duration : float, optional
        Length of the series [s], a multiple of every step; by default eight of the longest.
    normals, tolerance, receiver
        As in `convergence_study`.
    **run
        Options of the run, see `StudyOptions`; the series begins at the time of its `mesh`.

    Returns
    -------
    ConvergenceStudy
        `gain` is the mean over the series (trapezoidal rule), `scatter` the rms error of
        linear interpolation between its times.
    """
    values = descending("steps", steps)
    # one more frame between two of the shortest step shows its interpolation error, too
    finest = 0.5 * values[-1]
    # steps and duration in units of `finest`
    strides = [multiple_of("steps", value / finest) for value in values]
    duration = 8.0 * values[0] if duration is None else duration
    n = multiple_of("duration", duration / finest)
    for value, stride in zip(values, strides, strict=True):
        if n % stride:
            raise Refused("duration", duration, f"multiples of the step {value:g} s")
    campaign = campaign_of(link, surface, "time_step_study", run)
    chains = CommonChains(campaign, normals, receiver)
    begin, spacing, sea = campaign.meshing.time, campaign.meshing.spacing, campaign.sea

    def mesh(i: int) -> TriangleMesh:
        meshing = Meshing(time=begin + i * finest, spacing=spacing)
        return mesh_for(chains.link, sea, meshing, chains.reach)[0]

    cases = [partial(mesh, i) for i in range(n + 1)]
    recorded = {"start": begin, "duration": duration, "steps": values}
    # no photons: the share of total reflection does not depend on the step, and stays nan
    frames = chains.measure_all(cases, recorded, photons=0)  # (kinds, times, numbers)
    # (kinds, steps, 1, numbers): one repeat; over the times by the trapezoidal rule on every
    # stride-th frame. Times are in units of `finest`: the mean is the integral over n
    integrals = [np.trapezoid(frames[:, ::stride], dx=stride, axis=1) for stride in strides]
    means = np.stack(integrals, axis=1)[:, :, None] / n
    # slopes, reflection and times do not depend on the step: their means over all frames
    for k in range(SHIFTS + 1, frames.shape[-1]):
        means[..., k] = frames[..., k].mean(axis=1)[:, None, None]
    gain_in_time = frames[..., :SHIFTS].mean(axis=2)
    scatter = np.stack([_interpolation_error(gain_in_time, s) for s in strides], axis=1)
    return _study("time_step", values, chains, means, scatter, tolerance, recorded)


@check_call
def body_study(
    link: Link | Scenario,
    surface: MeshSource | TriangleMesh | None = None,
    meshes: Sequence[Any] = (),
    *,
    body: Annotated[int, Field(ge=0)] = 0,
    tolerance: Positive = 1e-2,
    receiver: int = 0,
    **run: Unpack[StudyOptions],
) -> ConvergenceStudy:
    """Study how the gain depends on the facets of a body, by meshes of several resolutions.

    Parameters
    ----------
    link : Link or Scenario
        The link with its bodies, or a scenario.
    surface : MeshSource or TriangleMesh, optional
        The sea.
    meshes : sequence of path or TriangleMesh
        At least four versions of the mesh of a body, in any order: scans of a reef, or the finest
        one decimated. Each takes the place, scale and albedo of the body.
    body : int
        Index of the body in `Link.objects`.
    tolerance, receiver
        As in `convergence_study`.
    **run
        Options of the run, see `StudyOptions`.

    Returns
    -------
    ConvergenceStudy
        Its step is the root of the mean area of a facet, `facet_size` [m].

    Raises
    ------
    Refused
        If there is no such body, or there are fewer than four sizes of facets.

    Notes
    -----
    All versions share the random numbers of their photons, so that differences show the meshes.
    """
    campaign = campaign_of(link, surface, "body_study", run, several=False, analog=True)
    base, surface = campaign.link, campaign.surface
    require_whole(receiver, 0, len(base.receivers) - 1, "receiver")
    require_whole(body, 0, len(base.objects) - 1, "body")
    links = {}
    for mesh in meshes:
        version = base.objects[body].replace(mesh=mesh, sha256=None)
        bodies = (*base.objects[:body], version, *base.objects[body + 1 :])
        vertices, faces = version.triangles()
        a, b, c = (vertices[faces[:, i]] for i in range(3))
        # half the parallelogram of two edges
        areas = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
        links[math.sqrt(areas.mean())] = base.replace(objects=bodies)
    sizes = descending("meshes", list(links))
    time = campaign.meshing.time
    by_size = [(links[size],) for size in sizes]
    # The sea is one and the same. As "realization", not "time", each step has chains and a mesh of
    # its own: light meets another body in each.
    steps = Steps("realization", np.array(sizes), lambda i: (surface, time), by_size)
    gains = campaign.gains(steps)[:, 0, :, receiver]  # (gain and unscattered part, sizes, shifts)
    unknown = np.full((1, len(sizes)), math.nan)
    if not gains[0].mean(axis=1).all():
        raise Refused("gain", Described("no light received"), "light with every mesh")
    recorded = {"facet_size": sizes, "body": body, "receiver": receiver}
    # one kind of normals and one repeat: samples (1, sizes, 1, shifts), unscattered (1, sizes, 1);
    # scatter, slopes, reflection and times are unknown
    return ConvergenceStudy(
        "facet_size", np.array(sizes), (campaign.meshing.normals,), gains[None, 0, :, None],
        gains[None, 1].mean(axis=2, keepdims=True), unknown, unknown, unknown, unknown, unknown,
        unknown, None, tolerance, campaign.provenance(of_study=recorded),
    )  # fmt: skip


def _by_step(values_by_case: Floats, values: list[float]) -> Floats:
    """Split the numbers of meshes by step: (kinds, meshes, n) to (kinds, steps, repeats, n)."""
    return values_by_case.reshape(len(values_by_case), len(values), -1, values_by_case.shape[-1])


def _study(
    parameter: str,
    values: list[float],
    chains: CommonChains,
    numbers: Floats,
    scatter: Floats,
    tolerance: float,
    recorded: dict[str, Any],
    reference: Reference | None = None,
) -> ConvergenceStudy:
    """Assemble the study from the numbers of its meshes, shape (kinds, steps, repeats, n).

    The n numbers are in the order of `CommonChains.measure`; `scatter` is that of
    `ConvergenceStudy`; `recorded` are the options of the study.
    """
    samples, (ballistic, *others) = numbers[..., :SHIFTS], np.moveaxis(numbers[..., SHIFTS:], -1, 0)
    # tolerances are relative: a gain of 0 has none
    if not samples.mean(axis=(2, 3)).all():
        raise Refused("gain", Described("no light received"), "light at every step")
    slopes, reflected, mesh_time, bvh_time, gain_time = (array.mean(axis=2) for array in others)
    kinds = chains.kinds
    recorded = recorded | {"normals": list(kinds), "receiver": chains.receiver}
    return ConvergenceStudy(
        parameter, np.array(values), kinds, samples, ballistic, scatter, slopes, reflected,
        mesh_time, bvh_time, gain_time, reference, tolerance,
        chains.campaign.provenance(of_study=recorded),
    )  # fmt: skip


def _interpolation_error(gain: Floats, stride: int) -> Floats:
    """Return the rms error (kinds,) of interpolating a gain (kinds, times) at every stride-th time.

    Interpolation is linear.
    """
    times = np.arange(gain.shape[1])
    interpolated = np.stack([np.interp(times, times[::stride], g[::stride]) for g in gain])
    # at the nodes themselves the error is zero by construction
    between = times % stride != 0
    return np.sqrt(np.mean((gain - interpolated)[:, between] ** 2, axis=1))
