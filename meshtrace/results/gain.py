"""Results: value, standard error, number of photons, their fates, and where all came from."""

from __future__ import annotations

import json
import math
import platform
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.tally import Fate

if TYPE_CHECKING:
    import xarray as xr

FORMAT_VERSION = 1

SHIFTS = 32
"""Independent groups of samples whose scatter gives the standard error."""

Data = dict[str, tuple[tuple[str, ...], NDArray[Any]]]
"""Arrays by name, each with the names of its dimensions."""


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
    Fate.DEEP: "went down for ever, in clear water without a floor",
}


class FateTally(NamedTuple):
    """Photons and share of the launched weight with one fate."""

    photons: int
    weight: float


@cache
def environment() -> dict[str, str]:
    """Return what a result depends on besides its configuration."""
    return {
        "meshtrace": version("meshtrace"),
        "git_commit": _git_commit(),
        "python": platform.python_version(),
        "machine": platform.machine(),
        **{name: version(name) for name in ("numpy", "numba", "embreex", "scipy")},
    }


def _git_commit() -> str:
    try:
        done = subprocess.run(
            ["git", "rev-parse", "HEAD"],
            cwd=Path(__file__).parent,
            capture_output=True,
            text=True,
            timeout=5,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return done.stdout.strip()


@dataclass(frozen=True, eq=False)
class GainResult:
    """Channel gain of one link over one surface.

    Attributes
    ----------
    gain, gain_stderr : float or ndarray, shape (receivers,)
        Fraction of the emitted power that each receiver collects, and its standard error.
    photons : int
        Photons launched (analog) or chain samples (forced).
    fates : dict of str to FateTally
        Photons and weight by fate; empty for the forced estimator.
    gain_ballistic, gain_scattered : same as gain, or None
        Unscattered and scattered parts, where the estimator knows them.
    provenance : dict
        Versions, commit, seed, and the whole configuration, which loads back.
    misses : tuple of int
        Rays cast again, rays given up.
    chains : dict of str to int
        Forced only: what became of the chains (solved, without a flat-sea crossing, searched
        through all facets, further crossings found, blocked by a wave).
    data : dict of str to (dimensions, ndarray)
        Further tallies by name: irradiances, radiance, map, arrivals, gain by order.
    """

    gain: float | NDArray[np.float64]
    gain_stderr: float | NDArray[np.float64]
    photons: int
    fates: dict[str, FateTally]
    provenance: dict[str, Any]
    gain_ballistic: float | NDArray[np.float64] | None = None
    gain_scattered: float | NDArray[np.float64] | None = None
    misses: tuple[int, int] = (0, 0)
    chains: dict[str, int] = field(default_factory=dict)
    data: Data = field(default_factory=dict)

    @property
    def gain_db(self) -> float | NDArray[np.float64]:
        """Gain in optical decibels, 10 log10 of the gain."""
        with np.errstate(divide="ignore"):
            value = 10.0 * np.log10(self.gain)
        return float(value) if np.ndim(value) == 0 else value

    def to_dataset(self) -> xr.Dataset:
        """Return the result as an xarray Dataset with units and provenance."""
        import xarray as xr

        from meshtrace.fields import attrs

        gain = np.atleast_1d(self.gain)
        variables: dict[str, Any] = {
            "gain": ("receiver", gain, attrs("gain")),
            "gain_stderr": ("receiver", np.atleast_1d(self.gain_stderr), attrs("gain_stderr")),
        }
        for name in ("gain_ballistic", "gain_scattered"):
            part = getattr(self, name)
            if part is not None:
                variables[name] = ("receiver", np.atleast_1d(part), attrs(name))
        if self.fates:
            rows = list(self.fates.values())
            variables["fate_photons"] = ("fate", np.array([r.photons for r in rows], np.int64))
            variables["fate_weight"] = ("fate", np.array([r.weight for r in rows]))
        for name, (dims, values) in self.data.items():
            variables[name] = (dims, values)
        coords: dict[str, Any] = {"receiver": np.arange(len(gain))}
        if self.fates:
            codes = np.array([Fate[name.upper()] for name in self.fates], np.int8)
            coords["fate"] = (
                "fate",
                codes,
                {
                    "flag_values": codes,
                    "flag_meanings": " ".join(self.fates),
                },
            )
        return xr.Dataset(
            variables,
            coords,
            {
                "title": "meshtrace channel gain",
                "format_version": FORMAT_VERSION,
                "kind": "gain",
                "photons": self.photons,
                "misses": list(self.misses),
                "chains": json.dumps(self.chains),
                "scalar": int(np.ndim(self.gain) == 0),
                "provenance": json.dumps(self.provenance),
            },
        )

    @classmethod
    def from_dataset(cls, dataset: xr.Dataset) -> GainResult:
        """Return the result that `to_dataset` wrote.

        Raises
        ------
        ValueError
            If the dataset is of another kind or of a later format.
        """
        found = (dataset.attrs.get("kind"), dataset.attrs.get("format_version"))
        if found != ("gain", FORMAT_VERSION):
            raise ValueError(
                f"dataset: kind and format_version {found}, allowed ('gain', {FORMAT_VERSION})"
            )
        scalar = bool(dataset.attrs["scalar"])

        def value(name: str) -> Any:
            if name not in dataset:
                return None
            array = dataset[name].to_numpy()
            return float(array[0]) if scalar else array

        known = {
            "gain",
            "gain_stderr",
            "gain_ballistic",
            "gain_scattered",
            "fate_photons",
            "fate_weight",
        }
        fates = {}
        if "fate" in dataset.coords:
            for i, name in enumerate(dataset["fate"].attrs["flag_meanings"].split()):
                fates[name] = FateTally(
                    int(dataset["fate_photons"][i]), float(dataset["fate_weight"][i])
                )
        return cls(
            gain=value("gain"),
            gain_stderr=value("gain_stderr"),
            photons=int(dataset.attrs["photons"]),
            fates=fates,
            provenance=json.loads(dataset.attrs["provenance"]),
            chains=json.loads(dataset.attrs["chains"]),
            gain_ballistic=value("gain_ballistic"),
            gain_scattered=value("gain_scattered"),
            misses=tuple(int(v) for v in np.atleast_1d(dataset.attrs["misses"])),  # type: ignore[arg-type]
            data={
                str(name): (tuple(map(str, dataset[name].dims)), dataset[name].to_numpy())
                for name in dataset.data_vars
                if name not in known
            },
        )

    def save(self, path: str | Path) -> None:
        """Write the result as netCDF."""
        self.to_dataset().to_netcdf(path, engine="h5netcdf")

    @classmethod
    def load(cls, path: str | Path) -> GainResult:
        """Read a result from netCDF."""
        import xarray as xr

        with xr.open_dataset(path, engine="h5netcdf", decode_timedelta=False) as dataset:
            return cls.from_dataset(dataset.load())


def merge(results: Sequence[GainResult]) -> GainResult:
    """Return the result of all photons of several analog runs of one configuration.

    mean = sum n_i mean_i / sum n_i, and so for the mean squares.

    Parameters
    ----------
    results : sequence of GainResult
        Runs that differ in nothing but their photon ids, which must be disjoint
        (`simulate(..., first_photon=)`).

    Raises
    ------
    ValueError
        If the configurations differ, photon ids overlap, or a run is not analog.
    """
    if not results:
        raise ValueError("results: empty, allowed at least one")
    results = sorted(results, key=_ranges)
    for r in results:
        if r.provenance["run"]["estimator"] != "analog":
            raise ValueError("results: a forced result, allowed analog runs")
        if _identity(r) != _identity(results[0]):
            raise ValueError("results: configurations differ, allowed runs of one configuration")
    ranges = sorted(span for r in results for span in _ranges(r))
    if any(a[1] > b[0] for a, b in pairwise(ranges)):
        raise ValueError("results: photon ids overlap, allowed disjoint runs")
    n = np.array([r.photons for r in results])
    gain, stderr = _merged_mean(
        [np.asarray(r.gain) for r in results], [np.asarray(r.gain_stderr) for r in results], n
    )
    scalar = np.ndim(results[0].gain) == 0
    fates = {
        name: FateTally(
            sum(r.fates[name].photons for r in results),
            sum(r.fates[name].weight * r.photons for r in results) / int(n.sum()),
        )
        for name in results[0].fates
    }
    run = {
        **results[0].provenance["run"],
        "photons": int(n.sum()),
        "photon_ranges": [list(span) for span in ranges],
    }
    return replace(
        results[0],
        gain=float(gain) if scalar else gain,
        gain_stderr=float(stderr) if scalar else stderr,
        photons=int(n.sum()),
        fates=fates,
        provenance={**results[0].provenance, "run": run},
        misses=(sum(r.misses[0] for r in results), sum(r.misses[1] for r in results)),
        data=_merge_data(results, n),
    )


def _ranges(result: GainResult) -> list[tuple[int, int]]:
    """Return the photon ids of a result as half-open ranges."""
    run = result.provenance["run"]
    first = run["first_photon"]
    spans = run.get("photon_ranges", [[first, first + result.photons]])
    return [(int(a), int(b)) for a, b in spans]


def _identity(result: GainResult) -> str:
    free = ("first_photon", "photons", "threads", "batch_size", "photon_ranges", "rtol")
    run = {k: v for k, v in result.provenance["run"].items() if k not in free}
    return json.dumps([result.provenance[k] for k in ("link", "surface")] + [run])


def _merged_mean(
    means: list[NDArray[np.float64]], errors: list[NDArray[np.float64]], n: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return mean and standard error of all photons; one photon has no error of its own."""
    total = int(n.sum())
    share = n / total
    mean = sum(w * m for w, m in zip(share, means, strict=True))
    square = sum(
        w * (m**2 + (0.0 if k < 2 else s**2 * (k - 1)))
        for w, m, s, k in zip(share, means, errors, n, strict=True)
    )
    return np.asarray(mean), np.sqrt(np.maximum(square - mean**2, 0.0) / max(total - 1, 1))


def _merge_data(results: Sequence[GainResult], n: NDArray[np.int64]) -> Data:
    merged: Data = {}
    share = n / n.sum()
    for name, (dims, first) in results[0].data.items():
        parts = [r.data[name][1] for r in results]
        if name == "arrival_weight":
            scaled = [w * p for w, p in zip(share, parts, strict=True)]
            merged[name] = (dims, np.concatenate(scaled))
        elif dims[0] == "arrival":
            merged[name] = (dims, np.concatenate(parts))
        elif name in ("plane_depth", "map_x", "map_y"):
            merged[name] = (dims, first)
        elif f"{name}_stderr" in results[0].data:
            errors = [r.data[f"{name}_stderr"][1] for r in results]
            mean, error = _merged_mean(parts, errors, n)
            merged[name] = (dims, mean)
            merged[f"{name}_stderr"] = (dims, error)
        elif not name.endswith("_stderr"):
            merged[name] = (dims, sum(w * p for w, p in zip(share, parts, strict=True)))
    return {name: merged[name] for name in results[0].data}


def standard_error(total: Any, squares: Any, n: int) -> Any:
    """Return the standard error of a mean from sum and sum of squares."""
    if n < 2:
        return np.full_like(np.asarray(total, float), math.nan)
    mean = np.asarray(total) / n
    return np.sqrt(np.maximum(np.asarray(squares) / n - mean**2, 0.0) / (n - 1))
