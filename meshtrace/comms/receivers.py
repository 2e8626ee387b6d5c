"""The six built-in receiver models.

`OokLink` describes devices and levels; a `ReceiverModel` turns them into a bit error rate.
"""

from __future__ import annotations

import functools
import math
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshtrace.comms import decisions
from meshtrace.comms.ook import OokLink
from meshtrace.models import Floats

_DESIGN_BER = 1e-3
_MANY = 5000.0  # counts in a sample, above which its law is normal to a skewness of some 1.5 %


class IndependentBits(decisions.ReceiverModel):
    """G0: no intersymbol interference, Gaussian noise in B = R_b / 2."""

    kind: Literal["G0"] = "G0"

    def decide(self, link: OokLink, power: decisions.Powers) -> decisions.Decision:
        """Decide between two Gaussian levels."""
        mean, variance = self.moments(link, power)
        return decisions.gaussian_decision(mean[:, 0], mean[:, 1], variance[:, 0], variance[:, 1])


class CountedBits(decisions.ReceiverModel):
    """GP: no intersymbol interference, exact generalized Poisson counts in each bit."""

    kind: Literal["GP"] = "GP"
    exact_counts: ClassVar[bool] = True

    def decide(self, link: OokLink, power: decisions.Powers) -> decisions.Decision:
        """Decide by the number of counts."""
        n0, n1 = (level * link.bit_time for level in link.levels(power))
        branching = link.sipm.branching
        ber, count = decisions.generalized_poisson_decision(n0, n1, branching)
        # half a count below the lowest one that is read as a one, in primaries per second
        return decisions.Decision(ber, (count - 0.5) * (1.0 - branching) * link.bit_rate)


class SampledPulses(decisions.ReceiverModel):
    """A: output sampled at the end of the bit; Campbell shot noise; bit patterns."""

    kind: Literal["A"] = "A"
    has_pulses: ClassVar[bool] = True

    def moments(self, link: OokLink, power: ArrayLike, phase: float = 1.0) -> tuple[Floats, Floats]:
        """Return the moments of filtered pulses, behind the equaliser."""
        pulses = _pulses(link, phase)
        shares, bandwidth = self._noise(link, pulses)
        shot = pulses.of_levels(link.shot_levels(power), shares)
        mean = pulses.of_levels(link.levels(power), pulses.heard)
        return mean, decisions.noise(link, shot, bandwidth)

    def _noise(self, link: OokLink, pulses: _Pulses) -> tuple[Floats, float]:
        """Return the shares of the bits in the shot noise, by Campbell, and its bandwidth [Hz]."""
        return pulses.shot, pulses.bandwidth

    def decide(self, link: OokLink, power: decisions.Powers) -> decisions.Decision:
        """Decide between Gaussian bit patterns."""
        mean, variance = self.moments(link, power)
        return decisions.pattern_decision(mean, np.sqrt(variance), _pulses(link, 1.0).bits[:, 0])


class PatternNoise(SampledPulses):
    """PC: sampled mean, noise of the pattern's mean in B = min(R_b / 2, pi / 2 f_c)."""

    kind: Literal["PC"] = "PC"  # type: ignore[assignment]

    def _noise(self, link: OokLink, pulses: _Pulses) -> tuple[Floats, float]:
        """Return the shares of the bits in the mean, and a fixed bandwidth [Hz]."""
        # pi / 2 f_c is the noise bandwidth of a first-order pole
        return pulses.mean, min(0.5 * link.bit_rate, 0.5 * math.pi * link.sipm.bandwidth)


class AveragedPulses(SampledPulses):
    """W: output averaged over a window that ends with the bit; otherwise as A."""

    kind: Literal["W"] = "W"  # type: ignore[assignment]

    def averaging_window(self, link: OokLink) -> float:
        """Return the window of the link, or the best one for its bit rate [s]."""
        return _best_window(link.on_detector) if link.window is None else link.window


class CompoundPoisson(AveragedPulses):
    """CP: as W, with the exact compound Poisson law in place of the Gaussian one; slower.

    Above some 5000 counts in a sample the Gaussian law stands for it.
    """

    kind: Literal["CP"] = "CP"  # type: ignore[assignment]
    exact_counts: ClassVar[bool] = True

    def decide(self, link: OokLink, power: decisions.Powers) -> decisions.Decision:
        """Decide between compound Poisson variables, between normal ones where counts are many."""
        decision = super().decide(link, power)
        # g has unit area, so that 1 / peak is about the duration of a response
        many = link.levels(power)[1] > _MANY * link.filters.peak
        for i in np.flatnonzero(~many):
            decision.ber[i], decision.threshold[i] = self._decide_at(link, float(power[i]))
        return decision

    def _decide_at(self, link: OokLink, power: float) -> tuple[float, float]:
        low, high = (float(level) for level in link.levels(power))
        filters, pulses = link.filters, _pulses(link, 1.0)
        # what the equaliser takes off the sample for each bit that was a one
        removed = (high - low) * (pulses.mean - pulses.heard)
        thermal = link.tia.thermal_noise(link.sipm.electrons_per_count)
        thermal_std = math.sqrt(0.5 * thermal * filters.noise_energy)
        return decisions.compound_poisson_decision(
            low, high, filters, link.bit_time, removed, link.sipm.branching, thermal_std
        )


class _Pulses(NamedTuple):
    """Bit patterns of a link, and their shares in the sample and in its shot noise."""

    bits: NDArray[np.bool_]
    mean: Floats
    heard: Floats  # the mean behind the equaliser
    shot: Floats
    bandwidth: float  # of the shot noise [Hz]

    def of_levels(self, levels: tuple[Floats, Floats], shares: Floats) -> Floats:
        """Return a quantity of each pattern from its levels in long zeros and long ones."""
        low, high = (level[..., None] for level in levels)
        return low + (high - low) * (self.bits @ shares)


@functools.lru_cache(maxsize=128)
def _pulses(link: OokLink, phase: float) -> _Pulses:
    """Return bit patterns and cursors, which do not depend on the power."""
    bits, filters = link.patterns(), link.filters
    size = link.bit_time, bits.shape[1], phase
    mean, energy = filters.mean_cursors(*size), filters.noise_energy
    heard = np.where(link.equalized(len(mean)), 0.0, mean)
    return _Pulses(bits, mean, heard, filters.shot_cursors(*size) / energy, 0.5 * energy)


@functools.lru_cache(maxsize=128)
def _best_window(link: OokLink) -> float:
    """Return the window that needs the least power at a BER of 1e-3, in twentieths of the bit."""
    windows = np.linspace(0.0, link.bit_time, 21)
    fixed = {"model": "W", "saturation": False}
    least, best = math.inf, 0
    for i in (10, 0, 20, 5, 15, *range(21)):  # most of the rest fail at the power of these
        trial = link.model_copy(update=fixed | {"window": float(windows[i])})
        if math.isinf(least) or trial.ber(least) < _DESIGN_BER:
            needed = trial.required_power(_DESIGN_BER)
            least, best = min((least, best), (needed, i))
    return float(windows[best])
