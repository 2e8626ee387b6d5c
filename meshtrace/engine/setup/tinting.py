"""Wavelengths of a link that share paths, and their waters as common functions.

The weights of paths at other wavelengths are sums of these functions, see `kernels.tints`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from meshtrace.engine.setup.arrays import Frame, frame_of, integral, mean_water
from meshtrace.kernels.medium import SMALLEST_ANGLE
from meshtrace.kernels.tints import ALONE, NO_TINTS, TINTS, Mixture, Tints, common_functions
from meshtrace.link import Link
from meshtrace.models import Floats

_NODES = 2049  # depths of layered water
_PER_LOG = 50.0  # cells per unit of the logarithm of the scattering angle
_NONE = -700.0  # logarithm of no scattering: exp(-700) is almost the smallest float
_CACHED = 512  # paths whose factors are formed together
_EXACT = 1e-6  # error of a logarithm: of a scattering, and of the way through the water


_ALONE = np.zeros((1, 0))


class Tinting(NamedTuple):
    """Weights of paths at several wavelengths from the weights at one.

    Parameters
    ----------
    tints : Tints or None
        Common functions, in the frame of the link; None at one wavelength.
    shares : ndarray, shape (wavelengths, tints)
        Their coefficients.
    bases : list of int
        Wavelengths whose photons are followed in turn, in place of those of the one link.
    density : ndarray, shape (bases, tints)
        Coefficients of the densities with which these draw a path.
    """

    tints: Tints | None
    shares: Floats
    bases: tuple[int, ...] = ()
    density: Floats = _ALONE

    def factors(self, sums: Floats) -> Floats:
        """Return the factors (wavelengths, paths) on the weights of paths, exp(shares . sums).

        `sums` (paths, tints or more) of the common functions over each path.
        """
        if not self.shares.any():
            return np.ones((len(self.shares), len(sums)))
        factors = np.zeros((len(self.shares), len(sums)))
        # a block at a time, which stays in the cache of a core up to its exponential
        for i in range(0, len(sums), _CACHED):
            block = factors[:, i : i + _CACHED]
            terms = np.array(sums[i : i + _CACHED].T, order="C")
            # paths have room for all functions that kernels can sum up: further columns are 0
            for share, term in zip(self.shares.T, terms, strict=False):
                block += share[:, None] * term
            np.exp(block, out=block)
        return factors

    def mixed(
        self, sums: Floats, base: int, parts: Floats, importance: Floats | None = None
    ) -> Floats:
        """Return the factors (wavelengths, paths) on the weights of paths of one of the bases.

        `parts` (bases,) are the shares of the photons. The balance heuristic counts a path with the
        density of the mixture: no wavelength between the bases lacks paths. Photons of a weight
        window are as dense as their light over its importance (bases,) at the start.
        """
        if not self.bases:
            return self.factors(sums)
        by_base = self.density if importance is None else self.shares[list(self.bases)]
        drawn = self._replace(shares=by_base).factors(sums)
        if importance is not None:
            drawn /= importance[:, None]
        # weights are over the base that drew the path, whose own factor is one
        relative = self._replace(shares=self.shares - self.shares[self.bases[base]])
        factors: Floats = relative.factors(sums)
        # balance heuristic (Veach and Guibas 1995): p_base / sum_i parts_i p_i; no 0 / 0 for paths
        # whose densities all underflow
        factors *= drawn[base] / np.maximum(np.einsum("i,ij->j", parts, drawn), 1e-300)
        return factors

    def mixture(self, base: int, parts: Floats) -> Mixture:
        """Return the weights of the photons of one base, for kernels."""
        if not self.bases:
            return ALONE._replace(shares=np.ascontiguousarray(self.shares.T))
        shares = np.ascontiguousarray((self.shares - self.shares[self.bases[base]]).T)
        return Mixture(shares, self.density, parts, base)

    @property
    def follows(self) -> bool:
        """Whether photons can sum up all functions: few, and of bubbles alike in number."""
        if self.tints is None:
            return True
        return len(self.tints.c) <= TINTS and not self.tints.bubble_c.any()


UNTINTED = Tinting(NO_TINTS, np.zeros((1, 0)))
"""Weights at one wavelength, that of the paths."""


class CommonPaths(NamedTuple):
    """Links at several wavelengths that are evaluated on the paths of a base link.

    Parameters
    ----------
    links : list of Link
        The link at each wavelength.
    wavelengths : list of int
        Positions of these links in the list that they were chosen from.
    ratios : list of float
        Their scattering coefficients over that of the base.
    tinting : Tinting
        Weights of the paths at each wavelength.
    bases : list of Link
        Links that have the paths: one, or those of the smallest and the largest index of the water.
    shares : ndarray, shape (wavelengths,)
        Weight of the second base in the gain of each wavelength, 1 - that of the first.
    """

    links: list[Link]
    wavelengths: list[int]
    ratios: list[float]
    tinting: Tinting
    bases: list[Link]
    shares: Floats

    def middle(self) -> Link:
        """Return the base with the mean of the indices."""
        first, last = self.bases[0], self.bases[-1]
        if len(self.bases) == 1:
            return first
        return first.replace("water.n", 0.5 * (first.water.n + last.water.n))


def paths_alone(link: Link, wavelength: int = 0) -> CommonPaths:
    """Return the paths of one link at its own wavelength."""
    return CommonPaths([link], [wavelength], [1.0], UNTINTED, [link], np.zeros(1))


def tinting(
    base: Link, links: Sequence[Link], frame: Frame, bases: Sequence[int] = ()
) -> Tinting | None:
    """Return the factors of links over a base that differs in water and bubbles alone.

    Parameters
    ----------
    base, links
        The link whose paths are followed, and those whose weights they get.
    frame : Frame
        Frame of the paths.
    bases : sequence of int
        Links whose photons are followed in turn.

    Returns
    -------
    Tinting or None
        None where the base has no paths of a link: where it does not scatter, or not by an angle.
    """
    # down to the deepest layer, and scaled by the way that light goes: the depth of the deepest end
    layers = [link.water.layers for link in (base, *links)]
    deepest = max((table[-1][0] for table in layers if table), default=0.0)
    deep = max(-item.center[2] for _, item in base.items()) or 1.0  # of sun and sky: any length
    grid = np.linspace(0.0, max(deepest, 1e-3), _NODES) if deepest else np.array([0.0, 1.0])
    profiles = [np.broadcast_arrays(*link.water.profile(grid)) for link in (base, *links)]
    waters = np.array(profiles).swapaxes(0, 1)  # a and b, links, nodes
    edges = np.exp(np.arange(math.log(SMALLEST_ANGLE), math.log(math.pi), 1.0 / _PER_LOG))
    middle = np.minimum(edges * math.exp(0.5 / _PER_LOG), math.pi)
    # a phase function that all share has the ratio 1 at every angle: one cell says so
    phases = np.ones((len(links) + 1, 1))
    if any(link.water.phase != base.water.phase for link in links):
        phases = np.array([link.water.phase.pdf(middle) for link in (base, *links)])
    bubbles, extra = _bubbles(base, links, middle)
    logs = [_logs(values) for values in (waters[1], phases, bubbles)]
    if any(values is None for values in logs):
        return None
    b, phase, bubble = (values for values in logs if values is not None)
    c = waters.sum(axis=0)
    # ln w_j / w of a path: a sum over its scatterings and an integral over its way, all in one
    # vector a link, so that one factorisation finds the functions that the links have in common.
    # (c_j - c) times the depth has the size of the other logarithms: one tolerance suits all.
    parts = [deep * (c[1:] - c[0]), b, phase, bubble, extra]
    whole = np.concatenate(parts, axis=1)
    drawn = whole[list(bases)]  # absorption is a weight: it does not change what is drawn
    drawn[:, : c.shape[1]] = deep * (waters[1, 1:][list(bases)] - waters[1, 0])
    shares, functions = common_functions(np.concatenate([whole, drawn]), _EXACT)
    shares, density = shares[: len(whole)], shares[len(whole) :]
    cuts = np.cumsum([part.shape[1] for part in parts])[:-1]
    c, b, phase, bubble, extra = np.split(functions, cuts, axis=1)
    size = max(phase.shape[1], bubble.shape[1])
    # contiguous, of one cell as of many: kernels are compiled for the layout of their arrays
    phase, bubble = (np.broadcast_to(x, (len(x), size)).copy() for x in (phase, bubble))
    step = float(grid[1]) / frame.unit
    c = c * (frame.unit / deep)
    tints = Tints(step, c.copy(), integral(c, step), b.copy(), phase, extra[:, 0].copy(), bubble,
                  math.log(SMALLEST_ANGLE), _PER_LOG)  # fmt: skip
    return Tinting(tints, shares, tuple(bases), density)


def _bubbles(base: Link, links: Sequence[Link], angle: Floats) -> tuple[Floats, Floats]:
    """Return what bubbles scatter at each wavelength, over the scattering coefficient of the base.

    The first array has b_j p_j(angle) / b, shape (1 + links, angles), the base first; the second
    b_j / b - 1, shape (links, 1), which attenuates the way through the bubbles.
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
        none = np.ones((len(links) + 1, 1))
        none[0] = 0.0  # other shapes: no path of the base is one of another
        return none, np.zeros((len(links), 1))
    pdf = np.array([bubbles.phase_function().pdf(angle) for bubbles in populations])
    return share * pdf, share[1:] - 1.0


def _logs(values: Floats) -> Floats | None:
    """Return the logarithms of values (1 + links, n) over those of the base, the first ones.

    None where a link has light that the base has not: no path of the base could bring it.
    """
    base, others = values[0], values[1:]
    if ((base == 0.0) & (others > 0.0)).any():
        return None
    ratio = np.divide(others, base, out=np.ones_like(others), where=base > 0.0)
    # a finite floor: infinite logarithms times a coefficient of 0 are nan
    return np.log(np.maximum(ratio, math.exp(_NONE)))


_OWN_PATHS = {"absorption": "paper", "free_path": "local_c"}  # forms whose weights are no products
_APART = 2.5  # distance of bases in turn, in standard deviations of the number of scatterings
_MOST_BASES = 4


def common_paths(links: Sequence[Link], base: int, waiting: Sequence[int]) -> CommonPaths:
    """Return the waiting links that can share the paths of a base, all if possible.

    Photons are those of several of them in turn if they can sum up the functions of these.
    """
    first, frame = links[base], frame_of(links[base])
    candidates = [i for i in waiting if i == base or _is_alike(first, links[i])]
    weights = tinting(first, [links[i] for i in candidates], frame) if len(candidates) > 1 else None
    # one link without common paths spoils the table of all: only then each is tried alone
    if weights is None:
        candidates = [i for i in candidates if tinting(first, [links[i]], frame) is not None]
        weights = tinting(first, [links[i] for i in candidates], frame)
    if len(candidates) == 1 or weights is None:
        return paths_alone(first, base)
    alike = [links[i] for i in candidates]
    ratios = [scattering(link)[0] / (scattering(first)[0] or 1.0) for link in alike]
    index = np.array([link.water.n for link in alike])
    low, high = index.min(), index.max()
    bases = [first.replace("water.n", float(n)) for n in dict.fromkeys((low, high))]
    if first.bubbles is None:
        turns = _in_turn(alike)
        several = tinting(first, alike, frame, turns) if len(turns) > 1 else None
        weights = several if several is not None and several.follows else weights
    shares = (index - low) / (high - low or 1.0)
    return CommonPaths(alike, candidates, ratios, weights, bases, shares)


def _in_turn(links: Sequence[Link]) -> list[int]:
    """Return the links whose photons are followed in turn, the one that scatters most first.

    Numbers of scatterings of neighbours, of about the Poisson law, overlap.
    """
    depth = max(-item.center[2] for _, item in links[0].items())
    # 2 N^(1/2) of a Poisson number N has a standard deviation of about 1 at any mean
    root = np.array([2.0 * math.sqrt(scattering(link)[0] * depth) for link in links])
    apart = float(root.max() - root.min())
    number = 1 + min(math.ceil(apart / _APART - 0.1), _MOST_BASES - 1)
    wanted = np.linspace(root.max(), root.min(), number)
    return list(dict.fromkeys(int(np.abs(root - level).argmin()) for level in wanted))


def _is_alike(first: Link, link: Link) -> bool:
    """Return whether two links differ in the wavelength, water and bubbles alone."""
    # the bottom reflects alike at all wavelengths, and is met where the photons of the base meet it
    floor = [(w.bottom_depth, w.bottom_albedo) for w in (first.water, link.water)]
    printed = any(getattr(link.physics, name) == form for name, form in _OWN_PATHS.items())
    if printed or (first.bubbles is None) != (link.bubbles is None) or floor[0] != floor[1]:
        return False
    if len(first.transmitters) != len(link.transmitters):
        return False
    for source, other in zip(first.transmitters, link.transmitters, strict=True):
        if source.model_copy(update={"wavelength_nm": other.wavelength_nm}) != other:
            return False
    others = type(first).model_fields.keys() - {"water", "bubbles", "transmitter"}
    return all(getattr(first, name) == getattr(link, name) for name in others)


def clearest(links: Sequence[Link]) -> Link:
    """Return the link whose light reaches farthest: the mesh of all is fine and wide enough."""
    return min(links, key=lambda link: link.water.a)


def scattering(link: Link) -> tuple[float, float]:
    """Return the mean scattering coefficient above the deepest end, and less absorption."""
    deepest = max(-item.center[2] for _, item in link.items())
    a, b = mean_water(link.water, deepest)
    if link.bubbles is not None:
        b += float(np.mean(link.bubbles.b(np.linspace(0.0, deepest, 257))))
    return b, -a


def photon_paths(
    links: Sequence[Link], waiting: Sequence[int], chains: bool = False
) -> tuple[int, CommonPaths]:
    """Return the base of the waiting links that scatters most, and those with its paths.

    Photons sum up few functions, and none of bubbles that differ in number; `chains` all.
    """
    # paths of the link that scatters most have all orders of scattering of the others
    base = max(waiting, key=lambda i: scattering(links[i]))
    paths = common_paths(links, base, waiting)
    if not (chains or paths.tinting.follows):
        paths = paths_alone(links[base], base)
    return base, paths
