"""Warnings name the user's line, however many functions lie between it and the cause."""

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.surfaces import JonswapSea

SEA = JonswapSea(wind_speed=5.0, omega_max=6.0)  # these waves omit most of the fading
SCENARIO = mt.Scenario(wind_speed=5.0, link=mt.Link(), surface=SEA)
RUN = {"photons": 32, "realizations": 50}


@pytest.mark.parametrize(
    "study",
    [
        lambda: mt.ensemble(mt.Link(), 50, SEA, photons=32),
        lambda: mt.time_series(mt.Link(), SEA, np.arange(50) * 0.1, photons=32),
        lambda: mt.link_performance(mt.Link(), SEA, **RUN),
        lambda: mt.link_performance(SCENARIO, **RUN),
    ],
    ids=["ensemble", "time_series", "link_performance", "of a scenario"],
)
def test_waves_that_omit_fading_are_those_of_the_call(study):
    with pytest.warns(UserWarning, match=r"^waves: those up to 6 rad/s") as caught:
        study()
    assert [warning.filename for warning in caught] == [__file__]
