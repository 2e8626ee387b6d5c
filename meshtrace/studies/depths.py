"""Performance of a link over depth, for several winds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Unpack

import numpy as np

from meshtrace.checks import check_call
from meshtrace.comms.combining import Combining
from meshtrace.comms.ook import OokLink, Preset
from meshtrace.daylight.light import Daylight
from meshtrace.engine.setup.options import StudyOptions
from meshtrace.errors import require_finite
from meshtrace.link import Link
from meshtrace.models import Floats
from meshtrace.results.provenance import water_of
from meshtrace.scenario import Scenario
from meshtrace.stored import Stacked
from meshtrace.studies.performance import LinkPerformance, link_performance
from meshtrace.surfaces import sea_in_wind
from meshtrace.uav import Dryden, Flight


@dataclass(frozen=True, eq=False, repr=False)
class DepthSweep(
    Stacked, kind="depth-sweep", title="meshtrace link performance over depth and wind"
):
    """Performance over depth, for several winds.

    Attributes
    ----------
    wind_speeds : sequence of float
        Winds at 10 m [m s-1].
    performances : tuple of LinkPerformance
        One for each wind.
    """

    wind_speeds: Sequence[float]
    performances: tuple[LinkPerformance, ...]

    # dimension of the stack in a file, and the name of its labels
    _along: ClassVar[tuple[str, str]] = ("wind_speed", "wind_speed")

    def _stack(self) -> tuple[Sequence[float], tuple[LinkPerformance, ...]]:
        return self.wind_speeds, self.performances

    def _headline(self) -> str:
        winds = ", ".join(f"{speed:g}" for speed in self.wind_speeds)
        return f"winds {winds} m/s, {len(self.performances[0].depths)} depths"

    def range_at_ber(self, ber: float | None = None) -> Floats:
        """Return the ranges of all winds and bit rates with their limits [m].

        Parameters
        ----------
        ber : float, optional
            See `LinkPerformance.range_at_ber`.

        Returns
        -------
        ndarray, shape (winds, bit_rates, 3)
        """
        return np.array([p.range_at_ber(ber) for p in self.performances])

    def summary(self) -> str:
        """Return the ranges of all winds and bit rates as text for a terminal."""
        first = self.performances[0]
        lines = [first._range_heading]
        pairs = list(zip(self.wind_speeds, self.performances, strict=True))
        for speed, performance in pairs:
            lines += performance._range_lines(f"{speed:>5g} m/s")
        lights = [f"background light, {speed:g} m/s: {p.background_light}" for speed, p in pairs]
        if len({p.background_light for p in self.performances}) == 1:
            lights = [f"background light: {first.background_light}"]
        tilts = [line for speed, p in pairs for line in p._tilts(f", {speed:g} m/s")]
        water = f"water: {water_of(first.provenance)}"
        return "\n".join([*lines, "", water, *lights, *tilts, first.status])


SWEEP_DEPTHS = tuple(float(d) for d in range(20, 95, 5))
"""Depths of `depth_sweep` [m]."""


class PerformanceOptions(StudyOptions, total=False):
    """Options of `link_performance` that `depth_sweep` passes on."""

    ook: OokLink | Preset | None
    daylight: Daylight | None
    limit: float
    confidence: float
    combining: Combining


@check_call
def depth_sweep(
    link: Link | Scenario,
    depths: Sequence[float] = SWEEP_DEPTHS,
    *,
    bit_rate: float | Sequence[float] = (1e6, 5e6, 1e7),
    wind_speeds: Sequence[float] = (0.0, 5.0, 13.0),
    realizations: int = 50,
    flight: Flight | None = None,
    **options: Unpack[PerformanceOptions],
) -> DepthSweep:
    """Return the curves of the bit error rate over depth with their confidence bands.

    Parameters
    ----------
    link : Link or Scenario
        The link; sea, bubbles and whitecaps follow each wind (`Link.in_wind`).
    depths : sequence of float
        Depths of the transmitter [m], rising.
    bit_rate : float or sequence of float
        R_b [bit s-1].
    wind_speeds : sequence of float
        Winds at 10 m [m s-1]; 0 is a flat sea.
    realizations : int
        Seas at each depth.
    flight : Flight, optional
        Aircraft that carries the end in the air; without a wind it flies in each of the winds.
    **options
        As in `link_performance`: `ook`, `limit`, `confidence`, ...

    Returns
    -------
    DepthSweep

    Examples
    --------
    >>> sweep = depth_sweep(Link(), [50.0, 55.0, 60.0], bit_rate=1e6, wind_speeds=[0.0])
    >>> f"{sweep.range_at_ber()[0, 0, 0]:.0f} m"
    '55 m'
    """
    performances = []
    speeds = require_finite(wind_speeds, "wind_speeds", "one or more wind speeds [m/s]").tolist()
    for speed in speeds:
        windy: Link | Scenario
        if isinstance(link, Scenario):
            windy = link.model_copy(update={"link": link.link.in_wind(speed), "wind_speed": speed})
        else:
            windy = link.in_wind(speed)
        # an aircraft without a wind of its own flies in that of the sea below
        flown = flight
        if flight is not None and flight.wind is None:
            height = (link.link if isinstance(link, Scenario) else link).air_end[1].height
            flown = flight._replace(wind=Dryden(wind_speed=speed, height=height))
        result = link_performance(
            windy, sea_in_wind(speed), bit_rate=bit_rate, depths=depths,
            realizations=realizations, flight=flown, **options,
        )  # fmt: skip
        performances.append(result)
    return DepthSweep(tuple(speeds), tuple(performances))
