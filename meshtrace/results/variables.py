"""Arrays of results: dimensions, names in files, and merge rules."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple, Self, get_type_hints

import numpy as np
from numpy.typing import NDArray

from meshtrace.fields import attrs
from meshtrace.stored import Stored

if TYPE_CHECKING:
    import xarray as xr

Variables = dict[str, tuple[tuple[str, ...], NDArray[Any], dict[str, str]]]


class Variable(NamedTuple):
    """Dimensions of an array, its rule for merging and its name in files.

    A mean merges together with its standard error, which has no separate rule.
    """

    dims: str
    rule: Callable[..., Any] | None = None
    name: str = ""


class WithArrays:
    """Base of the dataclasses with fields of type ``Annotated[array, Variable(...)]``."""

    @classmethod
    def _described(cls) -> Iterator[tuple[str, str, Variable]]:
        """Yield attribute, name in files and description of each array."""
        for attribute, hint in get_type_hints(cls, include_extras=True).items():
            for variable in getattr(hint, "__metadata__", ()):
                yield attribute, variable.name or attribute, variable

    def variables(self) -> Variables:
        """Return the arrays by their names in files, with dimensions and attributes."""
        found: Variables = {}
        for attribute, name, variable in self._described():
            value, dims = getattr(self, attribute), tuple(variable.dims.split())
            if value is not None:
                found[name] = (dims, np.atleast_1d(value) if dims else value, attrs(name))
        return found

    @classmethod
    def arrays(cls, data: xr.Dataset) -> dict[str, Any]:
        """Return the fields that a dataset holds; variables without dimensions are numbers."""
        return {
            attribute: data[name].to_numpy() if data[name].dims else float(data[name])
            for attribute, name, _ in cls._described()
            if name in data.variables
        }


class StoredArrays(WithArrays, Stored):
    """Base of the results that consist of described arrays and their provenance."""

    def _content(self) -> xr.Dataset:
        import xarray as xr

        return xr.Dataset(self.variables())

    @classmethod
    def _restored(cls, data: xr.Dataset, provenance: Any) -> Self:
        fields: dict[str, Any] = {**cls.arrays(data), "provenance": provenance}
        return cls(**fields)
