"""Photons need few facets of a plane: their gain is that over a fine mesh, in less time."""

import pytest

import meshtrace as mt
from meshtrace.engine.setup import meshing
from meshtrace.surfaces import FlatSea, TiltedPlane


@pytest.mark.parametrize("sea", [FlatSea(), TiltedPlane(slope_x=0.03)], ids=["flat", "tilted"])
def test_few_facets_give_the_same_gain(sea):
    link = mt.Link(water=mt.Water(b=0.1), receiver=mt.Receiver(radius=2.0, fov_deg=120.0))
    mesh, _ = meshing.mesh_for(link, sea, few=True)
    assert len(mesh.faces) < 1000
    extent = float(mesh.bounds[1, 0])
    fine = sea.mesh(extent=extent, spacing=extent / 100.0)
    run = {"estimator": "analog", "photons": 20_000, "threads": 1}
    few, many = (mt.simulate(link, mesh, **run) for mesh in (mesh, fine))
    assert few.gain > 0.0
    assert few.gain == pytest.approx(many.gain, rel=1e-9)
    assert mt.simulate(link, sea, **run).gain == few.gain
