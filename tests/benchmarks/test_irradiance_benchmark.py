"""CPU seconds of a frame of irradiance under a moving sea, beside one of the background.

Run with `pytest tests/benchmarks --benchmark-only` on a quiet machine.
"""

import numpy as np
from clocks import timed

import meshtrace as mt
from meshtrace.surfaces import resolved_sea

DAY = mt.Daylight(direct=1.421482, diffuse=0.295018)


def test_a_frame(benchmark):
    sea, times = resolved_sea(13.0, seed=7), 1e-3 * np.arange(20)
    options = {"depths": [1.0], "below": "waves", "photons": 1000, "threads": 1}
    mt.irradiance_series(sea, DAY, times=times[:1], **options)
    found = benchmark.pedantic(
        mt.irradiance_series, (sea, DAY), {"times": times, **options}, rounds=1
    )
    points, seconds = (
        found.provenance["surface_points"][0],
        found.provenance["cpu_seconds_per_frame"],
    )
    sea = sea.model_copy(update={"omega_max": 20.0})
    receiver = mt.WaterReceiver(depth=3.0, radius=0.025, fov_deg=180.0)
    link = mt.Link(transmitter=mt.AirLed(), receiver=receiver)
    other = timed(lambda: mt.background_series(link, sea, DAY, times[:3], photons=1024, threads=1))
    benchmark.extra_info.update(
        cpu_seconds=seconds, points=points, background_cpu_seconds=other[1] / 3
    )
    assert seconds < 0.15 * points / 512**2
