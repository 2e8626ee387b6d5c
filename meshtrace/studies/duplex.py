"""Gains of both directions of a link over the same surfaces."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple, Unpack

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from meshtrace.errors import (
    Described,
    Refused,
    require_finite,
    require_kind,
    require_real,
    require_whole,
)
from meshtrace.link import Link
from meshtrace.mesh import MeshSource
from meshtrace.results.series import GainSeries
from meshtrace.stored import Stored
from meshtrace.studies.campaign import campaign_of
from meshtrace.studies.series import gain_series
from meshtrace.transport.options import StudyOptions


class JointOutage(NamedTuple):
    """Shares of the surfaces with gains below their thresholds.

    Attributes
    ----------
    up, down : float
        Outage of each direction.
    both, either : float
        Outage of both at once, and of at least one.
    independent : float
        Outage of both at once if the fades were independent, up times down.
    """

    up: float
    down: float
    both: float
    either: float
    independent: float


@dataclass(frozen=True, eq=False, repr=False)
class Duplex(Stored):
    """Gains of an uplink and a downlink over the same surfaces.

    Attributes
    ----------
    up, down : GainSeries
        Gains of each direction, over the same times or realizations.
    correlation : float
        Pearson's correlation of the gains of both directions; nan if one of them is constant.
    provenance : dict
        Configuration of each direction.
    """

    up: GainSeries
    down: GainSeries
    correlation: float
    provenance: dict[str, Any] = field(default_factory=dict)

    kind: ClassVar[str] = "duplex"
    title: ClassVar[str] = "meshtrace gains of both directions"

    @property
    def correlation_stderr(self) -> float:
        """Standard error of the correlation r of n independent surfaces, (1 - r^2) / sqrt(n - 1).

        Surfaces of a time series are correlated: the error is then larger.
        """
        return float((1.0 - self.correlation**2) / math.sqrt(max(len(self.up.gain) - 1, 1)))

    def outage(self, up_gain: float, down_gain: float) -> JointOutage:
        """Return the outage of each direction, and of both.

        Parameters
        ----------
        up_gain, down_gain : float
            Least gain of each direction with a connection, >= 0.
        """
        for name, value in (("up_gain", up_gain), ("down_gain", down_gain)):
            if not 0.0 <= require_real(value, name, "a gain >= 0") < math.inf:
                raise Refused(name, value, "a gain >= 0")
        up, down = self.up.gain < up_gain, self.down.gain < down_gain
        alone = float(up.mean()), float(down.mean())
        both, either = float((up & down).mean()), float((up | down).mean())
        return JointOutage(*alone, both, either, alone[0] * alone[1])

    def _headline(self) -> str:
        means = f"up {self.up.gain.mean():.4e}, down {self.down.gain.mean():.4e}"
        return f"{len(self.up.gain)} surfaces, {means}, correlation {self.correlation:.3f}"

    def summary(self) -> str:
        """Return mean, scintillation index and joint fades below half of the mean as text."""
        lines = []
        for name, series in (("up", self.up), ("down", self.down)):
            gain = series.gain
            index = gain.var(ddof=1) / gain.mean() ** 2 if gain.any() else math.nan
            lines.append(
                f"{name:<6} mean gain {gain.mean():.4e} +- {series.mean_stderr:.1e}, "
                f"scintillation index {index:.3g}"
            )
        half = self.outage(0.5 * float(self.up.gain.mean()), 0.5 * float(self.down.gain.mean()))
        lines += [
            f"correlation of the gains   {self.correlation:.3f} +- {self.correlation_stderr:.2g}",
            f"below half of the mean     up {half.up:.3g}, down {half.down:.3g}, both "
            f"{half.both:.3g} (independent: {half.independent:.3g}), either {half.either:.3g}",
        ]
        return "\n".join(lines)

    def _content(self) -> xr.Dataset:
        parts = []
        for name, series in (("up", self.up), ("down", self.down)):
            data = series._content()
            data.attrs = {f"{name}_{key}": value for key, value in data.attrs.items()}
            parts.append(data.rename({key: f"{name}_{key}" for key in data.data_vars}))
        merged = xr.merge(parts, combine_attrs="no_conflicts")
        return merged.assign_attrs(correlation=self.correlation)

    @classmethod
    def _restored(cls, data: xr.Dataset, provenance: Any) -> Duplex:
        series = []
        for name in ("up", "down"):
            columns = {key: f"{name}_{key}" for key in ("gain", "gain_stderr", "gain_ballistic")}
            part = data[list(columns.values())].rename({new: old for old, new in columns.items()})
            part.attrs = {"mean_stderr": data.attrs[f"{name}_mean_stderr"]}
            series.append(GainSeries._restored(part, provenance[name]))
        return cls(series[0], series[1], float(data.attrs["correlation"]), provenance)


def duplex(
    up: Link,
    down: Link,
    surface: MeshSource,
    times: ArrayLike | None = None,
    *,
    realizations: int | None = None,
    **run: Unpack[StudyOptions],
) -> Duplex:
    """Return the gains of an uplink and a downlink over the same surfaces, by forced detection.

    Parameters
    ----------
    up, down : Link
        Links of one receiver each: a source in the water and a receiver in the air, and a lamp in
        the air and a receiver in the water.
    surface : MeshSource
        The sea: moving, or with random phases.
    times : array_like, shape (n,), optional
        Times [s] of a moving sea.
    realizations : int, optional
        Number of realizations of a random sea, in place of the times.
    **run
        Options of the run, see `StudyOptions`; chains are those of each direction.

    Returns
    -------
    Duplex

    Raises
    ------
    Refused
        If a link has another direction or several receivers, an option is out of range, or
        neither or both of `times` and `realizations` are given.

    Notes
    -----
    Each surface is one mesh for both directions, fine where the light of either crosses. Unless
    `waves` of the meshing says otherwise, it holds all waves that make the light of either fade.

    Examples
    --------
    >>> import meshtrace as mt
    >>> both = mt.duplex(mt.Link(), mt.Link().mirrored(), mt.surfaces.sea_in_wind(5.0),
    ...                  realizations=3, photons=256)
    >>> len(both.up.gain), len(both.down.gain)
    (3, 3)
    """
    pair = []
    for name, link in (("up", up), ("down", down)):
        require_kind(link, Link, name)
        if link.direction != name or len(link.receivers) != 1:
            found = Described(f"{len(link.receivers)} receivers, direction {link.direction}")
            raise Refused(name, found, f"a link with one receiver and direction {name}")
        pair.append(campaign_of(link, surface, "duplex", fading=True, **run))
    finest = max((one.surface for one in pair), key=lambda s: getattr(s, "omega_max", 0) or 0)
    campaign = pair[0]._replace(links={"up": up, "down": down}, surface=finest)
    if (times is None) == (realizations is None):
        raise Refused("times", times, "times, or a number of realizations")
    if times is not None:
        steps = campaign.in_time(require_finite(times, "times", "finite times (n,) [s], n >= 1"))
    else:
        require_whole(realizations, 1, 10_000_000, "realizations")
        steps = campaign.realizations(int(realizations or 0))
    gains = campaign.gains(steps, probed=1)
    of_up, of_down = (gain_series(campaign, gains, name) for name in campaign.links)
    first, second = of_up.gains[:, 0], of_down.gains[:, 0]
    constant = len(first) < 2 or min(np.ptp(first), np.ptp(second)) == 0.0
    correlation = math.nan if constant else float(np.corrcoef(first, second)[0, 1])
    return Duplex(of_up, of_down, correlation, gains.attrs["provenance"])
