"""Gains of one link over many surfaces."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from meshtrace.errors import Refused, require_whole
from meshtrace.models import Floats
from meshtrace.stored import Stored, Variable

if TYPE_CHECKING:
    from meshtrace.fading import FadingStatistics

_FEW = 50  # gains shown in place of statistics
_MOST_NOISE = 0.05  # fraction of the variance below which noise is not reported
_EACH = Variable("{along} receiver")


@dataclass(frozen=True, eq=False, repr=False)
class GainSeries(Stored):
    """Gains of one link over many surfaces, all with the same chains.

    Attributes
    ----------
    along : {"time", "realization"}
        Difference between the surfaces.
    coordinate : ndarray, shape (n,)
        Times [s], or seeds of the realizations.
    gain, gain_stderr, gain_ballistic : ndarray, shape (n,) or (n, receivers)
        Gain, its standard error and its unscattered part.
    mean_stderr : float or ndarray, shape (receivers,)
        Monte Carlo standard error of the mean gain. The chains are common to all surfaces, so
        that it is not that of n independent gains.
    provenance : dict
        Versions, configuration and seeds.
    """

    along: Literal["time", "realization"]
    coordinate: Annotated[NDArray[Any], Variable("{along}", name="{along}")]
    gain: Annotated[Floats, _EACH]
    gain_stderr: Annotated[Floats, _EACH]
    gain_ballistic: Annotated[Floats, _EACH]
    mean_stderr: Any
    provenance: dict[str, Any] = field(default_factory=dict)

    kind: ClassVar[str] = "series"
    title: ClassVar[str] = "meshtrace gain series"
    _attributes: ClassVar[tuple[str, ...]] = ("along", "mean_stderr")

    @property
    def gains(self) -> Floats:
        """Gains as an array of two dimensions, shape (n, receivers)."""
        return self.gain.reshape(len(self.coordinate), -1)

    @property
    def mean_stderrs(self) -> Floats:
        """Standard error of the mean gain of each receiver, shape (receivers,)."""
        return np.atleast_1d(self.mean_stderr)

    @property
    def time(self) -> Floats:
        """Times [s] of a moving sea."""
        if self.along != "time":
            raise Refused("along", self.along, "time, for a property of time series")
        return self.coordinate

    def fading(self, receiver: int = 0, **options: Any) -> FadingStatistics:
        r"""Return the fading statistics of one receiver, see `fading.fading_statistics`.

        .. math:: \sigma_\mathrm{own}^2 = (\overline{s_i^2} - s_{\bar h}^2) \, n / (n - 1)

        is the contribution of the Monte Carlo errors s_i to the variance of the gains, beyond the
        error s_hbar of their mean, which is common to all. It is removed from an ensemble. On a
        moving sea it varies as smoothly as the gain, and the correlation cannot separate the two:
        it stays, and is reported in a note unless negligible.

        Parameters
        ----------
        receiver : int
            Index of the receiver.
        options
            Of `fading.fading_statistics`.

        Raises
        ------
        ValueError
            If there is no such receiver, or fewer than two gains.
        """
        from meshtrace.fading import fading_statistics

        n, n_receivers = self.gains.shape
        require_whole(receiver, 0, n_receivers - 1, "receiver")
        gain, common = self.gains[:, receiver], float(self.mean_stderrs[receiver])
        stderr = self.gain_stderr.reshape(n, -1)[:, receiver]
        noise = float(np.mean(stderr**2))
        own = max(noise - common**2, 0.0) * n / max(n - 1, 1)
        if self.along == "realization":
            options["gain_stderr"] = (np.sqrt(own / noise) if noise > 0.0 else 0.0) * stderr
        else:
            options["time"] = self.time
        found = fading_statistics(gain, common_stderr=common, **options)
        notes, share = found.notes, own / max(float(gain.var()), own, 1e-300)
        if self.along == "time" and share >= _MOST_NOISE:
            note = f"Monte Carlo noise is {100.0 * share:.0f} % of the variance: increase photons"
            notes = (*notes, note)
        return replace(found, provenance=self.provenance, notes=notes)

    def _headline(self) -> str:
        means = self.gains.mean(axis=0)
        pairs = zip(means[:4], self.mean_stderrs, strict=False)
        shown = ", ".join(f"mean {mean:.4e} +- {stderr:.1e}" for mean, stderr in pairs)
        return f"{len(self.coordinate)} gains over {self.along}, {shown}"

    def summary(self) -> str:
        """Return the fading of each receiver, and the quantiles of an ensemble, as text."""
        lines = []
        for receiver, (gain, stderr) in enumerate(
            zip(self.gains.T, self.mean_stderrs, strict=True)
        ):
            if self.gain.ndim == 2:
                lines.append(f"receiver {receiver}")
            if self.along == "realization":
                shares = (1, 5, 25, 50, 75, 95, 99)
                lines.append("".join(f"{f'{share} %':>12}" for share in shares))
                lines.append("".join(f"{value:>12.4e}" for value in np.percentile(gain, shares)))
                lines.append("")
            lines.append(self._statistics(receiver))
            lines += self._origin_lines()
            if gain.any():
                percent = 100.0 * stderr / gain.mean()
                lines.append(f"  Monte Carlo error    {percent:.2g} % of the mean gain")
        return "\n".join(lines)

    def _origin_lines(self) -> list[str]:
        """Return the scintillation index of unscattered light, measured and in closed form."""
        found, light = self.provenance.get("closed_form"), self.gain_ballistic
        if not found or not light.any():
            return []
        measured = light.var(ddof=1) / light.mean() ** 2
        return [
            f"  unscattered light    scintillation index {measured:.3g}, closed form "
            f"{found['index_of_band']:.3g} up to {found['omega_max']:.3g} rad/s, "
            f"{found['index_of_all']:.3g} with all waves"
        ]

    def _statistics(self, receiver: int) -> str:
        """Return the fading of a receiver, or the first gains of a series too short for it."""
        try:
            return self.fading(receiver).summary()
        except ValueError as error:
            lines = []
            if self.along == "time":
                rows = zip(self.time[:_FEW], self.gains[:, receiver], strict=False)
                lines = [f"  {t:>12g} s {g:.4e}" for t, g in rows]
            return "\n".join([*lines, f"no fading statistics: {error}"])
