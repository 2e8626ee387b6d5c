"""The base of models: one error, however a model is made, and validated changes."""

import pickle
from typing import Literal

import numpy as np
import pytest
from pydantic import Field, model_validator

import meshtrace as mt
from meshtrace.errors import Described, Refused
from meshtrace.models import Model


class Disk(Model):
    radius: float = Field(1.0, gt=0.0, allow_inf_nan=False)
    angle: float = Field(60.0, gt=0.0, le=180.0)
    form: Literal["round", "square"] = "round"
    place: tuple[float, float] = (0.0, 0.0)
    count: int = Field(1, ge=1)
    shown: bool = True

    @model_validator(mode="after")
    def _small_squares(self):
        if self.form == "square" and self.radius > 5.0:
            raise Refused("radius", self.radius, "<= 5 for squares")
        return self


class Stand(Model):
    disk: Disk = Disk()
    spares: tuple[Disk, ...] = ()
    name: str


WRONG = [
    ({"radius": -1}, "radius: -1, allowed: > 0"),
    ({"radius": np.float64(-1.5)}, "radius: -1.5, allowed: > 0"),
    ({"angle": 181}, "angle: 181, allowed: 0 < angle <= 180"),
    ({"radius": float("nan")}, "radius: nan, allowed: finite numbers"),
    ({"radius": 1e31}, "radius: 1e+31, allowed: at most 1e+30 in magnitude"),
    ({"radius": "3"}, "radius: '3', allowed: numbers without quotes"),
    ({"radius": True}, "radius: true, allowed: neither true nor false"),
    ({"radius": [1]}, "radius: [1], allowed: a number"),
    ({"count": 1.5}, "count: 1.5, allowed: an integer"),
    ({"count": 10**5000}, "count: a huge integer, allowed: integers of 64 bits"),
    ({"form": "rond"}, "form: 'rond', did you mean round? allowed: round or square"),
    ({"place": (1.0, "x")}, "place[1]: 'x', allowed: a number"),
    ({"place": 3}, "place: 3, allowed: a list"),
    ({"shown": 7}, "shown: 7, allowed: true or false"),
    ({"raduis": 3}, "raduis: 3, no such key, did you mean radius? allowed: radius, angle, "),
    ({"form": "square", "radius": 9.0}, "radius: 9.0, allowed: <= 5 for squares"),
]


@pytest.mark.parametrize(("values", "line"), WRONG)
def test_every_way_of_making_a_model_has_one_error(values, line):
    makers = [
        lambda: Disk(**values),
        lambda: Disk.model_validate(values),
        lambda: Disk().replace(**values),
        lambda: Disk().model_copy(update=values),
    ]
    for make in makers:
        with pytest.raises(Refused) as caught:
            make()
        assert str(caught.value).startswith(line)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("values", "line"), WRONG)
def test_errors_inside_other_models_name_the_whole_path(values, line):
    with pytest.raises(Refused) as caught:
        Stand(name="a", disk=values)
    assert str(caught.value).startswith(f"disk.{line}")
    with pytest.raises(Refused) as caught:
        Stand(name="a", spares=({}, values))
    assert str(caught.value).startswith(f"spares[1].{line}")


def test_missing_values_and_wrong_tables():
    with pytest.raises(Refused, match=r"^name: missing, allowed: a value$"):
        Stand()
    with pytest.raises(Refused, match=r"^disk: 3, allowed: a table$"):
        Stand(name="a", disk=3)
    with pytest.raises(Refused, match=r"^disk\.radius: -1"):
        Stand.model_validate_json('{"name": "a", "disk": {"radius": -1}}')


def test_replace_follows_paths_and_keeps_the_rest():
    stand = Stand(name="a", spares=(Disk(), Disk(radius=3.0)))
    changed = stand.replace("spares.1.radius", 4.0).replace("disk.count", 2)
    assert (changed.spares[1].radius, changed.disk.count) == (4.0, 2)
    assert stand == Stand(name="a", spares=(Disk(), Disk(radius=3.0)))
    assert changed.replace(disk=Disk(), name="b").name == "b"
    assert stand.replace().model_fields_set == stand.model_fields_set


@pytest.mark.parametrize(
    ("path", "line"),
    [
        ("disk.raduis", "disk.raduis: 1.0, no such key, did you mean radius?"),
        ("dsk.radius", "dsk: 1.0, no such key, did you mean disk?"),
        ("spares.2.radius", "spares.2: 1.0, allowed: fields of a part"),
        ("name.length", "name.length: 1.0, allowed: fields of a part"),
    ],
)
def test_replace_refuses_paths_that_lead_nowhere(path, line):
    with pytest.raises(Refused) as caught:
        Stand(name="a", spares=(Disk(), Disk())).replace(path, 1.0)
    assert str(caught.value).startswith(line)


def test_copies_of_links_are_validated():
    link = mt.Link()
    assert link.replace("receiver.height", 10.0).receiver.height == 10.0
    with pytest.raises(Refused, match=r"^receiver\.fov_deg: 400"):
        link.replace("receiver.fov_deg", 400)
    with pytest.raises(Refused, match=r"^hieght: 3, no such key, did you mean height"):
        link.receiver.model_copy(update={"hieght": 3})


def test_refusals_survive_pickles_with_all_their_parts():
    refused = Refused("depth", Described("none"), "a depth", "did you mean 3?").of("a.toml")
    again = pickle.loads(pickle.dumps(refused.inside("transmitter", 1)))
    assert str(again) == "a.toml: transmitter[1].depth: none, did you mean 3? allowed: a depth"
    assert (again.field, again.value) == ("transmitter[1].depth", "none")
