"""Frozen chains over smooth seas: lists of facets against the search of every facet."""

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.engine.chains.gain import Counter
from meshtrace.engine.forced import TypicalSea
from meshtrace.engine.neighbours import FrozenForced
from meshtrace.surfaces import JonswapSea, SinusoidalSea

SMOOTH = mt.Link().replace("physics.unresolved", "none")
STEEP = SinusoidalSea(amplitude=0.03, wavelength=1.0)
"""Waves that focus below the receiver: many chains have three crossings and more."""
SEAS = {
    "5 m/s": JonswapSea(wind_speed=5.0, waves="paper", seed=7),
    "13 m/s": JonswapSea(wind_speed=13.0, waves="paper", seed=7),
    "steep": STEEP,
}
NEIGHBOURS = {
    "half angle": ("transmitter.half_angle_deg", 10.3),
    "depth": ("transmitter.depth", 10.1),
    "deeper": ("transmitter.depth", 9.7),
    "much deeper": ("transmitter.depth", 14.0),
    "height": ("receiver.height", 5.15),
    "radius": ("receiver.radius", 0.055),
    "offset": ("receiver.position", (0.05, -0.03)),
    "far offset": ("receiver.position", (3.0, 0.0)),
    "tilt": ("receiver.tilt_deg", 2.0),
    "index": ("water.n", 1.342),
    "phase function": ("water.phase.mu", 3.62),
    "field of view": ("receiver.fov_deg", 90.0),
}


def arrivals(frozen, link, mesh):
    """Return the scores of all chains of a link, and the counts of its search."""
    _, aimed, sets = frozen._aimed(link, mesh)
    scores = [aimed.score(0, 0, chains) for chains in sets[0]]
    return np.concatenate(scores), aimed.counters


@pytest.mark.parametrize("name", SEAS)
@pytest.mark.thorough
@pytest.mark.slow_but("5 m/s", "13 m/s")
def test_listed_facets_hold_all_crossings(name):
    """Chain by chain, the same digits as by the search of every facet, folds included."""
    mesh = SEAS[name].mesh(extent=8.0, spacing=0.08)
    crest = float(mesh.bounds[1, 2])
    every = FrozenForced(SMOOTH, 512, 1, TypicalSea(crest))
    lists = FrozenForced(SMOOTH, 512, 1, TypicalSea(crest), meshes=[mesh])
    _, before = arrivals(every, SMOOTH, mesh)
    folds = 0
    for what, (key, value) in NEIGHBOURS.items():
        link = SMOOTH.replace(key, value)
        expected, searched = arrivals(every, link, mesh)
        found, used = arrivals(lists, link, mesh)
        np.testing.assert_allclose(found, expected, rtol=1e-12, err_msg=what)
        assert used[Counter.EXTRA_ROOTS] == searched[Counter.EXTRA_ROOTS], what
        asked = searched[Counter.ENUMERATED]
        assert used[Counter.ENUMERATED] + used[Counter.LISTED] == asked, what
        assert searched[Counter.LISTED] == 0
        if what in ("half angle", "depth", "radius"):
            assert used[Counter.LISTED] > 0.9 * asked, what
        if what in ("much deeper", "far offset"):
            assert used[Counter.ENUMERATED] > 0.5 * asked, what
        if used[Counter.LISTED] > 0.5 * asked:
            folds += searched[Counter.EXTRA_ROOTS] != before[Counter.EXTRA_ROOTS]
    if name == "steep":  # crossings appear and vanish at folds
        assert before[Counter.EXTRA_ROOTS] > 50
        assert folds > 2


def test_lists_serve_their_own_surface_alone():
    """Over another surface, and over random slopes, no list is used."""
    meshes = [STEEP.mesh(time=t, extent=8.0, spacing=0.1) for t in (0.0, 0.1)]
    frozen = FrozenForced(SMOOTH, 64, 1, TypicalSea(0.1), meshes=meshes[:1])
    for mesh, used in zip(meshes, (True, False), strict=True):
        assert bool(arrivals(frozen, SMOOTH, mesh)[1][Counter.LISTED]) is used
    mesh = SEAS["5 m/s"].mesh(extent=8.0, spacing=0.1)
    rough = FrozenForced(mt.Link(), 64, 1, TypicalSea(0.5), meshes=[mesh])
    counts = arrivals(rough, mt.Link(), mesh)[1]
    assert counts[Counter.SOLVED] > 0
    assert counts[Counter.LISTED] == 0
