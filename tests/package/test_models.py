"""Texts of descriptions: representation, notes of the fields, notebook tables, help."""

import pydoc
import warnings

import numpy as np
import pandas as pd
import pint
import pytest
import xarray as xr

import meshtrace as mt
from meshtrace import InputWarning, optics
from meshtrace.comms import Curve
from meshtrace.errors import Refused
from meshtrace.surfaces import FlatSea, JonswapSea, TabulatedSpectrum

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


def with_unit(values, unit):
    return xr.DataArray(values, attrs={"units": unit})


def series(values, unit):
    column = pd.Series(values)
    column.attrs["units"] = unit
    return column


_PINT = pint.UnitRegistry()
CONVERTED = {
    "xarray": (mt.Led, {"depth": with_unit(1000.0, "mm")}, 1.0),
    "pint": (mt.Led, {"depth": _PINT.Quantity(1000.0, "mm")}, 1.0),
    "in a table": (mt.Link, {"water": {"b": 0.1, "a": with_unit(0.001, "cm-1")}}, None),
    "angle": (mt.Led, {"half_angle_deg": with_unit(np.pi / 18.0, "rad")}, 10.0),
    "unit in the name alone": (mt.WaterAperture, {"zenith_deg": with_unit(np.pi, "rad")}, 180.0),
    "pandas": (mt.Led, {"position": series([1000.0, 2000.0], "mm")}, (1.0, 2.0)),
    "in a list": (mt.Led, {"position": (_PINT.Quantity(1.0, "km"), 2.0)}, (1000.0, 2.0)),
    "fields of one text": (JonswapSea, {"wind_speed": 5.0, "hs": 1.0, "tp": with_unit(0.1, "min")},
                           6.0),
    "ratio": (mt.HenyeyGreenstein, {"g": with_unit(90.0, "%")}, 0.9),
    "spectrum of light": (Curve, {"value": (1.0, 2.0), "wavelength_nm": with_unit([0.4, 0.5], "um")},
                          (400.0, 500.0)),
    "phase table": (optics.TabulatedPhase, {"value": (3.0, 2.0, 1.0), "theta_deg": with_unit(
        [0.1 * np.pi, 0.5 * np.pi, np.pi], "rad")}, (18.0, 90.0, 180.0)),
    "spectrum of waves": (TabulatedSpectrum, {"omega": (1.0, 2.0, 3.0), "density": with_unit(
        [0.0, 2.0 * np.pi, 0.0], "m2/Hz")}, (0.0, 1.0, 0.0)),
    "chlorophyll": (optics.Constituents, {"chlorophyll": with_unit(1e-3, "g m-3")}, 1.0),
    "route": (mt.Route, {"times": (0.0, 1.0), "positions": with_unit([[0.0, 0.0], [1.0, 0.0]], "km")},
              ((0.0, 0.0), (1000.0, 0.0))),
}  # fmt: skip


@pytest.mark.parametrize("case", CONVERTED)
def test_units_of_values_are_converted(case):
    """Once 1000 mm were 1000 m."""
    model, fields, wanted = CONVERTED[case]
    with pytest.warns(InputWarning, match=r"^\S+ in .+ converted to .+$") as warned:
        made = model(**fields)
    assert len(warned) == 1
    value = made.water.a if wanted is None else getattr(made, list(fields)[-1])
    assert np.allclose(value, 0.1 if wanted is None else wanted, rtol=1e-12)


@pytest.mark.parametrize("value", [with_unit(2.0, "m"), with_unit(2.0, "metre"),
                                   xr.DataArray(2.0), _PINT.Quantity(2.0, "m")])  # fmt: skip
def test_values_in_the_unit_of_a_field_are_silent(value):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert mt.Led(depth=value).depth == 2.0


@pytest.mark.parametrize(
    ("model", "fields", "text"),
    [
        (mt.Led, {"depth": with_unit(2.0, "K")}, "depth: in K, allowed: a unit of length"),
        (mt.Led, {"depth": with_unit("x", "mm")}, "depth: 'x', allowed: numbers"),
        (mt.HenyeyGreenstein, {"g": with_unit(0.9, "m")}, "g: in m, allowed: a unit of a ratio"),
        (mt.Water, {"layers": with_unit([[0.0, 0.1, 0.1]], "m")},
         r"layers: an array in m, allowed: plain numbers \[m, m-1, m-1\]"),
        (optics.SpectralTable, {"table": with_unit([[400.0, 0.1, 0.1]], "nm")},
         "table: an array in nm, allowed: plain numbers"),
        (mt.Led, {"dept": with_unit(2.0, "mm")}, "did you mean depth"),
    ],
)  # fmt: skip
def test_units_of_another_kind_are_refused(model, fields, text):
    with pytest.raises(Refused, match=text):
        model(**fields)


def test_lists_without_end_are_refused():
    nested = []
    nested.append(nested)
    with pytest.raises(Refused, match="Led: lists nested too deeply, allowed: few levels"):
        mt.Led(depth=nested)
