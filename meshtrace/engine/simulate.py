"""Simulation of one link over one surface with either estimator."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import partial
from typing import Annotated, Any, Literal, Unpack, overload

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from meshtrace.checks import Inside, check_call
from meshtrace.engine import outcome
from meshtrace.engine.bvh import EmbreeIntersector
from meshtrace.engine.correlated import SpectralDetection, analog_sums
from meshtrace.engine.forced import ForcedDetection, cut_share
from meshtrace.engine.mesh_error import relative_mesh_error, with_mesh_errors
from meshtrace.engine.paths import PhotonPaths, received_paths, record_paths
from meshtrace.engine.photons.analog import options_over, run_analog
from meshtrace.engine.plan import Planner, TypicalSea
from meshtrace.engine.setup.ends import require_height_field, resolved_reach
from meshtrace.engine.setup.meshing import mesh_for
from meshtrace.engine.setup.options import (
    Analog,
    Case,
    Estimator,
    Forced,
    HasCase,
    Meshing,
    Record,
    Run,
    Shortcuts,
    SimulateOptions,
    read_records,
    resolve,
)
from meshtrace.engine.setup.tinting import clearest
from meshtrace.errors import Described, Refused, require_whole
from meshtrace.link import Link
from meshtrace.mesh import MeshSource, TriangleMesh
from meshtrace.models import Floats
from meshtrace.parallel import default_threads, one_blas_thread
from meshtrace.results.gain import GainResult, merge
from meshtrace.results.provenance import provenance
from meshtrace.results.series import ByWavelength, checked_wavelengths

_MOST_VERTICES = 2 * 10**7  # of all paths: 640 MB


@overload
def simulate(
    link: Link | HasCase,
    surface: MeshSource | TriangleMesh | None = None,
    estimator: Estimator | Literal["forced", "analog"] | None = None,
    *,
    wavelengths_nm: None = None,
    **options: Unpack[SimulateOptions],
) -> GainResult: ...


@overload
def simulate(
    link: Link | HasCase,
    surface: MeshSource | TriangleMesh | None = None,
    estimator: Estimator | Literal["forced", "analog"] | None = None,
    *,
    wavelengths_nm: ArrayLike,
    **options: Unpack[SimulateOptions],
) -> ByWavelength[GainResult]: ...


@check_call
def simulate(
    link: Link | HasCase,
    surface: MeshSource | TriangleMesh | None = None,
    estimator: Annotated[Estimator | Literal["forced", "analog"] | None, Inside()] = None,
    *,
    wavelengths_nm: ArrayLike | None = None,
    photons: int | None = None,
    rtol: float | None = None,
    seed: int | None = None,
    mesh: Meshing | None = None,
    threads: int | None = None,
    record: Annotated[Iterable[Record], Inside()] = (),
    progress: Callable[[int], None] | None = None,
    **options: Unpack[Shortcuts],
) -> GainResult | ByWavelength[GainResult]:
    r"""Simulate the gain of a link over a surface.

    Parameters
    ----------
    link : Link or Scenario
        The link, or a scenario whose options hold where none are given here.
    surface : MeshSource or TriangleMesh, optional
        A sea, triangulated over the link's footprint, meshes in time, or a mesh taken as it is.
        By default the JONSWAP sea of the link's wind, see `resolve`.
    estimator : Forced or Analog, or "forced" or "analog", optional
        Scattering chains aimed at the aperture, the default, or photons followed one by one, the
        default over a surface that overhangs.
    wavelengths_nm : array_like, optional
        Wavelengths in vacuum [nm], in place of that of the sources: a gain for each, of common
        paths, see Notes.
    photons : int, optional
        Chains (10 000 by default) or photons (1 000 000).
    rtol : float, optional
        Relative standard error to reach in every gain, with scattered light worth at least 100
        equal samples (400 joined photons) where it matters; `photons` is then the first guess, by
        default one that follows from pilots.
    seed : int, optional
        Key of the random numbers, 0 <= seed < 2^64, 1 by default.
    mesh : Meshing, optional
        Time, resolution and waves of the surface.
    threads : int, optional
        Threads, all cores by default; the result does not depend on them.
    record : sequence of Arrivals or IrradianceMap
        Extra tallies.
    progress : callable, optional
        Called with the number of photons followed since its last call.
    **options
        Fields of `Meshing` (`normals`, `time`, `extent`, `spacing`, `waves`) and of the estimator.

    Returns
    -------
    GainResult, or ByWavelength of them

    Raises
    ------
    Refused
        If an option is out of range, the mesh does not cover the link, the forced estimator does
        not follow a feature of the link, or the water has no spectrum for other wavelengths.

    Warns
    -----
    DomainWarning
        If more than 1e-4 of the weight left the mesh sideways, light leaked through it, or the
        error of the mesh exceeds the standard error and 0.3 % of the gain.

    Notes
    -----
    At each of several wavelengths (`Link.at_wavelength`) the paths are the same, and their weights

    .. math:: w_j = w \prod_k \frac{b_j p_j}{b p}(z_k, \theta_k) e^{-\int (c_j - c) dl}

    over their scatterings k and their ways through the water, from a base that scatters most, or
    from photons of several bases that count with the density of their mixture. Between the smallest
    and the largest index of the water gains are linear in the index, by some of the paths that are
    refracted by both. The error of the mesh is that of one wavelength, relative to its gain. Fates
    are those of photons of the bases.

    Examples
    --------
    >>> import meshtrace as mt
    >>> from meshtrace.surfaces import FlatSea
    >>> r = mt.simulate(mt.Link(), FlatSea(), photons=4096, seed=1)
    >>> round(r.gain * 1e5, 1)
    6.0
    """
    chosen = {"estimator": estimator, "photons": photons, "rtol": rtol, "seed": seed}
    chosen["threads"] = threads
    # an argument that is not given leaves the option of a scenario as it is
    fields: dict[str, Any] = dict(options)
    fields |= {name: value for name, value in chosen.items() if value is not None}
    case = resolve(link, surface, mesh=mesh, **fields)
    case = case._replace(run=case.run.replace(threads=default_threads(case.run.threads)))
    at = [] if wavelengths_nm is None else checked_wavelengths(wavelengths_nm)
    links = [case.link.at_wavelength(nm) for nm in at] or [case.link]
    try:
        with one_blas_thread():
            # one mesh for all wavelengths: the clearest water needs the finest and widest one
            case, triangles, config = _over_mesh(case._replace(link=clearest(links)))
            # warnings are those of the clearest link: the others have the same mesh and paths
            records, first = read_records(record, case.run.estimator), links.index(case.link)
            if at and "irradiance-map" in records:
                allowed = "arrivals, with wavelengths_nm; maps by coverage_map"
                raise Refused("record", Described("a map"), allowed)
            results, returned = _traced(case, links, triangles, config, records, progress)
            outcome.warn_of_few(results, links, first)
            if isinstance(case.run.estimator, Analog):
                outcome.warn_of_lost(results[first])
                follow = partial(
                    run_analog, case.link, EmbreeIntersector(triangles, case.threads),
                    case.run.estimator, seed=case.run.seed, normals=case.meshing.normals,
                    threads=case.threads,
                )  # fmt: skip
                outcome.warn_of_dark_map(results[first], records, follow)
            else:
                relative = relative_mesh_error(case.link, triangles, case.meshing.normals)
                results = with_mesh_errors(results, links, first, relative)
                outcome.warn_of_mesh(results[first], case, triangles)
                outcome.warn_of_cut_short(results[first])
                if results[first].gain_reflected is None:
                    outcome.warn_of_omitted(case.link, results[first].gains, returned)
                outcome.warn_of_cut(cut_share(case, triangles))
    except ArithmeticError as error:
        raise Refused("link", Described(f"{error}"), "numbers that do not overflow") from error
    # numpy overflows to inf without an exception
    for result in results:
        if not np.isfinite(result.gain).all():
            gain = Described(f"a gain of {result.gain}")
            raise Refused("link", gain, "numbers that do not overflow")
    return ByWavelength(np.array(at), tuple(results)) if at else results[0]


def _traced(
    case: Case,
    links: list[Link],
    mesh: TriangleMesh,
    config: dict[str, Any],
    records: dict[str, Record],
    progress: Callable[[int], None] | None,
) -> tuple[list[GainResult], Floats | None]:
    """Return the result of each link, alike but for wavelength and water, with common paths.

    With the estimated gain of light reflected first, where forced detection has made it.

    They are repeated with more photons until a relative standard error is met and certain itself.
    """
    recorded = [r.model_dump(mode="json") for r in records.values()]
    run: Run | None = case.run
    seed, normals, threads = case.run.seed, case.meshing.normals, case.threads
    results: list[GainResult] = []
    returned: Floats | None = None
    sea = TypicalSea.of_meshes([mesh])
    single = len(links) == 1
    if single and isinstance(case.run.estimator, Forced):
        # pilots do not depend on the number of chains: one comparison serves all repetitions
        planner = Planner(case.link, seed, normals, threads, sea)
        comparison = planner.compare()
        if case.run.rtol is not None and "photons" not in case.run.model_fields_set:
            photons = planner.photons_for(case.run.rtol, case.run.photons, comparison)
            run = case.run.replace(photons=photons)
    while run is not None:
        options = run.to_config() | case.meshing.model_dump() | {"record": recorded}
        origins = [provenance(link, config, options) | dict(case.origin) for link in links]
        if isinstance(run.estimator, Analog):
            sums = analog_sums(
                links, EmbreeIntersector(mesh, threads), run.estimator, run.photons, progress,
                records.values(), seed=seed, normals=normals, threads=threads,
            )  # fmt: skip
            further = [
                outcome.analog_result(link, tallies, origin, records)
                for link, tallies, origin in zip(links, sums, origins, strict=True)
            ]
            # photons are independent: those already traced count on
            pairs = zip(results, further, strict=True) if results else ()
            results = [merge(list(pair)) for pair in pairs] or further
        else:
            # more chains are allotted anew to the orders: all are drawn again
            paths: ForcedDetection | SpectralDetection
            if single:
                paths = ForcedDetection.following(planner, planner.plan(run.photons, comparison))
                returned = None if paths.plan.reflects else planner.returned
            else:
                paths = SpectralDetection(links, run.photons, seed, normals, threads, sea)
            gains = paths.at_wavelengths(mesh, record=bool(records))
            results = [
                outcome.forced_result(case._replace(run=run, link=link), mesh, gain, origin)
                for link, gain, origin in zip(links, gains, origins, strict=True)
            ]
        # all wavelengths share the photons: the one that lacks most decides
        longer = [more for result in results if (more := _further(case.run, result)) is not None]
        run = max(longer, key=lambda more: more.photons, default=None)
    return results, returned


def _over_mesh(case: Case) -> tuple[Case, TriangleMesh, dict[str, Any]]:
    """Return the case with its estimator, the mesh and the configuration that identifies it.

    Over a surface that overhangs the estimator is analog unless chosen.
    """
    # a surface says whether it overhangs before it is triangulated, or not at all
    chosen = "estimator" in case.run.model_fields_set
    if not chosen and not getattr(case.surface, "single_valued", True):
        case = case._replace(run=case.run.replace(estimator="analog"))
    options = case.run.estimator
    analog = isinstance(options, Analog)
    reach = resolved_reach(case.link, options)
    mesh, config = mesh_for(case.link, case.surface, case.meshing, reach, few=analog)
    if isinstance(options, Analog):
        run = case.run.replace(estimator=options_over(mesh, options))
        return case._replace(run=run), mesh, config
    if chosen or mesh.single_valued:
        require_height_field(mesh)
        return case, mesh, config
    # only the mesh shows that a user's surface overhangs
    return _over_mesh(case._replace(run=case.run.replace(estimator="analog")))


def _further(run: Run, result: GainResult) -> Run | None:
    """Return a run of more photons; None if the tolerance or the limit is reached."""
    if run.rtol is None:
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        # no hit yet is no result, not a gain of 0 +- 0
        error = np.where(result.gains > 0.0, result.stderrs / result.gains, math.inf)
    lack = max(float(np.max(error)) ** 2 / run.rtol**2, outcome.lack_of_samples(result))
    n, options = result.photons, run.estimator
    if lack <= 1.0 or n >= options.most_photons:
        return None
    # errors fall with n^(-1/2); 10 % more, as the error of the longer run scatters, too. That of
    # few hits is hardly known: never more than sixteenfold at once
    more = min(math.ceil(n * min(1.1 * lack, 16.0)), options.most_photons)
    if isinstance(options, Analog):
        return run.replace(photons=more - n, first_photon=options.first_photon + n)
    return run.replace(photons=more)


@check_call
def trace_paths(
    link: Link | HasCase,
    surface: MeshSource | TriangleMesh | None = None,
    n: Annotated[int, Field(ge=1, le=100_000)] = 1000,
    *,
    received_only: bool = False,
    seed: int | None = None,
    mesh: Meshing | None = None,
    max_vertices: int = 64,
    **options: Unpack[Shortcuts],
) -> PhotonPaths:
    """Trace photon paths for visualisation; tallies are unaffected.

    Parameters
    ----------
    link, surface, seed, mesh
        As in `simulate`.
    n : int
        Photons, 1 <= n <= 100 000.
    received_only : bool
        Paths of light that reaches the first receiver, sampled by the chains of forced detection
        in proportion to the light they carry, instead of the first n analog photons. Where the
        gain rests on joined photons, chains miss part of the light scattered by large angles.
    max_vertices : int
        Vertices kept of a photon, >= 2.
    **options
        Fields of `Meshing`: `normals`, `time`, `extent`, `spacing`, `waves`; without
        `received_only` also of `Analog`, such as `roulette`.

    Returns
    -------
    PhotonPaths
    """
    # all paths are held at once, each with room for as many vertices
    require_whole(max_vertices, 2, _MOST_VERTICES // n, "max_vertices")
    fields: dict[str, Any] = dict(options) if seed is None else {"seed": seed, **options}
    photons = Analog()
    if not received_only:
        analog = {key: fields.pop(key) for key in Analog.model_fields if key in fields}
        photons = photons.replace(**analog)
    case = resolve(link, surface, mesh=mesh, **fields)
    key, normals = case.run.seed, case.meshing.normals
    with one_blas_thread():
        # fine where the chains cross, and as wide as photons go: pictures show both
        triangles, _ = mesh_for(case.link, case.surface, case.meshing, math.inf)
        if received_only:
            return received_paths(case.link, triangles, n, key, normals)
        return record_paths(case.link, triangles, n, key, normals, max_vertices, photons)
