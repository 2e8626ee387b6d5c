"""Wavelengths of a link that can share paths, and the links whose paths these are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from meshtrace.engine.setup.arrays import frame_of
from meshtrace.engine.setup.tinting import Tinting, tinting
from meshtrace.link import Link
from meshtrace.models import Floats

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


def common_paths(
    links: Sequence[Link], base: int, waiting: Sequence[int], mixed: bool = False
) -> CommonPaths:
    """Return the waiting links that can share the paths of a base, all if possible.

    With photons of several of them in turn if `mixed` and sums of photons follow these.
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
    if mixed and first.bubbles is None:
        turns = _in_turn([links[i] for i in rows])
        several = tinting(first, [links[i] for i in rows], frame, turns) if len(turns) > 1 else None
        found = several if several is not None and several.follows else found
    return CommonPaths(rows, bases, found, (index - low) / (high - low or 1.0))


def _in_turn(links: Sequence[Link]) -> list[int]:
    """Return the links whose photons are followed in turn, the one that scatters most first.

    Numbers of scatterings of neighbours, of about the Poisson law, overlap.
    """
    depth = max(-item.center[2] for _, item in links[0].items())
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
    uniform = link.water.layers is None and link.bubbles is None
    deepest = max(-item.center[2] for _, item in link.items())
    depth = np.linspace(0.0, deepest, 1 if uniform else 257)
    a, b = (float(np.mean(x)) for x in link.water.profile(depth))
    if link.bubbles is not None:
        b += float(np.mean(link.bubbles.b(depth)))
    return b, -a


def photon_paths(
    links: Sequence[Link], waiting: Sequence[int], mixed: bool = False
) -> tuple[int, CommonPaths]:
    """Return the base of the waiting links that scatters most, and those with its photons."""
    base = max(waiting, key=lambda i: scattering(links[i]))
    common = common_paths(links, base, waiting, mixed)
    if common.tinting is not None and not common.tinting.follows:
        common = common_paths(links, base, [base])
    return base, common
