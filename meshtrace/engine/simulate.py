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
    Arrivals,
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
from meshtrace.link.link import SAME_SIDE
from meshtrace.mesh import MeshSource, TriangleMesh
from meshtrace.models import Floats
from meshtrace.parallel import default_threads, one_blas_thread
from meshtrace.results.gain import GainResult, merge
from meshtrace.results.provenance import provenance
from meshtrace.results.series import ByWavelength, checked_wavelengths

_MOST_VERTICES = 2 * 10**7  # of all paths together: 640 MB at 32 bytes each


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
    per_lamp: bool = False,
    **options: Unpack[Shortcuts],
) -> GainResult | ByWavelength[GainResult]:
    r"""Simulate the gain of a link over a surface.

    Parameters
    ----------
    link : Link or Scenario
        The link, or a scenario whose options hold unless they are given here.
    surface : MeshSource or TriangleMesh, optional
        A sea, triangulated over the link's footprint, a sequence of meshes in time, or a mesh,
        which is used as it is. By default the JONSWAP sea of the link's wind, see `resolve`.
    estimator : Forced or Analog, or "forced" or "analog", optional
        Scattering chains aimed at the aperture (default), or photons followed one by one (default
        over a surface that overhangs).
    wavelengths_nm : array_like, optional
        Wavelengths in vacuum [nm], in place of that of the sources: a gain for each, from the same
        paths, see Notes.
    photons : int, optional
        Chains (10 000 by default) or photons (1 000 000).
    rtol : float, optional
        Relative standard error to reach in every gain. Scattered light above 1 % of a gain also
        needs an effective sample size of at least 100 (400 for joined photons). `photons` is then
        the first guess; by default pilot runs choose it.
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
    per_lamp : bool
        Whether the result also has the gains by lamp, from the same chains and photons.
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
    All wavelengths (`Link.at_wavelength`) share the paths of a base, the wavelength that scatters
    most. At wavelength j a path of weight w has the weight

    .. math:: w_j = w \prod_k \frac{b_j p_j}{b p}(z_k, \theta_k) e^{-\int (c_j - c) dl}

    with a factor for each scattering k, at height z and by angle theta, and the integral over the
    path in the water; b, c and p are scattering coefficient, attenuation coefficient and phase
    function, without an index those of the base. Photons may belong to several bases in turn: the
    balance heuristic then weights them by the density of the mixture. Gains are linear in the index
    of the water between its smallest and largest value, both of which refract a share of the paths.
    The relative error of the mesh is computed at one wavelength. Fates are those of the photons at
    the wavelengths of the bases.

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
            records, reference = read_records(record, case.run.estimator), links.index(case.link)
            if at and "irradiance-map" in records:
                allowed = "arrivals, with wavelengths_nm; maps by coverage_map"
                raise Refused("record", Described("a map"), allowed)
            traced = _traced(case, links, triangles, config, records, progress, per_lamp)
            results, returned = traced
            outcome.warn_of_few(results, links, reference)
            if isinstance(case.run.estimator, Analog):
                outcome.warn_of_lost(results[reference])
                follow = partial(
                    run_analog, case.link, EmbreeIntersector(triangles, case.threads),
                    case.run.estimator, seed=case.run.seed, normals=case.meshing.normals,
                    threads=case.threads,
                )  # fmt: skip
                outcome.warn_of_dark_map(results[reference], records, follow)
            else:
                relative = relative_mesh_error(case.link, triangles, case.meshing.normals)
                results = with_mesh_errors(results, links, reference, relative)
                outcome.warn_of_mesh(results[reference], case, triangles)
                outcome.warn_of_cut_short(results[reference])
                same_side = case.link.direction in SAME_SIDE
                if results[reference].gain_reflected is None and not same_side:
                    outcome.warn_of_omitted(case.link, results[reference].gains, returned)
                outcome.warn_of_cut(cut_share(case, triangles))
    except ArithmeticError as error:
        raise Refused("link", Described(f"{error}"), "numbers that do not overflow") from error
    # numpy overflows to inf with no exception
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
    per_lamp: bool,
) -> tuple[list[GainResult], Floats | None]:
    """Return the results of links that differ in wavelength and water, from shared paths.

    Also return the estimated gain (receivers,) of light that the surface reflects first, None if
    photons have followed that light or if there was no estimate. `config` identifies the surface.
    Runs are repeated with more photons until the relative standard error reaches `rtol`, and rests
    on enough samples.
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
            analog = case._replace(run=run)
            further = _by_photons(analog, links, mesh, origins, records, progress, per_lamp)
            # photons are independent: further ones are merged with those already traced
            pairs = zip(results, further, strict=True) if results else ()
            results = [merge(list(pair)) for pair in pairs] or further
        else:
            # all chains are drawn again: a larger number is allotted anew to the orders
            paths: ForcedDetection | SpectralDetection
            if single:
                paths = ForcedDetection.following(planner, planner.plan(run.photons, comparison))
                omits = not paths.plan.reflects and case.link.direction not in SAME_SIDE
                returned = planner.returned if omits else None
            else:
                paths = SpectralDetection(links, run.photons, seed, normals, threads, sea)
            recording = "arrivals" in records or case.link.pixels > 1
            gains = paths.at_wavelengths(mesh, record=recording, per_lamp=per_lamp)
            results = [
                outcome.forced_result(
                    case._replace(run=run, link=link), mesh, gain, origin, "arrivals" in records
                )
                for link, gain, origin in zip(links, gains, origins, strict=True)
            ]
        # wavelengths share the photons: the one that needs most decides
        longer = [more for result in results if (more := _further(case.run, result)) is not None]
        run = max(longer, key=lambda more: more.photons, default=None)
    return results, returned


def _by_photons(
    case: Case,
    links: list[Link],
    mesh: TriangleMesh,
    origins: list[dict[str, Any]],
    records: dict[str, Record],
    progress: Callable[[int], None] | None,
    per_lamp: bool,
) -> list[GainResult]:
    """Return the results of links of several wavelengths by common analog photons."""
    seed, estimator = case.run.seed, case.run.estimator
    assert isinstance(estimator, Analog)
    # the lamp of an analog photon follows from its number, its pixel from its direction: arrivals
    # have both
    split = per_lamp or case.link.pixels > 1
    unrecorded = [Arrivals()] if split and "arrivals" not in records else []
    sums = analog_sums(
        links, EmbreeIntersector(mesh, case.threads), estimator, case.run.photons, progress,
        [*records.values(), *unrecorded],
        seed=seed, normals=case.meshing.normals, threads=case.threads,
    )  # fmt: skip
    return [
        outcome.analog_result(link, tallies, origin, records, seed if per_lamp else None)
        for link, tallies, origin in zip(links, sums, origins, strict=True)
    ]


def _over_mesh(case: Case) -> tuple[Case, TriangleMesh, dict[str, Any]]:
    """Return the case with its estimator, the mesh and the configuration of the surface.

    Over a surface that overhangs the estimator is analog unless the user has chosen one.
    """
    # a surface may state whether it overhangs; otherwise only its mesh shows it, see below
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
    # the mesh overhangs: mesh again for photons, which cross anywhere
    return _over_mesh(case._replace(run=case.run.replace(estimator="analog")))


def _further(run: Run, result: GainResult) -> Run | None:
    """Return a run with more photons; None if the tolerance or the limit is reached."""
    if run.rtol is None:
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        # a receiver without a hit needs more photons: its gain is unknown, not 0 +- 0
        error = np.where(result.gains > 0.0, result.stderrs / result.gains, math.inf)
    lack = max(float(np.max(error)) ** 2 / run.rtol**2, outcome.lack_of_samples(result))
    n, options = result.photons, run.estimator
    if lack <= 1.0 or n >= options.most_photons:
        return None
    # Errors fall with n^(-1/2). 10 % more, as the error of the longer run scatters, too; at most
    # sixteen times as many at once, as the error of few hits is hardly known. Both are tuned.
    more = min(math.ceil(n * min(1.1 * lack, 16.0)), options.most_photons)
    # only the further photons, numbered after those already traced
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
        Number of photons, 1 <= n <= 100 000.
    received_only : bool
        Trace paths of light that reaches the first receiver, sampled from the chains of forced
        detection in proportion to the light they carry, instead of the first n analog photons.
        Where `simulate` uses joined photons, chains miss part of the light scattered by large
        angles. Between ends on one side these are paths of unscattered light alone.
    max_vertices : int
        Most vertices stored for each photon, >= 2.
    **options
        Fields of `Meshing`: `normals`, `time`, `extent`, `spacing`, `waves`; without
        `received_only` also of `Analog`, such as `roulette`.

    Returns
    -------
    PhotonPaths
    """
    # all paths are held at once, each with room for as many vertices
    require_whole(max_vertices, 2, _MOST_VERTICES // n, "max_vertices")
    fields: dict[str, Any] = ({} if seed is None else {"seed": seed}) | dict(options)
    photons = Analog()
    if not received_only:
        analog = {key: fields.pop(key) for key in Analog.model_fields if key in fields}
        photons = photons.replace(**analog)
    case = resolve(link, surface, mesh=mesh, **fields)
    key, normals = case.run.seed, case.meshing.normals
    with one_blas_thread():
        # photons cross anywhere in their footprint, received light near the receivers alone
        reach = resolved_reach(case.link, Forced() if received_only else photons)
        triangles, _ = mesh_for(case.link, case.surface, case.meshing, reach)
        if received_only:
            return received_paths(case.link, triangles, n, key, normals)
        return record_paths(case.link, triangles, n, key, normals, max_vertices, photons)
