"""Results of one link at several wavelengths."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import (
    TYPE_CHECKING,
    Any,
    ClassVar,
    Generic,
    ParamSpec,
    Protocol,
    TypeVar,
    cast,
    overload,
)

import numpy as np
from numpy.typing import ArrayLike

from meshtrace.errors import Described, Refused, require_finite
from meshtrace.models import Floats
from meshtrace.results.gain import GainResult
from meshtrace.stored import Stacked, Stored

if TYPE_CHECKING:
    import xarray as xr

Result = TypeVar("Result", bound=Stored)
Options = ParamSpec("Options")


@dataclass(frozen=True, eq=False, repr=False)
class ByWavelength(Stacked, Generic[Result]):
    """Results of one link at several wavelengths, with common paths where that is possible.

    The standard errors of the wavelengths are correlated: their noise cancels in ratios.

    Attributes
    ----------
    wavelength_nm : ndarray, shape (n,)
        Wavelengths in vacuum [nm], rising.
    results : tuple
        Result at each wavelength, of one kind.

    Examples
    --------
    >>> import meshtrace as mt
    >>> from meshtrace.surfaces import FlatSea
    >>> link = mt.Link(water=mt.Water.from_type("jerlov-II"))
    >>> found = mt.simulate(link, FlatSea(), photons=1024, wavelengths_nm=[450, 500, 550])
    >>> found["gain"].dims, found.brightest
    (('wavelength', 'receiver'), 500.0)
    """

    wavelength_nm: Floats
    results: tuple[Result, ...]

    kind: ClassVar[str] = "wavelengths"
    title: ClassVar[str] = "meshtrace results by wavelength"
    _along: ClassVar[tuple[str, str]] = ("wavelength", "wavelength_nm")

    def at_wavelength(self, wavelength_nm: float) -> Result:
        """Return the result at a wavelength [nm].

        Raises
        ------
        Refused
            If the result has no such wavelength.
        """
        found = np.flatnonzero(self.wavelength_nm == wavelength_nm)
        if not len(found):
            known = ", ".join(f"{nm:g}" for nm in self.wavelength_nm)
            raise Refused("wavelength_nm", wavelength_nm, known)
        return self.results[int(found[0])]

    def __iter__(self) -> Iterator[tuple[float, Result]]:
        """Yield wavelengths [nm] and results."""
        return zip(self.wavelength_nm.tolist(), self.results, strict=True)

    def __len__(self) -> int:
        return len(self.results)

    def __getitem__(self, name: str) -> xr.DataArray:
        """Return a variable of the dataset, such as "gain", with the dimension `wavelength`."""
        data = self._content()
        if name not in data:
            raise Refused("name", name, ", ".join(map(str, data.data_vars)))
        return data[name]

    @property
    def brightest(self) -> float:
        """Wavelength of the highest mean gain of the first receiver [nm]."""
        gain = self["gain"]
        if "receiver" in gain.dims:
            gain = gain.isel(receiver=0)
        means = gain.mean([name for name in gain.dims if name != "wavelength"])
        return float(self.wavelength_nm[int(means.values.argmax())])

    def _headline(self) -> str:
        low, high = self.wavelength_nm[[0, -1]]
        return f"{len(self)} wavelengths, {low:g} to {high:g} nm, of kind {self.results[0].kind}"

    def summary(self) -> str:
        """Return a line for each wavelength as text for a terminal."""
        first = self.results[0]
        if not isinstance(first, GainResult):
            return "\n".join(f"{nm:>8g} nm  {found._headline()}" for nm, found in self)
        lines = [f"{'nm':>8}{'gain':>13}{'standard error':>16}{'effective samples':>19}  water"]
        for nm, found in self:
            assert isinstance(found, GainResult)
            for r, (gain, stderr) in enumerate(zip(found.gains, found.stderrs, strict=True)):
                samples = f"{found.scattered[r].effective:,.0f}" if found.scattered else "-"
                water = found.provenance.get("link", {}).get("water", {})
                known = [f"{key} {water[key]:.4g}" for key in ("a", "b", "n") if key in water]
                about = ", ".join([f"receiver {r}"] * (len(found.gains) > 1) + known)
                lines.append(f"{nm:>8g}{gain:>13.4e}{stderr:>16.1e}{samples:>19}  {about}")
        return "\n".join(lines)


class Spectral(Protocol[Options, Result]):
    """Function with a result, or one for each of the wavelengths that it is given."""

    @overload
    def __call__(
        self, *args: Any, wavelengths_nm: ArrayLike, **options: Any
    ) -> ByWavelength[Result]: ...

    @overload
    def __call__(self, *args: Options.args, **options: Options.kwargs) -> Result: ...


def spectral(
    function: Callable[Options, Result | ByWavelength[Result]],
) -> Spectral[Options, Result]:
    """Return a function, for type checkers with the kind of result that its options give."""
    return cast(Spectral[Options, Result], function)


def by_wavelength(data: xr.Dataset) -> xr.Dataset:
    """Return a dataset with wavelengths, if it has the dimension, as its coordinate."""
    return data.swap_dims(wavelength="wavelength_nm") if "wavelength" in data.dims else data


def checked_wavelengths(wavelengths_nm: Any) -> list[float]:
    """Return wavelengths [nm], rising and all different.

    Raises
    ------
    Refused
        If there is none, or one twice, or one is no finite number.
    """
    allowed = "one or more wavelengths [nm]"
    found = np.sort(np.atleast_1d(require_finite(wavelengths_nm, "wavelengths_nm", allowed)))
    if len(np.unique(found)) < len(found):
        raise Refused("wavelengths_nm", Described("one given twice"), "different wavelengths [nm]")
    return [float(nm) for nm in found]
