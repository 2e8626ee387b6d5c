"""Measurements compared with computed values and their bands: data, comparison, table.

An experiment is a folder in `data`: `experiment.toml` has its texts, its source and the inputs
that the source does not report, with their ranges; `data.csv` has the printed numbers. Its
prediction is a function of the rooms beside this file, of a row, the share of the photons and the
inputs; it returns a value, or a value and its standard error.
"""

from __future__ import annotations

import csv
import math
import tomllib
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from meshtrace.checks import check_call
from meshtrace.errors import DomainWarning, Refused, require_word
from meshtrace.models import Finite, Floats, Model
from meshtrace.parallel import announce
from meshtrace.results.provenance import environment
from meshtrace.stored import Stored, Variable
from meshtrace.tables import text_table

DATA = Path(__file__).with_name("data")
ERRORS = 2.0
"""Monte Carlo standard errors in a band."""

_SECONDS, _QUICK = 150.0, 8  # of the whole suite on two cores; fewer photons by this factor
_NUMBERS = ("at", "value", "low", "high")
_Text = Annotated[str, Field(min_length=1)]


class Unknown(Model, frozen=True):
    """Input that the source does not report.

    Parameters
    ----------
    name : str
        Name, a keyword of the prediction.
    nominal : number or str
        Value of the nominal prediction.
    others : sequence
        Further values of its range: the ends of a range, or the other choices.
    unit : str
        Unit, "1" for choices.
    authority : str
        Source of the range, or the reason of the judgement.
    """

    name: _Text
    nominal: Finite | str
    others: Annotated[tuple[Finite | str, ...], Field(min_length=1)]
    unit: _Text
    authority: _Text


class MeasuredRow(Model, frozen=True):
    """Printed number of a source.

    Parameters
    ----------
    quantity : str
        Quantity, as in the table.
    series, at : str, number
        Key of the prediction, and abscissa of the figure.
    unit : str
        Unit of `value`, `low`, `high`.
    value : number
        Printed number; nan for a range, or where nothing is printed.
    low, high : number
        Ends of its uncertainty, or of the printed range; nan where nothing is printed.
    place : str
        Place in the source.
    along : tuple of number
        Abscissas of all rows of the experiment.
    """

    quantity: _Text
    series: _Text
    at: Finite
    unit: _Text
    value: float
    low: float
    high: float
    place: _Text
    along: tuple[Finite, ...] = ()

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        middle = self.low if math.isnan(self.value) else self.value
        printed = not all(math.isnan(v) for v in (self.value, self.low, self.high))
        if printed and not self.low <= middle <= self.high:
            raise Refused("low, value, high", (self.low, self.value, self.high), "in this order")
        return self

    @property
    def text(self) -> str:
        """Measured value as text."""
        if math.isnan(self.low):
            return "-"
        if math.isnan(self.value):
            return f"> {self.low:g}" if self.high == math.inf else f"{self.low:g} to {self.high:g}"
        return f"{self.value:g} ({self.low:.3g} to {self.high:.3g})"


class Experiment(Model, frozen=True):
    """Published experiment with its source, unreported inputs and printed numbers.

    Parameters
    ----------
    name, title, source, doi : str
        Name of the folder, title, reference and its DOI ("" if none is known).
    read : {"table", "abstract", "second hand"}
        Part of the source that was read.
    kind : {"number", "in kind"}
        Whether numbers are compared, or a law, a trend, an order of magnitude.
    tests, measured, unreported, findings : str
        What the row tests; what was measured and how; what the source does not report; what
        agrees, what does not, and why.
    prediction : str
        "file:function" of the room.
    abscissa, ordinate : str
        Labels of the figure.
    unknowns, records : sequence of Unknown, MeasuredRow
        Inputs with ranges, printed numbers.
    """

    name: _Text
    title: _Text
    source: _Text
    doi: str
    read: Literal["table", "abstract", "second hand"]
    kind: Literal["number", "in kind"]
    tests: _Text
    measured: _Text
    unreported: _Text
    findings: _Text
    prediction: Annotated[str, Field(pattern=r"^\w+:\w+$")]
    abscissa: _Text
    ordinate: _Text
    unknowns: tuple[Unknown, ...] = Field(min_length=1)
    records: tuple[MeasuredRow, ...] = Field(min_length=1)

    @classmethod
    def from_folder(cls, folder: Path) -> Experiment:
        """Return the experiment of a folder with `experiment.toml` and `data.csv`."""
        texts = tomllib.loads((folder / "experiment.toml").read_text("utf-8"))
        lines = (folder / "data.csv").read_text("utf-8").splitlines()
        records = [
            {k: float(v or "nan") if k in _NUMBERS else v for k, v in row.items()}
            for row in csv.DictReader(lines)
        ]
        along = [row["at"] for row in records]
        records = [row | {"along": along} for row in records]
        return cls.model_validate({"name": folder.name, "records": records} | texts)

    def predict(
        self, photons: float, changed: dict[str, Any] | None = None
    ) -> tuple[Floats, Floats]:
        """Return the computed values of the rows and their standard errors.

        `changed` are unknown inputs by name, in place of their nominal values.
        """
        room, name = self.prediction.split(":")
        function = getattr(import_module(f"{__package__}.{room}"), name)
        inputs = {u.name: u.nominal for u in self.unknowns} | (changed or {})
        predictions = [function(row, photons, **inputs) for row in self.records]
        value, stderr = np.array([v if isinstance(v, tuple) else (v, 0.0) for v in predictions]).T
        return value, stderr


@check_call
@cache
def experiments() -> dict[str, Experiment]:
    """Return the experiments by name, in the order of the table."""
    order = (DATA / "order.txt").read_text("utf-8").split()
    return {name: Experiment.from_folder(DATA / name) for name in order}


@check_call
def band_of(
    nominal: Floats, stderr: Floats, ends: Mapping[str, Floats]
) -> tuple[Floats, Floats, tuple[str, ...]]:
    r"""Return the band of computed values: unknown inputs and Monte Carlo error.

    .. math:: y_\pm = y_0 \pm \sqrt{\sum_j \Delta_{j\pm}^2 + (2 \sigma)^2}

    Parameters
    ----------
    nominal, stderr : ndarray, shape (rows,)
        Values y_0 with all inputs nominal, and their standard errors sigma.
    ends : mapping of str to ndarray, shape (values, rows)
        Values with one input at the other values of its range.

    Returns
    -------
    low, high : ndarray, shape (rows,)
        Limits y_- and y_+; Delta_j+ and Delta_j- are the largest rise and fall by input j alone.
    dominant : tuple of str
        The input with the largest sum of the two, "Monte Carlo" where the standard error has a
        larger one.
    """
    moved = {name: np.atleast_2d(values) - nominal for name, values in ends.items()}
    up = np.array([np.maximum(d.max(axis=0), 0.0) for d in moved.values()])
    down = np.array([np.maximum(-d.min(axis=0), 0.0) for d in moved.values()])
    # independent causes add in squares
    chance = (ERRORS * stderr) ** 2
    spans = np.vstack([up + down, 2.0 * ERRORS * stderr])
    names = [*moved, "Monte Carlo"]
    dominant = tuple(names[i] for i in spans.argmax(axis=0))
    low = nominal - np.sqrt((down**2).sum(axis=0) + chance)
    return low, nominal + np.sqrt((up**2).sum(axis=0) + chance), dominant


_Words = Annotated[tuple[str, ...], Variable("row")]


@dataclass(frozen=True, eq=False, repr=False)
class MeasuredTable(Stored, kind="measured", title="meshtrace measured against computed"):
    """Table of measured and computed values.

    Attributes
    ----------
    experiment, observable, unit, observed_text : tuple of str
        Experiment, quantity, its unit, and the measured value as text.
    abscissa : ndarray, shape (rows,)
        Abscissa of the figures.
    observed, observed_low, observed_high : ndarray, shape (rows,)
        Printed number and the ends of its uncertainty or range; nan where nothing is printed.
    computed, computed_stderr : ndarray, shape (rows,)
        Value with all inputs nominal, and its Monte Carlo standard error.
    band_low, band_high : ndarray, shape (rows,)
        Band of unknown inputs and Monte Carlo error, see `band_of`.
    verdict, dominant : tuple of str
        "inside" where the measured interval meets the band, "outside", or "predicted" where
        nothing is printed; input with the largest effect.
    provenance : dict
        Versions and photons.
    """

    experiment: _Words
    observable: _Words
    unit: _Words
    observed_text: _Words
    abscissa: Annotated[Floats, Variable("row")]
    observed: Annotated[Floats, Variable("row")]
    observed_low: Annotated[Floats, Variable("row")]
    observed_high: Annotated[Floats, Variable("row")]
    computed: Annotated[Floats, Variable("row")]
    computed_stderr: Annotated[Floats, Variable("row")]
    band_low: Annotated[Floats, Variable("row")]
    band_high: Annotated[Floats, Variable("row")]
    verdict: _Words
    dominant: _Words
    provenance: dict[str, Any]

    def text_rows(self) -> list[tuple[str, ...]]:
        """Return the rows of the table as texts."""
        return [
            (
                *words,
                f"{value:.4g}" + (f" +- {error:.1g}" if error else ""),
                f"{low:.3g} to {high:.3g}",
                verdict,
                dominant.replace("_", " "),
            )
            for *words, value, error, low, high, verdict, dominant in zip(
                self.experiment, self.observable, self.unit, self.observed_text, self.computed,
                self.computed_stderr, self.band_low, self.band_high, self.verdict, self.dominant,
                strict=True,
            )
        ]  # fmt: skip

    def _headline(self) -> str:
        counts = (
            f"{self.verdict.count(word)} {word}" for word in ("inside", "outside", "predicted")
        )
        return f"experiments: {len(set(self.experiment))}; rows: {', '.join(counts)}"

    def summary(self) -> str:
        """Return the table and the counts as text for a terminal."""
        return f"{text_table(self.text_rows(), HEADINGS)}\n\n{self._headline()}"

    def save(self, path: str | Path) -> None:
        """Write the table as netCDF, or as CSV if the name ends in .csv."""
        if str(path).lower().endswith(".csv"):
            self.to_dataset().to_dataframe().to_csv(path)
        else:
            super().save(path)


HEADINGS = (
    "experiment", "quantity", "unit", "measured", "computed", "band", "verdict", "dominant unknown",
)  # fmt: skip


@check_call
def run(
    names: Iterable[str] | None = None,
    quick: bool = False,
    progress: Callable[[str], None] | None = None,
) -> MeasuredTable:
    """Return measured and computed values of experiments, with bands and verdicts.

    Parameters
    ----------
    names : iterable of str, optional
        Names of `experiments`; all by default, some two minutes on two cores.
    quick : bool
        An eighth of the photons.
    progress : callable, optional
        Called with the name of each experiment before it runs.

    Returns
    -------
    MeasuredTable
        Seeds are fixed: results on one machine are reproducible.

    Raises
    ------
    Refused
        If a name is not that of an experiment.

    Examples
    --------
    >>> run(["hu"]).verdict
    ('inside',)
    """
    known = experiments()
    chosen = list(known if names is None else names)
    for name in chosen:
        require_word(name, known, "names")
    photons = 1.0 / _QUICK if quick else 1.0
    announce(_SECONDS * photons * len(chosen) / len(known), "suite of measurements")
    lines: list[tuple[Any, ...]] = []
    for name in chosen:
        if progress is not None:
            progress(name)
        with warnings.catch_warnings():
            # the light that leaves the meshes sideways is below 0.1 %
            warnings.simplefilter("ignore", DomainWarning)
            lines += _compared(known[name], photons)
    columns: list[Any] = [
        tuple(column) if isinstance(column[0], str) else np.array(column)
        for column in zip(*lines, strict=True)
    ]
    columns.append({"environment": environment(), "experiments": chosen, "photons": photons})
    return MeasuredTable(*columns)


def _compared(experiment: Experiment, photons: float) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of the table in the order of its fields, computed with all unknown inputs."""
    value, stderr = experiment.predict(photons)
    ends = {
        u.name: np.array([experiment.predict(photons, {u.name: v})[0] for v in u.others])
        for u in experiment.unknowns
    }
    band_low, band_high, dominant = band_of(value, stderr, ends)
    low, high = np.array([[row.low, row.high] for row in experiment.records]).T
    verdict = verdicts(low, high, band_low, band_high).tolist()
    columns = zip(value, stderr, band_low, band_high, verdict, dominant, strict=True)
    for row, computed in zip(experiment.records, columns, strict=True):
        texts = experiment.name, row.quantity, row.unit, row.text
        yield (*texts, row.at, row.value, row.low, row.high, *computed)


def verdicts(low: Floats, high: Floats, band_low: Floats, band_high: Floats) -> NDArray[np.str_]:
    """Return the verdicts on measured intervals, see `MeasuredTable`."""
    met = (high >= band_low) & (low <= band_high)
    return np.where(np.isnan(low), "predicted", np.where(met, "inside", "outside"))
