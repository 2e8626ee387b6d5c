"""Base of the receiver models: the decision between zeros and ones, and its error rate."""

from __future__ import annotations

import abc
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from meshtrace.comms.decisions import Decision
from meshtrace.models import Family, Floats


class ReceiverModel(Family, default="W"):
    """Base of all receiver models.

    A subclass needs the method `decide`. It is then allowed as ``OokLink(model=Mine(...))``, and
    in plain data by its import path "module:Mine" (link files need trust for it), or by the name
    that a field such as ``kind: Literal["mine"] = "mine"`` gives it. Its methods get the
    `OokLink` whose model it is.

    docs/guides/own_receiver_model.md is an example.
    """

    has_pulses: ClassVar[bool] = False
    """Whether the model follows pulses, so that an eye diagram exists."""

    exact_counts: ClassVar[bool] = False
    """Whether the model takes the law of Poisson counts itself, which renewal noise is not."""

    def averaging_window(self, link: Any) -> float:
        """Return the averaging window in front of the decision [s]."""
        return 0.0

    def moments(self, link: Any, power: ArrayLike, phase: float = 1.0) -> tuple[Floats, Floats]:
        """Return mean [s-1] and variance [s-2] of the sample for each bit pattern.

        By default those of independent bits: levels of a zero and a one, Gaussian noise in
        B = R_b / 2.
        """
        mean, shot = (np.stack(v, axis=-1) for v in (link.levels(power), link.shot_levels(power)))
        thermal = link.tia.thermal_noise(link.sipm.gain)
        noise = 2.0 * link.sipm.excess_noise_factor * shot + thermal
        return mean, noise * 0.5 * link.bit_rate

    @abc.abstractmethod
    def decide(self, link: Any, power: Floats) -> Decision:
        """Return bit error rate and threshold [s-1] at powers (n,) on the SiPM, all > 0 [W]."""
