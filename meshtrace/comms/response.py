"""Response of the channel to a short flash of light."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Self

import numpy as np
import pydantic
from numpy.typing import ArrayLike

from meshtrace.checks import InfiniteOrNan, Shape
from meshtrace.comms.spectra import Curve
from meshtrace.errors import Described, Refused, require_array, require_finite, require_whole
from meshtrace.models import Floats, Model, NonNegative, Positive

SHORT = 1e-3
"""Rms delay spread in bit times below which a response counts as instantaneous."""

_FINENESS = 8.0  # of the delays near 0, in rms delay spreads
_ANGLES = 64


class ChannelResponse(Model, frozen=True):
    r"""Impulse response of the channel as a sum of delayed pulses.

    .. math:: h(t) / \int h = \sum_j w_j \, \delta(t - \tau_j)

    Parameters
    ----------
    delay : sequence of float
        Delays :math:`\tau_j` after the first light [s], rising.
    share : sequence of float
        Shares of the light :math:`w_j` [1]; they add up to 1.
    angle_deg : sequence of float
        Angles to the axis of the receiver [deg] with equal shares of the light, for the shift of
        a filter; none where they are not known.
    clock : float, optional
        Delay by which the receiver samples later than for prompt light [s], by default the median.
    gain_spectrum : Curve, optional
        Gain over wavelength, of any scale, which weighs the spectrum of the LED; by default that
        of the signal's wavelength holds at all.

    Raises
    ------
    Refused
        If a value is out of range, delays do not rise, or shares do not add up to 1 within 1e-6.

    Examples
    --------
    >>> found = ChannelResponse.from_arrivals([0.0, 2e-9], [3.0, 1.0])
    >>> found.share, f"{found.rms_spread:.3g} s"
    ((0.75, 0.25), '8.66e-10 s')
    """

    delay: tuple[NonNegative, ...]
    share: tuple[Positive, ...]
    angle_deg: tuple[Annotated[float, pydantic.Field(ge=0.0, le=90.0)], ...] = ()
    clock: NonNegative | None = None
    gain_spectrum: Curve | None = None

    @pydantic.model_validator(mode="after")
    def _consistent(self) -> Self:
        if not self.delay or np.any(np.diff(self.delay) <= 0.0):
            raise Refused("delay", self.delay, "rising delays [s]")
        if len(self.share) != len(self.delay) or abs(sum(self.share) - 1.0) > 1e-6:
            shares = Described(f"{len(self.share)} of sum {sum(self.share):g}")
            raise Refused("share", shares, f"{len(self.delay)} shares that add up to 1")
        if self.clock is None:
            # of two equal halves the first, in spite of rounding
            middle = int(np.searchsorted(np.cumsum(self.share), 0.5 - 1e-9))
            object.__setattr__(self, "clock", self.delay[middle])
        return self

    @classmethod
    def from_arrivals(
        cls,
        delay: ArrayLike,
        weight: ArrayLike,
        angle: Annotated[ArrayLike, InfiniteOrNan(), Shape("n")] | None = None,
        pulses: int | Sequence[float] = 64,
    ) -> Self:
        """Return the response of many arrivals as few pulses of the same mean delay.

        Each arrival is shared by the two pulses next to it, so that the response follows the
        delays and weights without steps.

        Parameters
        ----------
        delay, weight : array_like, shape (n,)
            Delays after the first light [s] and contributions to the gain [1], such as those of
            an `ImpulseResponse`.
        angle : array_like, shape (n,), optional
            Angles to the axis of the receiver [rad], nan where unknown: known ones stand for all
            if at least half of the light has them.
        pulses : int or sequence of float
            Most pulses, 1 ... 4096, on a scale of delays that is linear up to an eighth of the rms
            delay spread and logarithmic beyond; or their delays, rising [s].

        Raises
        ------
        Refused
            If an array holds other values, or there is no light.
        """
        t = require_finite(delay, "delay", "delays (n,) >= 0 [s]")
        w = require_finite(weight, "weight", "weights (n,) >= 0, not all 0")
        if t.shape != w.shape or min(t.min(), w.min()) < 0.0 or not w.any():
            shapes = Described(f"shapes {t.shape} and {w.shape}")
            raise Refused("delay, weight", shapes, "(n,) numbers >= 0, weights not all 0")
        if np.ndim(pulses):
            nodes = require_finite(pulses, "pulses", "a number, or rising delays >= 0 [s]")
        else:
            require_whole(pulses, 1, 4096, "pulses")
            nodes = _nodes(t, w, int(pulses))  # type: ignore[arg-type]
        if angle is not None and np.shape(angle) != w.shape:
            raise Refused("angle", Described(f"shape {np.shape(angle)}"), f"{w.shape}, as weight")
        arrivals = [] if angle is None else _angles(require_array(angle, "angle", "angles"), w)
        at = np.interp(t, nodes, np.arange(len(nodes)))
        left = at.astype(int)
        share = np.bincount(left, w * (left + 1 - at), len(nodes) + 1)
        share = (share + np.bincount(left + 1, w * (at - left), len(nodes) + 1))[:-1]
        nonzero = np.flatnonzero(share > 1e-12 * share.sum())
        order = np.argsort(t)
        end = np.cumsum(w[order])
        return cls(
            delay=nodes[nonzero].tolist(),
            share=(share[nonzero] / share[nonzero].sum()).tolist(),
            angle_deg=tuple(arrivals),
            # the median of the arrivals: that of the few pulses would jump from one to the next
            clock=float(np.interp(0.5 * end[-1], end, t[order])),
        )

    @property
    def rms_spread(self) -> float:
        """Root of the variance of the delays [s]."""
        return spread_of(np.array(self.delay), np.array(self.share))


def _nodes(t: Floats, w: Floats, pulses: int) -> Floats:
    """Return the delays of pulses for arrivals at t with weights w."""
    spread = spread_of(t, w)
    if spread == 0.0 or pulses == 1:
        return np.array([float(w @ t) / float(w.sum())])
    # linear near 0, where most of the light is, logarithmic in the tail
    scale = np.linspace(0.0, np.log1p(_FINENESS * t.max() / spread), pulses)
    return np.expm1(scale) * spread / _FINENESS


def spread_of(t: Floats, w: Floats) -> float:
    """Return the rms spread of delays t with weights w [s]."""
    mean = float(w @ t) / float(w.sum())
    return float(np.sqrt(w @ (t - mean) ** 2 / w.sum()))


def _angles(angle: Floats, weight: Floats) -> list[float]:
    """Return angles [deg] of the mean squared sine of equal shares of the light."""
    known = np.isfinite(angle)
    if not weight[known].sum() >= 0.5 * weight.sum():
        return []
    order = np.argsort(angle[known])
    # mean squared sines, in which the shift of a filter is linear to first order
    square, sorted_weight = np.sin(angle[known][order]) ** 2, weight[known][order]
    end = np.append(0.0, np.cumsum(sorted_weight))
    moment = np.interp(
        end[-1] * np.linspace(0.0, 1.0, _ANGLES + 1),
        end,
        np.append(0.0, np.cumsum(sorted_weight * square)),
    )
    means = np.clip(_ANGLES * np.diff(moment) / end[-1], 0.0, 1.0)
    return np.degrees(np.arcsin(np.sqrt(means))).tolist()
