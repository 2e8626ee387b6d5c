"""Result of an inference: values, covariance, identifiability."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

import numpy as np

from meshtrace.models import Floats
from meshtrace.stored import Stored, Variable
from meshtrace.tables import text_table


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

    unknown: Annotated[tuple[str, ...], Variable("unknown")]
    unit: Annotated[tuple[str, ...], Variable("unknown", name="inferred_unit")]
    estimate: Annotated[Floats, Variable("unknown", name="inferred_value")]
    error: Annotated[Floats, Variable("unknown", name="inferred_stderr")]
    covariance: Annotated[Floats, Variable("unknown unknown_too", name="inferred_covariance")]
    free_error: Annotated[Floats, Variable("unknown", name="inferred_free_error")]
    singular_values: Annotated[Floats, Variable("direction", name="singular_value")]
    weakest: str
    chi2: float
    degrees: int
    measured: Annotated[Floats, Variable("measurement", name="measured_gain")]
    predicted: Annotated[Floats, Variable("measurement", name="predicted_gain")]
    provenance: dict[str, Any] = field(default_factory=dict)

    kind: ClassVar[str] = "inference"
    title: ClassVar[str] = "meshtrace inference"
    _attributes: ClassVar[dict[str, type]] = {"weakest": str, "chi2": float, "degrees": int}

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
