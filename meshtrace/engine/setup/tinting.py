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

_NODES = 2049  # of layered water
_PER_LOG = 50.0  # cells over the logarithm of the scattering angle
_NONE = -700.0  # logarithm of no scattering
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
        """Return the factors (wavelengths, paths) on the weights of paths with sums (paths, >=)."""
        if not self.shares.any():
            return np.ones((len(self.shares), len(sums)))
        found = np.zeros((len(self.shares), len(sums)))
        for i in range(0, len(sums), _CACHED):
            # blocks small enough for the cache
            part, rows = found[:, i : i + _CACHED], np.array(sums[i : i + _CACHED].T, order="C")
            for share, row in zip(self.shares.T, rows, strict=False):
                part += share[:, None] * row
            np.exp(part, out=part)
        return found

    def mixed(
        self, sums: Floats, base: int, parts: Floats, importance: Floats | None = None
    ) -> Floats:
        """Return the factors on the weights of paths of one base.

        `parts` (bases,) are the shares of the photons. The balance heuristic counts a path with the
        density of the mixture: no wavelength between the bases lacks paths. Photons of a weight
        window are as dense as their light over its importance (bases,) at the start.
        """
        if not self.bases:
            return self.factors(sums)
        rows = self.density if importance is None else self.shares[list(self.bases)]
        drawn = self._replace(shares=rows).factors(sums)
        if importance is not None:
            drawn /= importance[:, None]
        # weights are over the base that drew the path, whose own factor is one
        own = self._replace(shares=self.shares - self.shares[self.bases[base]])
        found: Floats = own.factors(sums)
        found *= drawn[base] / np.maximum(np.einsum("i,ij->j", parts, drawn), 1e-300)
        return found

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


class Common(NamedTuple):
    """Links at several wavelengths, evaluated on the paths of one base link."""

    tinting: Tinting
    links: Sequence[Link]
    ratios: Sequence[float]  # of the scattering coefficients, over that of the base


UNTINTED = Tinting(NO_TINTS, np.zeros((1, 0)))
"""Weights at one wavelength, that of the paths."""


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
    layers = [row.water.layers for row in (base, *links)]
    deepest = max((rows[-1][0] for rows in layers if rows), default=0.0)
    deep = max(-item.center[2] for _, item in base.items()) or 1.0  # of sun and sky: any length
    grid = np.linspace(0.0, max(deepest, 1e-3), _NODES) if deepest else np.array([0.0, 1.0])
    profiles = [np.broadcast_arrays(*row.water.profile(grid)) for row in (base, *links)]
    waters = np.array(profiles).swapaxes(0, 1)  # a and b, links, nodes
    edges = np.exp(np.arange(math.log(SMALLEST_ANGLE), math.log(math.pi), 1.0 / _PER_LOG))
    middle = np.minimum(edges * math.exp(0.5 / _PER_LOG), math.pi)
    alike = [row.water.phase == base.water.phase for row in links]
    cells = np.ones(1) if all(alike) else middle
    phases = np.ones((len(links) + 1, len(cells)))
    if not all(alike):
        phases = np.array([row.water.phase.pdf(middle) for row in (base, *links)])
    bubbles, extra = _bubbles(base, links, middle)
    logs = [_logs(rows) for rows in (waters[1], phases, bubbles)]
    if any(rows is None for rows in logs):
        return None
    b, phase, bubble = (rows for rows in logs if rows is not None)
    c = waters.sum(axis=0)
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
    found = Tints(step, c, integral(c, step), b, phase, extra[:, 0].copy(), bubble,
                  math.log(SMALLEST_ANGLE), _PER_LOG)  # fmt: skip
    return Tinting(found._replace(c=c.copy(), b=b.copy()), shares, tuple(bases), density)


def _bubbles(base: Link, links: Sequence[Link], angle: Floats) -> tuple[Floats, Floats]:
    """Return b p and b of the bubbles over the values of the base, base first; b less 1."""
    populations = [row.bubbles for row in (base, *links) if row.bubbles is not None]
    first = base.bubbles
    if first is None or all(one == first for one in populations):
        return np.ones((len(links) + 1, 1)), np.zeros((len(links), 1))
    depth = np.linspace(0.0, 4.0 * first.e_folding, 9)
    b = np.array([one.b(depth) for one in populations])
    share = b[:, :1] / b[:1, :1]
    # paths are shared only where populations differ by a factor at every depth
    if not np.allclose(b, share * b[:1], rtol=1e-6):
        none = np.ones((len(links) + 1, 1))
        none[0] = 0.0  # other shapes: no path of the base is one of another
        return none, np.zeros((len(links), 1))
    pdf = np.array([one.phase_function().pdf(angle) for one in populations])
    return share * pdf, share[1:] - 1.0


def _logs(rows: Floats) -> Floats | None:
    """Return the logarithms of rows over the first, None where that is 0 and another is not."""
    base, others = rows[0], rows[1:]
    if ((base == 0.0) & (others > 0.0)).any():
        return None
    ratio = np.divide(others, base, out=np.ones_like(others), where=base > 0.0)
    # a finite floor: infinite logarithms times a coefficient of 0 are nan
    return np.log(np.maximum(ratio, math.exp(_NONE)))


_OWN_PATHS = {"absorption": "paper", "free_path": "local_c"}  # forms whose weights are no products
_APART = 2.5  # of twice the square roots of the scatterings expected, between bases in turn
_MOST_BASES = 4


class CommonPaths(NamedTuple):
    """Wavelengths with common paths, and the links that have these."""

    rows: list[int]
    bases: list[Link]  # one, or those of the smallest and the largest index
    tinting: Tinting | None  # None for a wavelength alone
    shares: Floats  # (rows,) of the second base

    def middle(self) -> Link:
        """Return the base with the mean of the indices."""
        first, last = self.bases[0], self.bases[-1]
        if len(self.bases) == 1:
            return first
        return first.replace("water.n", 0.5 * (first.water.n + last.water.n))


def common_paths(links: Sequence[Link], base: int, waiting: Sequence[int]) -> CommonPaths:
    """Return the waiting links that can share the paths of a base, all if possible.

    With photons of several of them in turn if sums of photons follow these.
    """
    first, frame = links[base], frame_of(links[base])
    rows = [i for i in waiting if i == base or _is_alike(first, links[i])]
    found = tinting(first, [links[i] for i in rows], frame) if len(rows) > 1 else None
    if found is None:
        rows = [i for i in rows if tinting(first, [links[i]], frame) is not None]
        found = tinting(first, [links[i] for i in rows], frame)
    if len(rows) == 1:
        return CommonPaths(rows, [first], None, np.zeros(1))
    index = np.array([links[i].water.n for i in rows])
    low, high = index.min(), index.max()
    bases = [first.replace("water.n", float(n)) for n in dict.fromkeys((low, high))]
    if first.bubbles is None:
        turns = _in_turn([links[i] for i in rows])
        several = tinting(first, [links[i] for i in rows], frame, turns) if len(turns) > 1 else None
        found = several if several is not None and several.follows else found
    return CommonPaths(rows, bases, found, (index - low) / (high - low or 1.0))


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
    return list(dict.fromkeys(int(np.abs(root - one).argmin()) for one in wanted))


def _is_alike(first: Link, link: Link) -> bool:
    """Return whether two links differ in the wavelength, water and bubbles alone."""
    floor = [(w.bottom_depth, w.bottom_albedo) for w in (first.water, link.water)]
    bubbles = [one.bubbles is None for one in (first, link)]
    printed = any(getattr(link.physics, name) == form for name, form in _OWN_PATHS.items())
    if printed or bubbles[0] != bubbles[1] or floor[0] != floor[1]:
        return False
    if len(first.transmitters) != len(link.transmitters):
        return False
    for one, other in zip(first.transmitters, link.transmitters, strict=True):
        if one.model_copy(update={"wavelength_nm": other.wavelength_nm}) != other:
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
    base = max(waiting, key=lambda i: scattering(links[i]))
    common = common_paths(links, base, waiting)
    if not (chains or common.tinting is None or common.tinting.follows):
        common = common_paths(links, base, [base])
    return base, common
