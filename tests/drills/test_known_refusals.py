"""Inputs that once ended in a traceback: each is one line of field, value, allowed."""

import math

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.errors import Refused
from meshtrace.surfaces import FlatSea

CORNERS = [(-9.0, -9.0, 0.0), (9.0, -9.0, 0.0), (9.0, 9.0, 0.0)]
LINK, SEA = mt.Link(), FlatSea()

CALLS = {
    "link": lambda: mt.simulate(1, SEA),
    "photons": lambda: mt.simulate(LINK, SEA, photons=2**31),
    "spacing": lambda: mt.simulate(LINK, SEA, spacing=10**400),
    "estimator": lambda: mt.simulate(LINK, SEA, np.array([])),
    "threads": lambda: mt.time_series(LINK, SEA, [0.0], threads=math.nan),
    "times": lambda: mt.time_series(LINK, SEA, "x"),
    "bit_rate": lambda: mt.link_performance(LINK, SEA, bit_rate=np.array("x")),
    "realizations": lambda: mt.link_performance(LINK, SEA, realizations=""),
    "flight.uav": lambda: mt.link_performance(LINK, SEA, uav="x", realizations=2),
    "n": lambda: mt.trace_paths(LINK, SEA, n=np.array("x")),
    "mesh.faces": lambda: mt.TriangleMesh(CORNERS, [[0, 1, 2**63]]),
    "mesh.vertices": lambda: mt.TriangleMesh({}, [[0, 1, 2]]),
}


@pytest.mark.parametrize("field", CALLS)
def test_refused_in_one_line(field):
    with pytest.raises(Refused) as caught:
        CALLS[field]()
    assert caught.value.field == field
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 500
