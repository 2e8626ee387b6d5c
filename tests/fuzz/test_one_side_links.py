"""All public functions with a link whose ends lie on one side: an answer, or `Refused` in one line.

Sound arguments are those of `test_every_name`, with another link; light is traced.
"""

import warnings

import pytest
from public_names import callables
from sound_calls import FEW, OTHER
from test_every_name import bound, names, parameters, sound

import meshtrace as mt
from meshtrace.errors import Refused
from meshtrace.scenario import Scenario
from meshtrace.surfaces import FlatSea

WATER = mt.Water(a=0.114, b=0.037)
LINKS = {
    "under": mt.Link(
        water=WATER,
        transmitter=mt.Led(depth=5.0, zenith_deg=60.0),
        receiver=mt.WaterReceiver(
            depth=3.0, position=(9.0, 0.0), tilt_deg=60.0, tilt_azimuth_deg=180.0, radius=0.2
        ),
    ),
    "over": mt.Link(
        water=WATER,
        transmitter=mt.AirLed(height=5.0, tilt_deg=40.0),
        receiver=mt.Receiver(
            height=4.0, position=(8.0, 0.0), tilt_deg=60.0, tilt_azimuth_deg=180.0, radius=0.2
        ),
    ),
}
ELSEWHERE = ("viz.", "apps.plot", "explore", "engine.")  # pictures: tests/viz; a server; internals
LONG = ("irradiance_series", "design", "channel_trace", "sweep", "studies.sweep_file")
KEYS = {"link", "up", "links", "scenario", "base"}


def takes_a_link(name):
    """Return whether a function has a link among its arguments, or is a method of one."""
    _, cls = callables()[name]
    if cls is mt.Link:
        return True
    function = {p.name for p in parameters(name)}
    return bool(function & KEYS) and not name.startswith(("comms.", *ELSEWHERE))


def with_link(name, link):
    """Return the sound arguments of a function with a link in place of the usual one."""
    arguments = dict(sound(name))
    for key, value in arguments.items():
        if isinstance(value, mt.Link) and key != "down":
            arguments[key] = link
        elif isinstance(value, Scenario):
            arguments[key] = value.model_copy(update={"link": link})
        elif key == "links" and isinstance(value, dict):
            arguments[key] = {"a": link, "b": link.replace("receiver.radius", 0.25)}
        elif key == "surface" and value is not None and key not in OTHER.get(name, {}):
            arguments[key] = FlatSea()
    return arguments | {key: FEW[key] for key in FEW.keys() & arguments.keys()}


NAMES = [n for n in names() if takes_a_link(n)]


# studies walk the same code on either side
DEAR = (*LONG, "background_series", "compare", "depth_sweep", "ensemble", "link_performance",
        "time_series")  # fmt: skip


def cost(name, side):
    """Return the marks of a case: of dear studies one side is slow."""
    if name in DEAR and side == "over":
        return [pytest.mark.slow]
    return [pytest.mark.thorough] * (name in LONG)


@pytest.mark.parametrize(
    ("name", "side"),
    [pytest.param(n, side, marks=cost(n, side)) for n in NAMES for side in LINKS],
)
def test_an_answer_or_a_refusal(name, side, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    link, (_, cls) = LINKS[side], callables()[name]
    function = getattr(link, name.rpartition(".")[2]) if cls is mt.Link else bound(name)
    arguments = with_link(name, link)
    defaults = {p.name: p for p in parameters(name)}
    first = [arguments.pop(k) for k, p in defaults.items() if p.kind is p.POSITIONAL_ONLY]
    named = {k: v for k, v in arguments.items() if v is not defaults[k].default}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            answer = function(*first, **named)
        except Refused as error:
            assert str(error).splitlines() == [str(error)]
            assert "allowed: " in str(error)
        else:
            assert "nan m" not in repr(answer)


def test_there_are_names():
    assert len(NAMES) > 30
