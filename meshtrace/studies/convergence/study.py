"""Result of a convergence study: gains over a parameter of the discretisation."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from meshtrace.models import Floats
from meshtrace.stored import Stored
from meshtrace.studies.convergence.checks import UNITS, Costs, Normals, Parameter, positive
from meshtrace.studies.convergence.exact import Reference
from meshtrace.studies.convergence.fit import Fit, fit_law, largest_step, stderr

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True, eq=False, repr=False)
class ConvergenceStudy(Stored):
    """Gain of one link against a parameter of the discretisation.

    Attributes
    ----------
    parameter : {"spacing", "time_step", "omega_max"}
        Refined parameter.
    values : ndarray, shape (n,)
        Its values, from coarse to fine: spacing [m], time step [s] or band limit [rad s-1].
    normals : tuple of str, shape (kinds,)
        Normals of the mesh.
    samples : ndarray, shape (kinds, n, repeats, shifts)
        Gain by repeat (placement of the mesh, or realization) and shift of the chains.
    ballistic : ndarray, shape (kinds, n, repeats)
        Unscattered gain.
    scatter : ndarray, shape (kinds, n)
        Error of a single surface around the mean error of its step: standard deviation over
        placements of the mesh, or over realizations of the difference to the widest band, or
        rms error of linear interpolation in time.
    slope_variance, total_reflection : ndarray, shape (kinds, n)
        Mean square slope that light meets; share of the photons arriving from below that are
        totally reflected. nan unless requested.
    costs : Costs
        Seconds for mesh, BVH and gain of one surface.
    reference : Reference or None
        The exact surface.
    tolerance : float
        Relative error that `recommended` is about.
    provenance : dict
        Versions, configuration and seeds.
    """

    parameter: Parameter
    values: Floats
    normals: tuple[Normals, ...]
    samples: Floats
    ballistic: Floats
    scatter: Floats
    slope_variance: Floats
    total_reflection: Floats
    costs: Costs
    reference: Reference | None = None
    tolerance: float = 1e-3
    provenance: dict[str, Any] = field(default_factory=dict)

    kind: ClassVar[str] = "convergence"
    title: ClassVar[str] = "meshtrace convergence"

    @property
    def step(self) -> Floats:
        """Quantity that goes to zero: the values, or one over the band limit."""
        return 1.0 / self.values if self.parameter == "omega_max" else self.values

    @property
    def gain(self) -> Floats:
        """Gain, shape (kinds, n), mean over the repeats."""
        return self.samples.mean(axis=(2, 3))

    @property
    def gain_stderr(self) -> Floats:
        """Monte Carlo standard error of the gain, common to all steps."""
        return stderr(self.samples.mean(axis=2))

    @cached_property
    def _differences(self) -> Floats:
        """Gain minus that of the exact surface or the finest step, (kinds, n, shifts)."""
        mean = self.samples.mean(axis=2)
        anchor = mean[:, -1:] if self.reference is None else self.reference.samples
        return mean - anchor

    @property
    def anchor(self) -> Floats:
        """Gain that differences are taken from, shape (kinds,): exact, or of the finest step."""
        return self.gain[:, 0] - self.difference[:, 0]

    @property
    def difference(self) -> Floats:
        """Gain minus `anchor`, shape (kinds, n)."""
        return self._differences.mean(axis=2)

    @property
    def difference_stderr(self) -> Floats:
        """Standard error of `difference`, the Monte Carlo error left by the common chains."""
        return stderr(self._differences)

    @cached_property
    def fits(self) -> dict[str, Fit]:
        """Fitted law of each kind of normals, with the gain as `Fit.gain`.

        Notes
        -----
        Least squares, weighted by the standard errors of the differences and a misfit: the
        scatter over the placements over their number, as the mean over a lattice errs, or else
        something in proportion to h^2, which the law leaves out; as large as the residuals are
        beyond their standard errors (Paule and Mandel 1982). Intervals join a bootstrap over
        the shifts of the chains with that misfit, known from n - 3 residuals (Student). They
        leave out `gain_stderr`, which exact and meshed gains share.

        References
        ----------
        L. Eça and M. Hoekstra, J. Comput. Phys. 262, 104 (2014), doi:10.1016/j.jcp.2014.01.006.
        """
        placements = self.samples.shape[2]
        known = self.parameter == "spacing" and placements > 1
        return {
            kind: fit_law(
                self.step,
                self._differences[k],
                float(self.anchor[k]),
                self.scatter[k] / placements if known else None,
            )
            for k, kind in enumerate(self.normals)
        }

    @property
    def error(self) -> Floats:
        """Error of one surface, shape (kinds, n): hypot(g - g_0, scatter).

        g_0 is the gain over the exact surface, or else the fitted one.
        """
        if self.reference is None:
            target = np.array([self.fits[kind].gain.value for kind in self.normals])
        else:
            target = self.anchor
        return np.hypot(self.gain - target[:, None], np.nan_to_num(self.scatter))

    def recommended(self, tolerance: float | None = None) -> dict[str, float]:
        """Return the coarsest value that errs by less than a tolerance, for each kind of normals.

        Parameters
        ----------
        tolerance : float, optional
            Relative error of one surface; by default that of the study.

        Returns
        -------
        dict of str to float
            Interpolated between the values of the study; nan if none of them is fine enough.
        """
        limit = self.tolerance if tolerance is None else positive("tolerance", tolerance)
        steps = [largest_step(self.step, row, limit) for row in self.error / self.gain[:, -1:]]
        values = [1.0 / s if self.parameter == "omega_max" else s for s in steps]
        return dict(zip(self.normals, values, strict=True))

    def _content(self) -> xr.Dataset:
        from meshtrace.studies.convergence.tables import dataset

        return dataset(self)

    @classmethod
    def _restored(cls, data: xr.Dataset, provenance: Any) -> ConvergenceStudy:
        from meshtrace.studies.convergence.tables import fields_of

        return cls(**fields_of(data), provenance=provenance)

    def _headline(self) -> str:
        none = f"finer than {self.values[-1]:g}"
        found = ", ".join(
            f"{kind} {none if math.isnan(value) else format(value, '.3g')}"
            for kind, value in self.recommended().items()
        )
        percent = 100.0 * self.tolerance
        return f"{self.parameter} [{UNITS[self.parameter]}] for an error of {percent:g} %: {found}"

    def summary(self) -> str:
        """Return the study as a table of text, errors in percent of the gain."""
        from meshtrace.studies.convergence.tables import table

        return "\n\n".join(table(self, kind) for kind in self.normals)
