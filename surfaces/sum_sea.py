"""Several random seas at once, such as a wind sea and swells."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field, SerializeAsAny

from meshtrace.errors import Refused
from meshtrace.mesh import FADING

from .parameters import Variances
from .random_sea import RandomSea
from .surface import Surface
from .waves import WaveComponents


def _part(value: Any) -> RandomSea:
    sea = Surface.read(value)
    if not isinstance(sea, RandomSea):
        raise Refused("parts", getattr(sea, "kind", value), "random seas only")
    if sea.choppy or sea.order != 1:
        raise Refused("parts", sea.kind, "choppy and order of the sum, not of its parts")
    if getattr(sea, "omega_max", None) == FADING:
        allowed = "a frequency > 0 rad/s: a sum has no closed form, see fading.resolve_band"
        raise Refused("omega_max", FADING, allowed)
    return sea


class SumSea(RandomSea, frozen=True):
    """Sum of independent random seas.

    z = sum_i z_i, with the phases of part i from the seed `SeedSequence([seed, i])`

    Parameters
    ----------
    parts : sequence of RandomSea
        Seas, or their plain data; their own seeds do not matter.
    seed : int
        Seed of all phases.
    choppy, order, order_omega_max
        Nonlinear seas, see `RandomSea`: the waves of all parts interact.

    Raises
    ------
    Refused
        If a part is no random sea, choppy or of second order itself, or has
        `omega_max="fading"`, which is a number for one link and one spectrum.

    Notes
    -----
    Slopes add. Those beyond the mesh are of the part with the largest slope variance of the real
    sea, in the direction of its wind; the slopes of all parts count as resolved.

    Examples
    --------
    >>> from meshtrace.surfaces import JonswapSea, Jonswap, SpectralSea
    >>> swell = SpectralSea(spectrum=Jonswap(hs=1.0, tp=12.0, gamma=6.0), mss="band")
    >>> sea = SumSea(parts=[JonswapSea(wind_speed=5.0), swell], seed=3)
    >>> len(sea.components.omega) == sum(len(part.components.omega) for part in sea.parts)
    True
    """

    kind: Literal["sum"] = "sum"
    parts: Annotated[
        tuple[Annotated[SerializeAsAny[RandomSea], BeforeValidator(_part)], ...],
        Field(min_length=1),
    ]

    @property
    def windiest(self) -> RandomSea:
        """The part with the largest slope variance of the real sea."""
        return max(self.parts, key=lambda part: sum(part.slope_variance or (0.0, 0.0)))

    @property
    def slope_variance(self) -> Variances | None:
        """Slope variances along and across the wind of the part with the largest ones."""
        return self.windiest.slope_variance

    @property
    def _slopes_along_deg(self) -> float:
        return self.windiest._slopes_along_deg

    def _water_depth(self) -> float | None:
        depths = [part._water_depth() for part in self.parts]
        return min((depth for depth in depths if depth is not None), default=None)

    @cached_property
    def free_waves(self) -> WaveComponents:
        """The waves of first order of all parts."""
        seeds = (np.random.SeedSequence([self.seed, i]) for i in range(len(self.parts)))
        waves = [
            part.with_seed(int(seed.generate_state(1)[0])).free_waves
            for part, seed in zip(self.parts, seeds, strict=True)
        ]
        return WaveComponents(*(np.concatenate(rows) for rows in zip(*waves, strict=True)))

    @property
    def jitter(self) -> bool:
        """Whether another seed has other wave vectors."""
        return any(getattr(part, "jitter", False) for part in self.parts)
