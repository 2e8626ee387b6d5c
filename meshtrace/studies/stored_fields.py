"""Base of the results with names and single values beside their arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from meshtrace.results.variables import StoredArrays

if TYPE_CHECKING:
    import xarray as xr


class StoredFields(StoredArrays):
    """Result of described arrays, tuples of text among them, and of attributes of its dataset.

    Subclasses list in `_attributes` the fields that are attributes, with their types. One that a
    file lacks has its default.
    """

    _attributes: ClassVar[dict[str, type]] = {}

    def _content(self) -> xr.Dataset:
        found = super()._content()
        return found.assign_attrs({name: getattr(self, name) for name in self._attributes})

    @classmethod
    def arrays(cls, data: xr.Dataset) -> dict[str, Any]:
        """Return the fields that a dataset holds, texts as tuples."""
        fields = super().arrays(data)
        for name, value in fields.items():
            if isinstance(value, np.ndarray) and value.dtype.kind in "OUT":
                fields[name] = tuple(map(str, value))
        kinds = cls._attributes.items()
        return fields | {n: kind(data.attrs[n]) for n, kind in kinds if n in data.attrs}
