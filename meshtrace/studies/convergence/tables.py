"""A study as a dataset and as text."""

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


def dataset(study: ConvergenceStudy) -> xr.Dataset:
    """Return a study as an xarray Dataset with units and provenance."""
    dims, by_value = ("normals", study.parameter), (study.parameter,)
    one = {"units": "1"}
    variables: dict[str, Any] = {
        "gain": (dims, study.gain, attrs("gain")),
        "gain_stderr": (dims, study.gain_stderr, attrs("gain_stderr")),
        "gain_ballistic": (dims, study.ballistic.mean(axis=2), attrs("gain_ballistic")),
        "difference": (dims, study.difference, one),
        "difference_stderr": (dims, study.difference_stderr, one),
        "scatter": (dims, study.scatter, one),
        "error": (dims, study.error, one),
        "mss": (dims, study.slope_variance, attrs("mss")),
        "total_reflection": (dims, study.total_reflection, one),
    }
    for name, seconds in study.costs._asdict().items():
        variables[f"{name}_time"] = (dims, seconds, {"units": "s"})
    for name in ("order", "gain"):
        limits = np.array([getattr(study.fits[kind], name) for kind in study.normals])
        variables[f"fitted_{name}"] = (("normals", "limit"), limits, one)
    variables["recommended"] = ("normals", list(study.recommended().values()))
    if study.reference is not None:
        variables["exact_gain"] = ((), study.reference.gain, attrs("gain"))
        variables["exact_gain_ballistic"] = (
            (),
            study.reference.ballistic,
            attrs("gain_ballistic"),
        )
        variables["exact_mss"] = ((), study.reference.slope_variance, attrs("mss"))
        variables["exact_samples"] = ("shift", study.reference.samples, attrs("gain"))
        variables["exact_quadrature_error"] = ((), study.reference.quadrature_error, one)
        variables["exact_lost"] = ((), study.reference.lost, one)
    coordinates = {
        "normals": list(study.normals),
        "limit": ["value", "low", "high"],
        study.parameter: (by_value, study.values, {"units": UNITS[study.parameter]}),
    }
    variables["samples"] = ((*dims, "repeat", "shift"), study.samples, attrs("gain"))
    variables["samples_ballistic"] = ((*dims, "repeat"), study.ballistic, attrs("gain_ballistic"))
    about = {"parameter": study.parameter, "tolerance": study.tolerance}
    return xr.Dataset(variables, coordinates, about)


def fields_of(data: xr.Dataset) -> dict[str, Any]:
    """Return the fields of the study that `dataset` wrote."""
    parameter, reference = data.attrs["parameter"], None
    if "exact_samples" in data:
        reference = Reference(
            samples=data["exact_samples"].to_numpy(),
            ballistic=float(data["exact_gain_ballistic"]),
            quadrature_error=float(data["exact_quadrature_error"]),
            slope_variance=float(data["exact_mss"]),
            lost=int(data["exact_lost"]),
        )
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
    """Return the part of a study about one kind of normals as text."""
    unit, k = UNITS[study.parameter], study.normals.index(kind)
    head = f"{study.parameter} [{unit}]"
    base = "the exact surface" if study.reference else "the finest"
    percent = 100.0 / study.anchor[k]
    lines = [
        f"{kind} normals, differences from {base} in percent",
        f"{head:>18}{'gain':>12}{'unscattered':>12}{'difference':>12}{'stderr':>9}{'scatter':>9}"
        f"{'slope var.':>12}{'total refl.':>12}{'mesh s':>8}{'BVH s':>8}{'gain s':>8}",
    ]
    ballistic = study.ballistic.mean(axis=2)
    for j, value in enumerate(study.values):
        lines.append(
            f"{value:>18g}{study.gain[k, j]:>12.4e}{ballistic[k, j]:>12.4e}"
            f"{percent * study.difference[k, j]:>+12.4f}"
            f"{percent * study.difference_stderr[k, j]:>9.4f}"
            f"{percent * study.scatter[k, j]:>9.4f}{study.slope_variance[k, j]:>12.6f}"
            f"{study.total_reflection[k, j]:>12.5f}"
            + "".join(f"{seconds[k, j]:>8.3f}" for seconds in study.costs)
        )
    return "\n".join([*lines, *_exact_lines(study), *_fitted_lines(study, kind)])


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
        f"Monte Carlo error of all {100.0 * study.gain_stderr[k, -1] / study.gain[k, -1]:.2g} %; "
        f"{study.parameter} for an error of {100.0 * study.tolerance:g} %: {said} {unit}"
    )
    return lines
