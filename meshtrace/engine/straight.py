"""Unscattered light straight from lamp to receiver (interim)."""

from __future__ import annotations

import math

import numpy as np

from meshtrace.engine.bvh import EmbreeIntersector
from meshtrace.engine.setup.ends import ForcedLink
from meshtrace.kernels.medium import Medium
from meshtrace.kernels.scene import Emitter
from meshtrace.kernels.sources import SourceKind
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
    if r == 0.0:
        return 0.0, 0.0
    w = way / r
    facing = float(w @ np.array(target.axis))
    if facing <= 0.0 or facing < target.cos_half_fov:
        return 0.0, 0.0
    tau = 0.0 if link.direction == "over" else float(medium.a + medium.b) * r
    gain = (
        _intensity(emitter, float(w @ np.array(emitter.axis)))
        * target.area
        * facing
        / r**2
        * math.exp(-tau)
    )
    return gain, 1e-4 if gain else 0.0


def _intensity(emitter: Emitter, cosine: float) -> float:
    if emitter.kind == SourceKind.ISOTROPIC:
        return emitter.norm
    if emitter.kind == SourceKind.LED:
        return emitter.norm * max(cosine, 0.0) ** emitter.spread
    theta = math.acos(min(max(cosine, -1.0), 1.0))
    if emitter.kind == SourceKind.GAUSSIAN_BEAM:
        return emitter.norm * math.exp(-2.0 * (theta / emitter.spread) ** 2)
    return emitter.norm if theta <= emitter.spread else 0.0
