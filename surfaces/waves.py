"""Plane waves: dispersion, and their sums at points and on tensor grids.

z = sum_i a_i cos(omega_i t - kx_i x - ky_i y + phase_i)

Every function of the dispersion takes `depth=None` for deep water and `capillary=True` to add
surface tension, omega^2 = (g k + T k^3) tanh(k depth).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache, cached_property, lru_cache
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshtrace.checks import check_call
from meshtrace.errors import Described, Refused, warn

from .parameters import Depth, Floats, finite_array, points

GRAVITY = 9.81
"""Gravity g [m s-2]."""

CAPILLARY_WAVENUMBER = 370.0
"""Wavenumber k_m of the slowest wave [rad m-1] (Elfouhaily et al. 1997)."""

# At the slowest wave gravity and tension balance, g k = T k^3. The result, 7.17e-5 m3 s-2, is clean
# sea water near 20 deg C: 0.0735 N/m over 1026 kg/m3.
KINEMATIC_TENSION = GRAVITY / CAPILLARY_WAVENUMBER**2
"""Surface tension over density T [m3 s-2]."""

_NEWTON_STEPS = 60  # at most, so that the time is bounded; far fewer are needed


@check_call
def angular_frequency(k: ArrayLike, depth: Depth | None = None, capillary: bool = False) -> Floats:
    """Return the angular frequency of a wave.

    omega = sqrt((g k + T k^3) tanh(k depth))

    Parameters
    ----------
    k : array_like
        Wavenumber [rad m-1], k >= 0.
    depth : float, optional
        Water depth [m]; None is deep water, tanh = 1.
    capillary : bool
        Add the surface tension T; it matters above some 30 rad/s, where it adds 3 % to omega.

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
    squared, _ = _squared_frequency(finite_array("k", k, 0.0), depth, capillary)
    return np.sqrt(squared)


@check_call
def wavenumber(omega: ArrayLike, depth: Depth | None = None, capillary: bool = False) -> Floats:
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
    deep_water = omega**2 / GRAVITY  # wavenumber by gravity alone
    if depth is None and not capillary:
        return deep_water
    # a wave of frequency 0 has wavenumber 0; Newton's method would divide 0 by 0
    above_zero = deep_water > 0.0
    target = omega[above_zero] ** 2
    k = deep_water[above_zero]
    if capillary:
        # The roots for gravity alone and for tension alone both lie above the root. omega^2 is
        # convex in k, so that Newton's method descends to the root without overshooting.
        k = np.minimum(k, np.cbrt(target / KINEMATIC_TENSION))
    if depth is not None:
        k = k / np.sqrt(np.tanh(k * depth))
    result = np.zeros_like(omega)

    def step(k: Floats) -> Floats:
        squared, slope = _squared_frequency(k, depth, capillary)
        return (squared - target) / slope

    result[above_zero] = _newton(k, step)
    return result


@check_call
def wavenumber_in_current(
    omega: ArrayLike,
    theta: ArrayLike,
    current: tuple[float, float] | None = None,
    depth: Depth | None = None,
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
    beyond omega = -g / (4 U.k / k), where the group speed over ground vanishes.

    Examples
    --------
    >>> float(wavenumber_in_current(1.0, 0.0, current=(1.0, 0.0)).round(6))
    0.08529
    """
    still = wavenumber(omega, depth, capillary)
    if current is None:
        return still
    omega, theta, k = np.broadcast_arrays(finite_array("omega", omega, 0.0), theta, still)
    # component of the current along the wave [m s-1]
    along = current[0] * np.cos(theta) + current[1] * np.sin(theta)
    tiny = np.finfo(float).tiny  # in place of 0, by which a wave of frequency 0 would be divided

    def step(k: Floats) -> Floats:
        squared, slope = _squared_frequency(k, depth, capillary)
        sigma = np.sqrt(squared)
        # group speed over ground, the derivative by k of sigma + k along
        ground_speed = 0.5 * slope / np.maximum(sigma, tiny) + along
        stopped = (ground_speed <= 0.0) & (k > 0.0)
        if stopped.any():
            first = np.argmax(stopped)
            wave = float(omega.flat[first]), np.degrees(np.asarray(theta).flat[first])
            problem = Described(f"{current} m/s")
            allowed = "a current that the wave of {:g} rad/s towards {:g} deg can pass"
            raise Refused("current", problem, allowed.format(*wave))
        # a wave of frequency 0 stays at wavenumber 0
        return np.where(k > 0.0, (sigma + k * along - omega) / ground_speed, 0.0)

    return _newton(k, step)


@check_call
def phase_speed(k: ArrayLike, depth: Depth | None = None, capillary: bool = False) -> Floats:
    """Return the phase speed c = omega / k [m s-1] of waves of wavenumber `k` > 0 [rad m-1].

    Examples
    --------
    >>> round(float(phase_speed(370.0, capillary=True)), 4)  # the slowest wave
    0.2303
    """
    k = finite_array("k", k, np.finfo(float).tiny)
    return angular_frequency(k, depth, capillary) / k


@check_call
def group_speed(k: ArrayLike, depth: Depth | None = None, capillary: bool = False) -> Floats:
    """Return the group speed c_g = d omega / d k [m s-1] of waves of wavenumber `k` > 0 [rad m-1].

    Examples
    --------
    >>> round(float(group_speed(0.4) / phase_speed(0.4)), 12)  # deep water
    0.5
    """
    k = finite_array("k", k, np.finfo(float).tiny)
    squared, slope = _squared_frequency(k, depth, capillary)
    return slope / (2.0 * np.sqrt(squared))


def _squared_frequency(k: Floats, depth: float | None, capillary: bool) -> tuple[Floats, Floats]:
    """Return omega^2 [rad2 s-2] and its derivative by k [m s-2]."""
    tension = KINEMATIC_TENSION if capillary else 0.0
    deep = (GRAVITY + tension * k**2) * k  # g k + T k^3
    deep_slope = GRAVITY + 3.0 * tension * k**2
    if depth is None:
        return deep, deep_slope
    tanh = np.tanh(k * depth)
    return deep * tanh, deep_slope * tanh + deep * depth * (1.0 - tanh**2)


def _newton(k: Floats, step: Callable[[Floats], Floats]) -> Floats:
    """Return the root that Newton's method reaches from k; `step` is function over derivative."""
    # until the steps are of the size of rounding
    for _ in range(_NEWTON_STEPS):
        last = step(k)
        k = k - last
        if (np.abs(last) <= 1e-15 * k).all():
            break
    return k


_BLOCK = 2**20  # numbers of a block in a direct sum: 8 MB of doubles, tuned to the cache
_GRIDS_KEPT = 4  # last grids whose plans stay in memory
_ROUNDING = 1e-14  # of the position of equally spaced lines, relative to the farthest
_MOST_CELLS = 5e7  # of an FFT: some GB
# Error of a fast sum, see `WaveGrid`. Light by a mesh from such sums is within 1e-3 of the exact.
_SUM_ERROR = 2e-7
_UPSAMPLING = 1.25  # the least that finufft allows: fewer cells than by its default of 2

# Lines of an FFT per half of the shortest wavelength, for interpolation between them. It is the
# upsampling factor sigma of the transform that interpolation undoes.
_OVERSAMPLING = 1.25
# The error of interpolation from w lines goes as exp(-pi w sqrt(1 - 1 / sigma)) (Barnett, Magland
# and af Klinteberg 2019), that is exp(-_DECAY w).
_DECAY = math.pi * math.sqrt(1.0 - 1.0 / _OVERSAMPLING)

# Measured times [s] of one term of a direct sum, one cell of an FFT, one wave spread on the cells,
# one value interpolated: they decide which sum is faster, and only their ratios matter.
_TERM, _FFT_CELL, _SPREAD, _INTERPOLATED = 0.7e-9, 20e-9, 110e-9, 20e-9


class WaveComponents(NamedTuple):
    """Plane waves as plain arrays of one length, for compiled code.

    Parameters
    ----------
    amplitude : ndarray, shape (n,)
        Amplitudes a [m].
    omega : ndarray, shape (n,)
        Angular frequencies [rad s-1].
    kx, ky : ndarray, shape (n,)
        Wave vectors [rad m-1].
    phase : ndarray, shape (n,)
        Phases at the origin and time 0 [rad].
    """

    amplitude: Floats
    omega: Floats
    kx: Floats
    ky: Floats
    phase: Floats


def flat_components(
    amplitude: Floats | float,
    omega: Floats,
    k: Floats | float,
    heading: Floats | float,
    phase: Floats | float,
    current: tuple[float, float] | None = None,
) -> WaveComponents:
    """Flatten a table of waves over frequency and direction.

    Parameters
    ----------
    amplitude, phase : ndarray or float
        Amplitudes [m] and phases [rad].
    omega : ndarray
        Frequencies seen by an observer who moves with the current [rad s-1].
    k, heading : ndarray or float
        Wavenumbers [rad m-1] and directions of travel from +x [rad].
    current : (float, float), optional
        Velocity (U_x, U_y) [m s-1]; None is still water.
    """
    kx, ky = k * np.cos(heading), k * np.sin(heading)
    if current is not None:
        omega = omega + kx * current[0] + ky * current[1]
    return WaveComponents(*(np.ravel(a).copy() for a in (amplitude, omega, kx, ky, phase)))


def _monomials(waves: WaveComponents, order: int) -> list[Floats]:
    """Return the factors kx^i ky^j, i + j = order, of the derivatives of each wave, kx first."""
    return [waves.kx ** (order - j) * waves.ky**j for j in range(order + 1)]


def wave_weights(waves: WaveComponents, order: int, time: float) -> NDArray[np.complex128]:
    """Return weights for `WaveGrid.sum`: the derivatives of z of one order at a time [s]."""
    # z = Re sum amplitude exp(-i (kx x + ky y)), which each derivative multiplies by -i kx or -i ky
    amplitude = waves.amplitude * np.exp(1j * (waves.omega * time + waves.phase))
    return np.stack([(-1j) ** order * factor * amplitude for factor in _monomials(waves, order)])


def elevation_and_slopes(waves: WaveComponents, time: float) -> NDArray[np.complex128]:
    """Return weights (3, n) for `WaveGrid.sum`: z, dz/dx and dz/dy at a time [s]."""
    return np.concatenate([wave_weights(waves, order, time) for order in (0, 1)])


def sum_waves(
    waves: WaveComponents, order: int, x: ArrayLike, y: ArrayLike, time: float
) -> list[Floats]:
    """Return the elevation, or its exact derivatives of an order, at points and a time.

    Parameters
    ----------
    waves : WaveComponents
        The waves.
    order : {0, 1, 2}
        z [m]; the slopes dz/dx and dz/dy; or the second derivatives zxx, zxy and zyy [m-1].
    x, y : array_like
        Positions [m], broadcast together.
    time : float
        Time [s].
    """
    x, y = points(x, y)
    px, py = x.reshape(-1, 1), y.reshape(-1, 1)
    # derivatives of a cos(omega t - kx x - ky y): a kx sin(...), then -a kx kx cos(...)
    trigonometric = np.sin if order == 1 else np.cos
    amplitude = -waves.amplitude if order == 2 else waves.amplitude
    weights = amplitude[:, None] * np.stack(_monomials(waves, order), axis=1)
    phase_at_origin = waves.omega * time + waves.phase
    sums = np.empty((len(px), order + 1))
    # blocks that fit the cache
    step = max(1, _BLOCK // max(1, len(phase_at_origin)))
    for start in range(0, len(px), step):
        block = slice(start, start + step)
        phase = phase_at_origin - px[block] * waves.kx - py[block] * waves.ky
        # Not a BLAS product, whose last digits change with its number of threads.
        sums[block] = np.einsum("pi,iw->pw", trigonometric(phase), weights)
    return [column.reshape(x.shape) for column in sums.T]


class WaveGrid:
    """Sums of plane waves on a tensor grid.

    f(x_m, y_n) = Re sum_i w_i exp(-i (kx_i x_m + ky_i y_n))

    Parameters
    ----------
    kx, ky : ndarray, shape (n,)
        Wave vectors [rad m-1].
    x_axis : ndarray, shape (nx,)
        Grid lines [m].
    y_axis : ndarray, shape (ny,)
        Grid lines [m].
    error : float
        Root mean square error of a fast sum, relative to that of the sum over all places,
        sqrt(sum |w|^2 / 2); single points are within 1e-5 of it with the default of 2e-7.

    Notes
    -----
    The method is the one that is expected to be faster. Either a non-uniform FFT (Barnett, Magland
    and af Klinteberg 2019) onto equally spaced lines; between them other lines are interpolated,
    axis by axis, with a Kaiser-Bessel kernel, by whose transform the weights of the waves are
    divided before. Or the direct sum: for few waves, and for lines that lie far apart compared
    with the shortest of many waves. Two real sums make one complex transform, over the waves and
    their mirror images; the last of an odd number is the real part of one over the waves alone. The
    choice, and with it the digits, depends on the waves and the grid alone, not on the number of
    threads.

    Attributes
    ----------
    seconds : float
        Time of a sum [s], roughly.

    References
    ----------
    Barnett, Magland and af Klinteberg (2019), SIAM J. Sci. Comput. 41(5), C479-C504.
    """

    def __init__(
        self, kx: Floats, ky: Floats, x_axis: Floats, y_axis: Floats, error: float = _SUM_ERROR
    ) -> None:
        self._error = error
        self._waves, self._axes = (kx, ky), (x_axis, y_axis)
        # plans that no thread uses at present, by the shape of their weights
        self._idle: dict[tuple[int, ...], list[Any]] = {}
        # unless the lines of both axes are equally spaced, both axes are interpolated
        if None in map(_step, self._axes):
            width = math.ceil(-math.log(error) / _DECAY)
            pairs = zip(self._axes, self._waves, strict=True)
            self._lines = [
                _Lines.between(axis, float(np.abs(k).max(initial=0.0)), width) for axis, k in pairs
            ]
        else:
            self._lines = [_Lines.along(axis) for axis in self._axes]
        direct = _TERM * len(kx) * len(x_axis) * len(y_axis)
        transform = self._transform_cost()
        self._fast = transform < direct and _has_finufft()
        self.seconds = transform if self._fast else direct

    def sum(self, weights: NDArray[np.complex128]) -> Floats:
        """Return the sums for several weights, shape (m, n), as an array (m, nx, ny)."""
        if not self._fast:
            return self._direct(weights)
        norm = np.sqrt(np.square(np.abs(weights)).sum(axis=1))
        norm[norm == 0.0] = 1.0
        # of norm 1, since the error of a transform is shared by the two sums that it holds
        scaled = weights * (self._factor / norm[:, None])
        sums = np.empty((len(weights), *map(len, self._axes)))
        paired = len(weights) // 2 * 2
        if paired:
            # A real sum is half the transform of the waves and, with conjugate weights, of their
            # mirror images: one complex transform holds two, as its real and imaginary part.
            real, imag = 0.5 * scaled[:paired:2], 0.5j * scaled[1:paired:2]
            pairs = np.concatenate([real + imag, real.conj() - imag.conj()], axis=1)
            transforms = self._transformed(pairs)
            sums[:paired:2], sums[1:paired:2] = transforms.real, transforms.imag
        if paired < len(weights):
            sums[paired:] = self._transformed(scaled[paired:]).real
        sums *= norm[:, None, None]
        return sums

    @cached_property
    def _factor(self) -> NDArray[np.complex128]:
        """Factor of each wave: the phase factor at line 0, over the transform of the kernel."""
        factor = np.ones(len(self._waves[0]), complex)
        for k, lines in zip(self._waves, self._lines, strict=True):
            factor *= np.exp(-1j * k * lines.middle) / lines.transfer(k)
        return factor

    def _transformed(self, weights: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Return transforms (m, nx, ny) of the waves; weights of mirror images follow theirs."""
        # by a plan that no other thread uses
        idle = self._idle.setdefault(weights.shape, [])
        try:
            plan = idle.pop()
        except IndexError:
            plan = self._plan(*weights.shape)
        x, y = self._lines
        sums = np.asarray(plan.execute(weights)).reshape(-1, x.number, y.number)
        idle.append(plan)
        if x.near is None:
            return sums
        # one axis after the other, each turned to the front
        return np.stack([y.interpolated(x.interpolated(plane).T).T for plane in sums])

    def _plan(self, transforms: int, sources: int) -> Any:
        import finufft

        numbers = tuple(lines.number for lines in self._lines)
        # type 1: from waves anywhere to equally spaced lines; one thread, so that the digits do not
        # depend on their number
        plan = finufft.Plan(
            1, numbers, n_trans=transforms, eps=self._error, isign=-1, nthreads=1,
            upsampfac=_UPSAMPLING,
        )  # fmt: skip
        # phase per line [rad]; with twice as many sources, also of the mirror images
        phases = (k * lines.step for k, lines in zip(self._waves, self._lines, strict=True))
        plan.setpts(*(p if sources == len(p) else np.concatenate([p, -p]) for p in phases))
        return plan

    def _direct(self, weights: NDArray[np.complex128]) -> Floats:
        """Return the direct sums, in blocks of waves that bound the memory."""
        (kx, ky), (x, y) = self._waves, self._axes
        sums = np.zeros((len(weights), len(x), len(y)))
        block = max(1, _BLOCK // max(len(x), len(y)))
        for start in range(0, len(kx), block):
            part = slice(start, start + block)
            # the phase factor is a product of one factor for each axis
            left = np.exp(-1j * x[:, None] * kx[part])
            right = np.exp(-1j * ky[part, None] * y)
            # Re(left weight right) = real real - imag imag, as one real product
            parts = np.concatenate([right.real, -right.imag])
            for total, weight in zip(sums, weights[:, part], strict=True):
                weighted = left * weight
                both = np.concatenate([weighted.real, weighted.imag], axis=1)
                # not a BLAS product, whose last digits change with its number of threads
                total += np.einsum("mi,in->mn", both, parts)
        return sums

    def _transform_cost(self) -> float:
        """Return the expected time of a fast sum [s]."""
        cells, waves = math.prod(lines.number for lines in self._lines), 2 * len(self._waves[0])
        if cells > _MOST_CELLS:
            return math.inf
        between = 0 if self._lines[0].near is None else len(self._axes[0]) * self._lines[1].number
        # a transform holds two sums; tuned: the 4 stands for the upsampled cells of finufft
        return 0.5 * (4 * cells * _FFT_CELL + waves * _SPREAD) + between * _INTERPOLATED


@cache
def _has_finufft() -> bool:
    """Return whether finufft is installed; warn, once per process, if it is not."""
    if find_spec("finufft"):
        return True
    warn("finufft is not installed: many waves are summed directly")
    return False


def _step(axis: Floats) -> float | None:
    """Return the distance of equally spaced lines, None if they are not equally spaced."""
    n = len(axis)
    step = float(axis[-1] - axis[0]) / max(1, n - 1)
    even = axis[n // 2] + step * (np.arange(n) - n // 2)
    return step if np.abs(axis - even).max() <= _ROUNDING * np.abs(axis).max() else None


class _Lines(NamedTuple):
    """Equally spaced lines of an FFT, and the weights that interpolate other lines between them.

    Line j stands at middle + j h, h = `step`; x is measured from the middle:

    exp(-i k x) = sum_j phi(x / h - j) exp(-i k j h) / phi^(k h), up to aliases, phi^ the Fourier
    transform of phi(u) = I_0(beta sqrt(1 - (2 u / width)^2)), the kernel of Kaiser and Bessel.
    """

    middle: float  # [m], of line 0
    step: float  # h [m]
    number: int
    width: int = 0  # number of lines from which a value is interpolated; 0: no interpolation
    near: tuple[NDArray[np.int64], Floats] | None = None
    """Indices of the `width` lines around each line of the axis, and their weights, both of the
    shape (width, lines of the axis); None where the lines are those of the axis."""

    @classmethod
    def along(cls, axis: Floats) -> _Lines:
        """Return the lines of an equally spaced axis, without interpolation."""
        return cls(float(axis[len(axis) // 2]), _step(axis) or 0.0, len(axis))

    @classmethod
    def between(cls, axis: Floats, k: float, width: int) -> _Lines:
        """Return grid lines dense enough for waves up to a wavenumber [rad m-1]."""
        middle = 0.5 * float(axis[0] + axis[-1])
        span = float(axis[-1] - axis[0]) or 1.0
        # pi / k is half the shortest wavelength; 1e-300 for waves of infinite length
        step = min(math.pi / (_OVERSAMPLING * max(k, 1e-300)), span)
        half = math.ceil(0.5 * span / step) + width
        # too many for a transform, whose cost is then infinite: the weights are not needed
        if half > _MOST_CELLS:
            return cls(middle, step, 2 * half + 1, width)
        position = (axis - middle) / step
        # the `width` lines within half a width on either side
        near = np.ceil(position - 0.5 * width).astype(np.int64)[:, None] + np.arange(width)
        # 2 u / width of the kernel
        offset = (position[:, None] - near) / (0.5 * width)
        phi = np.i0(cls.beta(width) * np.sqrt(np.maximum(1.0 - offset**2, 0.0)))
        lines, weights = np.ascontiguousarray(near.T) + half, np.ascontiguousarray(phi.T)
        return cls(middle, step, 2 * half + 1, width, (lines, weights))

    @staticmethod
    def beta(width: int) -> float:
        """Return the parameter beta of a Kaiser-Bessel kernel for the density `_OVERSAMPLING`.

        beta = pi w (1 - 1 / (2 sigma)) puts the edge of its transform at the first alias of the
        shortest wave.
        """
        return math.pi * width * (1.0 - 0.5 / _OVERSAMPLING)

    def transfer(self, k: Floats) -> Floats:
        """Return phi^(k h), 1 without interpolation."""
        if not self.width:
            return np.ones_like(k)
        # int phi(u) exp(-i k h u) du = w sinh(s) / s, s^2 = beta^2 - (w k h / 2)^2
        s = np.sqrt(self.beta(self.width) ** 2 - (0.5 * self.width * self.step * k) ** 2)
        return self.width * np.sinh(s) / s

    def interpolated(self, values: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Interpolate values on these lines to the lines of the axis, shape (nx, n)."""
        # real and imaginary parts side by side: real products are half the work
        parts = np.ascontiguousarray(values).view(float)
        assert self.near is not None
        near, weights = self.near
        # a sparse matrix would take a third of the time, but importing scipy a tenth of a short run
        total = np.zeros((near.shape[1], parts.shape[1]))
        part = np.empty_like(total)
        for lines, weight in zip(near, weights, strict=True):
            np.take(parts, lines, axis=0, out=part, mode="clip")  # other modes make a copy
            part *= weight[:, None]
            total += part
        return total.view(complex)


def grid_store() -> Callable[..., WaveGrid]:
    """Return a cached constructor of `WaveGrid`, from the bytes of wave vectors and grid lines.

    Copies of a sea, and seas that differ by the seed, share one: plans do not depend on the phases.
    """

    @lru_cache(maxsize=_GRIDS_KEPT)
    def planned(*arrays: bytes) -> WaveGrid:
        # bytes, as a cache needs keys that do not change: 8 for each number
        kx, ky, x_axis, y_axis = (np.ndarray(len(a) // 8, buffer=a) for a in arrays)
        return WaveGrid(kx, ky, x_axis, y_axis)

    return planned
