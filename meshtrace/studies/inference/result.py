"""Result of an inference: values, covariance, identifiability."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from meshtrace.fields import attrs
from meshtrace.models import Floats
from meshtrace.stored import Stored
from meshtrace.tables import text_table

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True, eq=False, repr=False)
class Inference(Stored):
    """Unknown parameters of a link from measured gains.

    Attributes
    ----------
    unknown, unit : tuple of str
        Names and units of the unknowns.
    estimate, error : ndarray, shape (n,)
        Values and standard errors; nan for unknowns with an error above 100 % without priors.
    covariance : ndarray, shape (n, n)
        Covariance of the logarithms (of offsets and angles themselves), priors included.
    free_error : ndarray, shape (n,)
        Relative standard errors without priors, at the start.
    singular_values : ndarray, shape (n,)
        Of the whitened sensitivities at the start: standard errors of the measurements per unit
        of a combination of logarithms.
    weakest : str
        The combination that the measurements see least.
    chi2 : float
        Sum of the squared residuals, in standard errors.
    degrees : int
        Measurements and priors minus unknowns.
    measured, predicted : ndarray, shape (m,)
        Measurements, and the fit.
    provenance : dict
        Versions and configuration.
    """

    unknown: tuple[str, ...]
    unit: tuple[str, ...]
    estimate: Floats
    error: Floats
    covariance: Floats
    free_error: Floats
    singular_values: Floats
    weakest: str
    chi2: float
    degrees: int
    measured: Floats
    predicted: Floats
    provenance: dict[str, Any] = field(default_factory=dict)

    kind: ClassVar[str] = "inference"
    title: ClassVar[str] = "meshtrace inference"

    @property
    def value(self) -> dict[str, float]:
        """Values by name; nan for undetermined ones."""
        return dict(zip(self.unknown, self.estimate.tolist(), strict=True))

    @property
    def stderr(self) -> dict[str, float]:
        """Standard errors by name, in the units of the values."""
        return dict(zip(self.unknown, self.error.tolist(), strict=True))

    @property
    def correlation(self) -> Floats:
        """Correlation of the unknowns, shape (n, n)."""
        std = np.sqrt(np.diag(self.covariance))
        return self.covariance / np.outer(std, std)

    def _headline(self) -> str:
        return ", ".join(
            f"{name} = {value:.4g} +- {error:.1g}"
            for name, value, error in zip(self.unknown, self.estimate, self.error, strict=True)
        )

    def summary(self) -> str:
        """Return values, errors and identifiability as text for a terminal."""
        rows = [
            (
                name,
                "not determined" if math.isnan(value) else f"{value:.5g}",
                "-" if math.isnan(error) else f"{error:.2g}",
                unit,
                f"{100.0 * free:.3g} %",
            )
            for name, value, error, unit, free in zip(
                self.unknown, self.estimate, self.error, self.unit, self.free_error, strict=True
            )
        ]
        head = ("unknown", "value", "std. error", "unit", "without priors")
        singular = ", ".join(f"{value:.3g}" for value in self.singular_values)
        return "\n".join(
            [
                text_table(rows, head),
                "",
                f"chi2 {self.chi2:.3g} for {self.degrees} degrees of freedom",
                f"singular values {singular}",
                f"weakest: {self.weakest}",
            ]
        )

    def _content(self) -> xr.Dataset:
        import xarray as xr

        data = {
            "inferred_value": ("unknown", self.estimate),
            "inferred_stderr": ("unknown", self.error),
            "inferred_unit": ("unknown", list(self.unit)),
            "inferred_free_error": ("unknown", self.free_error),
            "inferred_covariance": (("unknown", "unknown_too"), self.covariance),
            "singular_value": ("direction", self.singular_values),
            "measured_gain": ("measurement", self.measured),
            "predicted_gain": ("measurement", self.predicted),
        }
        found = xr.Dataset(data, {"unknown": list(self.unknown)})
        for name in found.variables:
            found[name].attrs.update(attrs(str(name)))
        return found.assign_attrs(weakest=self.weakest, chi2=self.chi2, degrees=self.degrees)

    @classmethod
    def _restored(cls, data: xr.Dataset, provenance: Any) -> Inference:
        return cls(
            unknown=tuple(str(name) for name in data["unknown"].values),
            unit=tuple(str(name) for name in data["inferred_unit"].values),
            estimate=data["inferred_value"].values,
            error=data["inferred_stderr"].values,
            covariance=data["inferred_covariance"].values,
            free_error=data["inferred_free_error"].values,
            singular_values=data["singular_value"].values,
            weakest=data.attrs["weakest"],
            chi2=float(data.attrs["chi2"]),
            degrees=int(data.attrs["degrees"]),
            measured=data["measured_gain"].values,
            predicted=data["predicted_gain"].values,
            provenance=provenance,
        )
