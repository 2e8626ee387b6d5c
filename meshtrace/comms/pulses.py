"""Light pulses and their shot noise behind the channel and the filters of LED and receiver.

The light is shaped by the LED's pole and the response of the channel. Each count is shaped by the
SiPM's pole and, optionally, by an average over a window that ends at the sample: impulse response
g(t), of unit area. The mean signal is the light filtered by g, the shot noise (Campbell) the light
filtered by g^2.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from meshtrace.checks import Positive, check_methods
from meshtrace.comms.response import ChannelResponse
from meshtrace.models import Floats

_Terms = list[tuple[float, float]]
_NODES = 2**14  # of the energy of a pulse behind a channel, in the exact law


@check_methods
@dataclasses.dataclass(frozen=True)
class PulseFilters:
    """Filters of an optical link: LED pole, channel, SiPM pole, averaging window.

    Parameters
    ----------
    tau_led, tau_sipm : float
        Time constants of the two poles [s].
    window : float
        Length of the averaging window [s]; 0 samples the SiPM's output itself.
    response : ChannelResponse, optional
        Response of the channel; None for an instantaneous one.

    Notes
    -----
    Behind a channel the light of a step is the mean of l(t + t_c - tau_j) over the shares of the
    response. The receiver's clock follows the light: t_c is the median delay, the best instant
    of a receiver that averages over a bit if the response is shorter than that. Light that comes
    sooner is then part of the sample of the bit before.

    References
    ----------
    Campbell's theorem: Rice (1944), Bell Syst. Tech. J. 23, 282,
    doi:10.1002/j.1538-7305.1944.tb00874.x.

    Examples
    --------
    >>> filters = PulseFilters(tau_led=15.9155e-9, tau_sipm=79.5775e-9)
    >>> filters.mean_cursors(bit_time=200e-9, count=3).round(4)
    array([0.8987, 0.0931, 0.0075])
    """

    tau_led: float
    tau_sipm: float
    window: float = 0.0
    response: ChannelResponse | None = None

    def mean_step(self, t: ArrayLike) -> Floats:
        """Return the mean signal `t` [s] after the light is switched on, int g(u) l(t - u) du.

        Behind a channel `t` counts from the median delay.
        """
        a, w = 1.0 / self.tau_sipm, self.window
        if w == 0.0:
            return self._step(t, [], [(a, a)])
        # g(u) = (1 - exp(-a u)) / w inside the window, a decay from its value at w behind it
        return self._step(t, [(1.0 / w, 0.0), (-1.0 / w, a)], [(-math.expm1(-a * w) / w, a)])

    def shot_step(self, t: ArrayLike) -> Floats:
        """Return the shot-noise variance [s-1] `t` [s] after that, int g(u)^2 l(t - u) du."""
        a, w = 1.0 / self.tau_sipm, self.window
        if w == 0.0:
            return self._step(t, [], [(a * a, 2.0 * a)])
        inside = [(1.0 / w**2, 0.0), (-2.0 / w**2, a), (1.0 / w**2, 2.0 * a)]
        return self._step(t, inside, [((math.expm1(-a * w) / w) ** 2, 2.0 * a)])

    @property
    def noise_energy(self) -> float:
        """Shot variance of a unit constant rate, int g^2 du [s-1]; twice the noise bandwidth."""
        if self.window == 0.0:
            return 0.5 / self.tau_sipm
        x = self.window / self.tau_sipm
        return (x + math.expm1(-x)) / (x * self.window)

    @property
    def peak(self) -> float:
        """Largest value of g [s-1]."""
        if self.window == 0.0:
            return 1.0 / self.tau_sipm
        return -math.expm1(-self.window / self.tau_sipm) / self.window

    def ages_above(self, level: Annotated[Floats, Field(gt=0.0)]) -> tuple[Floats, Floats]:
        """Return the first and last age [s] of a response above 0 < `level` <= peak [s-1]."""
        with np.errstate(divide="ignore"):  # level = peak of a window much longer than the pole
            # g rises up to the end of the window and decays from there: one age on each flank
            young = -self.tau_sipm * np.log1p(-self.window * level)
        return np.minimum(young, self.window), self.window + self.tau_sipm * np.log(
            self.peak / level
        )

    def light_since(self, age: Floats, bits_ago: int, bit_time: float) -> Floats:
        """Return the light [s] of one bit within `age` [s] before the end of the present bit."""

        def energy(t: Floats | float) -> Floats:
            elapsed = np.maximum(t, 0.0)
            return self._overlap(0.0, elapsed, elapsed)

        start, end = (bits_ago + 1) * bit_time, bits_ago * bit_time
        if self.response is None:
            return energy(start) - energy(start - age) - energy(end) + energy(end - age)
        # smooth over the nodes: the pole and the response blur its kink
        at: Floats = np.linspace(min(end - float(age.max()), 0.0), start, _NODES)
        response = self._behind_channel(energy, at)
        before, after = (np.interp(edge - age, at, response) for edge in (start, end))
        return np.interp(start, at, response) - before - np.interp(end, at, response) + after

    def mean_cursors(
        self, bit_time: float, count: Annotated[int, Field(ge=1, le=2**20)], phase: float = 1.0
    ) -> Floats:
        """Return the shares of the present, earlier and next bits in the sample of the present one.

        w_0 = s(phase T),  w_k = s((k + phase) T) - s((k + phase - 1) T)

        Parameters
        ----------
        bit_time : float
            T [s].
        count : int
            Number of bits, the present one and `bits_ahead` next ones included.
        phase : float
            Sampling instant within the bit, 0 < phase <= 1; 1 is its end.

        Returns
        -------
        ndarray
            w_k (count,), k = 0, 1, ..., and last the next bits, ..., -2, -1.
        """
        return self._cursors(self.mean_step, bit_time, count, phase)

    def shot_cursors(
        self, bit_time: float, count: Annotated[int, Field(ge=1, le=2**20)], phase: float = 1.0
    ) -> Floats:
        """Return the shares v_k [s-1] of the bits in the shot noise, ordered as `mean_cursors`."""
        return self._cursors(self.shot_step, bit_time, count, phase)

    def slot_shares(
        self, bit_time: Positive, count: Annotated[int, Field(ge=1, le=2**20)]
    ) -> Floats:
        """Return the shares of the bits' light in one slot of T, ordered as `mean_cursors`.

        The channel alone, without the poles and the window.
        """

        def ramp(t: Floats) -> Floats:
            return self._behind_channel(lambda at: np.clip(at / bit_time, 0.0, 1.0), t)

        return self._cursors(ramp, bit_time, count, 1.0)

    def bits_ahead(self, bit_time: Positive) -> int:
        """Return the number of later bits whose light can arrive before the sample."""
        return 0 if self.response is None else math.ceil((self.response.clock or 0.0) / bit_time)

    def _cursors(
        self,
        step: Callable[[Floats], Floats],
        bit_time: float,
        count: Annotated[int, Field(ge=1, le=2**20)],
        phase: float,
    ) -> Floats:
        ahead = min(self.bits_ahead(bit_time), count - 1)
        bits = np.arange(-ahead, count - ahead, dtype=np.float64)
        edges = step((bits + phase) * bit_time)
        return np.roll(np.diff(edges, prepend=0.0), -ahead)

    @property
    def _delays(self) -> Floats:
        """Delays of the channel behind the clock [s]."""
        assert self.response is not None
        return np.array(self.response.delay) - (self.response.clock or 0.0)

    def _behind_channel(self, step: Callable[[Floats], Floats], t: Floats) -> Floats:
        if self.response is None:
            return step(t)
        return step(t[..., None] - self._delays) @ np.array(self.response.share)

    def _step(self, t: ArrayLike, inside: _Terms, behind: _Terms) -> Floats:
        # g or g^2 is one sum of exponentials c exp(-a u) inside the window and another, counted
        # from the window's end, after it.
        def prompt(then: Floats) -> Floats:
            elapsed: Floats = np.maximum(then, 0.0)
            during = np.minimum(elapsed, self.window)
            after = elapsed - during
            total = np.zeros_like(elapsed)
            for c, a in inside:
                total += c * self._overlap(a, during, elapsed)
            for c, a in behind:
                total += c * self._overlap(a, after, after)
            return total

        return self._behind_channel(prompt, np.asarray(t, dtype=float))

    def _overlap(self, a: float, m: Floats, t: Floats) -> Floats:
        # int_0^m exp(-a u) l(t - u) du with the LED's step l(t) = 1 - exp(-t / tau_led)
        from scipy.special import exprel

        if self.tau_led == 0.0:
            return m * exprel(-a * m)
        b = 1.0 / self.tau_led
        # int exp(-a u - b (t - u)) du, written so that no exponent is positive and a = b is regular
        lag = np.exp(-b * (t - m) - min(a, b) * m) * m * exprel(-abs(b - a) * m)
        return m * exprel(-a * m) - lag


class Eye(NamedTuple):
    """Eye diagram at one received power.

    `time` (n,) runs over the bit [s]; `level` and `std` (p, n) are the mean and the standard
    deviation of the signal [counts s-1] for each of the p bit patterns, `bits` (p, k) those
    patterns, present bit first; `ber` (n,) the error rate when sampling there (bathtub curve);
    `swing` the distance of a long one from a long zero [counts s-1].
    """

    time: Floats
    level: Floats
    std: Floats
    bits: NDArray[np.bool_]
    ber: Floats
    swing: float

    @property
    def _gap(self) -> tuple[float, float]:
        """Lowest one minus highest zero at the end of the bit, and the sum of their deviations."""
        is_one, level, std = self.bits[:, 0], self.level[:, -1], self.std[:, -1]
        lowest = np.argmin(np.where(is_one, level, np.inf))
        highest = np.argmax(np.where(is_one, -np.inf, level))
        return float(level[lowest] - level[highest]), float(std[lowest] + std[highest])

    @property
    def opening(self) -> float:
        """Lowest one minus highest zero at the end of the bit, over the swing [1]."""
        return self._gap[0] / self.swing

    @property
    def q_factor(self) -> float:
        """Lowest one minus highest zero over the sum of their standard deviations [1]."""
        distance, noise = self._gap
        return distance / noise
