"""Gain of a link: value, standard error, fates of the photons, tallies and provenance."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np

from meshtrace.checks import check_call
from meshtrace.errors import Described, Refused
from meshtrace.fields import attrs
from meshtrace.kernels.tally import Fate
from meshtrace.models import Floats
from meshtrace.results.provenance import water_of
from meshtrace.results.tallies import ONE_SIDE_PARTS, ArrivalTally, MapTally, Planes, merged_means
from meshtrace.stored import Columns, Elsewhere, Part, Stored, Variable, Variables

if TYPE_CHECKING:
    import xarray as xr

Values = float | Floats
"""A number for a single receiver, an array of shape (receivers,) for a list of receivers."""


FATE_MEANING = {
    Fate.RECEIVED: "entered an aperture",
    Fate.LANDED: "left the sea, landed elsewhere",
    Fate.ABSORBED: "absorbed in the water",
    Fate.WHITECAP: "stopped by foam",
    Fate.REFLECTED: "reflected by the surface and not followed",
    Fate.BOTTOM: "absorbed by the bottom",
    Fate.LEFT_DOMAIN: "left the meshed surface sideways",
    Fate.LEAKED: "missed the surface inside the mesh",
    Fate.ROULETTE: "ended by roulette (net weight)",
    Fate.EVENT_LIMIT: "reached the limit of events",
    Fate.DEEP: "escaped downwards (bottomless, non-absorbing water)",
    Fate.BODY: "absorbed by a body",
}
"""Description of each `Fate` of photons."""


class FateTally(NamedTuple):
    """Number of photons with one fate, and their share of the launched weight [1]."""

    photons: int
    weight: float


class ScatteredSamples(NamedTuple):
    """Samples behind the scattered gain of a receiver.

    Attributes
    ----------
    estimator : {"chains", "joined photons", "analog photons"}
        Chains aimed at the aperture, or photons joined to it or followed until they hit it.
    samples, scored : int
        Number of samples, and of samples with a contribution.
    effective : float
        Effective sample size, (sum w)^2 / sum w^2 of the contributions w.
    """

    estimator: str
    samples: int
    scored: int
    effective: float


class ChainCounts(NamedTuple):
    """Counts of scattering chains by outcome.

    A crossing is a point of the surface at which a chain can be refracted into the aperture; a
    chain may have several over waves. `fields.toml` has the long names.

    Attributes
    ----------
    drawn : int
        Scattering chains drawn.
    solved : int
        Crossings of the waves that Newton's method reached from those of still water, or that were
        sampled around these.
    no_flat : int
        Chains without a crossing of still water: they contribute nothing.
    enumerated : int
        Searches of all facets for the crossings of a chain.
    extra_roots : int
        Crossings that these searches added.
    blocked : int
        Crossings whose path is blocked by a wave.
    sampled : int
        Pairs of source and receiver whose unscattered light was sampled rather than integrated.
    cut_short : int
        Pairs whose integral of unscattered light stopped before it was fine enough.
    """

    drawn: int = 0
    solved: int = 0
    no_flat: int = 0
    enumerated: int = 0
    extra_roots: int = 0
    blocked: int = 0
    sampled: int = 0
    cut_short: int = 0


# Ratio of `mesh_error` to `gain_stderr` above which a summary shows the former. Tuned: added in
# quadrature the two are hypot(1, 0.5) = 1.12 standard errors, too little more to change a decision.
_MESH_ERROR_SHOWN = 0.5
_PER_RECEIVER = Variable("receiver")
PER_LAMP = Variable("transmitter", "receiver")
"""Description of values by lamp and receiver."""
PER_PIXEL = Variable("receiver", "pixel_x", "pixel_y")
"""Description of values by receiver and pixel."""


@dataclass(frozen=True, eq=False, repr=False)
class GainResult(Stored, kind="gain", title="meshtrace channel gain"):
    """Channel gain of one link over one surface.

    Attributes
    ----------
    gain, gain_stderr : float or ndarray, shape (receivers,)
        Fraction of the emitted power that each receiver collects, and its standard error.
    mesh_error : same as gain, or None
        Estimated difference from the gain over the exact surface, which the mesh interpolates; not
        included in `gain_stderr`, which is the error of the samples. None or nan where unknown;
        None for analog photons.
    photons : int
        Photons launched (analog), or chains (forced); joined photons may be several times as many,
        see `scattered` and `reflected`.
    fates : dict of str to FateTally
        Photons and weight by fate; empty for the forced estimator.
    gain_bound : same as gain, or None
        Upper bound of the gain at 95 % confidence where no light was received, or where scattered
        light rests on so few samples that its standard error is uncertain; nan elsewhere, None if
        there is no such receiver.
    gain_ballistic, gain_scattered : same as gain, or None
        Unscattered and scattered parts, where the estimator separates them.
    gain_reflected, gain_reflected_stderr : same as gain, or None
        Part of the gain that the surface first reflected back into the water, where the forced
        estimator follows it; 0 for receivers served by chains where a closed estimate of it is
        below 0.02 % of the gain.
    gain_part, gain_part_stderr : ndarray, shape (receivers, 6), or None
        Parts of the gain of a link whose ends lie on one side, see `gain_parts`, by the numbers of
        `ArrivalTally.part`.
    gain_order : ndarray, shape (receivers, orders), or None
        Forced only: gain by the number of scatterings, from 1.
    provenance : dict
        Versions, commit, seed, and the whole configuration, which loads back.
    rays_recast, rays_lost : int
        Analog only: rays that missed the surface inside the mesh and were cast again, and those
        that missed it twice.
    chains : ChainCounts, optional
        Forced only: numbers of chains by outcome.
    scattered : list of ScatteredSamples
        Forced only: estimator and samples of the scattered gain of each receiver.
    reflected : list of ScatteredSamples
        The same for `gain_reflected`.
    gain_by_lamp, gain_by_lamp_stderr : ndarray, shape (transmitters, receivers), or None
        Gain by lamp and receiver over the power of all lamps, and its standard error; sums over
        the lamps are the gain.
    gain_by_lamp_groups : ndarray, shape (transmitters, receivers, 32), or None
        The same by independent group of samples, see `stored.SHIFTS`. All pairs have the same
        samples: their errors have the covariance of these estimates over groups, divided by 32.
    gain_by_pixel, gain_by_pixel_stderr : ndarray, shape (receivers, pixels, pixels), or None
        Gain of each pixel (i, j) of receivers that have them, and its standard error; sums over
        the pixels are the gain. Directions of unscattered light are those to facets: an edge
        between pixels is as sharp as a facet.
    arrivals : ArrivalTally, optional
        Arrivals with their path lengths.
    planes : Planes, optional
        Irradiances and radiance in the water.
    map : MapTally, optional
        Irradiance on a plane in the air.
    """

    gain: Annotated[Values, _PER_RECEIVER]
    gain_stderr: Annotated[Values, _PER_RECEIVER]
    photons: int
    fates: Annotated[dict[str, FateTally], Elsewhere()]
    provenance: dict[str, Any]
    gain_ballistic: Annotated[Values | None, _PER_RECEIVER] = None
    gain_scattered: Annotated[Values | None, _PER_RECEIVER] = None
    rays_recast: int = 0
    rays_lost: int = 0
    chains: Annotated[ChainCounts | None, Columns(ChainCounts, "chains")] = None
    scattered: Annotated[
        list[ScatteredSamples], Columns(ScatteredSamples, "scattered", "receiver")
    ] = field(default_factory=list)
    reflected: Annotated[
        list[ScatteredSamples], Columns(ScatteredSamples, "reflected", "receiver")
    ] = field(default_factory=list)
    gain_bound: Annotated[Values | None, _PER_RECEIVER] = None
    gain_reflected: Annotated[Values | None, _PER_RECEIVER] = None
    gain_reflected_stderr: Annotated[Values | None, _PER_RECEIVER] = None
    mesh_error: Annotated[Values | None, _PER_RECEIVER] = None
    gain_part: Annotated[Floats | None, Variable("receiver", "part")] = None
    gain_part_stderr: Annotated[Floats | None, Variable("receiver", "part")] = None
    gain_order: Annotated[Floats | None, Variable("receiver", "order")] = None
    gain_by_lamp: Annotated[Floats | None, PER_LAMP] = None
    gain_by_lamp_stderr: Annotated[Floats | None, PER_LAMP] = None
    gain_by_lamp_groups: Annotated[Floats | None, Variable(*PER_LAMP.dims, "group")] = None
    gain_by_pixel: Annotated[Floats | None, PER_PIXEL] = None
    gain_by_pixel_stderr: Annotated[Floats | None, PER_PIXEL] = None
    arrivals: Annotated[ArrivalTally | None, Part(ArrivalTally)] = None
    planes: Annotated[Planes | None, Part(Planes)] = None
    map: Annotated[MapTally | None, Part(MapTally)] = None

    @property
    def gains(self) -> Floats:
        """Gain of each receiver as an array, shape (receivers,)."""
        return np.atleast_1d(self.gain)

    @property
    def stderrs(self) -> Floats:
        """Standard error of each gain, shape (receivers,)."""
        return np.atleast_1d(self.gain_stderr)

    @property
    def gain_db(self) -> Values:
        """Gain in optical decibels, 10 log10 of the gain."""
        with np.errstate(divide="ignore"):
            return like(self.gain, 10.0 * np.log10(self.gains))

    @property
    def gain_parts(self) -> dict[str, Values]:
        """Parts of the gain by name, which add up to it.

        "unscattered", "scattered" and "reflected" by the surface before it left the water; of a
        link whose ends lie on one side "straight", "mirrored" by the surface, "scattered" where
        the last event was in the water, "bottom" and "bodies" where it was there. Empty where the
        estimator does not separate them.
        """
        if self.gain_part is not None:
            columns = self.gain_part.T
            return {name: like(self.gain, columns[k]) for name, k in ONE_SIDE_PARTS.items()}
        if self.gain_ballistic is None or self.gain_scattered is None:
            return {}
        parts = {"unscattered": self.gain_ballistic, "scattered": self.gain_scattered}
        if self.gain_reflected is not None:
            parts["reflected"] = self.gain_reflected
        return parts

    def _per_receiver(self, name: str) -> list[float]:
        """Return the values of a field for each receiver, nan if the field is None."""
        value = getattr(self, name)
        numbers = np.broadcast_to(math.nan if value is None else value, self.gains.shape)
        return [float(number) for number in numbers]

    def _headline(self) -> str:
        # `not bound > 0.0` is true of nan, too: a receiver without a bound
        receivers = zip(self.gains, self.stderrs, self._per_receiver("gain_bound"), strict=True)
        parts = [
            f"gain {gain:.4e} +- {stderr:.1e}" if gain or not bound > 0.0 else self._dark(bound)
            for gain, stderr, bound in receivers
        ]
        # a line of a terminal has room for four
        shown = parts[:4] + [f"{len(parts) - 4} more"] * (len(parts) > 4)
        return ", ".join([*shown, self._samples])

    def _dark(self, bound: float) -> str:
        """Return the upper bound of a gain of 0 as text."""
        # That none of n analog photons arrived is a measurement. That no chain connects lamp and
        # receiver is none, since only a few of all possible paths were tried.
        if self.fates:
            return f"dark to below {bound:.2g}"
        return f"not found with {self._samples}, below {bound:.2g}"

    @property
    def _samples(self) -> str:
        """Return the number of samples of each estimator as text."""
        counts = {item.estimator: item.samples for item in self.scattered}
        # the number asked for: `samples` has a few chains more, as each order of scattering has
        # whole numbers of them
        if "chains" in counts or not counts:
            counts["photons" if self.fates else "chains"] = self.photons
        return " and ".join(f"{n:,} {name}" for name, n in counts.items())

    def summary(self, wall_time: float | None = None, verbose: bool = False) -> str:
        """Return the gain and the fates of the photons as text for a terminal.

        Parameters
        ----------
        wall_time : float, optional
            Duration of the run [s], shown with the number of photons.
        verbose : bool
            Include fates without photons, lost rays, the outcomes of the chains, and the error of
            the mesh where it is small.
        """
        count = self._samples
        if wall_time is not None:
            count += f" in {wall_time:.2f} s"
        lines = [*self._gain_lines(verbose), *self._origin_lines(), _line("samples", count)]
        if self.fates and (verbose or self.rays_lost):
            text = f"{self.rays_recast:,} rays cast again, {self.rays_lost:,} lost"
            lines.append(_line("misses", text))
        if self.fates:
            lines += ["", f"{'fate':<12}{'photons':>15}{'weight %':>12}  meaning"]
        for name, (photons, weight) in self.fates.items():
            if photons or weight or verbose:
                meaning = FATE_MEANING[Fate[name.upper()]]
                lines.append(f"{name:<12}{photons:>15,}{100.0 * weight:>12.4g}  {meaning}")
        if verbose and self.chains is not None and self.chains.drawn:
            lines += ["", f"{'chains':<12}{'number':>15}  meaning"]
            for name, number in self.chains._asdict().items():
                meaning = attrs(f"chains_{name}")["long_name"].removeprefix("number of ")
                lines.append(f"{name:<12}{number:>15,}  {meaning}")
        return "\n".join(lines)

    def _gain_lines(self, verbose: bool) -> list[str]:
        """Return gain and errors of each receiver, and the error of the mesh where it matters."""
        lines = []
        names = "gain", "gain_stderr", "gain_bound", "mesh_error"
        parts = "gain_ballistic", "gain_reflected"
        columns = zip(*(self._per_receiver(name) for name in (*names, *parts)), strict=True)
        for i, (gain, stderr, bound, mesh_error, ballistic, reflected) in enumerate(columns):
            name = "channel gain" if np.ndim(self.gain) == 0 else f"channel gain [{i}]"
            if not gain > 0.0:
                dark = f"{self._dark(bound)} at 95 % confidence" if bound > 0.0 else "dark"
                lines.append(_line(name, f"{dark}: no light received"))
                continue
            # d(10 log10 g) = 10 / ln 10 dg / g
            percent, decibel = 100.0 * stderr / gain, 10.0 / math.log(10.0) * stderr / gain
            lines.append(_line(name, f"{gain:.4e}  ({10.0 * math.log10(gain):.3f} dB optical)"))
            errors = f"{stderr:.1e}  ({percent:.2g} %, {decibel:.2g} dB)"
            lines.append(_line("standard error", errors))
            # false of nan, which stands where the standard error can be trusted
            if bound > 0.0:
                few = "at 95 % confidence: few samples, light of rare paths may be missing"
                lines.append(_line("upper bound", f"{bound:.4e}  {few}"))
            if mesh_error > _MESH_ERROR_SHOWN * stderr or (verbose and mesh_error >= 0.0):
                text = f"{mesh_error:.1e}  ({100.0 * mesh_error / gain:.2g} %)"
                lines.append(_line("error of the mesh", text))
            if self.gain_part is not None:
                # the parts of receiver i, without those that this link does not have
                of_part = {k: np.atleast_1d(part)[i] for k, part in self.gain_parts.items()}
                lines.append(_line("", ", ".join(f"{k} {g:.4e}" for k, g in of_part.items() if g)))
            elif self.gain_ballistic is not None:
                scattered = 100.0 * (1.0 - ballistic / gain)
                text = f"{ballistic:.4e} unscattered; scattered {scattered:.1f} %"
                if self.gain_reflected is not None:
                    text += f", of which reflected first {100.0 * reflected / gain:.2g} %"
                lines.append(_line("", text))
            if self.gain_by_lamp is not None and self.gain_by_lamp_stderr is not None:
                lamps = zip(self.gain_by_lamp[:, i], self.gain_by_lamp_stderr[:, i], strict=True)
                lines.append(_line("by lamp", ", ".join(f"{g:.4e} +- {s:.1e}" for g, s in lamps)))
            if self.scattered:
                estimator, samples, scored, effective = self.scattered[i]
                # a share: `samples` below has their number
                share = 100.0 * scored / max(samples, 1)
                text = f"{share:.3g} % of the {estimator} contribute"
                lines.append(_line("", f"{text}; effective sample size {effective:,.0f}"))
        return lines

    def _content(self) -> xr.Dataset:
        # for `_restored`: a number and an array of one receiver are stored alike
        data = super()._content().assign_attrs(scalar=int(np.ndim(self.gain) == 0))
        return data.assign_coords(receiver=np.arange(len(self.gains)))

    def _derived(self) -> Variables:
        """Return the fates as flags of the CF conventions, with their photons and weights."""
        if not self.fates:
            return {}
        codes = np.array([Fate[name.upper()] for name in self.fates], np.int8)
        flags = {"flag_values": codes, "flag_meanings": " ".join(self.fates)}
        columns = zip(*self.fates.values(), strict=True)
        named = zip(FateTally._fields, map(np.array, columns), strict=True)
        return {"fate": ("fate", codes, flags)} | {f"fate_{n}": ("fate", x) for n, x in named}

    @classmethod
    def _restored(
        cls, data: xr.Dataset, provenance: Any, derived: dict[str, Any] | None = None
    ) -> GainResult:
        fates: dict[str, FateTally] = {}
        if "fate" in data.coords:
            columns = (data[f"fate_{name}"].values.tolist() for name in FateTally._fields)
            names = data["fate"].attrs["flag_meanings"].split()
            fates = dict(zip(names, map(FateTally, *columns), strict=True))
        result = super()._restored(data, provenance, {"fates": fates})
        if not data.attrs["scalar"]:
            return result
        # a link whose `receiver` is no list: its numbers, too, are arrays (1,) in files
        numbers: dict[str, Any] = {}
        for name in (item.name for item in fields(result)):
            array = getattr(result, name)
            if isinstance(array, np.ndarray) and array.ndim == 1:
                numbers[name] = float(array[0])
        return replace(result, **numbers)

    def _origin_lines(self) -> list[str]:
        """Return lines with the water, the estimator, the sea and the wind of a run."""
        provenance = self.provenance
        if "surface" not in provenance:
            return []
        link, surface = provenance.get("link", {}), provenance["surface"]
        # the wind of the sea comes first; bubbles and whitecaps have one over a sea without wind
        parts = (surface, surface.get("spectrum"), link.get("bubbles"), link.get("whitecaps"))
        winds = [part["wind_speed"] for part in parts if part and "wind_speed" in part]
        wind = f", wind {winds[0]:g} m/s" if winds else ", wind 0 m/s"
        band = f", waves up to {surface['omega_max']:.3g} rad/s" if "omega_max" in surface else ""
        text = f"{provenance['run']['estimator']} estimator, {surface['kind']} sea{wind}{band}"
        water = [_line("water", water_of(provenance))] if link else []
        return [*water, _line("run", text)]


def like(gain: Values, array: Any) -> Any:
    """Return an array (receivers,) unchanged, or as a number if `gain` is a number."""
    return float(array[0]) if array is not None and np.ndim(gain) == 0 else array


def bound_where_dark(gain: Values, photons: int) -> Values | None:
    """Return 95 % upper bounds where analog gains are 0, None if all are positive.

    An event that does not occur in n independent trials has a probability below 3 / n (rule of
    three, from (1 - p)^n = 0.05).
    """
    gains = np.atleast_1d(gain)
    dark = ~(gains > 0.0)
    # a photon weighs at most 1: the gain is at most the probability of a hit
    return like(gain, np.where(dark, min(3.0 / photons, 1.0), np.nan)) if dark.any() else None


def _line(name: str, text: str) -> str:
    """Format a line of a summary: a name in a column of fixed width, and its text."""
    return f"{name:<18}{text}"


@check_call
def merge(results: Sequence[GainResult]) -> GainResult:
    """Merge analog runs of one configuration into the result of all their photons.

    The mean of all photons is sum n_i mean_i / sum n_i over runs of n_i photons; mean squares, for
    the standard errors, combine in the same way.

    Parameters
    ----------
    results : sequence of GainResult
        Runs that differ in nothing but their photon ids, which must be disjoint
        (`simulate(..., first_photon=)`).

    Raises
    ------
    Refused
        If the configurations differ, photon ids overlap, or a run is not analog.
    """
    if not isinstance(results, Sequence) or not results:
        raise Refused("results", results, "a list of one or more GainResult")
    for i, r in enumerate(results):
        if not isinstance(r, GainResult):
            raise Refused(f"results[{i}]", Described(type(r).__name__), "a GainResult")
        if r.provenance["run"]["estimator"] != "analog":
            raise Refused(f"results[{i}]", Described("a forced result"), "analog runs")
        if _identity(r) != _identity(results[0]):
            problem = Described("configurations differ")
            raise Refused(f"results[{i}]", problem, "runs of one configuration")
    # sorted: floats are summed in an order that does not depend on that of the arguments
    results = sorted(results, key=_ranges)
    first = results[0]
    ranges = sorted(span for r in results for span in _ranges(r))
    if any(before[1] > after[0] for before, after in pairwise(ranges)):
        raise Refused("results", Described("photon ids overlap"), "disjoint runs")
    run_photons = np.array([r.photons for r in results])
    total = int(run_photons.sum())
    means = merged_means(results, run_photons)
    for name in ("arrivals", "planes", "map"):
        tallies = [getattr(result, name) for result in results]
        if tallies[0] is not None:
            means[name] = tallies[0].merged(tallies, run_photons)
    if first.gain_by_lamp_groups is not None:
        # groups are photon ids modulo 32, the same ones in all runs: each is a mean like the gain
        shares = zip(results, run_photons / total, strict=True)
        means["gain_by_lamp_groups"] = sum(share * r.gain_by_lamp_groups for r, share in shares)
    fates = {}
    for name in first.fates:
        photons = sum(r.fates[name].photons for r in results)
        weight = sum(r.fates[name].weight * r.photons for r in results) / total
        fates[name] = FateTally(photons, weight)
    run = {"photons": total, "photon_ranges": [list(span) for span in ranges]}
    return replace(
        first,
        gain_bound=bound_where_dark(means["gain"], total),
        photons=total,
        fates=fates,
        provenance=first.provenance | {"run": first.provenance["run"] | run},
        rays_recast=sum(r.rays_recast for r in results),
        rays_lost=sum(r.rays_lost for r in results),
        **means,
    )


def _ranges(result: GainResult) -> list[tuple[int, int]]:
    """Return the photon ids of a result as half-open ranges [start, stop)."""
    run = result.provenance["run"]
    # `merge` has stored the ranges of its runs; a single run has one
    single = [run["first_photon"], run["first_photon"] + result.photons]
    spans = run.get("photon_ranges", [single])
    return [(int(start), int(stop)) for start, stop in spans]


def _identity(result: GainResult) -> str:
    """Return the configuration of a run as text, without options that merged runs may differ in."""
    # these choose which photons are traced and in which batches, not how each one is traced
    ignored = ("first_photon", "photons", "threads", "batch_size", "photon_ranges", "rtol")
    run = {k: v for k, v in result.provenance["run"].items() if k not in ignored}
    return json.dumps([result.provenance[k] for k in ("link", "surface")] + [run])
