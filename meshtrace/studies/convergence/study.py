"""Gains over a parameter of the discretisation: the fitted law and the result of a study."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NamedTuple

import numpy as np
from scipy.optimize import brentq

from meshtrace.fading import Estimate
from meshtrace.fields import attrs
from meshtrace.models import Floats
from meshtrace.results.tallies import error_of_groups
from meshtrace.stored import Stored, Variable
from meshtrace.studies.convergence.measure import Normals, Reference, positive

if TYPE_CHECKING:
    import xarray as xr


_REPLICATES = 2000  # of the bootstrap
_LEVEL = 0.95
_REWEIGHTINGS = 4  # of the fit by its own misfit
_ORDERS = np.linspace(0.5, 6.0, 1101)  # of the fit


class Fit(NamedTuple):
    """The law g_0 + C h^p fitted to a study."""

    order: Estimate
    gain: Estimate
    coefficient: float


def fit_law(step: Floats, differences: Floats, anchor: float, spread: Floats | None = None) -> Fit:
    """Fit g_0 + C h^p to differences from an anchor, with 95 % intervals.

    Parameters
    ----------
    step : ndarray, shape (n,)
        Steps h, from coarse to fine, n >= 4.
    differences : ndarray, shape (n, shifts)
        Gains less the anchor, of each shift of the chains.
    anchor : float
        Reference of the differences.
    spread : ndarray, shape (n,), optional
        Further error of each mean, absolute and in proportion; by default the law leaves
        out something in proportion to h^2.

    Returns
    -------
    Fit
    """
    n, shifts = differences.shape
    h = step / step[0]
    y, noise = differences.mean(axis=1), error_of_groups(differences, -1)
    shape, least = (h**2, 0.0) if spread is None else (spread, 1.0)
    sigma = h**2
    for _ in range(_REWEIGHTINGS):
        order, offset, slope = _least_squares(h, y[None], sigma)
        misfit = max(_misfit(y - offset - slope * h**order, noise, shape), least)
        sigma = np.hypot(noise, misfit * shape) + 1e-300
    order, offset, slope = _least_squares(h, y[None], sigma)
    rng = np.random.default_rng(n * shifts)
    resampled = differences[:, rng.integers(shifts, size=(_REPLICATES, shifts))].mean(axis=2).T
    # a misfit that was fitted is itself known from n - 3 residuals only: Student's distribution
    fitted = misfit > least
    scale = np.sqrt((n - 3) / rng.chisquare(n - 3, (_REPLICATES, 1))) if fitted else 1.0
    left = misfit * shape * scale * rng.standard_normal((_REPLICATES, n))
    orders, offsets, _ = _least_squares(h, offset + slope * h**order + resampled - y + left, sigma)
    tail = 0.5 * (1.0 - _LEVEL)
    limits = np.quantile([orders, offsets], (tail, 1.0 - tail), axis=1)
    return Fit(
        Estimate(float(order[0]), *map(float, limits[:, 0])),
        Estimate(anchor + float(offset[0]), *(anchor + float(v) for v in limits[:, 1])),
        float(slope[0] * step[0] ** -order[0]),
    )


def _misfit(residual: Floats, noise: Floats, shape: Floats) -> float:
    """Return the m >= 0 of errors hypot(noise, m shape) that the residuals of the fit have.

    sum r^2 / (noise^2 + m^2 shape^2) = n - 3, as R. C. Paule and J. Mandel, J. Res. Natl.
    Bur. Stand. 87, 377 (1982), doi:10.6028/jres.087.022: noise is not counted twice.
    """
    freedom = len(residual) - 3

    def excess(m: float) -> float:
        return float(np.sum(residual**2 / (noise**2 + (m * shape) ** 2 + 1e-300))) - freedom

    most = math.sqrt(float(np.sum((residual / shape) ** 2)) / freedom)
    if excess(0.0) <= 0.0 or excess(most) >= 0.0:
        return 0.0 if excess(0.0) <= 0.0 else most
    return float(brentq(excess, 0.0, most))


def _least_squares(h: Floats, y: Floats, sigma: Floats) -> tuple[Floats, Floats, Floats]:
    """Return p, g_0 and C for each row of y (rows, n), errors in proportion to sigma.

    For a given order the law is linear: the best order is looked up on a fine grid.
    """
    weight = (sigma / sigma.max()) ** -2
    weight /= weight.sum()
    power = h ** _ORDERS[:, None]
    power_mean = power @ weight
    power = power - power_mean[:, None]
    mean = y @ weight
    covariance = (weight * (y - mean[:, None])) @ power.T  # (rows, orders)
    variance = (weight * power**2).sum(axis=1)
    best = np.argmax(covariance**2 / variance, axis=1)
    slope = covariance[np.arange(len(y)), best] / variance[best]
    return _ORDERS[best], mean - slope * power_mean[best], slope


def largest_step(step: Floats, error: Floats, limit: float) -> float:
    """Return the largest step with all errors from there on below a limit, or nan."""
    worst = np.maximum(np.maximum.accumulate(error[::-1])[::-1], 1e-300)
    if not worst[-1] <= limit:
        return math.nan
    if worst[0] <= limit:
        return float(step[0])
    j = int(np.argmax(worst <= limit))
    share = math.log(limit / worst[j]) / math.log(worst[j - 1] / worst[j])
    return float(step[j] * (step[j - 1] / step[j]) ** share)


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
    mesh_time, bvh_time, evaluation_time : ndarray, shape (kinds, n)
        Time for mesh, BVH and gain of one surface [s].
    reference : Reference or None
        The exact surface.
    tolerance : float
        Relative error that `recommended` is about.
    provenance : dict
        Versions, configuration and seeds.
    """

    parameter: str
    values: Annotated[Floats, Variable("{parameter}", name="{parameter}")]
    normals: Annotated[tuple[Normals, ...], Variable("normals")]
    samples: Annotated[Floats, Variable("normals {parameter} repeat shift")]
    ballistic: Annotated[Floats, Variable("normals {parameter} repeat", name="samples_ballistic")]
    scatter: Annotated[Floats, Variable("normals {parameter}")]
    slope_variance: Annotated[Floats, Variable("normals {parameter}", name="mss")]
    total_reflection: Annotated[Floats, Variable("normals {parameter}")]
    mesh_time: Annotated[Floats, Variable("normals {parameter}")]
    bvh_time: Annotated[Floats, Variable("normals {parameter}")]
    evaluation_time: Annotated[Floats, Variable("normals {parameter}")]
    reference: Reference | None = None
    tolerance: float = 1e-3
    provenance: dict[str, Any] = field(default_factory=dict)

    kind: ClassVar[str] = "convergence"
    title: ClassVar[str] = "meshtrace convergence"
    _attributes: ClassVar[tuple[str, ...]] = ("parameter", "tolerance")

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
        return error_of_groups(self.samples.mean(axis=2), -1)

    @cached_property
    def _differences(self) -> Floats:
        """Gain minus the gain of the exact surface or the finest step, (kinds, n, shifts)."""
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
        return error_of_groups(self._differences, -1)

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
        dims, one = ("normals", self.parameter), {"units": "1"}
        found: dict[str, Any] = {
            "gain": (dims, self.gain, attrs("gain")),
            "gain_stderr": (dims, self.gain_stderr, attrs("gain_stderr")),
            "gain_ballistic": (dims, self.ballistic.mean(axis=2), attrs("gain_ballistic")),
            "recommended": ("normals", list(self.recommended().values())),
        }
        for name in ("difference", "difference_stderr", "error"):
            found[name] = (dims, getattr(self, name), one)
        for name in ("order", "gain"):
            limits = np.array([getattr(self.fits[kind], name) for kind in self.normals])
            found[f"fitted_{name}"] = (("normals", "limit"), limits, one)
        if self.reference is not None:
            found["exact_gain"] = ((), self.reference.gain, attrs("gain"))
        return super()._content().assign(found).assign_coords(limit=["value", "low", "high"])

    @property
    def _unit(self) -> str:
        return attrs(self.parameter)["units"]

    def _headline(self) -> str:
        found = ", ".join(f"{kind} {self._recommended(kind)}" for kind in self.normals)
        percent = 100.0 * self.tolerance
        return f"{self.parameter} [{self._unit}] for an error of {percent:g} %: {found}"

    def _recommended(self, kind: Normals) -> str:
        """Return the recommended value for one kind of normals as text."""
        best = self.recommended()[kind]
        return f"finer than {self.values[-1]:g}" if math.isnan(best) else f"{best:.3g}"

    def summary(self) -> str:
        """Return the study as a table of text, errors in percent of the gain."""
        return "\n\n".join(self._table(kind) for kind in self.normals)

    def _table(self, kind: Normals) -> str:
        """Return the results of a study for one kind of normals as text."""
        unit, k = self._unit, self.normals.index(kind)
        base = "the exact surface" if self.reference else "the finest"
        percent = 100.0 / self.anchor[k]
        columns = [
            (f"{self.parameter} [{unit}]", ">18", "g", self.values),
            ("gain", ">12", ".4e", self.gain[k]),
            ("unscattered", ">12", ".4e", self.ballistic.mean(axis=2)[k]),
            ("difference", ">+12", ".4f", percent * self.difference[k]),
            ("stderr", ">9", ".4f", percent * self.difference_stderr[k]),
            ("scatter", ">9", ".4f", percent * self.scatter[k]),
            ("slope var.", ">12", ".6f", self.slope_variance[k]),
            ("total refl.", ">12", ".5f", self.total_reflection[k]),
            ("mesh s", ">8", ".3f", self.mesh_time[k]),
            ("BVH s", ">8", ".3f", self.bvh_time[k]),
            ("gain s", ">8", ".3f", self.evaluation_time[k]),
        ]
        lines = ["".join(format(head, width.replace("+", "")) for head, width, _, _ in columns)]
        for j in range(len(self.values)):
            lines.append("".join(_cell(v[j], width, digits) for _, width, digits, v in columns))
        lines = [f"{kind} normals, differences from {base} in percent", *lines]
        return "\n".join([*lines, *self._exact_lines(), *self._fitted_lines(kind)])

    def _exact_lines(self) -> list[str]:
        """Return the row of the exact surface."""
        exact = self.reference
        if exact is None:
            return []
        lines = [
            f"{'exact surface':>18}{exact.gain:>12.4e}{exact.ballistic:>12.4e}{'':>30}"
            f"{exact.slope_variance:>12.6f}"
        ]
        if exact.lost:
            lines.append(f"{exact.lost} crossings have none of the exact surface next to them")
        return lines

    def _fitted_lines(self, kind: Normals) -> list[str]:
        """Return order, limit and recommendation as text."""
        k, unit, exact = self.normals.index(kind), self._unit, self.reference
        order, gain, _ = self.fits[kind]
        lines = [
            f"order {order.value:.2f} ({order.low:.2f} to {order.high:.2f}, 95 %)",
            f"Richardson {gain.value:.5e} ({gain.low:.5e} to {gain.high:.5e}, 95 %)",
        ]
        if exact is not None:
            inside = "inside" if gain.low <= exact.gain <= gain.high else "outside"
            lines.append(f"exact surface {exact.gain:.5e}, {inside} that interval")
        lines.append(
            f"common Monte Carlo error {100.0 * self.gain_stderr[k, -1] / self.gain[k, -1]:.2g} %; "
            f"{self.parameter} for an error of {100.0 * self.tolerance:g} %: "
            f"{self._recommended(kind)} {unit}"
        )
        return lines


def _cell(value: float, width: str, digits: str) -> str:
    """Return a value of the table, "-" for nan."""
    return (
        format("-", width.replace("+", "")) if math.isnan(value) else format(value, width + digits)
    )
