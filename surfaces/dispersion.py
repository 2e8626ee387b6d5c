"""Dispersion of water waves: frequency, wavenumber, phase and group speed.

Every function takes `depth=None` for deep water and `capillary=True` to add surface tension,
omega^2 = (g k + T k^3) tanh(k depth).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from meshtrace.errors import Described, Refused

from .parameters import DEPTH, Floats, finite_array

GRAVITY = 9.81
"""Gravity g [m s-2]."""

CAPILLARY_WAVENUMBER = 370.0
"""Wavenumber k_m of the slowest wave [rad m-1] (Elfouhaily et al. 1997)."""

# 7.17e-5 m3 s-2 is clean sea water near 20 deg C: 0.0735 N/m over 1026 kg/m3.
KINEMATIC_TENSION = GRAVITY / CAPILLARY_WAVENUMBER**2
"""Surface tension over density T [m3 s-2]."""

_NEWTON_STEPS = 60


def angular_frequency(k: ArrayLike, depth: float | None = None, capillary: bool = False) -> Floats:
    """Return the angular frequency of a wave.

    omega = sqrt((g k + T k^3) tanh(k depth))

    Parameters
    ----------
    k : array_like
        Wavenumber [rad m-1], k >= 0.
    depth : float, optional
        Water depth [m]; None is deep water, tanh = 1.
    capillary : bool
        Add the surface tension T; it matters above some 30 rad/s.

    Returns
    -------
    ndarray
        Angular frequency [rad s-1], shape of `k`.

    Raises
    ------
    Refused
        If a wavenumber is negative or not finite, or the depth is not positive.

    Notes
    -----
    The default is the paper's approximation omega^2 = g k.

    Examples
    --------
    >>> round(float(angular_frequency(0.3907)), 4)
    1.9577
    """
    squared, _ = _squared_frequency(finite_array("k", k, 0.0), _checked(depth), capillary)
    return np.sqrt(squared)


def wavenumber(omega: ArrayLike, depth: float | None = None, capillary: bool = False) -> Floats:
    """Return the wavenumber of a wave, the inverse of `angular_frequency`.

    Parameters
    ----------
    omega : array_like
        Angular frequency [rad s-1], omega >= 0.
    depth : float, optional
        Water depth [m]; None is deep water.
    capillary : bool
        Add the surface tension.

    Returns
    -------
    ndarray
        Wavenumber [rad m-1], shape of `omega`, to 1e-14 relative.

    Raises
    ------
    Refused
        If a frequency is negative or not finite, or the depth is not positive.

    Notes
    -----
    Newton's method from the start of Eckart (1952), k = k_deep / sqrt(tanh(k_deep depth)).

    Examples
    --------
    >>> round(float(wavenumber(1.0, depth=2.0)), 6)
    0.233726
    """
    omega = finite_array("omega", omega, 0.0)
    depth = _checked(depth)
    gravity_wave = omega**2 / GRAVITY
    if depth is None and not capillary:
        return gravity_wave
    moving = gravity_wave > 0.0
    target = omega[moving] ** 2
    k = gravity_wave[moving]
    if capillary:
        k = np.minimum(k, np.cbrt(target / KINEMATIC_TENSION))
    if depth is not None:
        k = k / np.sqrt(np.tanh(k * depth))
    result = np.zeros_like(omega)

    def step(k: Floats) -> Floats:
        squared, slope = _squared_frequency(k, depth, capillary)
        return (squared - target) / slope

    result[moving] = _newton(k, step)
    return result


def wavenumber_in_current(
    omega: ArrayLike,
    theta: ArrayLike,
    current: tuple[float, float] | None = None,
    depth: float | None = None,
    capillary: bool = False,
) -> Floats:
    """Return the wavenumber of a wave in a uniform current.

    sigma(k) + k (U_x cos theta + U_y sin theta) = omega, sigma(k) of `angular_frequency`

    Parameters
    ----------
    omega : array_like
        Angular frequency at a fixed point [rad s-1], omega >= 0.
    theta : array_like
        Direction the wave travels to, counter-clockwise from +x [rad]; broadcasts with `omega`.
    current : (float, float), optional
        Velocity (U_x, U_y) [m s-1]; None is still water.
    depth : float, optional
        Water depth [m]; None is deep water.
    capillary : bool
        Add the surface tension.

    Returns
    -------
    ndarray
        Wavenumber [rad m-1], broadcast shape: the root that still water continues to, where
        the group speed over ground c_g + U.k / k is positive.

    Raises
    ------
    Refused
        If an opposing current stops a wave: there is no such root.

    Notes
    -----
    Newton's method from the root of still water. In deep water an opposing current stops waves
    beyond omega = -g / (4 U.k / k).

    Examples
    --------
    >>> float(wavenumber_in_current(1.0, 0.0, current=(1.0, 0.0)).round(6))
    0.08529
    """
    still = wavenumber(omega, depth, capillary)
    if current is None:
        return still
    omega, theta, k = np.broadcast_arrays(finite_array("omega", omega, 0.0), theta, still)
    along = current[0] * np.cos(theta) + current[1] * np.sin(theta)
    tiny = np.finfo(float).tiny

    def step(k: Floats) -> Floats:
        squared, slope = _squared_frequency(k, depth, capillary)
        sigma = np.sqrt(squared)
        rate = 0.5 * slope / np.maximum(sigma, tiny) + along
        stopped = (rate <= 0.0) & (k > 0.0)
        if stopped.any():
            first = np.argmax(stopped)
            wave = float(omega.flat[first]), np.degrees(np.asarray(theta).flat[first])
            problem = Described(f"{current} m/s")
            allowed = "a current that the wave of {:g} rad/s towards {:g} deg can pass"
            raise Refused("current", problem, allowed.format(*wave))
        return np.where(k > 0.0, (sigma + k * along - omega) / rate, 0.0)

    return _newton(k, step)


def phase_speed(k: ArrayLike, depth: float | None = None, capillary: bool = False) -> Floats:
    """Return the phase speed c = omega / k [m s-1] of waves of wavenumber `k` > 0 [rad m-1].

    Examples
    --------
    >>> round(float(phase_speed(370.0, capillary=True)), 4)  # the slowest wave
    0.2303
    """
    k = finite_array("k", k, np.finfo(float).tiny)
    return angular_frequency(k, depth, capillary) / k


def group_speed(k: ArrayLike, depth: float | None = None, capillary: bool = False) -> Floats:
    """Return the group speed c_g = d omega / d k [m s-1] of waves of wavenumber `k` > 0 [rad m-1].

    Examples
    --------
    >>> round(float(group_speed(0.4) / phase_speed(0.4)), 12)  # deep water
    0.5
    """
    k = finite_array("k", k, np.finfo(float).tiny)
    squared, slope = _squared_frequency(k, _checked(depth), capillary)
    return slope / (2.0 * np.sqrt(squared))


def _checked(depth: float | None) -> float | None:
    return None if depth is None else DEPTH.check(depth)


def _squared_frequency(k: Floats, depth: float | None, capillary: bool) -> tuple[Floats, Floats]:
    """Return omega^2 and its derivative by k."""
    tension = KINEMATIC_TENSION if capillary else 0.0
    deep = (GRAVITY + tension * k**2) * k
    deep_slope = GRAVITY + 3.0 * tension * k**2
    if depth is None:
        return deep, deep_slope
    tanh = np.tanh(k * depth)
    return deep * tanh, deep_slope * tanh + deep * depth * (1.0 - tanh**2)


def _newton(k: Floats, step: Callable[[Floats], Floats]) -> Floats:
    """Return k less the steps of Newton's method, until these are of rounding."""
    for _ in range(_NEWTON_STEPS):
        last = step(k)
        k = k - last
        if (np.abs(last) <= 1e-15 * k).all():
            break
    return k
