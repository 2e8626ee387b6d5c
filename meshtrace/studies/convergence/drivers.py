"""Studies of gain and fading against the mesh, the time step and the band of waves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from typing import Annotated, Any, ClassVar, Literal, Unpack

import numpy as np

from meshtrace.engine.setup.meshing import mesh_for
from meshtrace.engine.setup.options import Meshing, StudyOptions
from meshtrace.errors import Described, Refused, require_whole
from meshtrace.fading.spectral import WITHIN, fading_band, scintillation_of_spectrum
from meshtrace.kernels.random import realization_seed
from meshtrace.link import Link
from meshtrace.mesh import SurfaceModel, TriangleMesh
from meshtrace.models import Floats
from meshtrace.scenario import Scenario
from meshtrace.stored import Stored, Variable
from meshtrace.studies.campaign import Campaign, campaign_of
from meshtrace.studies.convergence.measure import (
    CommonChains,
    MeshSamples,
    Normals,
    Reference,
    Unresolved,
    descending,
    multiple_of,
    nested_mesh,
    placement_shifts,
    positive,
    spread,
    wave_sum,
)
from meshtrace.studies.convergence.study import ConvergenceStudy
from meshtrace.studies.series import over_realizations

DEFAULT_SPACINGS = (2.0, 1.0, 0.5, 0.25, 0.125, 0.0625)
"""Mesh spacings [m] of a study: each halves the one before, so that the grid lines nest."""

PLACEMENTS = 34
"""Meshes of each spacing: a Fibonacci number, whose lattice fills a cell most evenly."""

REALIZATIONS = 16
"""Realizations of the sea for each band."""


def convergence_study(
    link: Link | Scenario,
    surface: SurfaceModel | None = None,
    spacings: Sequence[float] = DEFAULT_SPACINGS,
    normals: Sequence[Normals] = ("vertex", "facet"),
    *,
    placements: int = PLACEMENTS,
    reference: Literal["analytic"] | None = "analytic",
    tolerance: float = 1e-3,
    receiver: int = 0,
    unresolved: Unresolved = "none",
    **run: Unpack[StudyOptions],
) -> ConvergenceStudy:
    """Study the dependence of the gain over a sea on the spacing of its mesh.

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
    reference : "analytic" or None
        Whether to find the gain over the exact sum of waves too.
    tolerance : float
        Relative error of one surface with the recommended step.
    receiver : int
        Index of the receiver.
    unresolved : {"none", "tilt"}
        Slopes of the waves that each mesh leaves out. "none" studies the mesh itself, "tilt"
        whether the mean gain is free of it: normals tilt at random (`Physics.unresolved`).
    **run
        Options of the run, see `StudyOptions`; of its `mesh` the time counts.

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
    positive("tolerance", tolerance)
    require_whole(placements, 1, 100_000, "placements")
    if reference not in ("analytic", None):
        raise Refused("reference", reference, "'analytic' or None")
    if unresolved == "tilt" and reference:
        raise Refused("reference", reference, "None beside random slopes")
    campaign = campaign_of(link, surface, "convergence_study", **run)
    exact = wave_sum(campaign.sea) if reference else None
    chains = CommonChains(campaign, normals, receiver, unresolved)
    link, sea, at = campaign.link, campaign.sea, campaign.meshing.time
    pairs = product(values, placement_shifts(placements))
    cases = [partial(nested_mesh, link, sea, at, spacing, shift) for spacing, shift in pairs]
    recorded = {"spacings": values, "placements": placements, "unresolved": unresolved}
    found = chains.over(cases, len(values), recorded)
    truth = chains.exact(exact, values[-1]) if exact else None
    scatter = spread(found.samples.mean(axis=3))
    return _study("spacing", values, chains, found, scatter, tolerance, recorded, truth)


def band_limit_study(
    link: Link | Scenario,
    surface: SurfaceModel | None = None,
    omega_max: Sequence[float] = (),
    *,
    realizations: int = REALIZATIONS,
    normals: Sequence[Normals] = ("vertex",),
    tolerance: float = 1e-2,
    receiver: int = 0,
    unresolved: Unresolved = "none",
    **run: Unpack[StudyOptions],
) -> ConvergenceStudy:
    """Study the dependence of the mean gain over a random sea on its shortest waves.

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
        be a few to the shortest wave.

    Returns
    -------
    ConvergenceStudy
        Its step is 1 / omega_max.

    Notes
    -----
    The mean square slope of a spectrum with an omega^-5 tail grows as log omega_max: without
    random slopes for the waves left out (`unresolved="tilt"`) this study has no limit.
    """
    values = descending("omega_max", omega_max)[::-1]
    positive("tolerance", tolerance)
    require_whole(realizations, 1, 100_000, "realizations")
    campaign = campaign_of(link, surface, "band_limit_study", **run)
    sea: Any = campaign.sea
    if not {"omega_max", "seed"} <= set(getattr(type(sea), "model_fields", {})):
        raise Refused("surface", Described(type(sea).__name__), "a random sea with omega_max")
    step = campaign.meshing.spacing or 0.1
    widest = sea.model_copy(update={"omega_max": values[-1]})
    base, at, key = campaign.link, campaign.meshing.time, campaign.run.seed
    chains = CommonChains(campaign, normals, receiver, unresolved, widest)

    def mesh(limit: float, i: int) -> TriangleMesh:
        wide = sea.model_copy(update={"omega_max": limit, "seed": realization_seed(key, i)})
        return nested_mesh(base, wide, at, step, np.zeros(2))

    cases = [partial(mesh, *pair) for pair in product(values, range(realizations))]
    recorded = {"omega_max": values, "realizations": realizations, "spacing": step,
                "unresolved": unresolved}  # fmt: skip
    found = chains.over(cases, len(values), recorded)
    gain = found.samples.mean(axis=3)
    scatter = spread(gain - gain[:, -1:])
    return _study("omega_max", values, chains, found, scatter, tolerance, recorded)


def time_step_study(
    link: Link | Scenario,
    surface: SurfaceModel | None = None,
    steps: Sequence[float] = (),
    *,
    duration: float | None = None,
    normals: Sequence[Normals] = ("vertex",),
    tolerance: float = 1e-2,
    receiver: int = 0,
    **run: Unpack[StudyOptions],
) -> ConvergenceStudy:
    """Study the dependence of the mean gain over a moving sea on the time step.

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
    positive("tolerance", tolerance)
    finest = 0.5 * values[-1]
    strides = [multiple_of("steps", value / finest) for value in values]
    duration = 8.0 * values[0] if duration is None else positive("duration", duration)
    n = multiple_of("duration", duration / finest)
    for value, stride in zip(values, strides, strict=True):
        if n % stride:
            raise Refused("duration", duration, f"multiples of the step {value:g} s")
    campaign = campaign_of(link, surface, "time_step_study", **run)
    chains = CommonChains(campaign, normals, receiver)
    begin, width, sea = campaign.meshing.time, campaign.meshing.spacing, campaign.sea

    def mesh(i: int) -> TriangleMesh:
        meshing = Meshing(time=begin + i * finest, spacing=width)
        return mesh_for(chains.link, sea, meshing, chains.reach)[0]

    cases = [partial(mesh, i) for i in range(n + 1)]
    recorded = {"start": begin, "duration": duration, "steps": values}
    frames = chains.over(cases, 1, recorded, photons=0)
    by_shift, ballistic = frames.samples[:, 0], frames.ballistic[:, 0]  # (kinds, frames, ...)
    each, shape = by_shift.mean(axis=2), (len(chains.kinds), len(values))
    found = MeshSamples(
        np.stack([_time_mean(by_shift, s) for s in strides], axis=1)[:, :, None],
        np.stack([_time_mean(ballistic, s) for s in strides], axis=1)[:, :, None],
        np.broadcast_to(frames.slope_variance, shape),
        np.broadcast_to(frames.total_reflection, shape),
        *(np.broadcast_to(seconds, shape) for seconds in frames[4:]),
    )
    scatter = np.stack([_interpolation_error(each, s) for s in strides], axis=1)
    return _study("time_step", values, chains, found, scatter, tolerance, recorded)


def _study(
    parameter: str,
    values: list[float],
    chains: CommonChains,
    found: MeshSamples,
    scatter: Floats,
    tolerance: float,
    recorded: dict[str, Any],
    reference: Reference | None = None,
) -> ConvergenceStudy:
    """Return the study of the gains over all meshes, with its own options in the provenance."""
    return ConvergenceStudy(
        parameter=parameter,
        values=np.array(values),
        normals=chains.kinds,
        **found._asdict(),
        scatter=scatter,
        reference=reference,
        tolerance=tolerance,
        provenance=chains.campaign.provenance(
            **recorded, normals=list(chains.kinds), receiver=chains.receiver
        ),
    )


def _time_mean(frames: Floats, stride: int) -> Floats:
    """Return the mean over the times, axis 1, by the trapezoidal rule on every stride-th."""
    return np.trapezoid(frames[:, ::stride], dx=stride, axis=1) / (frames.shape[1] - 1)


def _interpolation_error(frames: Floats, stride: int) -> Floats:
    """Return the rms error of linear interpolation between every stride-th of (kinds, times)."""
    times = np.arange(frames.shape[1])
    guess = np.stack([np.interp(times, times[::stride], row[::stride]) for row in frames])
    between = times % stride != 0
    return np.sqrt(np.mean((frames - guess)[:, between] ** 2, axis=1))


DEFAULT_BANDS = (4.0, 8.0, 12.0, 16.0, 24.0, 32.0, 64.0, 128.0)
"""Highest frequencies of a study [rad s-1]."""

_BOOTSTRAPS = 400


@dataclass(frozen=True, eq=False, repr=False)
class FadingConvergence(Stored):
    """Scintillation index of unscattered light against the highest frequency of the sea.

    Attributes
    ----------
    omega_max : ndarray, shape (n,)
        Highest frequencies [rad s-1], rising.
    with_tilts, band_alone : ndarray, shape (n,)
        Closed form with random slopes for the waves beyond, and with nothing beyond.
    all_waves : float
        Closed form of all waves down to 1.3 mm.
    measured, measured_stderr : ndarray, shape (n,)
        Index with tilts over an ensemble, and its standard error; nan if not measured.
    tolerance : float
        Relative error of the index at `recommended`.
    recommended : float
        Smallest omega_max within the tolerance [rad s-1], nan if there is none.
    provenance : dict
        Versions, configuration and seeds.
    """

    omega_max: Annotated[Floats, Variable("omega_max")]
    with_tilts: Annotated[Floats, Variable("omega_max")]
    band_alone: Annotated[Floats, Variable("omega_max")]
    all_waves: float
    measured: Annotated[Floats, Variable("omega_max")]
    measured_stderr: Annotated[Floats, Variable("omega_max")]
    tolerance: float
    recommended: float
    provenance: dict[str, Any] = field(default_factory=dict)

    kind: ClassVar[str] = "fading-convergence"
    title: ClassVar[str] = "meshtrace fading over the band of waves"
    _attributes: ClassVar[tuple[str, ...]] = ("all_waves", "tolerance", "recommended")

    def _headline(self) -> str:
        percent = 100.0 * self.tolerance
        if math.isnan(self.recommended):
            return f"no omega_max with tilts within {percent:g} % of all waves"
        return (
            f"omega_max = {self.recommended:.3g} rad/s with tilts is within {percent:g} % of the "
            f"scintillation index of all waves, {self.all_waves:.3g}"
        )

    def summary(self) -> str:
        """Return the study as a table of text with a verdict."""
        lines = [
            f"{'omega_max [rad/s]':>18}{'band alone':>12}{'with tilts':>12}{'of all':>9}"
            f"{'measured':>12}{'stderr':>9}"
        ]
        closed = self.omega_max, self.band_alone, self.with_tilts
        rows = zip(*closed, self.measured, self.measured_stderr, strict=True)
        for omega, alone, tilted, found, stderr in rows:
            line = f"{omega:>18g}{alone:>12.4g}{tilted:>12.4g}{tilted / self.all_waves:>9.1%}"
            lines.append(line if math.isnan(found) else f"{line}{found:>12.4g}{stderr:>9.2g}")
        lines.append(f"{'all waves':>18}{self.all_waves:>12.4g}{self.all_waves:>12.4g}")
        return "\n".join([*lines, self._headline()])


def fading_study(
    link: Link | Scenario,
    surface: SurfaceModel | None = None,
    omega_max: Sequence[float] = DEFAULT_BANDS,
    *,
    realizations: int = 0,
    tolerance: float = WITHIN,
    **run: Unpack[StudyOptions],
) -> FadingConvergence:
    """Study the dependence of the scintillation index on the shortest waves of a random sea.

    Parameters
    ----------
    link : Link or Scenario
        A link on its axis, as for `fading.scintillation_of_spectrum`; or a scenario.
    surface : JonswapSea or SpectralSea, optional
        The sea. A spectrum with an omega^-5 tail is replaced by Elfouhaily's of the same wind and
        fetch (`short_waves` of the sea).
    omega_max : sequence of float
        At least four highest frequencies [rad s-1].
    realizations : int
        Seas of each band over which the index is measured as well; 0, the default, measures none.
    tolerance : float
        Relative error of the index at the recommended frequency.
    **run
        Options of the run, see `StudyOptions`.

    Returns
    -------
    FadingConvergence

    Raises
    ------
    Refused
        If an option is out of range, or there is no closed form for the link or the sea.

    Notes
    -----
    The band alone converges with its centimetre waves only: decimetre waves form caustics which
    nothing blurs. With tilts the index rises to that of all waves within a few per cent.
    """
    values = descending("omega_max", omega_max)[::-1]
    require_whole(realizations, 0, 1_000_000, "realizations")
    tolerance = positive("tolerance", tolerance)
    campaign = campaign_of(link, surface, "fading_study", **run)
    link = campaign.link
    sea = getattr(campaign.sea, "short_waves", campaign.sea)
    campaign = campaign._replace(surface=sea)
    all_waves = scintillation_of_spectrum(link, sea)
    both = [[scintillation_of_spectrum(link, sea, w, t) for w in values] for t in (True, False)]
    try:
        recommended = fading_band(link, sea, tolerance)
    except Refused:
        recommended = math.nan
    measured = np.full((len(values), 2), math.nan)
    for i, limit in enumerate(values if realizations else ()):
        measured[i] = _measured(campaign, limit, realizations)
    return FadingConvergence(
        omega_max=np.array(values),
        with_tilts=np.array(both[0]),
        band_alone=np.array(both[1]),
        all_waves=all_waves,
        measured=measured[:, 0],
        measured_stderr=measured[:, 1],
        tolerance=tolerance,
        recommended=recommended,
        provenance=campaign.provenance(omega_max=list(values), realizations=realizations),
    )


def _measured(campaign: Campaign, omega_max: float, realizations: int) -> tuple[float, float]:
    """Return the index of unscattered light over an ensemble, and its standard error."""
    sea: Any = campaign.sea
    campaign = campaign.of(campaign.link, f"up to {omega_max!r} rad/s")
    campaign = campaign._replace(surface=sea.model_copy(update={"omega_max": omega_max}))
    gain = over_realizations(campaign, realizations).gain_ballistic
    rng = np.random.default_rng(campaign.run.seed)
    drawn = rng.integers(0, realizations, (_BOOTSTRAPS, realizations))
    indices = [sample.var(ddof=1) / sample.mean() ** 2 for sample in (gain, *gain[drawn])]
    return indices[0], float(np.std(indices[1:]))
