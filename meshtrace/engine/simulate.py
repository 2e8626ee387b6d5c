"""Simulation of one link over one surface with either estimator."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any, Literal, Unpack, overload

import numpy as np
from numpy.typing import ArrayLike

from meshtrace.engine import outcome
from meshtrace.engine.bvh import EmbreeIntersector
from meshtrace.engine.forced import ForcedDetection, TypicalSea
from meshtrace.engine.mesh_error import with_mesh_error
from meshtrace.engine.paths import PhotonPaths, received_paths, record_paths
from meshtrace.engine.photons.analog import options_over, run_analog
from meshtrace.engine.setup.ends import require_height_field, resolved_reach
from meshtrace.engine.setup.meshing import mesh_for
from meshtrace.engine.setup.options import (
    Analog,
    Case,
    Estimator,
    HasCase,
    Meshing,
    Record,
    Run,
    Shortcuts,
    read_records,
    resolve,
)
from meshtrace.engine.wavelengths import SpectralDetection, analog_sums, clearest
from meshtrace.errors import Described, Refused, require_function, require_whole
from meshtrace.link import Link
from meshtrace.mesh import MeshSource, TriangleMesh
from meshtrace.parallel import default_threads
from meshtrace.results.gain import GainResult, merge
from meshtrace.results.provenance import provenance
from meshtrace.results.wavelengths import ByWavelength, checked_wavelengths

_MOST_VERTICES = 2 * 10**7  # of all paths: 640 MB


@overload
def simulate(
    link: Link | HasCase,
    surface: MeshSource | TriangleMesh | None = None,
    estimator: Estimator | Literal["forced", "analog"] | None = None,
    *,
    wavelengths_nm: None = None,
    **options: Any,
) -> GainResult: ...


@overload
def simulate(
    link: Link | HasCase,
    surface: MeshSource | TriangleMesh | None = None,
    estimator: Estimator | Literal["forced", "analog"] | None = None,
    *,
    wavelengths_nm: ArrayLike,
    **options: Any,
) -> ByWavelength[GainResult]: ...


def simulate(  # type: ignore[misc]
    link: Link | HasCase,
    surface: MeshSource | TriangleMesh | None = None,
    estimator: Estimator | Literal["forced", "analog"] | None = None,
    *,
    wavelengths_nm: ArrayLike | None = None,
    photons: int | None = None,
    rtol: float | None = None,
    seed: int | None = None,
    mesh: Meshing | None = None,
    threads: int | None = None,
    record: Iterable[Record] = (),
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
        equal samples (400 joined photons) where it matters; `photons` is then the first guess.
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

    over their scatterings k and their ways through the water, from a base that scatters most.
    Between the smallest and the largest index of the water, for each of which half of the paths
    are refracted, gains are linear in the index. Wavelengths for which the base has too few
    effective samples have paths of their own, as if run alone; so have all below bubbles with
    photons in place of chains. The error of the mesh is that of one wavelength, relative to its
    gain. Fates are those of photons of the base.

    Examples
    --------
    >>> import meshtrace as mt
    >>> from meshtrace.surfaces import FlatSea
    >>> r = mt.simulate(mt.Link(), FlatSea(), photons=4096, seed=1)
    >>> round(r.gain * 1e5, 1)
    6.0
    """
    require_function(progress, "progress")
    own = {"estimator": estimator, "photons": photons, "rtol": rtol, "seed": seed}
    given: dict[str, Any] = {**own, "threads": threads}
    given = {key: value for key, value in given.items() if value is not None}
    case = resolve(link, surface, mesh=mesh, **given, **options)
    case = case._replace(run=case.run.replace(threads=default_threads(case.run.threads)))
    result: GainResult | ByWavelength[GainResult]
    try:
        if wavelengths_nm is None:
            result = _simulated(case, record, progress)
            results = [result]
        else:
            if "irradiance-map" in read_records(record, case.run.estimator):
                allowed = "arrivals, with wavelengths_nm; maps by coverage_map"
                raise Refused("record", Described("a map"), allowed)
            at = checked_wavelengths(wavelengths_nm)
            links = [case.link.at_wavelength(nm) for nm in at]
            results = _simulated_at(case, links, record, progress)
            result = ByWavelength(np.array(at), tuple(results))
    except ArithmeticError as error:
        raise Refused("link", Described(f"{error}"), "numbers that do not overflow") from error
    for one in results:
        if not np.isfinite(one.gain).all():
            gain = Described(f"a gain of {one.gain}")
            raise Refused("link", gain, "numbers that do not overflow")
    return result


def _simulated_at(
    case: Case,
    links: list[Link],
    record: Iterable[Record],
    progress: Callable[[int], None] | None,
) -> list[GainResult]:
    """Return the result of each link, alike but for wavelength and water, with common paths."""
    first = clearest(links)
    case, mesh, config = _over_mesh(case._replace(link=first))
    records = read_records(record, case.run.estimator)
    recorded = [r.model_dump(mode="json") for r in records.values()]
    run: Run | None = case.run
    results: list[GainResult] = []
    while run is not None:
        whole = {**run.to_config(), **case.meshing.model_dump(), "record": recorded}
        origins = [{**provenance(link, config, whole), **case.origin} for link in links]
        if isinstance(run.estimator, Analog):
            intersector = EmbreeIntersector(mesh, case.threads)
            how = {"progress": progress, "arrivals": bool(records), **case.how}
            sums = analog_sums(links, intersector, run.estimator, run.photons, **how)
            found = [
                outcome.analog_result(link, one, origin, records)
                for link, one, origin in zip(links, sums, origins, strict=True)
            ]
            if results:
                found = [merge(list(pair)) for pair in zip(results, found, strict=True)]
        else:
            sea = TypicalSea.of([mesh])
            parts = SpectralDetection(links, run.photons, **case.how, sea=sea, mesh=mesh)
            light = parts.arrivals(mesh) if records else [None] * len(links)
            rows = zip(links, parts.evaluate(mesh), origins, light, strict=True)
            found = [
                outcome.forced_result(case._replace(run=run, link=link), mesh, one, origin, seen)
                for link, one, origin, seen in rows
            ]
        results = found
        wanted = [more for one in results if (more := _further(case.run, one)) is not None]
        run = max(wanted, key=lambda more: more.photons, default=None)
    return _checked_at(results, case, mesh, links.index(first))


def _checked_at(
    results: list[GainResult], case: Case, mesh: TriangleMesh, first: int
) -> list[GainResult]:
    """Return results with the mesh error of one of them; warn of light that they omit."""
    checked = _checked(results[first], case, mesh, {})
    worst = max(results, key=outcome.lack_of_samples)
    if worst is not results[first]:
        nm = _wavelength_of(worst.provenance["link"]["transmitter"])
        outcome.warn_of_few(worst, f"{nm:g} nm, the wavelength of fewest samples, ")
    if checked.mesh_error is None:
        return [checked if i == first else one for i, one in enumerate(results)]
    relative = np.atleast_1d(checked.mesh_error) / np.maximum(checked.gains, 1e-300)
    errors = [outcome.per_receiver(case.link, relative * one.gains) for one in results]
    return [replace(one, mesh_error=error) for one, error in zip(results, errors, strict=True)]


def _wavelength_of(sources: Any) -> float:
    """Return the wavelength of the first source as plain data."""
    first = sources[0] if isinstance(sources, list) else sources
    return float(first["wavelength_nm"])


def _simulated(
    case: Case, record: Iterable[Record], progress: Callable[[int], None] | None
) -> GainResult:
    """Return the result of a case whose options have been checked.

    It is repeated with more photons until a relative standard error is met and certain itself.
    Analog photons add to those already traced; chains are drawn again.
    """
    case, mesh, config = _over_mesh(case)
    records = read_records(record, case.run.estimator)
    recorded = [r.model_dump(mode="json") for r in records.values()]
    run: Run | None = case.run
    result: GainResult | None = None
    while run is not None:
        whole = {**run.to_config(), **case.meshing.model_dump(), "record": recorded}
        origin = {**provenance(case.link, config, whole), **case.origin}
        if isinstance(run.estimator, Analog):
            followed: dict[str, Any] = {"record": records.values(), "progress": progress}
            intersector = EmbreeIntersector(mesh, case.threads)
            sums = run_analog(
                case.link, intersector, run.estimator, photons=run.photons, **case.how, **followed
            )
            found = outcome.analog_result(case.link, sums, origin, records)
            result = found if result is None else merge([result, found])
        else:
            forced = ForcedDetection(case.link, run.photons, **case.how, sea=TypicalSea.of([mesh]))
            parts = forced.evaluate(mesh)
            arrivals = forced.arrivals(mesh) if "arrivals" in records else None
            result = outcome.forced_result(case._replace(run=run), mesh, parts, origin, arrivals)
        run = _further(case.run, result)
    assert result is not None
    return _checked(result, case, mesh, records)


def _checked(
    result: GainResult, case: Case, mesh: TriangleMesh, records: dict[str, Record]
) -> GainResult:
    """Return a result with its mesh error, and warn of light that it omits."""
    outcome.warn_of_few(result)
    if isinstance(case.run.estimator, Analog):
        outcome.warn_of_lost(result)
        options = case.run.estimator
        outcome.warn_of_dark_map(
            result,
            records,
            lambda grid, photons: run_analog(
                case.link, EmbreeIntersector(mesh, case.threads), options, photons=photons,
                record=[grid], **case.how,
            ),
        )  # fmt: skip
        return result
    result = with_mesh_error(result, case, mesh)
    outcome.warn_of_mesh(result, case, mesh)
    if result.gain_reflected is None and case.link.physics.reflected == "trace":
        outcome.warn_of_omitted(case.link, result.gains)
    outcome.warn_of_cut(case, mesh)
    return result


def _over_mesh(case: Case) -> tuple[Case, TriangleMesh, dict[str, Any]]:
    """Return the case with its estimator, the mesh and the configuration that identifies it.

    Over a surface that overhangs the estimator is analog unless chosen.
    """
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
    return _over_mesh(case._replace(run=case.run.replace(estimator="analog")))


def _further(run: Run, result: GainResult) -> Run | None:
    """Return a run of more photons, or None if the tolerance or the limit is reached."""
    if run.rtol is None:
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        # no hit yet is no result, not a gain of 0 +- 0
        error = np.where(result.gains > 0.0, result.stderrs / result.gains, math.inf)
    lack = max(float(np.max(error)) ** 2 / run.rtol**2, outcome.lack_of_samples(result))
    n, options = result.photons, run.estimator
    if lack <= 1.0 or n >= options.most_photons:
        return None
    # an error of few hits is itself uncertain: never more than sixteenfold at once
    more = min(math.ceil(n * min(1.1 * lack, 16.0)), options.most_photons)
    if isinstance(options, Analog):
        return run.replace(photons=more - n, first_photon=options.first_photon + n)
    return run.replace(photons=more)


def trace_paths(
    link: Link | HasCase,
    surface: MeshSource | TriangleMesh | None = None,
    n: int = 1000,
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
        Fields of `Meshing`: `normals`, `time`, `extent`, `spacing`, `waves`.

    Returns
    -------
    PhotonPaths
    """
    require_whole(n, 1, 100_000, "n")
    require_whole(max_vertices, 2, _MOST_VERTICES // n, "max_vertices")
    given: dict[str, Any] = {} if seed is None else {"seed": seed}
    case = resolve(link, surface, mesh=mesh, **given, **options)
    made, _ = mesh_for(case.link, case.surface, case.meshing, math.inf)
    key, normals = case.run.seed, case.meshing.normals
    if received_only:
        return received_paths(case.link, made, n, key, normals)
    return record_paths(case.link, made, n, key, normals, max_vertices)
