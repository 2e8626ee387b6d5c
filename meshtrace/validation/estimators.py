"""Two estimators of one gain: photons followed one by one, and chains aimed at the aperture."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import hypot
from typing import Literal

from meshtrace.link import Link, Physics, Receiver
from meshtrace.mesh import SurfaceModel
from meshtrace.optics.bubbles import HallNovarini
from meshtrace.transport.simulate import simulate
from meshtrace.validation.check import Check, simulated


def estimator_checks(photons: int) -> Iterator[Check]:
    """Yield analog gains against forced ones; `photons` for each analog run.

    An aperture of 0.25 m has 25 times the hits of the default one and the same physics. Both sides
    neglect light reflected downwards by the surface.
    """
    from meshtrace.surfaces import FlatSea, JonswapSea

    kill, receiver = Physics(reflected="kill"), Receiver(radius=0.25)
    plain = Link(receiver=receiver, physics=kill)
    bubbly = Link(receiver=receiver, physics=kill, bubbles=HallNovarini(wind_speed=13.0))
    sea = JonswapSea(wind_speed=13.0, seed=3, waves="paper")
    cases: dict[str, tuple[Link, SurfaceModel, Literal["vertex", "facet"]]] = {
        "flat": (plain, FlatSea(), "vertex"),
        "13 m/s": (plain, sea, "vertex"),
        "13 m/s, facets": (plain, sea, "facet"),
        "13 m/s, bubbles": (bubbly, sea, "vertex"),
    }
    for name, (link, surface, normals) in cases.items():
        f = simulate(link, surface, photons=10_000, seed=3, normals=normals)
        a = simulate(link, surface, estimator="analog", photons=photons, seed=4, normals=normals)
        label = f"gain, {name}, r = 0.25 m, analog"
        one = simulated(label, "forced estimator", float(f.gain), a)
        yield replace(one, stderr=hypot(one.stderr, float(f.gain_stderr)))
