"""Families of models: kinds, import paths, entry points, and closed doors."""

import sys
from importlib.metadata import EntryPoint
from typing import Annotated, Literal

import pytest
from pydantic import BeforeValidator, SerializeAsAny

import meshtrace as mt
from meshtrace import models
from meshtrace.errors import Refused
from meshtrace.models import Family, Model, modules_of


class Lens(Family, default="ball"):
    pass


class Ball(Lens):
    kind: Literal["ball"] = "ball"
    radius: float = 1.0


class Plane(Lens):
    thickness: float = 0.1


class Tube(Model):
    lens: Annotated[SerializeAsAny[Lens], BeforeValidator(Lens.read)] = Ball()


def test_a_subclass_without_a_kind_is_named_by_its_import_path():
    assert set(Lens.registered) == {"ball", f"{__name__}:Plane"}
    assert Plane().kind == f"{__name__}:Plane"
    tube = Tube(lens=Plane(thickness=0.3))
    assert Tube.model_validate_json(tube.model_dump_json()) == tube
    assert Tube(lens=f"{__name__}:Plane").lens == Plane()


@pytest.mark.parametrize("value", ["ball", {"kind": "ball"}, {"model": "ball"}, {}, Ball()])
def test_plain_data_name_a_kind(value):
    assert Tube(lens=value).lens == Ball()


@pytest.mark.parametrize(
    ("value", "line"),
    [
        ("bal", r"^lens\.kind: 'bal', did you mean ball\? allowed: ball, .* or module:Lens$"),
        ({"model": "bal"}, r"^lens\.model: 'bal'"),
        ({"radius": "x"}, r"^lens\.radius: 'x', allowed: a number"),
        ("json:dumps", r"^lens\.kind: 'json:dumps'"),
        ("no_such_module:Lens", r"^lens\.kind: .*would run the module no_such_module: a link file"),
        (3, r"^lens: 3, allowed: a table, or one of ball"),
        ({"kind": ["ball"]}, r"^lens\.kind: \['ball'\]"),
    ],
)
def test_unknown_kinds_are_refused(value, line):
    with pytest.raises(Refused, match=line):
        Tube(lens=value)


def test_a_module_in_the_working_directory_is_found_with_trust_alone(tmp_path, monkeypatch):
    file = tmp_path / "mine_only_here.py"
    file.write_text(f"from {__name__} import Lens\nclass Rod(Lens):\n    length: float = 2.0\n")
    monkeypatch.chdir(tmp_path)
    path = list(sys.path)
    try:
        with pytest.raises(Refused, match=rf"would run {file}: a link file may, with --trust"):
            Tube(lens={"kind": "mine_only_here:Rod", "length": 3.0})
        assert "mine_only_here" not in sys.modules
        with models.trusting():
            rod = Tube(lens={"kind": "mine_only_here:Rod", "length": 3.0}).lens
        assert Tube(lens={"kind": "mine_only_here:Rod", "length": 3.0}).lens == rod
        assert modules_of("kind = 'mine_only_here:Rod'") == ["mine_only_here"]
        assert modules_of("kind = 'petzold'") == []
        assert (rod.kind, rod.length) == ("mine_only_here:Rod", 3.0)
    finally:
        Lens.registered.pop("mine_only_here:Rod", None)
        sys.modules.pop("mine_only_here", None)
    assert sys.path == path


def test_a_failure_of_an_import_is_told():
    with models.trusting(), pytest.raises(Refused, match=r"^lens\.kind: .*No module named"):
        Tube(lens="no_such_module:Lens")


def test_an_entry_point_names_a_kind(monkeypatch):
    found = [EntryPoint("plate", f"{__name__}:Plane", models.GROUP)]
    monkeypatch.setattr("meshtrace.models.entry_points", lambda group: found)
    assert Tube(lens="plate").lens == Plane()


def test_a_kind_belongs_to_one_class():
    with pytest.raises(Refused, match=r"Other\.kind: 'ball', allowed: a kind other than Ball's"):
        type("Other", (Lens,), {"__annotations__": {"kind": Literal["ball"]}, "kind": "ball",
                                "__module__": __name__})  # fmt: skip
    assert Lens.registered["ball"] is Ball


@pytest.mark.parametrize("base", [mt.Led, mt.Receiver, mt.Analog])
def test_closed_families_say_why(base):
    with pytest.raises(Refused, match="closed: the "):
        type("Mine", (base,), {"__module__": __name__})
    with pytest.raises(Refused, match="closed: the kernels sample these alone"):
        mt.Link(transmitter={"kind": "my_module:Lamp"})
