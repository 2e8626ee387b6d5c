"""Texts of descriptions: representation, notes of the fields, notebook tables, help."""

import pydoc

import pytest

import meshtrace as mt
from meshtrace.surfaces import FlatSea, JonswapSea

MODELS = [mt.Link(), mt.Led(depth=3.0), mt.Water(), JonswapSea(wind_speed=7.0), FlatSea(), mt.Uav(),
          mt.Link().in_wind(5.0), mt.Forced(), mt.Meshing(spacing=0.5)]  # fmt: skip


@pytest.mark.parametrize("model", MODELS, ids=repr)
def test_representations_load_back_and_name_only_other_values(model):
    rooms = (mt, mt.optics, mt.physics, mt.surfaces, mt.uav, mt.options)
    names = {name: getattr(room, name) for room in rooms for name in dir(room) if name[0].isupper()}
    assert eval(repr(model), names) == model
    assert "\n" not in repr(model)
    if not isinstance(model, mt.Water):  # whose text is its a, b and source
        assert str(model) == repr(model)


def test_representations_are_short():
    assert repr(mt.Link()) == "Link()"
    assert repr(mt.Link().at_depth(3.0)) == "Link(transmitter=Led(depth=3.0))"


@pytest.mark.parametrize("model", MODELS, ids=lambda m: type(m).__name__)
def test_every_field_has_a_note(model):
    cls = type(model)
    assert set(cls.model_fields) - {"kind"} <= set(cls.notes())
    table = model._repr_html_()
    for note in cls.notes().values():
        assert note.replace('"', "&quot;").replace("'", "&#x27;").replace("<", "&lt;").replace(
            ">", "&gt;"
        ) in table.replace("&amp;", "&")


def test_help_shows_the_model_and_not_pydantic():
    for model in MODELS:
        text = pydoc.plain(pydoc.render_doc(type(model)))
        assert "model_" not in text.replace("model_copy", "")
        assert "pydantic" not in text.replace("pydantic.main.BaseModel", "")
        assert text.count("\n") < 350
