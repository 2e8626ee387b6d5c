"""Studies on a dask cluster: the digits are those of threads, and finished steps are kept."""

import numpy as np
import pytest
from studies.test_store import FEW, LINK, SMALL, STUDIES, TIMES, WAVE, digits

import meshtrace as mt
from meshtrace.errors import Refused
from meshtrace.studies.campaign import campaign_of
from meshtrace.surfaces import SinusoidalSea

distributed = pytest.importorskip("distributed")

ON_CLUSTERS = ("ensemble", "trace", "compare", "sensitivities", "flight", "duplex", "background",
               "performance", "depths", "convergence", "bands", "steps", "fading")  # fmt: skip


@pytest.fixture(scope="module")
def address():
    """Scheduler with a worker in a process of its own."""
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=":0", silence_logs=50
    ) as cluster:
        yield cluster.scheduler_address


@pytest.mark.process
@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", ON_CLUSTERS)
@pytest.mark.slow_but("ensemble", "convergence", "trace")
def test_digits_on_a_cluster_are_those_of_threads(name, address, tmp_path):
    study, path = STUDIES[name], tmp_path / "kept.store"
    expected = repr(digits(study()))
    assert repr(digits(study(workers=address, store=path))) == expected
    assert repr(digits(study(store=path))) == expected  # from the store


@pytest.fixture(scope="module")
def here():
    """Scheduler of one worker in a thread of this process."""
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0"
    ) as cluster:
        yield cluster.scheduler_address


def test_series_on_a_cluster(here):
    seen = []
    found = mt.time_series(LINK, WAVE, TIMES, **SMALL, workers=here, progress=seen.append)
    alone = mt.time_series(LINK, WAVE, TIMES, **SMALL)
    np.testing.assert_array_equal(found.gains, alone.gains)
    assert seen == [1] * len(TIMES)


def test_a_failing_surface_ends_the_study(here):
    campaign = campaign_of(LINK, WAVE, workers=here, **SMALL)
    steps = campaign.in_time(TIMES)

    def surface(i):
        if i == 2:
            raise Refused("surface", i, "other numbers")
        return WAVE, 0.0

    with pytest.raises(Refused, match="surface: 2, allowed: other numbers"):
        campaign.gains(steps._replace(surface=surface), probed=1)


@pytest.mark.parametrize("workers", [0, 1.5, -1])
def test_workers_out_of_range_are_refused(workers):
    with pytest.raises(Refused, match=r"workers: .*, allowed"):
        mt.ensemble(LINK, 2, SinusoidalSea(amplitude=0.1, wavelength=3.0), workers=workers, **FEW)
