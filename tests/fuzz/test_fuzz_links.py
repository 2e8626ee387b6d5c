"""Spoilt link files by the thousand (in CI): each is a scenario that runs to finite numbers, or one line.

What a link file may say, and how it is spoilt value by value, is in `test_link_files`; here there
are many more of them, files spoilt letter by letter, changes of the command line, and short runs.
"""

import faulthandler
import math
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_link_files import (
    SOUND,
    WORDS,
    check,
    check_text,
    damaged,
    documents,
    examples,
    numbers,
    places,
    plausible,
    values,
)

import meshtrace.scenario.seas
from meshtrace.errors import Refused
from meshtrace.optics import HallNovarini
from meshtrace.scenario import Scenario, parse_setting

EXAMPLE = Path(__file__).parents[2] / "examples" / "default_link.toml"
TEXTS = [EXAMPLE.read_text(), *SOUND, *(Scenario.from_toml(text).to_toml() for text in SOUND)]
KEYS = sorted(
    {
        ".".join(str(key) for key in path)
        for text in SOUND
        for path in places(Scenario.from_toml(text).to_config())
    }
)
SNIPPETS = ["nan", "inf", "-", "=", "[", "]]", '"', "'", "{", "\n", "\x00", "é", "1e999", "#", "..",
            "true", "0x", "1979-05-27", "0_", "\\u"]  # fmt: skip


@pytest.fixture(autouse=True)
def no_hang():
    """End the session with a traceback where a test takes far longer than any machine needs."""
    faulthandler.dump_traceback_later(1800, exit=True)
    yield
    faulthandler.cancel_dump_traceback_later()


@st.composite
def misspelt(draw):
    """Return the text of a sound file with some letters lost, doubled or replaced."""
    text = draw(st.sampled_from(TEXTS))
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(text)))
        end = min(len(text), start + draw(st.sampled_from([0, 1, 2, 5, 40])))
        patch = draw(
            st.one_of(st.sampled_from(SNIPPETS), st.just(""), st.just(text[start:end] * 2))
        )
        text = text[:start] + patch + text[end:]
    return text


@examples(1000)
@given(damaged())
@pytest.mark.thorough
def test_spoilt_values(config):
    check(config)


@examples(500)
@given(misspelt())
def test_spoilt_letters(text):
    check_text(text)


@examples(250)
@given(documents)
def test_documents(config):
    check(config)


@examples(250)
@given(
    st.one_of(st.sampled_from(KEYS), st.sampled_from(KEYS), st.text(max_size=12)),
    st.one_of(numbers, st.sampled_from(WORDS), st.text(max_size=12), values),
)
def test_changes_of_the_command_line(key, value):
    """`--set key=value` is a scenario or one line, whatever the key and the value."""
    try:
        scenario = Scenario.from_toml("", changes=dict([parse_setting(f"{key}={value}")]))
    except Refused as error:
        assert str(error).splitlines() == [str(error)]
        assert "allowed: " in str(error)
    else:
        assert Scenario.from_toml(scenario.to_toml()) == scenario


def coarse(text):
    """Return the configuration of a file, on a coarse mesh."""
    config = Scenario.from_toml(text).to_config()
    config["sea"]["spacing"] = 0.5
    return config


def shortened(scenario):
    """Return a scenario that is over soon: few photons, and no Mie table of its own."""
    analog = scenario.run.estimator.kind == "analog"
    changes = {"max_events": 1000} if analog else {}
    run = scenario.run.replace(photons=64 if analog else 32, rtol=None, threads=1, **changes)
    bubbles = scenario.link.bubbles
    if bubbles is not None and _mie_key(bubbles) != _mie_key(HallNovarini(wind_speed=5.0)):
        bubbles = None  # a Mie table takes minutes, as it may
    link = scenario.link.model_copy(update={"bubbles": bubbles})
    return scenario.model_copy(update={"link": link, "run": run})


def _mie_key(bubbles):
    return bubbles.n_water, bubbles.wavelength_nm, bubbles.r_min, bubbles.r_max


def outcome(config):
    """Return the result of a short run, or None where the file or the run is refused."""
    try:
        scenario = Scenario.from_config(config)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return shortened(scenario).simulate()
    except Refused as error:
        assert str(error).splitlines() == [str(error)]
        assert "allowed: " in str(error)
        return None


@pytest.fixture(scope="module")
def compiled():
    """Compile the kernels, which would count as a hang."""
    for text in SOUND:
        outcome(coarse(text))


@pytest.fixture
def small_meshes(monkeypatch, compiled):
    """Refuse meshes that are right but take long."""
    monkeypatch.setattr(meshtrace.surfaces.surface, "MOST_VERTICES", 40_000)


@st.composite
def retouched(draw):
    """Return a sound configuration on a coarse mesh, with one or two numbers replaced."""
    config = coarse(draw(st.sampled_from(SOUND)))
    for _ in range(draw(st.integers(1, 2))):
        paths = [path for path in places(config) if isinstance(_at(config, path), float)]
        path = draw(st.sampled_from(paths))
        old = _at(config, path)
        new = draw(
            st.one_of(plausible, numbers, st.floats(0.0, 4.0).map(lambda f, old=old: f * old))
        )
        _at(config, path[:-1])[path[-1]] = new
    return config


def _at(config, path):
    for key in path:
        config = config[key]
    return config


@settings(
    examples(50),
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
@given(retouched())
def test_short_runs_give_finite_gains(small_meshes, config):
    result = outcome(config)
    if result is None:
        return
    assert np.isfinite(result.gain).all()
    assert np.isfinite(result.gain_stderr).all()
    assert (np.asarray(result.gain) >= 0.0).all()
    if result.fates:
        assert math.isclose(sum(f.weight for f in result.fates.values()), 1.0, abs_tol=1e-9)


@pytest.mark.parametrize(
    "changes",
    [
        {"receiver.height": 4e77},
        {"receiver.radius": 1e-300, "sea": {"spectrum": "sinusoid", "wavelength": 2.0}},
        {"transmitter.half_angle_deg": 1e-12},
        {"sea.\x1e": 0},
        {"\x1b[2J.depth": 1.0},
    ],
    ids=str,
)
def test_found_before(compiled, changes):
    """What gave a gain of nan, a traceback or more than one line."""
    with pytest.raises(Refused) as refused:
        shortened(Scenario.from_toml("", changes=changes)).simulate()
    assert str(refused.value).splitlines() == [str(refused.value)]
    assert str(refused.value).isprintable()
    assert "allowed: " in str(refused.value)


@pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning")
def test_nearly_clear_water_runs(compiled):
    result = shortened(Scenario.from_toml("", changes={"water.a": 1e-300})).simulate()
    assert result.gain > 0.0


@pytest.mark.parametrize("text", SOUND)
def test_sound_files_run(text):
    """The files that are spoilt above do run, so that the runs above are not all refusals."""
    result = outcome(coarse(text))
    assert result is not None
    assert np.isfinite(result.gain).all()
