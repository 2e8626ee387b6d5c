"""Random sea from a table of variance over frequency and direction."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from meshtrace.errors import Refused

from .dispersion import wavenumber_in_current
from .parameters import Current, Depth, Finite, Floats, Mss, Positive, Variances, WindSpeed
from .random_sea import RandomSea
from .statistics import real_slope_variance
from .waves import WaveComponents, flat_components

Variance = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]


class MeasuredSea(RandomSea, frozen=True):
    """Random sea from a table of variance over frequency and direction.

    Parameters
    ----------
    omega : sequence of float, length m
        Angular frequencies at a fixed point [rad s-1].
    theta : sequence of float, length n
        Directions the waves travel to, counter-clockwise from +x [rad].
    variance : sequence of sequences of float, m by n
        Elevation variance of each bin [m2].
    seed : int
        Seed of the random phases (and frequencies, with `jitter`).
    d_theta : float, optional
        Largest distance of directions [rad]: wider bins are split, with a density that is linear
        between the directions of the table, which have to go round the circle in equal steps.
        None keeps one wave per bin and direction, a sea of few crossing trains.
    jitter : bool
        Draw every wave's frequency uniformly within its bin, so that the sea does not repeat.
        Bins meet half-way between their frequencies. The variance of each bin is kept.
    depth : float, optional
        Water depth [m]; None is deep water.
    capillary : bool
        Surface tension in the dispersion.
    current : (float, float), optional
        Uniform current [m s-1]. The table holds frequencies at a fixed point, so that the current
        changes wavenumbers: sigma(k) + k.U = omega.
    choppy, order, order_omega_max
        Nonlinear seas, see `RandomSea`.
    mss : {"cox-munk", "elfouhaily", "band"}
        Slope variance of the real sea, see `JonswapSea`; "band", the default, has no waves beyond
        the table.
    wind_speed : float, optional
        Wind speed at 10 m [m s-1] of `mss`.
    wind_direction_deg : float
        Direction the wind blows to, counter-clockwise from +x [deg], for `mss`.
    record : str, optional
        Origin of the table, such as station and time. Phases belong to t = 0 of the sea.

    Raises
    ------
    Refused
        If a parameter is out of range, the table has not m by n values, or a current stops a wave.

    Examples
    --------
    >>> sea = MeasuredSea(omega=[1.0, 2.0], theta=[0.0], variance=[[0.02], [0.005]])
    >>> sea.components.amplitude.round(12)
    array([0.2, 0.1])
    """

    kind: Literal["measured"] = "measured"
    omega: tuple[Positive, ...] = Field(min_length=1)
    theta: tuple[Finite, ...] = Field(min_length=1)
    variance: tuple[tuple[Variance, ...], ...]
    d_theta: Positive | None = None
    jitter: bool = False
    depth: Depth | None = None
    capillary: bool = True
    current: Current | None = None
    mss: Mss = "band"
    wind_speed: WindSpeed | None = None
    wind_direction_deg: Finite = 0.0
    record: str | None = None

    @model_validator(mode="after")
    def _check_table(self) -> Self:
        lengths = sorted({len(row) for row in self.variance})
        if len(self.variance) != len(self.omega) or lengths != [len(self.theta)]:
            raise Refused(
                "variance",
                f"{len(self.variance)} rows of {lengths} values",
                f"{len(self.omega)} rows (omega) of {len(self.theta)} (theta)",
            )
        if self.mss != "band" and self.wind_speed is None:
            raise Refused("wind_speed", None, f'a wind speed for mss = "{self.mss}"')
        if self.jitter and (len(self.omega) < 2 or (np.diff(self.omega) <= 0.0).any()):
            raise Refused("jitter", True, "with two or more increasing frequencies only")
        if self.d_theta is not None:
            turn = np.diff(np.sort(np.mod(self.theta, 2.0 * math.pi)))
            if len(self.theta) < 3 or not np.allclose(turn, 2.0 * math.pi / len(self.theta)):
                allowed = "only with three or more directions in equal steps round the circle"
                raise Refused("d_theta", self.d_theta, allowed)
        if self.current is not None:
            _ = self.free_waves  # refuses a current that stops a wave
        return self

    @property
    def slope_variance(self) -> Variances | None:
        """Slope variances along and across the wind of the real sea, by `mss`."""
        return real_slope_variance(self.mss, self.wind_speed or 5.0)

    @cached_property
    def free_waves(self) -> WaveComponents:
        """The waves of first order, direction by direction at each frequency."""
        theta, variance = self._split()
        rng = np.random.default_rng(self.seed)
        phase = 2.0 * math.pi * rng.random(variance.shape)
        omega = np.broadcast_to(np.array(self.omega)[:, None], variance.shape)
        if self.jitter:
            edges = bin_edges(np.array(self.omega))[:, None]
            omega = edges[:-1] + np.diff(edges, axis=0) * rng.random(variance.shape)
        amplitude = np.sqrt(2.0 * variance)
        k = wavenumber_in_current(omega, theta, self.current, self.depth, self.capillary)
        return flat_components(amplitude, omega, k, theta, phase)

    def _split(self) -> tuple[Floats, Floats]:
        """Return directions and variances, after wide bins have been split."""
        theta, variance = np.array(self.theta), np.array(self.variance)
        width = 2.0 * math.pi / len(theta)
        if self.d_theta is None or self.d_theta >= width:
            return theta, variance
        order = np.argsort(np.mod(theta, 2.0 * math.pi))
        theta, variance = np.mod(theta, 2.0 * math.pi)[order], variance[:, order]
        parts = math.ceil(width / self.d_theta - 1e-9)
        offset = (np.arange(parts) + 0.5) / parts - 0.5
        # linear towards the neighbour on either side
        neighbours = np.stack([np.roll(variance, 1, axis=1), np.roll(variance, -1, axis=1)])
        towards = neighbours[(offset > 0.0).astype(int)]  # (parts, m, n)
        share = np.abs(offset)[:, None, None]
        fine = np.moveaxis((1.0 - share) * variance + share * towards, 0, -1)
        total = fine.sum(axis=-1, keepdims=True)
        fine = fine * np.divide(
            variance[..., None], total, out=np.zeros_like(total), where=total > 0
        )
        angles = theta[:, None] + width * offset
        return angles.ravel(), fine.reshape(len(variance), -1)


def bin_edges(omega: Floats) -> Floats:
    """Return the edges of frequency bins: midpoints, and the same distance beyond the ends."""
    middle = 0.5 * (omega[1:] + omega[:-1])
    first = max(1.5 * omega[0] - 0.5 * omega[1], 0.5 * omega[0])
    return np.concatenate([[first], middle, [1.5 * omega[-1] - 0.5 * omega[-2]]])
