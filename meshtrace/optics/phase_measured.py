"""Phase functions from tables: measured, tabulated by the user, or histograms."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import pydantic
from pydantic import Field

from meshtrace.columns import read_columns
from meshtrace.errors import Described, Refused
from meshtrace.optics.phase_base import BuiltInPhase, s_of
from meshtrace.optics.phase_tables import Segments, power_law_segments


def _as_list(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value


Numbers = Annotated[tuple[pydantic.FiniteFloat, ...], pydantic.BeforeValidator(_as_list)]


class TabulatedPhase(BuiltInPhase, frozen=True):
    """Phase function given by a table of angles and values, of any normalisation.

    Parameters
    ----------
    theta_deg : sequence of float
        Scattering angles [degree], increasing, 0 ... 180; at least two above 0.
    value : sequence of float
        Phase function or volume scattering function at these angles, > 0, in any unit.

    file : path, optional
        Text file of both columns in place of them, see `from_file`.

    Notes
    -----
    Between the angles the function is a power of s = sin^2(theta / 2), that is, linear in log-log
    axes; at small angles this is a power of theta. The laws of the first and the last pair of
    angles are carried on to 0 (as Petzold did) and to 180 degrees; a row at exactly 0 is replaced
    by that law. The pieces have closed integrals and inverses, so that normalisation, CDF, moments
    and samples agree with `pdf` to rounding.
    """

    kind: Literal["tabulated"] = "tabulated"
    theta_deg: Numbers
    value: Numbers

    @pydantic.model_validator(mode="before")
    @classmethod
    def _from_table(cls, data: Any) -> Any:
        if isinstance(data, Mapping) and "file" in data:
            own = {key: value for key, value in data.items() if key != "file"}
            return {**dict(cls.from_file(data["file"])), **own}
        return data

    @pydantic.model_validator(mode="after")
    def _check(self) -> Self:
        theta, value = np.array(self.theta_deg), np.array(self.value)
        if theta.size != value.size or np.count_nonzero(theta > 0.0) < 2:
            sizes = Described(f"{theta.size} and {value.size} numbers")
            allowed = "as many of each, at least two with theta_deg > 0"
            raise Refused("theta_deg, value", sizes, allowed)
        if np.any(np.diff(theta) <= 0.0) or theta[0] < 0.0 or theta[-1] > 180.0:
            ends = Described(f"{theta[0]} ... {theta[-1]}")
            raise Refused("theta_deg", ends, "increasing within 0 ... 180")
        if np.any(value <= 0.0):
            raise Refused("value", value.min(), "value > 0")
        self._segments()
        return self

    @classmethod
    def from_file(cls, path: str | Path, *, delimiter: str | None = None) -> Self:
        """Read a text file of two columns, angle [degree] and value, see `read_columns`."""
        values = read_columns(path, 2, delimiter).values
        return cls(theta_deg=values[:, 0], value=values[:, 1])

    def _segments(self) -> Segments:
        theta = np.radians(self.theta_deg)
        return power_law_segments(s_of(theta)[theta > 0.0], np.array(self.value)[theta > 0.0])


class Petzold(BuiltInPhase, frozen=True):
    """Phase functions that Petzold measured in 1971, at 514 nm.

    Parameters
    ----------
    water : {"average", "clear", "coastal", "harbour"}
        Average particle (three harbour stations less pure sea water), or the total phase function
        of clear (Tongue of the Ocean), coastal (San Pedro Channel) or harbour (San Diego) water.

    Notes
    -----
    55 angles from 0.1 to 180 degrees, joined and normalised as in `TabulatedPhase`. The printed
    table 3.10 of Mobley (1994) has 2.188e2 for the average particle at 0.501 degrees, 9 % above
    its neighbours' trend; the file of the Ocean Optics Web Book has 2.018e2 (on its scale), which
    is used here.

    References
    ----------
    Petzold 1972, SIO Ref. 72-78, Scripps Institution of Oceanography; Mobley 1994, Light and Water,
    table 3.10; Ocean Optics Web Book, "Petzold's measurements".

    Examples
    --------
    >>> round(Petzold().backscatter_fraction, 4)
    0.0183
    """

    kind: Literal["petzold"] = "petzold"
    water: Literal["average", "clear", "coastal", "harbour"] = "average"

    def _segments(self) -> Segments:
        column = ("clear", "coastal", "harbour", "average").index(self.water) + 1
        file = resources.files("meshtrace.optics") / "data" / "petzold_vsf.csv"
        theta_deg, value = np.loadtxt(
            file.read_text().splitlines(), delimiter=",", usecols=(0, column), unpack=True
        )
        return power_law_segments(s_of(np.radians(theta_deg)), value)


class HistogramPhase(BuiltInPhase, frozen=True, populate_by_name=True):
    """Phase function that is constant per solid angle inside each bin of a histogram.

    Parameters
    ----------
    theta_edges : sequence of float
        Edges of the bins [rad], increasing from 0 to pi, shape (n + 1,).
    cdf : sequence of float
        Probability of an angle up to each edge, from 0 to 1 and not decreasing, shape (n + 1,).

    Examples
    --------
    >>> isotropic = HistogramPhase(theta_edges=(0.0, np.pi / 2, np.pi), cdf=(0.0, 0.5, 1.0))
    >>> round(float(isotropic.pdf(1.0) * 4.0 * np.pi), 12)
    1.0
    """

    kind: Literal["histogram"] = "histogram"
    theta_edges: Numbers
    cdf_edges: Numbers = Field(alias="cdf")

    @pydantic.model_validator(mode="after")
    def _check(self) -> Self:
        theta, cdf = np.array(self.theta_edges), np.array(self.cdf_edges)
        if theta.size != cdf.size or theta.size < 2:
            sizes = Described(f"{theta.size} and {cdf.size} numbers")
            raise Refused("theta_edges, cdf", sizes, "as many of each, at least two")
        if np.any(np.diff(theta) <= 0.0) or theta[0] != 0.0 or abs(theta[-1] - np.pi) > 1e-12:
            ends = Described(f"{theta[0]} ... {theta[-1]}")
            raise Refused("theta_edges", ends, "increasing from 0 to pi")
        if np.any(np.diff(cdf) < 0.0) or cdf[0] != 0.0 or abs(cdf[-1] - 1.0) > 1e-12:
            raise Refused("cdf", Described(f"{cdf[0]} ... {cdf[-1]}"), "not decreasing from 0 to 1")
        return self

    def _segments(self) -> Segments:
        s = np.sin(0.5 * np.array(self.theta_edges)) ** 2
        s[-1] = 1.0
        mass = np.diff(self.cdf_edges)
        return Segments(s[:-1], s[1:], np.ones_like(mass), mass / mass.sum())
