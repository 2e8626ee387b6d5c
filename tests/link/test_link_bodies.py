"""Bodies of a link: meshes, places, albedos, and the files that describe them."""

import numpy as np
import pytest
import trimesh

import meshtrace as mt
from meshtrace.errors import Refused
from meshtrace.link import Body, Link
from meshtrace.scenario import Scenario

CORNERS = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)]


@pytest.fixture
def plate():
    return mt.TriangleMesh(CORNERS, [(0, 1, 2)])


@pytest.fixture
def reef(tmp_path):
    path = tmp_path / "reef.obj"
    trimesh.creation.icosphere(subdivisions=1).export(path)
    return path


def test_place_of_a_body(plate):
    body = Body(plate, scale=2.0, position=(1.0, 2.0, -3.0), rotation_deg=(90.0, 0.0, 90.0))
    # about x the y axis turns to z; about z the x axis turns to y
    expected = [(1.0, 2.0, -3.0), (1.0, 4.0, -3.0), (1.0, 2.0, -1.0)]
    np.testing.assert_allclose(body.triangles()[0], expected, atol=1e-12)


@pytest.mark.parametrize("end", ["ply", "stl", "obj", "off", "glb"])
def test_files_of_meshes(tmp_path, end):
    path = tmp_path / f"ball.{end}"
    trimesh.creation.icosphere(subdivisions=1).export(path)
    assert Body(path).n_facets == 80
    assert Body(str(path)) == Body(mesh=path)


def test_facets_without_area_are_left_out(tmp_path):
    path = tmp_path / "flat.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 2 0 0\nf 1 2 3\nf 1 2 4\n")
    assert Body(path).n_facets == 1


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (None, "No such file"),
        ("", "empty|has no|geometry|mesh"),
        ("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "no facets with an area"),
        ("v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not finite"),
        ("v 0 0 0\nv 1 0 0\n", "."),
    ],
)
def test_meshes_are_refused(tmp_path, text, reason):
    path = tmp_path / "bad.obj"
    if text is not None:
        path.write_text(text)
    with pytest.raises(Refused, match=reason) as error:
        Body(path)
    assert error.value.field == "mesh"
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("fields", "field"),
    [
        ({"albedo": 1.2}, "albedo"),
        ({"albedo": [(400.0, 0.1)]}, "albedo"),
        ({"albedo": [(500.0, 0.1), (400.0, 0.2)]}, "albedo"),
        ({"albedo": "no.csv"}, "albedo"),
        ({"scale": 0.0}, "scale"),
        ({"reflection": "glossy"}, "reflection"),
        ({"position": (0.0, 0.0, 1e9)}, "mesh"),
        ({"sha256": "0f"}, "mesh"),
    ],
)
def test_values_are_refused(plate, fields, field):
    with pytest.raises(Refused) as error:
        Body(plate, **fields)
    assert error.value.field.startswith(field)


@pytest.mark.parametrize("mesh", [None, 3, {"sha256": "0", "facets": 1}])
def test_what_is_no_mesh_is_refused(mesh):
    with pytest.raises(Refused, match="mesh"):
        Body(mesh)


def test_albedo_by_wavelength(plate, tmp_path):
    path = tmp_path / "coral.csv"
    path.write_text("wavelength [nm],albedo\n400,0.1\n500,0.3\n")
    for table in (path, {"file": str(path)}, np.array([(400.0, 0.1), (500.0, 0.3)])):
        assert Body(plate, albedo=table).albedo_at(470.0) == pytest.approx(0.24)
    body = Body(plate, albedo=path)
    assert body.replace(reflection="black").albedo_at(470.0) == 0.0
    link = Link(objects=body)
    with pytest.raises(Refused, match=r"objects\[0\].albedo"):
        link.replace("transmitter.wavelength_nm", 550.0)
    blue, green = mt.Led(wavelength_nm=450.0), mt.Led(wavelength_nm=490.0)
    with pytest.raises(Refused, match="several wavelengths"):
        link.replace(transmitter=(blue, green))


def test_bottom_as_a_mesh(reef):
    link = Link(water=mt.Water(bottom=reef, bottom_albedo=0.4))
    assert link.bodies == (Body(reef, albedo=0.4),)
    with pytest.raises(Refused, match=r"water\.bottom"):
        Link(water=mt.Water(bottom="no.obj"))


def test_link_files(reef, tmp_path):
    (tmp_path / "coral.csv").write_text("400,0.1\n500,0.3\n")
    text = """
        [water]
        bottom = "reef.obj"
        bottom_albedo = 0.3
        [[objects]]
        mesh = "reef.obj"
        albedo = "coral.csv"
        position = [1.0, 2.0, -4.0]
        [[objects]]
        mesh = "reef.obj"
        reflection = "mirror"
        scale = 0.5
    """
    (tmp_path / "link.toml").write_text(text)
    scenario = Scenario.load(tmp_path / "link.toml")
    assert len(scenario.link.bodies) == 3
    # the mirror rises out of the water
    assert scenario.run.estimator.kind == "analog"
    deep = text.replace('bottom = "reef.obj"', "").replace("scale = 0.5", "position = [0, 0, -9]")
    (tmp_path / "deep.toml").write_text(deep)
    assert Scenario.load(tmp_path / "deep.toml").run.estimator.kind == "forced"
    assert Scenario.from_toml(scenario.to_toml()) == scenario
    assert Link.model_validate(scenario.link.model_dump(mode="json")) == scenario.link


def test_results_tell_a_mesh_that_has_changed(reef):
    plain = Link(objects=(Body(reef),)).model_dump(mode="json")
    assert len(plain["objects"][0]["sha256"]) == 64
    trimesh.creation.box().export(reef)
    with pytest.raises(Refused, match="SHA-256"):
        Link.model_validate(plain)


def test_a_mesh_without_a_file_is_in_no_link_file(plate):
    scenario = Scenario.from_toml("").replace(link=Link(objects=Body(plate)))
    with pytest.raises(Refused, match="objects"):
        scenario.to_toml()
