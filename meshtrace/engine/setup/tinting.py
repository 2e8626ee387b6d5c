"""Choice of the wavelengths that share paths, and the functions that convert their weights.

A path is traced in the water of one wavelength, the base. The logarithm of its weight at another
one is a linear combination of a few sums over the path; their integrands, which all wavelengths
have in common, are called tints (`kernels.tints`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from meshtrace.engine.setup.arrays import Frame, frame_of, integral, mean_water
from meshtrace.kernels.medium import LOG_SMALLEST
from meshtrace.kernels.tints import (
    ALONE,
    NO_TINTS,
    TINT_CELLS_PER_LOG,
    TINTS,
    Mixture,
    Tints,
    common_functions,
)
from meshtrace.link import Link
from meshtrace.link.link import FEW_METRES
from meshtrace.models import Floats

_NODES = 2049  # depths in the tables of layered water; tuned
_LEAST_LOG = -700.0  # stands for ln 0: exp(-700) is close to the smallest normal float
_PATHS_AT_ONCE = 512  # paths whose factors are computed at a time, in the cache; tuned
_MOST_ERROR = 1e-6  # of a logarithm of weights: for a scattering, and for the whole optical path
_ONE_BASE = np.zeros((1, 0))  # densities of one base: the empty sum, ln 1


class Tinting(NamedTuple):
    """Weights of paths at several wavelengths from the weights at one.

    Parameters
    ----------
    tints : Tints or None
        Common functions, in the frame of the link; None at one wavelength.
    shares : ndarray, shape (wavelengths, tints)
        Coefficients: ln(w_j / w) = shares[j] . t for a path with the sums t of the tints.
    bases : tuple of int
        Wavelengths at which photons are traced in turn; empty if all are traced at one.
    density : ndarray, shape (bases, tints)
        Coefficients of the logarithms of the probability densities of a path at each of the bases.
    """

    tints: Tints | None
    shares: Floats
    bases: tuple[int, ...] = ()
    density: Floats = _ONE_BASE

    def factors(self, sums: Floats) -> Floats:
        """Return the factors (wavelengths, paths) on the weights of paths, exp(shares . sums).

        `sums` (paths, tints or more) are those of the tints along each path.
        """
        if not self.shares.any():
            return np.ones((len(self.shares), len(sums)))
        factors = np.zeros((len(self.shares), len(sums)))
        # by blocks, which stay in the cache of a core from the sums to the exponential
        for i in range(0, len(sums), _PATHS_AT_ONCE):
            block = factors[:, i : i + _PATHS_AT_ONCE]
            terms = np.array(sums[i : i + _PATHS_AT_ONCE].T, order="C")
            # arrivals have room for the most tints that kernels sum up: further columns are unused
            for share, term in zip(self.shares.T, terms, strict=False):
                block += share[:, None] * term
            np.exp(block, out=block)
        return factors

    def mixed(
        self, sums: Floats, base: int, parts: Floats, importance: Floats | None = None
    ) -> Floats:
        """Return the factors (wavelengths, paths) on the weights of paths traced at one base.

        By the balance heuristic, which divides by the mean density of a path over all bases: thus
        no wavelength between the bases lacks paths. `sums` as for `factors`; `base` is an index
        into `bases`; `parts` (bases,) are the fractions of the photons traced at each. Under a
        weight window, photons are as dense as their weight over the window's `importance` (bases,)
        at the start of the path.
        """
        if not self.bases:
            return self.factors(sums)
        by_base = self.density if importance is None else self.shares[list(self.bases)]
        drawn = self._replace(shares=by_base).factors(sums)
        if importance is not None:
            drawn /= importance[:, None]
        # weights relative to the base that drew the path, which has the factor 1
        relative = self._replace(shares=self.shares - self.shares[self.bases[base]])
        factors: Floats = relative.factors(sums)
        # balance heuristic (Veach and Guibas 1995): p_base / sum_i parts_i p_i; 1e-300: no 0 / 0
        # for paths whose densities all underflow
        factors *= drawn[base] / np.maximum(np.einsum("i,ij->j", parts, drawn), 1e-300)
        return factors

    def mixture(self, base: int, parts: Floats) -> Mixture:
        """Return the weights of photons traced at one base, for kernels; see `mixed`."""
        if not self.bases:
            return ALONE._replace(shares=np.ascontiguousarray(self.shares.T))
        shares = np.ascontiguousarray((self.shares - self.shares[self.bases[base]]).T)
        return Mixture(shares, self.density, parts, base)

    @property
    def follows(self) -> bool:
        """Whether photons can sum up all tints: not too many, and none for bubbles' attenuation."""
        if self.tints is None:
            return True
        return len(self.tints.c) <= TINTS and not self.tints.bubble_c.any()


UNTINTED = Tinting(NO_TINTS, np.zeros((1, 0)))
"""Weights at the wavelength of the paths alone."""


class CommonPaths(NamedTuple):
    """Links at several wavelengths, evaluated on the paths of a base link.

    Parameters
    ----------
    links : list of Link
        The link at each wavelength.
    wavelengths : list of int
        Indices of these links in the list that they were chosen from.
    ratios : list of float
        Their mean scattering coefficients relative to that of the base.
    tinting : Tinting
        Weights of the paths at each wavelength.
    bases : list of Link
        Links on whose refractive indices paths are traced: one, or the base link with the smallest
        and with the largest index of the water.
    shares : ndarray, shape (wavelengths,)
        Weight of the second of `bases` in the gain of each wavelength; the first has the rest.
        Gains are linear in the index.
    """

    links: list[Link]
    wavelengths: list[int]
    ratios: list[float]
    tinting: Tinting
    bases: list[Link]
    shares: Floats

    def middle(self) -> Link:
        """Return the base link with the mean of the smallest and the largest index."""
        first, last = self.bases[0], self.bases[-1]
        if len(self.bases) == 1:
            return first
        return first.replace("water.n", 0.5 * (first.water.n + last.water.n))


def paths_alone(link: Link, wavelength: int = 0) -> CommonPaths:
    """Return the paths of one link, for its wavelength alone."""
    return CommonPaths([link], [wavelength], [1.0], UNTINTED, [link], np.zeros(1))


def _albedos(link: Link) -> list[float]:
    """Return the albedo of each body at the wavelength of the link."""
    return [body.albedo_at(link.transmitters[0].wavelength_nm) for body in link.bodies]


def tinting(
    base: Link, links: Sequence[Link], frame: Frame, bases: Sequence[int] = ()
) -> Tinting | None:
    """Return the weights at other wavelengths of paths of a base.

    Parameters
    ----------
    base : Link
        Link whose paths are traced.
    links : sequence of Link
        The link at each wavelength; it differs from the base in water and bubbles alone.
    frame : Frame
        Frame of the paths.
    bases : sequence of int
        Indices of the links at whose wavelengths photons are traced in turn.

    Returns
    -------
    Tinting or None
        None where the base lacks paths of a link: where it does not scatter, or not by some angle;
        and where albedos of bodies differ.
    """
    # weights do not keep which bodies a path has met
    if any(_albedos(link) != _albedos(base) for link in links):
        return None
    # tables go down to the deepest layer; attenuations are scaled by the depth of the deepest end
    layers = [link.water.layers for link in (base, *links)]
    deepest = max((table[-1][0] for table in layers if table), default=0.0)
    # 1 m if no end lies in the water
    deep = max(-item.center[2] for _, item in base.items()) or 1.0
    grid = np.linspace(0.0, max(deepest, 1e-3), _NODES) if deepest else np.array([0.0, 1.0])
    profiles = [np.broadcast_arrays(*link.water.profile(grid)) for link in (base, *links)]
    waters = np.array(profiles).swapaxes(0, 1)  # (a and b, 1 + links, nodes)
    edges = np.exp(np.arange(LOG_SMALLEST, math.log(math.pi), 1.0 / TINT_CELLS_PER_LOG))
    middle = np.minimum(edges * math.exp(0.5 / TINT_CELLS_PER_LOG), math.pi)
    # with a phase function common to all, the ratio is 1 at every angle: one cell suffices
    phases = np.ones((len(links) + 1, 1))
    if any(link.water.phase != base.water.phase for link in links):
        phases = np.array([link.water.phase.pdf(middle) for link in (base, *links)])
    bubbles, extra = _bubbles(base, links, middle)
    logs = [_logs(values) for values in (waters[1], phases, bubbles)]
    if any(values is None for values in logs):
        return None
    b, phase, bubble = (values for values in logs if values is not None)
    c = waters.sum(axis=0)
    # ln(w_j / w) is a sum over the scatterings and an integral along the path (`kernels.tints`).
    # All its tables form one vector for each link, so that one factorisation gives the common
    # functions. (c_j - c) times the depth is as large as the other logarithms, and has their
    # tolerance.
    parts = [deep * (c[1:] - c[0]), b, phase, bubble, extra]
    whole = np.concatenate(parts, axis=1)
    # densities of paths: absorption is a weight and does not change what is drawn, thus b for c
    drawn = whole[list(bases)]
    drawn[:, : c.shape[1]] = deep * (waters[1, 1:][list(bases)] - waters[1, 0])
    shares, functions = common_functions(np.concatenate([whole, drawn]), _MOST_ERROR)
    shares, density = shares[: len(whole)], shares[len(whole) :]
    cuts = np.cumsum([part.shape[1] for part in parts])[:-1]
    # tables of the tints, (tints, nodes or cells)
    c, b, phase, bubble, extra = np.split(functions, cuts, axis=1)
    cells = max(phase.shape[1], bubble.shape[1])
    # contiguous copies: kernels are compiled for the layout of their arrays
    phase, bubble = (np.broadcast_to(x, (len(x), cells)).copy() for x in (phase, bubble))
    step = float(grid[1]) / frame.unit
    c = c * (frame.unit / deep)  # back to an attenuation, per unit of the frame
    tints = Tints(step, c.copy(), integral(c, step), b.copy(), phase, extra[:, 0].copy(), bubble)
    return Tinting(tints, shares, tuple(bases), density)


def _bubbles(base: Link, links: Sequence[Link], angle: Floats) -> tuple[Floats, Floats]:
    """Return the scattering by bubbles at each wavelength, relative to the base.

    The first array is b_j p_j(angle) / b, shape (1 + links, angles), with the base first. The
    second is b_j / b - 1, shape (links, 1): the relative excess of attenuation by bubbles.
    """
    populations = [link.bubbles for link in (base, *links) if link.bubbles is not None]
    first = base.bubbles
    if first is None or all(bubbles == first for bubbles in populations):
        return np.ones((len(links) + 1, 1)), np.zeros((len(links), 1))
    depth = np.linspace(0.0, 4.0 * first.e_folding, 9)
    b = np.array([bubbles.b(depth) for bubbles in populations])
    share = b[:, :1] / b[:1, :1]
    # paths are shared only where populations differ by a factor at every depth
    if not np.allclose(b, share * b[:1], rtol=1e-6):
        unshared = np.ones((len(links) + 1, 1))
        unshared[0] = 0.0  # a base without scattering makes `_logs` refuse the links
        return unshared, np.zeros((len(links), 1))
    pdf = np.array([bubbles.phase_function().pdf(angle) for bubbles in populations])
    return share * pdf, share[1:] - 1.0


def _logs(values: Floats) -> Floats | None:
    """Return logarithms of values (1 + links, n) relative to row 0, the base.

    None if a link scatters where the base does not: no path of the base carries such light.
    """
    base, others = values[0], values[1:]
    if ((base == 0.0) & (others > 0.0)).any():
        return None
    ratio = np.divide(others, base, out=np.ones_like(others), where=base > 0.0)
    # a finite floor: -inf times a coefficient of 0 would be nan
    return np.log(np.maximum(ratio, math.exp(_LEAST_LOG)))


# forms of `Physics` under which the weight of a path is no product over its parts
_NO_PRODUCTS = {"absorption": "paper", "free_path": "local_c"}
_APART = 2.5  # distance of bases, in standard deviations of the number of scatterings; tuned
_MOST_BASES = 4  # tuned


def common_paths(
    links: Sequence[Link], base: int, waiting: Sequence[int], b: Mapping[int, float]
) -> CommonPaths:
    """Select the waiting links that can share the paths of a base, all if possible.

    `base` and `waiting` are indices into `links`, `b` are the mean scattering coefficients of these
    [m-1]. Photons are traced at several of the wavelengths in turn if they can sum up the tints of
    these.
    """
    first, frame = links[base], frame_of(links[base])
    candidates = [i for i in waiting if i == base or _is_alike(first, links[i])]

    def weights_of(indices: list[int]) -> Tinting | None:
        return _weights(first, [links[i] for i in indices], frame, [b[i] for i in indices])

    weights = weights_of(candidates) if len(candidates) > 1 else None
    # a single link without common paths makes `tinting` fail for all: then each is tried alone
    if weights is None:
        candidates = [i for i in candidates if tinting(first, [links[i]], frame) is not None]
        weights = weights_of(candidates)
    if len(candidates) == 1 or weights is None:
        return paths_alone(first, base)
    alike = [links[i] for i in candidates]
    ratios = [b[i] / (b[base] or 1.0) for i in candidates]
    index = np.array([link.water.n for link in alike])
    low, high = index.min(), index.max()
    bases = [first.replace("water.n", float(n)) for n in dict.fromkeys((low, high))]
    shares = (index - low) / (high - low or 1.0)  # 0 for equal indices
    return CommonPaths(alike, candidates, ratios, weights, bases, shares)


def _weights(
    first: Link, links: Sequence[Link], frame: Frame, b: Sequence[float]
) -> Tinting | None:
    """Return the weights on paths of several bases if photons can follow these, else of the first.

    `b` (links,) are the scattering coefficients [m-1].
    """
    turns = _in_turn(links, np.array(b)) if first.bubbles is None else []
    several = tinting(first, links, frame, turns) if len(turns) > 1 else None
    return several if several is not None and several.follows else tinting(first, links, frame)


def _in_turn(links: Sequence[Link], b: Floats) -> list[int]:
    """Return the order in which links are traced, strongest scattering first.

    `b` (links,) are their mean scattering coefficients. The links are so close that the
    distributions of their numbers of scatterings, roughly Poisson laws, overlap.
    """
    depth = _depth_of_light(links[0])
    # 2 sqrt(N) of a Poisson number N has a standard deviation of about 1, whatever its mean
    root = 2.0 * np.sqrt(b * depth)
    apart = float(root.max() - root.min())
    # a tenth of a distance more does not take a further base
    number = 1 + min(math.ceil(apart / _APART - 0.1), _MOST_BASES - 1)
    wanted = np.linspace(root.max(), root.min(), number)
    return list(dict.fromkeys(int(np.abs(root - level).argmin()) for level in wanted))


def _depth_of_light(link: Link) -> float:
    """Return the depth [m] down to which a link has light: its deepest end, or as below."""
    if link.direction == "over":  # light that comes back to the air
        return link.water.bottom_depth or FEW_METRES
    return max(-item.center[2] for _, item in link.items())


def _is_alike(first: Link, link: Link) -> bool:
    """Return whether two links differ in the wavelength, water and bubbles alone."""
    # tints have no term for reflections by the bottom: its depth and albedo must be equal
    bottom, other_bottom = ((w.bottom_depth, w.bottom_albedo) for w in (first.water, link.water))
    printed = any(getattr(link.physics, name) == form for name, form in _NO_PRODUCTS.items())
    if printed or (first.bubbles is None) != (link.bubbles is None) or bottom != other_bottom:
        return False
    if len(first.transmitters) != len(link.transmitters):
        return False
    for source, other in zip(first.transmitters, link.transmitters, strict=True):
        if source.model_copy(update={"wavelength_nm": other.wavelength_nm}) != other:
            return False
    others = type(first).model_fields.keys() - {"water", "bubbles", "transmitter"}
    return all(getattr(first, name) == getattr(link, name) for name in others)


def clearest(links: Sequence[Link]) -> Link:
    """Return the link of least absorption; its light reaches farthest, so its mesh suits all."""
    return min(links, key=lambda link: link.water.a)


def scattering(link: Link) -> tuple[float, float]:
    """Return the mean scattering coefficient and minus the mean absorption [m-1], a sort key.

    The means are from still water to `_depth_of_light`; of equal scattering less absorption is
    first.
    """
    deepest = _depth_of_light(link)
    a, b = mean_water(link.water, deepest)
    if link.bubbles is not None:
        b += float(np.mean(link.bubbles.b(np.linspace(0.0, deepest, 257))))
    return b, -a


def photon_paths(
    links: Sequence[Link], waiting: Sequence[int], chains: bool = False
) -> tuple[int, CommonPaths]:
    """Return the waiting link that scatters most as base, and the links that share its paths.

    `waiting` and the base are indices into `links`. Photons share paths only if they can sum up the
    tints (`Tinting.follows`); `chains` sum up any.
    """
    # its paths have every order of scattering that the others need
    levels = {i: scattering(links[i]) for i in waiting}
    base = max(waiting, key=levels.__getitem__)
    paths = common_paths(links, base, waiting, {i: b for i, (b, _) in levels.items()})
    if not (chains or paths.tinting.follows):
        paths = paths_alone(links[base], base)
    return base, paths
