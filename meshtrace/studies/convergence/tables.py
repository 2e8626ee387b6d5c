"""Dataset and text of a convergence study."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from meshtrace.fields import attrs
from meshtrace.studies.convergence.checks import UNITS, Costs, Normals
from meshtrace.studies.convergence.exact import Reference

if TYPE_CHECKING:
    from meshtrace.studies.convergence.study import ConvergenceStudy


# fields of the reference in order: name in files after "exact_", registered name of its metadata
_EXACT = {
    "samples": ("samples", "gain"),
    "ballistic": ("gain_ballistic", "gain_ballistic"),
    "quadrature_error": ("quadrature_error", ""),
    "slope_variance": ("mss", "mss"),
    "lost": ("lost", ""),
}


def dataset(study: ConvergenceStudy) -> xr.Dataset:
    """Return a study as an xarray Dataset with units and provenance."""
    dims, one = ("normals", study.parameter), {"units": "1"}
    variables: dict[str, Any] = {
        "gain": (dims, study.gain, attrs("gain")),
        "gain_stderr": (dims, study.gain_stderr, attrs("gain_stderr")),
        "gain_ballistic": (dims, study.ballistic.mean(axis=2), attrs("gain_ballistic")),
        "mss": (dims, study.slope_variance, attrs("mss")),
        "samples": ((*dims, "repeat", "shift"), study.samples, attrs("gain")),
        "samples_ballistic": ((*dims, "repeat"), study.ballistic, attrs("gain_ballistic")),
        "recommended": ("normals", list(study.recommended().values())),
    }
    for name in ("difference", "difference_stderr", "scatter", "error", "total_reflection"):
        variables[name] = (dims, getattr(study, name), one)
    for name, seconds in study.costs._asdict().items():
        variables[f"{name}_time"] = (dims, seconds, {"units": "s"})
    for name in ("order", "gain"):
        limits = np.array([getattr(study.fits[kind], name) for kind in study.normals])
        variables[f"fitted_{name}"] = (("normals", "limit"), limits, one)
    if study.reference is not None:
        variables["exact_gain"] = ((), study.reference.gain, attrs("gain"))
        for name, (stored, registered) in _EXACT.items():
            value = getattr(study.reference, name)
            kind = attrs(registered) if registered else one
            variables[f"exact_{stored}"] = ("shift" if np.ndim(value) else (), value, kind)
    coordinates = {
        "normals": list(study.normals),
        "limit": ["value", "low", "high"],
        study.parameter: (study.parameter, study.values, {"units": UNITS[study.parameter]}),
    }
    about = {"parameter": study.parameter, "tolerance": study.tolerance}
    return xr.Dataset(variables, coordinates, about)


def fields_of(data: xr.Dataset) -> dict[str, Any]:
    """Return the fields of the study that `dataset` wrote."""
    parameter, reference = data.attrs["parameter"], None
    if "exact_samples" in data:
        found = {name: data[f"exact_{stored}"] for name, (stored, _) in _EXACT.items()}
        exact: dict[str, Any] = {
            name: v.to_numpy() if v.dims else v.item() for name, v in found.items()
        }
        reference = Reference(**exact)
    return dict(
        parameter=parameter,
        values=data[parameter].to_numpy(),
        normals=tuple(data["normals"].values.tolist()),
        samples=data["samples"].to_numpy(),
        ballistic=data["samples_ballistic"].to_numpy(),
        scatter=data["scatter"].to_numpy(),
        slope_variance=data["mss"].to_numpy(),
        total_reflection=data["total_reflection"].to_numpy(),
        costs=Costs(*(data[f"{name}_time"].to_numpy() for name in Costs._fields)),
        reference=reference,
        tolerance=float(data.attrs["tolerance"]),
    )


def table(study: ConvergenceStudy, kind: Normals) -> str:
    """Return the results of a study for one kind of normals as text."""
    unit, k = UNITS[study.parameter], study.normals.index(kind)
    base = "the exact surface" if study.reference else "the finest"
    percent = 100.0 / study.anchor[k]
    columns = [
        (f"{study.parameter} [{unit}]", ">18", "g", study.values),
        ("gain", ">12", ".4e", study.gain[k]),
        ("unscattered", ">12", ".4e", study.ballistic.mean(axis=2)[k]),
        ("difference", ">+12", ".4f", percent * study.difference[k]),
        ("stderr", ">9", ".4f", percent * study.difference_stderr[k]),
        ("scatter", ">9", ".4f", percent * study.scatter[k]),
        ("slope var.", ">12", ".6f", study.slope_variance[k]),
        ("total refl.", ">12", ".5f", study.total_reflection[k]),
        *(
            (f"{name} s", ">8", ".3f", seconds[k])
            for name, seconds in zip(("mesh", "BVH", "gain"), study.costs, strict=True)
        ),
    ]
    lines = ["".join(format(head, width.replace("+", "")) for head, width, _, _ in columns)]
    for j in range(len(study.values)):
        lines.append("".join(_cell(v[j], width, digits) for _, width, digits, v in columns))
    lines = [f"{kind} normals, differences from {base} in percent", *lines]
    return "\n".join([*lines, *_exact_lines(study), *_fitted_lines(study, kind)])


def _cell(value: float, width: str, digits: str) -> str:
    """Return a value of the table, "-" for none."""
    return (
        format("-", width.replace("+", "")) if math.isnan(value) else format(value, width + digits)
    )


def _exact_lines(study: ConvergenceStudy) -> list[str]:
    """Return the row of the exact surface."""
    exact = study.reference
    if exact is None:
        return []
    lines = [
        f"{'exact surface':>18}{exact.gain:>12.4e}{exact.ballistic:>12.4e}{'':>30}"
        f"{exact.slope_variance:>12.6f}"
    ]
    if exact.lost:
        lines.append(f"{exact.lost} crossings have none of the exact surface next to them")
    return lines


def _fitted_lines(study: ConvergenceStudy, kind: Normals) -> list[str]:
    """Return order, limit and recommendation as text."""
    k, unit, exact = study.normals.index(kind), UNITS[study.parameter], study.reference
    order, gain, _ = study.fits[kind]
    lines = [
        f"order {order.value:.2f} ({order.low:.2f} to {order.high:.2f}, 95 %)",
        f"Richardson {gain.value:.5e} ({gain.low:.5e} to {gain.high:.5e}, 95 %)",
    ]
    if exact is not None:
        inside = "inside" if gain.low <= exact.gain <= gain.high else "outside"
        lines.append(f"exact surface {exact.gain:.5e}, {inside} that interval")
    best = study.recommended()[kind]
    said = f"finer than {study.values[-1]:g}" if math.isnan(best) else f"{best:.3g}"
    lines.append(
        f"common Monte Carlo error {100.0 * study.gain_stderr[k, -1] / study.gain[k, -1]:.2g} %; "
        f"{study.parameter} for an error of {100.0 * study.tolerance:g} %: {said} {unit}"
    )
    return lines
