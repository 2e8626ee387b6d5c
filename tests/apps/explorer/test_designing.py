"""Designs of the explorer: those of the library, in a process that can be ended."""

import asyncio
import math

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.apps import Design
from meshtrace.apps.designs.page import BestValue, Figures, Line, Reach
from meshtrace.apps.explorer import readings, stages
from meshtrace.errors import Refused
from meshtrace.scenario import Scenario

FEW = {"photons": 64, "realizations": 8}
WIDTH = "detector.optics.filter_width_nm"
CALM = Scenario.from_toml("wind_speed = 0.0")


def a_design():
    figures = [
        Figures(light, "", (0.0, 0.0, 0.05), (1e-3, 0.0, 1.0), 2.5, reserve, 0.3, 9e5)
        for light, reserve in (("night", 3.0), ("day", -4.0))
    ]
    best = [
        BestValue(light, "receiver.radius", "m", 0.05, 0.2, 1.5, 0.1, (0.1, 0.2))
        for light in ("night", "day")
    ]
    reach = [
        Reach("night", "transmitter.depth", "m", 10.0, 12.0, "at most"),
        Reach("day", "transmitter.depth", "m", 10.0, math.nan, "at most"),
        Reach("night", WIDTH, "nm", 10.0, 40.0, "at most", "end of the scan"),
        Reach("day", WIDTH, "nm", 10.0, 3.0, "at most"),
    ]
    budget = (Line("lamp", "dBm", 20.0, 20.0), Line("reserve", "dB", 3.0, -4.0, 0.1, True))
    table = np.ones((2, 3))
    origin = mt.simulate(CALM, photons=64).provenance
    return Design(
        0.01, 1e-3, tuple(figures), tuple(best), tuple(best), tuple(reach), budget, table, table,
        ("a note",), "", origin,
    )  # fmt: skip


def test_a_design_is_read_in_the_units_of_the_page():
    found = readings.design_reading(a_design())
    assert found["answer"][0].startswith("By night: yes.")
    assert any(line.startswith("By day: no.") for line in found["answer"])
    tables = {table["title"]: table for table in found["tables"]}
    figures, best, together, reach, budget = tables.values()
    assert figures["rows"][3] == ["Reserve, outage 1 %", "3.0 ± 0.3 dB", "−4.0 ± 0.3 dB"]
    cell = "20 (10 … 20), +1.5 dB"
    assert best["rows"] == [["Aperture radius [cm]", "5", cell, cell]]
    assert together["rows"][-1] == ["Change", "", "+1.5 ± 0.1 dB", "+1.5 ± 0.1 dB"]
    assert reach["rows"] == [
        ["Depth [m]", "10", "≤ 12", "none"],
        ["Filter width [nm]", "10", "all to 40", "≤ 3"],
    ]
    assert budget["rows"][-1] == ["= reserve", "3.0", "−4.0", "dB"]
    for table in found["tables"]:
        assert {len(row) for row in table["rows"]} == {len(table["head"])}


@pytest.mark.process
@pytest.mark.slow
def test_the_design_is_that_of_the_library(monkeypatch):
    options = [f"--{key}={value}" for key, value in FEW.items()]
    monkeypatch.setattr(stages, "_DESIGN", (*stages._DESIGN, *options))
    found, expected = asyncio.run(stages.design_of(CALM)), mt.design(CALM, **FEW)
    assert found.figures == expected.figures
    assert found.choices == expected.choices
    assert readings.design_reading(found)["answer"] == readings.design_reading(expected)["answer"]


@pytest.mark.process
@pytest.mark.thorough
def test_a_refused_design_is_one_line():
    under = CALM.replace(link=mt.Link(receiver=mt.WaterReceiver(depth=5.0)))
    with pytest.raises(Refused, match="ends on one side") as error:
        asyncio.run(stages.design_of(under))
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.process
@pytest.mark.thorough
def test_a_design_can_be_ended():
    """Its process ends with the task."""

    async def cancelled():
        made, create = [], asyncio.create_subprocess_exec

        async def kept(*args, **options):
            made.append(await create(*args, **options))
            return made[0]

        asyncio.create_subprocess_exec = kept
        try:
            task = asyncio.create_task(stages.design_of(CALM))
            while not made:
                await asyncio.sleep(0.05)
            task.cancel()
            await asyncio.wait({task})
        finally:
            asyncio.create_subprocess_exec = create
        return task.cancelled(), made[0].returncode

    ended, code = asyncio.run(cancelled())
    assert ended
    assert code not in (None, 0)
