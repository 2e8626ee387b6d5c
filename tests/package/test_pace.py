"""Long works announce their expected time."""

import numpy as np
import pytest

from meshtrace import parallel
from meshtrace.errors import Refused
from meshtrace.surfaces import Elfouhaily, FlatSea, SpectralSea

pytestmark = pytest.mark.filterwarnings("error::meshtrace.parallel.LongWork")


@pytest.fixture
def work(monkeypatch):
    """Return a function that yields results after some seconds each, without waiting."""
    now = [0.0]
    monkeypatch.setattr(parallel, "monotonic", lambda: now[0])

    def results(*seconds):
        for each in seconds:
            now[0] += each
            yield each

    return results


def test_the_first_result_may_wait_for_compilation(work):
    assert list(parallel.paced(work(60.0, 1.0, 1.0), 100, "100 seas")) == [60.0, 1.0, 1.0]


def test_a_work_of_hours_is_announced_once_by_its_rate(work):
    with pytest.warns(parallel.LongWork) as caught:
        list(parallel.paced(work(60.0, *[0.5] * 50), 1e4, "10,000 frames"))
    assert [str(one.message) for one in caught] == ["10,000 frames: about 1.4 h"]


def test_results_of_minutes_are_announced_after_the_first(work):
    points = parallel.paced(work(300.0, 300.0), 10, "10 points")
    next(points)
    with pytest.warns(parallel.LongWork, match="10 points: about 50.0 min"):
        next(points)


def test_results_count_by_their_sizes(work):
    with pytest.warns(parallel.LongWork, match="1,000 photons: about 8.3 min"):
        list(parallel.paced(work(1.0, 1.0, 2.0), 1000, "1,000 photons", lambda each: 2.0 * each))


def test_a_mesh_of_many_waves_is_announced_before_it_begins():
    """Lines that lie hundreds of wavelengths apart leave the plain sum."""
    sea = SpectralSea(spectrum=Elfouhaily(wind_speed=13.0), omega_max=200.0, choppy=True)
    with pytest.raises(
        parallel.LongWork, match=r"mesh of 2,5\d\d by 2,5\d\d vertices from 5,\d* waves, some"
    ):
        sea.mesh(extent=200.0, spacing=0.01, fine_extent=2.0, coarse_spacing=0.5)


def test_a_mesh_that_would_fill_the_memory_is_refused():
    with pytest.raises(Refused, match=r"mesh: 1.6e\+07 vertices, some 8 GB, allowed: at most 10"):
        FlatSea().mesh(extent=2000.0, spacing=1.0)


def test_the_work_is_not_changed():
    assert list(parallel.paced(iter(np.arange(3)), 3, "3")) == [0, 1, 2]
