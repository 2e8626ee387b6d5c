"""Waters of one link at several wavelengths as common functions, see `kernels.tints`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from meshtrace.engine.setup.arrays import Frame
from meshtrace.kernels.phase import SMALLEST_ANGLE
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
        found = np.zeros((len(self.shares), len(sums)))
        for i in range(0, len(sums), _CACHED):
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
    """Links at several wavelengths whose light the paths of a base bring."""

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
    deep = max(-item.center[2] for _, item in base.items())
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
    if size > 1:
        phase, bubble = (np.broadcast_to(x, (len(x), size)).copy() for x in (phase, bubble))
    step = float(grid[1]) / frame.unit
    c = c * (frame.unit / deep)
    path = np.zeros_like(c)
    path[:, 1:] = np.cumsum(0.5 * step * (c[:, 1:] + c[:, :-1]), axis=1)
    found = Tints(step, c, path, b, phase, extra[:, 0].copy(), bubble,
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
    return np.log(np.maximum(ratio, math.exp(_NONE)))
