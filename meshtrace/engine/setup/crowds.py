"""Many receivers: one represents its neighbourhood if that changes no light."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.scene import Emitter, Target
from meshtrace.kernels.vectors import Vec3

_MANY = 64
"""Targets up to which each stands for itself."""

_CELL = 0.06  # edge of a neighbourhood over the height of a target above the sources


def representatives(emitters: Sequence[Emitter], targets: Sequence[Target]) -> NDArray[np.intp]:
    """Return the representative of each target.

    Notes
    -----
    Up to 64 targets stand for themselves. Of more, those that differ in their horizontal place
    alone share square cells of 6 % of their height above the highest source: the target nearest to
    the middle of a cell stands for the others in it. Which it is does not depend on the order of
    the targets.
    """
    found = np.arange(len(targets))
    if len(targets) <= _MANY:
        return found
    alike: dict[Target, list[int]] = defaultdict(list)
    for i, t in enumerate(targets):
        alike[t._replace(center=Vec3(0.0, 0.0, t.center.z), reach=0.0)].append(i)
    level = max(e.position.z for e in emitters)
    for kind, some in alike.items():
        rows = np.array(sorted(some, key=lambda i: targets[i].center))
        places = np.array([targets[i].center[:2] for i in rows])
        edge = _CELL * (kind.center.z - level)
        _, cell = np.unique(
            np.floor((places - places.min(axis=0)) / edge), axis=0, return_inverse=True
        )
        for members in np.split(np.argsort(cell.ravel(), kind="stable"), _ends(cell.ravel())):
            middle = 0.5 * (places[members].min(axis=0) + places[members].max(axis=0))
            square = np.square(places[members] - middle).sum(axis=1)
            found[rows[members]] = rows[members[np.argmin(square)]]
    return found


def _ends(cell: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the ends of the sorted members of each cell but the last."""
    return np.cumsum(np.bincount(cell))[:-1]
