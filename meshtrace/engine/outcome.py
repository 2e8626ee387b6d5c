"""Build results from the sums of the estimators, and warn of their limits."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from meshtrace.engine.bvh import EmbreeIntersector
from meshtrace.engine.choice import exceeds, returned_gain
from meshtrace.engine.forced import ForcedDetection
from meshtrace.engine.gains import Gains, Method, lamps_of, photons_by_group, pixel_groups, table_of
from meshtrace.engine.photons.analog import PhotonSums, run_analog
from meshtrace.engine.photons.arriving import largest_weight
from meshtrace.engine.setup import options
from meshtrace.engine.setup.options import Analog, Case, Record
from meshtrace.errors import DomainWarning, warn
from meshtrace.kernels.tally import REFLECTED, SCATTERED
from meshtrace.link import Link
from meshtrace.link.link import SAME_SIDE
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Floats
from meshtrace.results import tallies
from meshtrace.results.gain import Fate, FateTally, GainResult, ScatteredSamples, bound_where_dark
from meshtrace.stored import SHIFTS

LEFT_DOMAIN_WARNING = 1e-4
"""Share of the light that passes beside the mesh above which a wider mesh is advised."""

MESH_ERROR_WARNING = 3e-3
"""Relative error of a gain by the mesh above which a finer mesh is advised."""

_FEW = {"chains": 100.0, "joined photons": 400.0, "analog photons": 100.0}
"""Effective sample size below which a standard error is itself uncertain."""

FEW_PHOTONS = 100.0
"""Effective photons of an aperture below which a wavelength does not share those of another."""

_FEW_SHARE = {"chains": 0.1, "joined photons": 0.15, "analog photons": 0.1}
"""Effective sample size over the number of samples: a warning needs it to be lower than this, too.

That a run of few samples is uncertain is known. Scores of joined photons have heavier tails."""
# least number of analog photons that bound a gain where chains bring no light; tuned: time, or a
# bound too far above any gain to be of use
_BOUND_PHOTONS = 2**18
_BACK_PHOTONS = 4096  # least number of photons that look for light behind a map; tuned: time, noise
# light from behind over the light of a map, from which on the map may well face the wrong way
_BEHIND = 10.0
_SMALL = 0.01  # share of the gain below which its scattered part does not matter


class FewSamplesWarning(UserWarning):
    """Small effective sample size: the error of a gain may exceed its standard error."""


def per_receiver(link: Link, array: Floats) -> Any:
    """Return values of the receivers as an array, or as a number for a single receiver."""
    return array if isinstance(link.receiver, tuple) else float(array[0])


def analog_result(
    link: Link, sums: PhotonSums, origin: dict[str, Any], records: Mapping[str, Record],
    seed: int | None = None,
) -> GainResult:  # fmt: skip
    """Return the result of analog photons, with the gains by lamp if their seed is given."""
    # scores are sums over photons: a column for each receiver, then the columns of planes
    n, n_rx = sums.photons, len(link.receivers)
    mean = sums.score / n
    stderr = tallies.standard_error(sums.score, sums.score_squared, n)
    weights, arrivals = sums.ledger.value() / n, None
    extra: dict[str, Any] = {}
    if "arrivals" in records or link.pixels > 1:
        hits = sums.all_arrivals
        table = table_of(hits, hits["weight"] / n, 1.0, link)
        arrivals = table if "arrivals" in records else None
        extra = by_pixel_of(table, link)
    grid = records.get("irradiance-map")
    gain = per_receiver(link, mean[:n_rx])
    if seed is not None:
        extra |= by_lamp_of(groups_by_lamp(sums, seed, link))
    return GainResult(
        gain=gain,
        gain_stderr=per_receiver(link, stderr[:n_rx]),
        gain_bound=bound_where_dark(gain, n),
        photons=n,
        fates={
            fate.name.lower(): FateTally(int(sums.count[fate]), float(weights[fate]))
            for fate in Fate
        },
        provenance=origin,
        rays_recast=int(sums.misses[0]),
        rays_lost=int(sums.misses[1]),
        arrivals=arrivals,
        planes=_planes(link, sums, mean[n_rx:], stderr[n_rx:]),
        map=irradiance_map(grid, sums) if isinstance(grid, options.IrradianceMap) else None,
        **extra,
    )


def groups_by_lamp(sums: PhotonSums, seed: int, link: Link) -> Floats:
    """Return the gain (lamps, receivers, SHIFTS) of analog photons by group, see `Gains.groups`."""
    hits, shape = sums.all_arrivals, (len(link.transmitters), len(link.receivers))
    pair = lamps_of(hits["photon"], seed, link) * shape[1] + hits["receiver"]
    group = hits["photon"] % SHIFTS
    groups = tallies.sums_by_group(group, hits["weight"] / sums.photons, pair, math.prod(shape))
    return groups.T.reshape(*shape, SHIFTS)


def by_lamp_of(groups: Floats, quadrature: Floats | float = 0.0) -> dict[str, Floats]:
    """Return the fields of a result by lamp from the gain (lamps, receivers, SHIFTS) by group."""
    stderr = np.hypot(tallies.error_of_groups(groups, axis=-1), quadrature)
    names = "gain_by_lamp", "gain_by_lamp_stderr", "gain_by_lamp_groups"
    return dict(zip(names, (groups.mean(axis=-1), stderr, groups), strict=True))


def by_pixel_of(
    table: tallies.ArrivalTally, link: Link, quadrature: Floats | float = 0.0
) -> dict[str, Any]:
    """Return the fields of a result by pixel; none for receivers without pixels.

    `quadrature` (receivers,) are errors of unscattered light without samples of its own.
    """
    if link.pixels == 1:
        return {}
    groups = pixel_groups(table, link)
    direct = replace(table, weight=table.weight * (table.group < 0))
    share = pixel_groups(direct, link).mean(axis=-1)
    share /= np.maximum(share.sum(axis=1, keepdims=True), 1e-300)
    # light of one quadrature errs alike in all pixels
    error = np.hypot(
        tallies.error_of_groups(groups, axis=-1), share * np.reshape(quadrature, (-1, 1))
    )
    shape = len(groups), link.pixels, link.pixels
    return {
        "gain_by_pixel": groups.mean(axis=-1).reshape(shape),
        "gain_by_pixel_stderr": error.reshape(shape),
    }


def forced_result(
    case: Case, mesh: TriangleMesh, gains: Gains, origin: dict[str, Any], record: bool
) -> GainResult:
    """Return the result of forced detection over a mesh, with its arrivals if `record`."""
    link = case.link
    # fields are absent, rather than 0, if no photons followed light that the surface reflects first
    extra: dict[str, Any] = {}
    if link.direction in SAME_SIDE:
        extra["gain_part"], extra["gain_part_stderr"] = gains.parts.T, gains.part_stderr.T
    elif gains.reflects:
        extra["gain_reflected"] = per_receiver(link, gains.parts[REFLECTED])
        extra["gain_reflected_stderr"] = per_receiver(link, gains.part_stderr[REFLECTED])
        extra["reflected"] = gains.samples_of(REFLECTED)
    if gains.by_lamp is not None:
        pairs, shape = gains.by_lamp, (-1, len(link.receivers))
        groups = pairs.shifts.reshape(*shape, SHIFTS)
        extra |= by_lamp_of(groups, pairs.quadrature.reshape(shape))
    if gains.table:
        # a quadrature shows in the groups of the gain, or beside them, but in none of its rows
        error = np.hypot(tallies.error_of_groups(gains.direct, axis=-1), gains.quadrature)
        extra |= by_pixel_of(gains.table[0], link, error)
    result = GainResult(
        gain=per_receiver(link, gains.gain),
        gain_stderr=per_receiver(link, gains.stderr),
        photons=case.run.photons,
        fates={},
        provenance=origin,
        gain_ballistic=per_receiver(link, gains.ballistic),
        gain_scattered=per_receiver(link, gains.scattered.mean(axis=-1)),
        gain_order=gains.orders,
        chains=gains.counts,
        scattered=gains.samples_of(SCATTERED),
        arrivals=gains.table[0] if record else None,
        **extra,
    )
    # the larger one where both apply; nan of either is ignored
    bound = np.fmax(_bound_of_dark(case, mesh, gains.gain), _bound_of_few(result))
    if not np.isfinite(bound).any():
        return result
    return replace(result, gain_bound=per_receiver(link, bound))


def _bound_of_few(result: GainResult) -> Floats:
    """Return upper bounds of gains that rest on few effective samples, nan elsewhere.

    Light of paths that are rare compared with the number of samples is missing from most runs, and
    from their standard errors. With gain h and standard error s the bound is h + 2 s + 3 w / n:
    paths of score w that none of n samples shows bring less than 3 w / n at 95 % confidence (rule
    of three). Their w is taken as (sum w_i^2)^(1/2) over the scores w_i, which no score of the run
    exceeds, so that w / n = h_k / n_eff^(1/2) for a part h_k = sum w_i / n of the gain with the
    effective sample size n_eff = (sum w_i)^2 / sum w_i^2.
    """
    # scattered and reflected light are estimated apart: paths of both may be missing
    rare = np.full(len(result.gains), np.nan)
    for r, row, part in _samples(result):
        if _is_few(row):
            rare[r] = np.nan_to_num(rare[r]) + 3.0 * part / math.sqrt(max(row.effective, 1.0))
    return result.gains + 2.0 * result.stderrs + rare


def _bound_of_dark(case: Case, mesh: TriangleMesh, gain: Floats) -> Floats:
    """Return upper bounds of gains without received light, nan elsewhere.

    Aimed samples that bring nothing give no bound: at least `_BOUND_PHOTONS` analog photons do.
    None scores more than w = exp(-a d), with absorption a and the height d of the lowest trough
    above the end in the water. With mean m and standard error s of the scores of n photons the
    bound is m + 2 s + 3 w / n, which is 3 w / n, at 95 % confidence (rule of three), if none
    arrives.
    """
    # most links need no bound, and no photons
    if (gain > 0.0).all():
        return np.full(len(gain), np.nan)
    most = largest_weight(case.link, float(mesh.bounds[0, 2]))
    bound = np.full(len(gain), sys.float_info.min)
    # if w underflows the bound stays at the smallest normal float, and no photons are traced
    if most > sys.float_info.min:
        n = max(case.run.photons, _BOUND_PHOTONS)
        intersector = EmbreeIntersector(mesh, case.threads)
        # Russian roulette below a thousandth of the largest weight hardly changes the bound
        options = Analog(roulette=1e-3 * most)
        sums = run_analog(
            case.link, intersector, options, photons=n, seed=case.run.seed,
            normals=case.meshing.normals, threads=case.threads,
        )  # fmt: skip
        error = tallies.standard_error(sums.score, sums.score_squared, n)
        bound = np.maximum(sums.score / n + 2.0 * error + 3.0 * most / n, bound)
    return np.where(gain > 0.0, np.nan, bound)


def lack_of_samples(result: GainResult) -> float:
    """Return the largest ratio of the required to the effective sample size of a part of a gain.

    Parts are scattered light and light that the surface reflects first, where they matter. Above 1
    the standard error of a gain is itself uncertain.
    """
    return max(
        (_FEW[row.estimator] / max(row.effective, 1.0) for _, row, _ in _samples(result)),
        default=0.0,
    )


def warn_of_few(results: list[GainResult], links: list[Link], first: int) -> None:
    """Warn of small effective sample sizes, of link `first` and of the worst link."""
    # not at every wavelength: all of them share samples
    worst = max(range(len(results)), key=lambda i: (lack_of_samples(results[i]), i == first))
    for i in dict.fromkeys((first, worst)):
        nm = links[i].transmitters[0].wavelength_nm
        where = "" if i == first else f"{nm:g} nm, the wavelength of fewest samples, "
        _warn_of_few(_samples(results[i]), where)


def warn_of_chains(chains: ForcedDetection, usual: Sequence[Method]) -> None:
    """Warn of receivers for which chains are the worse estimator, or for which there are too few.

    Parameters
    ----------
    chains : ForcedDetection
        The link with scattering chains for all receivers.
    usual : sequence of {"chains", "joined", "analog"}
        Estimators that `simulate` would choose, by receiver.
    """
    # over still water: the link is judged before any of its seas is known
    gains = chains.evaluate(chains.planner.flat())
    samples = gains.samples_of(SCATTERED)
    counted = _that_matter(samples, gains.parts[SCATTERED], gains.gain)
    worse = [r for r, method in enumerate(usual) if method != "chains"]
    for r in worse:
        warn(
            f"receiver {r}: light arrives by large angles or many scatterings, or from a narrow "
            "beam; scattering chains miss part of it, for which `simulate` uses "
            f"{usual[r]} photons",
            FewSamplesWarning,
        )
    _warn_of_few([row for row in counted if row[0] not in worse])
    warn_of_omitted(chains.link, gains.gain, chains.planner.returned)


def _warn_of_few(counted: list[tuple[int, ScatteredSamples, float]], where: str = "") -> None:
    for r, row, _ in counted:
        if _is_few(row):
            warn(
                f"{where}receiver {r}: {row.scored:,} of {row.samples:,} {row.estimator} "
                f"contribute, effective sample size {row.effective:.0f}: the error may exceed the "
                "standard error, and the gain has an upper bound",
                FewSamplesWarning,
            )


def _is_few(row: ScatteredSamples) -> bool:
    """Return whether the effective samples are too few for their standard error."""
    # a small share of very few samples is no surprise: the user chose their number
    return row.effective < min(_FEW[row.estimator], _FEW_SHARE[row.estimator] * row.samples)


def _samples(result: GainResult) -> list[tuple[int, ScatteredSamples, float]]:
    """Return rows (receiver, samples, gain of the part) for the parts of a gain that matter.

    Parts are scattered light and light that the surface reflects first.
    """
    scattered = _that_matter(result.scattered, result.gain_scattered, result.gains)
    known = {r: part for r, row, part in scattered if row.estimator == "analog photons"}
    reflected = _that_matter(result.reflected, result.gain_reflected, result.gains)
    # the same analog photons bring both parts: the larger part, with more hits, represents them
    return scattered + [row for row in reflected if row[2] > known.get(row[0], 0.0)]


def _that_matter(
    samples: list[ScatteredSamples], share: Any, gain: Floats
) -> list[tuple[int, ScatteredSamples, float]]:
    """Return rows (receiver, samples, gain of the part) for receivers where a part matters.

    `share` (receivers,) is the gain of that part, None if it was not measured.
    """
    share = np.atleast_1d(0.0 if share is None else share)
    matters = (r for r in range(len(samples)) if share[r] > _SMALL * gain[r])
    return [(r, samples[r], float(share[r])) for r in matters]


def warn_of_cut_short(result: GainResult) -> None:
    """Warn of unscattered light whose quadrature was stopped before it converged."""
    pairs = 0 if result.chains is None else result.chains.cut_short
    if pairs:
        warn(
            f"unscattered light of {pairs} pair{'s' * (pairs > 1)} of a source and a receiver took "
            "too long to be integrated finely; its error is part of the standard error: a wider "
            'view, a smaller aperture or estimator="analog" lowers it',
            DomainWarning,
        )


def warn_of_omitted(link: Link, gain: Floats, returned: Floats | None = None) -> None:
    """Warn of receivers for which forced detection leaves out more than 0.1 % of a gain > 0.

    `returned` (receivers,) is the estimated gain of light reflected first, None to compute it.
    """
    returned = returned_gain(link) if returned is None else returned
    # to one digit: the closed-form estimate is good to a factor of 3
    for r in np.flatnonzero(exceeds(returned, gain)):
        percent = float(f"{100.0 * returned[r] / (gain[r] + returned[r]):.1g}")
        warn(
            f"receiver {r}: about {percent:g} % of the light leaves the water after a reflection "
            'at the surface, which is omitted here: estimator="analog" follows it',
            DomainWarning,
        )


def warn_of_mesh(result: GainResult, case: Case, mesh: TriangleMesh) -> None:
    """Warn of gains with a mesh error above the standard error and 0.3 %."""
    if result.mesh_error is None:
        return
    for r, error in enumerate(np.atleast_1d(result.mesh_error)):
        limit = max(result.stderrs[r], MESH_ERROR_WARNING * result.gains[r])
        if error > limit:
            cure = "a finer mesh"
            # errors are taken to fall with the square of the spacing of the finest facets
            if not isinstance(case.surface, TriangleMesh):
                first, second = mesh.vertices[mesh.faces[:, 0]], mesh.vertices[mesh.faces[:, 1]]
                shortest = float(np.linalg.norm((second - first)[:, :2], axis=1).min())
                cure = f"a spacing below {math.sqrt(limit / error) * shortest:.2g} m"
            warn(
                f"receiver {r}: the mesh causes an error of about "
                f"{100.0 * error / result.gains[r]:.2g} % of the gain, more than the standard "
                f"error: {cure} lowers it",
                DomainWarning,
            )


def warn_of_cut(cut: Floats) -> None:
    """Warn of a mesh that cuts off a share of the light to a receiver."""
    for r in np.flatnonzero(cut > LEFT_DOMAIN_WARNING):
        warn(
            f"receiver {r}: the mesh cuts off {100.0 * cut[r]:.2g} % of the light (flat sea; limit "
            f"{100.0 * LEFT_DOMAIN_WARNING:g} %): enlarge extent",
            DomainWarning,
        )


def _planes(link: Link, sums: PhotonSums, mean: Floats, stderr: Floats) -> tallies.Planes | None:
    """Return the tallies of planes from the columns (4 planes,) of their scores, None without."""
    if not link.planes:
        return None
    # four scores for each plane, one plane after the other, see `kernels.tally.score_planes`
    columns = [values[i::4] for values in (mean, stderr) for i in range(4)]
    radiance = {}
    if link.planes.n_cosines:
        flux, photons = sums.radiance.value(), photons_by_group(sums.photons)
        error = np.full(flux.shape[1:], np.nan)
        # a group of a single photon shows no scatter
        if sums.photons >= 2 * SHIFTS:
            groups = flux / photons[:, None, None, None]
            error = tallies.error_of_groups(groups)
        radiance = tallies.Planes.radiance_of(flux.sum(axis=0) / sums.photons, error)
    return tallies.Planes(np.array(link.planes.depths), *columns, **radiance)


def irradiance_map(grid: options.IrradianceMap, sums: PhotonSums) -> tallies.MapTally:
    """Return the irradiance by analog photons in the cells of a map, over the power [m-2]."""
    area = grid.step**2
    cell, error = (x[:, :, 0] / area for x in sums.map_mean())
    return tallies.MapTally(grid.axes, grid.axes, cell, error)


def warn_of_lost(result: GainResult) -> None:
    """Warn of analog photons that left the mesh sideways or through holes."""
    left = result.fates["left_domain"].weight
    if left > LEFT_DOMAIN_WARNING:
        warn(
            f"{100.0 * left:.2g} % of the launched weight left the meshed surface sideways (limit "
            f"{100.0 * LEFT_DOMAIN_WARNING:g} %): enlarge extent",
            DomainWarning,
        )
    if result.rays_lost:
        warn(
            f"{result.rays_lost} photons missed the surface inside the mesh twice: the mesh may "
            "have holes",
            DomainWarning,
        )


def warn_of_dark_map(
    result: GainResult,
    records: Mapping[str, Record],
    follow: Callable[..., PhotonSums],
) -> None:
    """Warn of a map that faces away from the light, by tracing photons that arrive from behind it.

    `follow(photons=..., record=...)` traces photons with a map as the only record.
    """
    grid = records.get("irradiance-map")
    if not isinstance(grid, options.IrradianceMap) or result.map is None:
        return
    # the same cells, turned round and with the view of a hemisphere
    x, y, z = grid.axis
    back = grid.replace(axis=(-x, -y, -z), fov_deg=180.0)
    photons = min(result.photons, max(_BACK_PHOTONS, result.photons // 100))
    behind_map = irradiance_map(back, follow(photons=photons, record=[back]))
    # less three standard errors of the sum, so that noise alone triggers no warning
    behind = behind_map.irradiance.sum() - 3.0 * math.hypot(*behind_map.irradiance_stderr.ravel())
    in_front = result.map.irradiance.sum()
    if in_front > behind / _BEHIND or (in_front > 0.0 and behind <= 0.0):
        return
    received = f"received none of {result.photons:,} photons"
    if in_front > 0.0:
        share = in_front / behind_map.irradiance.sum()
        received = f"received {share:.2g} of the light that comes from behind it"
    warn(
        f"the map at {grid.height:g} m {received}: its axis {grid.axis} is the direction in which "
        f"light arrives, within {grid.fov_deg / 2.0:g} deg; light that goes down needs (0, 0, -1)",
        DomainWarning,
    )
