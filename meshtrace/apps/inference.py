"""Properties of a link from measurements: least squares with covariance and identifiability."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Unpack

import numpy as np

from meshtrace import MeshSource, TriangleMesh
from meshtrace.apps.predictions import OF_DETECTOR, SCALE, Prediction, Predictor, read_measurements
from meshtrace.checks import check_call
from meshtrace.engine.setup.options import StudyOptions
from meshtrace.errors import Refused, require_keys
from meshtrace.link import Link
from meshtrace.models import Floats
from meshtrace.scenario import Scenario
from meshtrace.stored import Stored, Variable
from meshtrace.studies import Variant
from meshtrace.studies.background import electronics_of, light_of
from meshtrace.studies.campaign import campaign_of
from meshtrace.studies.keys import Parameter, parameters
from meshtrace.studies.neighbours import WATER
from meshtrace.surfaces import FlatSea
from meshtrace.tables import text_table


@dataclass(frozen=True, eq=False, repr=False)
class Inference(Stored, kind="inference", title="meshtrace inference"):
    """Unknown parameters of a link from measurements.

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
    covariance: Annotated[Floats, Variable("unknown", "unknown_too", name="inferred_covariance")]
    free_error: Annotated[Floats, Variable("unknown", name="inferred_free_error")]
    singular_values: Annotated[Floats, Variable("direction", name="singular_value")]
    weakest: str
    chi2: float
    degrees: int
    measured: Annotated[Floats, Variable("measurement", name="measured_value")]
    predicted: Annotated[Floats, Variable("measurement", name="predicted_value")]
    provenance: dict[str, Any] = field(default_factory=dict)

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
        lines = [
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
                text_table(lines, head),
                "",
                f"chi2 {self.chi2:.3g} for {self.degrees} degrees of freedom",
                f"singular values {singular}",
                f"weakest: {self.weakest}",
            ]
        )


DEFAULT_CHAINS = 4096
"""Chains of the prediction of each measurement."""

_SCALE = Parameter(SCALE, 1.0, "1", absolute=False, origin=0.0, step=1.0, usual=1.0)
_FARTHEST = 5.0  # of a logarithm from its start
_ANY_SCALE = 100.0  # of the logarithm of the scale
_UNKNOWN = 1.0  # relative standard error beyond which no value is quoted
_LEAST = 1e-12  # singular value over the largest, below which a direction is unknown
_ROUNDS = 2  # of the fit: the error of the prediction is updated in between
_SCORINGS = 20  # the same with counts, at most
_SETTLED = 1e-5  # move of the unknowns in a round


@check_call
def infer(
    measurements: Any,
    link: Link | Scenario,
    unknown: Sequence[str] = (*WATER, SCALE),
    prior: Mapping[str, tuple[float, float]] | None = None,
    *,
    surface: MeshSource | TriangleMesh | None = None,
    **run: Unpack[StudyOptions],
) -> Inference:
    """Return unknown parameters of a link from measured gains, powers or error rates.

    Parameters
    ----------
    measurements : sequence of mappings, or mapping of columns
        Each with "gain" and "stderr", or "counts" (that follow the law of Poisson, 0 included,
        unless "stderr" is given), or behind the optics of the detector with "power" [W] or "ber"
        and "stderr", and the keys that differ between measurements, such as
        "transmitter.depth", "receiver.fov_deg" and "detector.bit_rate".
    link : Link or Scenario
        The link at the starting values of the unknowns; a scenario also gives the detector, and
        the daylight behind error rates.
    unknown : sequence of str
        Keys of link, detector and daylight, and "scale" for a common factor of all gains.
    prior : mapping of str to (mean, std), optional
        Independent knowledge of unknowns.
    surface : MeshSource or TriangleMesh, optional
        The surface; still water by default, or that of the scenario.
    **run
        Options of the run, see `StudyOptions`: 4096 chains of each prediction by default, progress
        by prediction.

    Returns
    -------
    Inference

    Raises
    ------
    Refused
        If a key or an unknown is not known, or there are more unknowns than measurements and
        priors.

    Notes
    -----
    Least squares in the logarithms of gains and parameters (offsets and angles as they are), with
    weights W = diag(1 / sigma^2) from the errors of the measurements s and those of the
    predictions by their chains, c, sigma^2 = (s / y)^2 + c^2:

        chi2 = sum_i (ln y_i - m_i(x))^2 / sigma_i^2,
        cov(x) = A^-1 J^T W V W J A^-1,    A = J^T W J,

    J the sensitivities (moments for a and b) and V the covariance of all errors, in which
    predictions share chains. It is not inverted: 32 shifts know its elements, not its inverse, by
    which intervals of few chains were too narrow. Counts n have the likelihood of Poisson,
    by Fisher's scoring: n / mu - 1 for ln y - m, and 1 / mu for (s / y)^2, mu the prediction.

    Error rates are those behind the response of the channel from the chains of each measurement.

    Before the fit the singular values of W^1/2 J, without priors, tell which combinations the
    measurements see; `weakest` names the one that they see least. A parameter whose relative
    error without priors exceeds 100 % is not quoted: its value is nan.

    Where the errors of the chains dominate (256 chains, measurements of 0.2 %), intervals remain
    some 20 % too narrow; the page on validation has the measured coverage.

    Examples
    --------
    >>> import meshtrace as mt
    >>> rows = [{"transmitter.depth": d, "gain": g, "stderr": 0.02 * g}
    ...         for d, g in ((5.0, 3.0e-4), (10.0, 6.0e-5), (20.0, 6.9e-6))]
    >>> f = mt.infer(rows, mt.Link(), ["water.a"], photons=512)
    >>> f"{f.value['water.a']:.2f}"
    '0.11'
    """
    data = read_measurements(measurements)
    # measurements of tanks and lakes are of still water; waves are asked for
    if surface is None and not isinstance(link, Scenario):
        surface = FlatSea()
    run.setdefault("photons", DEFAULT_CHAINS)
    campaign = campaign_of(link, surface, "infer", run, several=False)
    campaign.require_chains()
    names = list(unknown)
    keys = [name for name in names if name != SCALE]
    variant = Variant(campaign.link, campaign.surface)
    detector = electronics_of(campaign, getattr(campaign.scenario, "detector", None), None)
    # measured gains say nothing about a detector, whose background takes time
    if detector is not None and set(data.names) & set(OF_DETECTOR):
        variant = variant._replace(detector=detector, daylight=light_of(campaign, None))
    of_keys = parameters(variant, keys, None, "vertex", "unknown") if keys else []
    for p in of_keys:
        # every gain of the sea needs another mesh, which common chains do not share
        if p.name.split(".")[0] in ("sea", "wind_speed"):
            raise Refused("unknown", p.name, "keys of link, detector and daylight, or scale")
    of_link = iter(of_keys)
    unknowns = [_SCALE if name == SCALE else next(of_link) for name in names]
    slope, target = _priors(prior or {}, names, unknowns)
    if not names or len(set(names)) < len(names):
        raise Refused("unknown", names, "one or more names, each once")
    known = len(data.value) + len(target)
    if len(names) > known:
        raise Refused("unknown", names, f"at most {known}: measurements and priors")
    model = Predictor(campaign, variant, data, unknowns)
    with campaign.workers():
        return _Fit(model, names, unknowns, slope, target).result(campaign.provenance())


def _priors(
    table: Mapping[str, tuple[float, float]], names: list[str], unknowns: list[Parameter]
) -> tuple[Floats, Floats]:
    """Return the priors in the coordinates of the fit: slope @ x = target, with error 1."""
    require_keys(table, names, "prior")
    slope, target = np.zeros((len(table), len(names))), np.zeros(len(table))
    for i, (name, pair) in enumerate(table.items()):
        (mean, std), axis = pair, names.index(name)
        p = unknowns[axis]
        if not std > 0.0 or not (mean > 0.0 or p.absolute):
            raise Refused(f"prior.{name}", pair, "(mean, std), std > 0")
        off = mean - (p.base if p.absolute else p.origin)
        # of a logarithm the error is the relative one
        mean, std = (off, std) if p.absolute else (math.log(off / p.scale), std / off)
        slope[i, axis], target[i] = 1.0 / std, mean / std
    return slope, target


class _Fit:
    """Least-squares fit of the unknowns; priors count as further measurements (`_priors`)."""

    def __init__(
        self, model: Predictor, names: list[str], unknowns: list[Parameter], slope: Floats,
        target: Floats,
    ) -> None:  # fmt: skip
        self.model, self.data, self.names, self.unknowns = model, model.data, names, unknowns
        self._slope, self._target = slope, target

    def _variance(self, prediction: Prediction) -> Floats:
        """Return the variances of ln gain by the measurements, Poisson's for counts."""
        # the variance of a logarithm is the relative variance; of counts it is 1 / mean
        # of counts the standard error is nan here, and not used
        relative = np.square(self.data.stderr / np.maximum(self.data.value, 1e-300))
        return np.where(self.data.counted, np.exp(-prediction.log), relative)

    def _sigma(self, prediction: Prediction) -> Floats:
        """Return the standard errors of ln gain by measurements and chains."""
        return np.sqrt(self._variance(prediction) + np.diag(prediction.covariance))

    def _residuals(self, log: Floats, around: Floats) -> Floats:
        """Return predicted minus measured ln gain; of counts the difference over exp(`around`)."""
        value, counted = self.data.value, self.data.counted
        counts = (np.exp(log) - value) * np.exp(-around)
        # counts may be 0, so that they are compared as they are and not by their logarithm
        return np.where(counted, counts, log - np.log(np.where(counted, 1.0, value)))

    def _solved(self, x0: Floats, last: Prediction) -> Floats:
        """Return the least-squares solution for the weights of one prediction."""
        from scipy.optimize import least_squares

        sigma = self._sigma(last)

        def residuals(x: Floats) -> Floats:
            off = self._residuals(self.model.at(x).log, last.log)
            return np.concatenate([off / sigma, self._slope @ x - self._target])

        def jacobian(x: Floats) -> Floats:
            prediction = self.model.at(x)
            growth = np.where(self.data.counted, np.exp(prediction.log - last.log), 1.0)
            return np.concatenate([prediction.slope * (growth / sigma)[:, None], self._slope])

        # beyond these a prediction is dark or overflows, from which no step leads back
        far = [100.0 * p.step if p.absolute else _FARTHEST for p in self.unknowns]
        limits = np.where([name == SCALE for name in self.names], _ANY_SCALE, far)
        bounds = -limits, limits
        return np.asarray(
            least_squares(residuals, x0, jac=jacobian, bounds=bounds, x_scale="jac").x
        )

    def result(self, origin: dict[str, Any]) -> Inference:
        """Fit the unknowns and assess their identifiability at the start."""
        x = np.zeros(len(self.names))
        first = self.model.at(x)
        # without this start a wrong scale would look like wrong water
        if SCALE in self.names:  # one with the right mean
            positive = self.data.value > 0.0
            off = np.log(self.data.value[positive]) - first.log[positive]
            x[self.names.index(SCALE)] = float(np.mean(off))
        last = self.model.at(x)
        sigma = self._sigma(last)
        # small singular values belong to mixtures of unknowns that the measurements do not tell
        _, singular, directions = np.linalg.svd(first.slope / sigma[:, None], full_matrices=False)
        before = _relative(singular, directions)
        # Fisher scoring: the weights of counts follow from the prediction, which changes
        for _ in range(_SCORINGS if self.data.counted.any() else _ROUNDS):
            previous, x = x, self._solved(x, last)
            last = self.model.at(x)
            if np.abs(x - previous).max() < _SETTLED:
                break
        covariance, after = self._covariance(last)
        off = self._residuals(last.log, last.log) / self._sigma(last)
        beside = self._slope @ x - self._target
        absolute = np.array([p.absolute for p in self.unknowns])
        moves = list(zip(self.unknowns, x, strict=True))
        values = [p.moved(step) for p, step in moves]
        scales = [1.0 if p.absolute else abs(p.scale) * math.exp(step) for p, step in moves]
        # an error of a logarithm beyond 1 leaves not even the order of magnitude
        hidden = ~absolute & ((before > _UNKNOWN) | (after > _UNKNOWN))
        return Inference(
            unknown=tuple(self.names),
            unit=tuple(p.unit for p in self.unknowns),
            estimate=np.where(hidden, math.nan, values),
            error=np.where(hidden, math.nan, np.sqrt(np.diag(covariance)) * scales),
            covariance=covariance,
            free_error=before,
            singular_values=singular,
            weakest=_words(self.names, absolute, singular, directions),
            chi2=float(off @ off + beside @ beside),
            degrees=len(off) + len(beside) - len(x),
            measured=self.data.value,
            predicted=np.exp(last.log),
            provenance=origin,
        )

    def _covariance(self, last: Prediction) -> tuple[Floats, Floats]:
        """Return the covariance of the unknowns, and their standard errors without priors.

        I^-1 S I^-1: information I of the weights, S with the errors that all measurements have in
        common by the chains.
        """
        sigma = self._sigma(last)
        whitened = last.slope / sigma[:, None]
        noise = (np.diag(self._variance(last)) + last.covariance) / np.outer(sigma, sigma)
        known = self._slope.T @ self._slope
        information, spread = whitened.T @ whitened + known, whitened.T @ noise @ whitened + known
        # directions that no measurement tells would have infinite variance
        inverse = np.linalg.pinv(information, rcond=_LEAST**2, hermitian=True)
        alone = _relative(*np.linalg.svd(whitened, full_matrices=False)[1:])
        return inverse @ spread @ inverse, alone


def _relative(singular: Floats, directions: Floats) -> Floats:
    """Return the relative standard errors without priors, infinite where undetermined."""
    n = directions.shape[1]
    known = np.zeros(n)
    known[: len(singular)] = np.where(singular > _LEAST * singular[0], singular, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        parts = np.where(
            directions[: len(known)] != 0.0, directions / known[: len(directions), None], 0.0
        )
    errors: Floats = np.sqrt(np.square(parts).sum(axis=0))
    return np.full(n, math.inf) if len(directions) < n else errors


def _words(names: list[str], absolute: Any, singular: Floats, directions: Floats) -> str:
    """Describe the combination of unknowns that the measurements determine least."""
    # the least singular value belongs to the change that the measurements hardly see
    v = directions[-1] / directions[-1][int(np.abs(directions[-1]).argmax())]
    step, parts = 0.1, []
    for i in np.argsort(-np.abs(v)):
        if abs(v[i]) >= 0.005:
            change = f"{step * v[i]:+.2g}" if absolute[i] else f"{100.0 * step * v[i]:+.2g} %"
            parts.append(f"{names[i]} {change}")
    length = step / np.abs(directions[-1]).max()
    seen = singular[-1] * length
    return f"{' with '.join(parts)} changes the measurements by {seen:.2g} standard errors"
