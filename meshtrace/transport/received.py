"""Paths of received light, sampled from the chains in proportion to their weight."""

from __future__ import annotations

import math

import numpy as np

from meshtrace.kernels.chains import Chains
from meshtrace.kernels.scene import Emitter, Target
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Floats
from meshtrace.transport.aimed import AimedChains, on_disk
from meshtrace.transport.forced import ForcedDetection


def received_light(
    forced: ForcedDetection, mesh: TriangleMesh, n: int, rng: np.random.Generator
) -> list[tuple[Floats, float]]:
    """Return n paths into the first receiver, sampled in proportion to their weight.

    Each is (points, weight) from the source over its scatterings and the crossing to the
    aperture; all carry the same share of the gain.
    """
    aimed = forced.over(mesh)
    sets = forced.sets(aimed)
    link = forced.arrays
    light: list[float] = []
    paths: list[Floats] = []
    for s, power in enumerate(link.power):
        e, t = (0, s) if link.down else (s, 0)
        if not aimed.rough:
            direct, gain = _direct(aimed, e, t, n, rng)
            paths += list(direct)
            light += [power * gain / max(len(direct), 1)] * len(direct)
        for chains in sets[e]:
            _, found = aimed.aim(e, t, chains, keep=True)
            weight = power * found["weight"] / len(chains.audit)
            if not weight.sum() > 0.0:
                continue
            kept = rng.choice(len(found), min(n, len(found)), p=weight / weight.sum())
            for k in kept:
                paths.append(_placed(chains.chains, found[k], link.emitters[e], link.targets[t]))
            light += [float(weight.sum()) / max(len(kept), 1)] * len(kept)
    if not paths:
        return []
    total = float(sum(light))
    chosen = rng.choice(len(paths), n, p=np.array(light) / total)
    with_light = -1 if link.down else 1
    return [(link.frame.metres(paths[k][::with_light]), total / n) for k in chosen]


def _direct(
    aimed: AimedChains, emitter: int, target: int, n: int, rng: np.random.Generator
) -> tuple[Floats, float]:
    """Return about n unscattered paths into the first receiver and their gain."""
    gains = aimed.facet_gains(emitter, target)
    lit = np.flatnonzero(gains)
    if not len(lit):
        return np.zeros((0, 3, 3)), 0.0
    facets = rng.choice(lit, n, p=gains[lit] / gains[lit].sum())
    u = rng.random((n, 2))
    angle = 2.0 * np.pi * u[:, 1]
    disk = np.sqrt(u[:, :1]) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return aimed.direct_paths(emitter, target, facets, disk), float(gains.sum())


def _placed(chains: Chains, arrival: np.void, emitter: Emitter, target: Target) -> Floats:
    """Return the points of a chain turned to its emission direction, up to the aperture."""
    from scipy.spatial.transform import Rotation

    i, w = int(arrival["chain"]), arrival["emission"]
    axis = np.array([-w[1], w[0], 0.0])
    sine = np.linalg.norm(axis)
    angle = math.atan2(sine, w[2])
    turn = Rotation.from_rotvec(axis * (angle / sine if sine > 0.0 else 0.0))
    start = on_disk(emitter.position, emitter, chains.disk[i : i + 1])
    end = on_disk(target.center, target, chains.disk[i : i + 1])
    return np.vstack([start, turn.apply(chains.vertex[i]) + start, arrival["point"], end])
