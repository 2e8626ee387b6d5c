"""Unscattered light straight from lamp to receiver (interim)."""

from __future__ import annotations

import math

import numpy as np

from meshtrace.engine.bvh import EmbreeIntersector
from meshtrace.engine.setup.ends import ForcedLink
from meshtrace.kernels.medium import Medium, depth_between
from meshtrace.kernels.sources import intensity
from meshtrace.kernels.vectors import Vec3


def straight_gains(
    link: ForcedLink, intersector: EmbreeIntersector | None, medium: Medium, e: int, t: int,
    at: Vec3 | None = None,
) -> tuple[float, float]:  # fmt: skip
    """Interim."""
    emitter, target = link.emitters[e], link.targets[t]
    start = np.array(at if at is not None else emitter.position)
    way = np.array(target.center) - start
    r = float(np.linalg.norm(way))
    w = way / r
    facing = float(w @ np.array(target.axis))
    if facing <= 0.0 or facing < target.cos_half_fov:
        return 0.0, 0.0
    tau = (
        0.0
        if link.direction == "over"
        else float(medium.a + medium.b) * r
    )
    gain = intensity(emitter, Vec3(*w.tolist())) * target.area * facing / r**2 * math.exp(-tau)
    return gain, 1e-4 if gain else 0.0
