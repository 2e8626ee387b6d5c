"""Whatever a link file says: it is a scenario that loads back, or an error of one line."""

import tomllib

import tomli_w
from drills.hostile_parts import places
from hypothesis import given, settings
from hypothesis import strategies as st

import meshtrace as mt
from meshtrace import options
from meshtrace.errors import Refused
from meshtrace.link import Aperture, Physics, Source
from meshtrace.optics import HallNovarini, PhaseFunction, Water
from meshtrace.optics.spectra import WATER_TYPES
from meshtrace.scenario import KEYS, Scenario
from meshtrace.surfaces import Spectrum, Spreading, Surface

WORDS = [
    "paper",
    "physical",
    "none",
    "vertex",
    "facet",
    "mie",
    "local",
    "scaled",
    "w_0225",
    "sinusoid",
    *WATER_TYPES,
    *(
        kind
        for union in (Source, Aperture, PhaseFunction, Surface, Spectrum, Spreading)
        for kind in union.registered
    ),
]
SEAS, PHASES, SOURCES, APERTURES = (
    sorted({key for model in union.registered.values() for key in model.model_fields})
    for union in (Surface, PhaseFunction, Source, Aperture)
)


def examples(count):
    """Return settings for a number of examples, a tenth of it outside CI."""
    return settings(max_examples=count * settings.default.max_examples // 100)


numbers = st.one_of(
    st.sampled_from([0, 1, 2, 5.0, 13.0, 60.0, 1e-3, 0.5, 90.0, 180.0, 4096, 1.0e6]),
    st.integers(-(2**63), 2**63 - 1),
    st.floats(),
)
leaves = st.one_of(numbers, numbers, st.sampled_from(WORDS), st.text(max_size=8), st.booleans())
values = st.recursive(
    leaves,
    lambda inner: st.one_of(
        st.lists(inner, max_size=3),
        st.dictionaries(st.sampled_from(["kind", "model", *PHASES, "s"]), inner, max_size=3),
        st.dictionaries(st.text(max_size=5), inner, max_size=2),
    ),
    max_leaves=6,
)
plausible = st.one_of(
    st.floats(1e-3, 100.0), st.integers(1, 100), st.sampled_from(WORDS), st.floats(0.0, 1.0)
)


def table(keys, inner=values):
    """Return tables with some of the keys, mostly with values that might do."""
    return st.dictionaries(st.sampled_from(keys), st.one_of(plausible, inner), max_size=4)


def one_or_more(tables):
    return st.one_of(tables, tables, st.lists(tables, max_size=2))


documents = st.fixed_dictionaries(
    {},
    optional={
        "wind_speed": st.one_of(st.floats(0.0, 30.0), values),
        "physics": st.one_of(
            st.sampled_from(["physical", "paper"]), table([*Physics.model_fields])
        ),
        "whitecaps": st.one_of(st.sampled_from(WORDS), values),
        "n_air": st.one_of(st.just(1.0), values),
        "sea": table(["spectrum", "mesh", *mt.Meshing.model_fields, *SEAS]),
        "water": table(["type", *Water.model_fields], st.one_of(values, table(["model", *PHASES]))),
        "bubbles": table(["model", *HallNovarini.model_fields]),
        "transmitter": one_or_more(table(SOURCES)),
        "receiver": one_or_more(table(APERTURES)),
        "planes": table(["depths", "n_cosines", "n_azimuths"]),
        "run": table(options.run_keys()),
    },
)


def check_text(text):
    """Check that a text is a scenario that loads back, or an error of one line."""
    try:
        scenario = Scenario.from_toml(text, source="link.toml")
    except Refused as error:
        message = str(error)
    else:
        assert Scenario.from_toml(scenario.to_toml()) == scenario
        return
    assert message.splitlines() == [message]
    assert message.startswith("link.toml: ")
    assert "allowed: " in message
    assert len(message) < 1000


def check(config):
    text = tomli_w.dumps(config)
    assert set(tomllib.loads(text)) == set(config)
    check_text(text)


SOUND = [
    "",
    "wind_speed = 13.0\nphysics = 'paper'\n[sea]\nomega_max = 6.0\nspacing = 0.2",
    "whitecaps = { wind_speed = 3.0 }\nphysics = { snell = 'paper' }\n[sea]\nspectrum = 'tma'\n"
    "depth = 9.0\nspreading = 'cos2s'\n[[receiver]]\n[[receiver]]\nkind = 'water-aperture'",
    "[sea]\nspectrum = 'measured'\nomega = [1.0]\ntheta = [0.0]\nvariance = [[0.1]]\n"
    "[[transmitter]]\nkind = 'sun'\n[planes]\ndepths = [1.0, 2.0]\n[run]\n"
    "estimator = 'analog'\nrtol = 0.1",
    "[sea]\nspectrum = 'sinusoid'\namplitude = 0.1\nwavelength = 2.0\n[water]\n"
    "layers = [[0.0, 0.1, 0.2], [9.0, 0.2, 0.1]]\n[water.phase]\nmodel = 'mixture'\n"
    "components = ['petzold', 'rayleigh']\nweights = [1.0, 2.0]",
]


@st.composite
def damaged(draw):
    """Return a sound configuration with one or two values replaced."""
    config = Scenario.from_toml(draw(st.sampled_from(SOUND))).to_config()
    for value in draw(st.lists(st.one_of(plausible, numbers, values), min_size=1, max_size=2)):
        *parents, last = draw(st.sampled_from(list(places(config))))
        table = config
        for key in parents:
            table = table[key]
        table[last] = value
    return config


@examples(300)
@given(damaged())
def test_damaged_files(config):
    check(config)


@examples(100)
@given(documents)
def test_plausible_files(config):
    check(config)


@examples(100)
@given(st.dictionaries(st.one_of(st.sampled_from(KEYS), st.text(max_size=5)), values, max_size=4))
def test_files_of_noise(config):
    check(config)


@examples(100)
@given(st.text(max_size=40))
def test_texts(text):
    check_text(text)
