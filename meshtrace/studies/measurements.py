"""Measurements of a link, from which `infer` finds its properties."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.errors import Described, Refused, require_array, require_real
from meshtrace.models import Floats

OF_DETECTOR = ("power", "ber")
"""Measurements behind the optics: received power [W], and bit error rate."""


class Measurements(NamedTuple):
    """Gains, counts, powers or error rates with errors, and the keys that belong to each."""

    value: Floats  # (n,)
    stderr: Floats  # (n,) nan of counts, which follow the law of Poisson
    keys: list[dict[str, Any]]  # (n,) values by dotted key
    names: list[str]  # (n,) quantities

    @property
    def counted(self) -> NDArray[np.bool_]:
        """Whether each measurement is a count."""
        return np.isnan(self.stderr)


def read_measurements(given: Any) -> Measurements:
    """Return measurements from rows, or from a table of columns.

    Raises
    ------
    Refused
        If a value or an error is missing or not above 0, or no count is.
    """
    rows = _rows(given)
    if not rows:
        raise Refused("measurements", Described("empty"), "at least one")
    values, errors, keys, names = [], [], [], []
    for i, row in enumerate(rows):
        rest, path = dict(row), f"measurements[{i}]"
        if "counts" in rest and "stderr" not in rest and "gain" not in rest:
            counts = rest.pop("counts")
            number = require_real(counts, f"{path}.counts", "a number >= 0")
            if not 0.0 <= number < math.inf:
                raise Refused(f"{path}.counts", counts, "a number >= 0")
            name = "counts"
            values.append(number)
            errors.append(math.nan)
        else:
            name = next((k for k in ("gain", "counts", *OF_DETECTOR) if k in rest), "gain")
            values.append(_positive(rest.pop(name, None), f"{path}.{name}"))
            errors.append(_positive(rest.pop("stderr", None), f"{path}.stderr"))
        keys.append(rest)
        names.append(name)
    if not any(values):
        raise Refused("measurements.counts", Described("all 0"), "a count > 0 in one of them")
    return Measurements(np.array(values), np.array(errors), keys, names)


def _positive(value: Any, path: str) -> float:
    """Return a finite number above 0; refuse any other value."""
    number = require_real(value, path, "a number > 0")
    if not 0.0 < number < math.inf:
        raise Refused(path, value, "a number > 0")
    return number


def _rows(given: Any) -> list[Mapping[str, Any]]:
    """Return the rows of a table of columns, or those given."""
    if isinstance(given, Mapping) or hasattr(given, "columns"):
        columns = {
            str(key): np.atleast_1d(
                require_array(given[key], f"measurements.{key}", "a column of values", None)
            ).tolist()
            for key in given
        }
        n = max((len(column) for column in columns.values()), default=0)
        uneven = [key for key, column in columns.items() if len(column) not in (1, n)]
        if uneven:
            raise Refused(f"measurements.{uneven[0]}", Described("too short"), f"{n} values")
        return [{k: c[i % len(c)] for k, c in columns.items()} for i in range(n)]
    if isinstance(given, Sequence) and all(isinstance(row, Mapping) for row in given):
        return list(given)
    raise Refused("measurements", Described(type(given).__name__), "rows, or a table")
