"""Spoilt study files: each is a study that could be run, or an error of one line.

Only the reading is under test: no cluster is started and nothing is computed.
"""

import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st
from test_link_files import damaged, examples, numbers, plausible, values

pytest.importorskip("distributed")

from meshtrace.errors import Refused
from meshtrace.studies import sweeps as batch

KEYS = [
    "wind_speed",
    "transmitter.depth",
    "transmitter.half_angle_deg",
    "receiver.radius",
    "receiver.fov_deg",
    "water.b",
    "sea.omega_max",
    "sea.spectrum",
    "bubbles.model",
    "run.normals",
    "water.phase",
    "receiver",
    "transmitter.depth.deeper",
    "no.such.key",
]
points = st.lists(st.one_of(plausible, numbers, values), min_size=1, max_size=3)
parameters = st.dictionaries(
    st.one_of(st.sampled_from(KEYS), st.text(max_size=6)),
    st.one_of(points, points, values),
    max_size=3,
)
tables = st.one_of(
    st.fixed_dictionaries(
        {},
        optional={
            "parameters": st.one_of(parameters, parameters, values),
            "realizations": st.one_of(st.integers(1, 16), values),
            "rtol": st.one_of(st.floats(1e-3, 1.0), values),
            "photons": st.one_of(st.integers(1, 10_000), values),
            "seed": st.one_of(st.integers(0, 100), values),
            "workers": values,
        },
    ),
    values,
)
links = st.one_of(st.just({}), st.just({"wind_speed": 13.0}), damaged())


@pytest.fixture(scope="module")
def study_file(tmp_path_factory):
    return tmp_path_factory.mktemp("studies") / "study.toml"


@pytest.fixture(scope="module", autouse=True)
def nothing_computed():
    """Read and check the study, make its arrays in memory, and stop there."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(batch.Cluster, "map", lambda *arguments: (found for found in ()))
        yield


def read(path, text):
    """Return the dataset of a study of which nothing is computed, None where it is refused."""
    path.write_text(text, encoding="utf-8")
    try:
        return batch.read_study(path)[0].run(None)
    except Refused as error:
        assert str(error).splitlines() == [str(error)]
        assert "allowed: " in str(error)
        return None


@examples(400)
@given(links, tables)
def test_spoilt_studies(study_file, link, table):
    read(study_file, tomli_w.dumps({**link, "sweep": table}))


@examples(100)
@given(st.text(max_size=60))
def test_texts(study_file, text):
    read(study_file, text)


def test_a_sound_study_is_read(study_file):
    data = read(
        study_file,
        "[sweep]\nrealizations = 3\n[sweep.parameters]\nwind_speed = [5.0, 13.0]\n"
        "transmitter.depth = [5.0, 10.0, 20.0]\n",
    )
    assert dict(data.gain.sizes) == {"wind_speed": 2, "transmitter.depth": 3, "realization": 3}
