"""The page of a link whose ends lie on one side: gain, rays, fading and map, or one line."""

from pathlib import Path

import numpy as np
import pytest

from meshtrace.apps.explorer import controls, stages
from meshtrace.apps.explorer.scene import LiveScene
from meshtrace.scenario import Scenario

OVER = """
[transmitter]
kind = "air-led"
height = 5.0
tilt_deg = 40.0
[receiver]
height = 4.0
position = [8.0, 0.0]
radius = 0.2
fov_deg = 120.0
tilt_deg = 60.0
tilt_azimuth_deg = 180.0
"""
UNDER = (Path(__file__).parents[3] / "examples" / "mirror.toml").read_text(encoding="utf-8")


@pytest.mark.filterwarnings("ignore:the fading of short waves is left out")
@pytest.mark.filterwarnings("ignore::meshtrace.FewSamplesWarning")
@pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning")
@pytest.mark.thorough
@pytest.mark.slow_but("over")
@pytest.mark.parametrize("text", [UNDER, OVER], ids=["under", "over"])
def test_all_stages(text, monkeypatch):
    for name in ("CHAINS", "FADING_CHAINS"):
        few = getattr(stages, name)
        monkeypatch.setattr(stages, name, (64, 128) if isinstance(few, tuple) else 64)
    monkeypatch.setattr(stages, "FADING_FRAMES", 10)  # shown in two answers
    monkeypatch.setattr(stages, "MAP_PHOTONS", (1000, 2000))
    state = controls.State(Scenario.from_toml(text))
    assert LiveScene(state).changes()
    signals = list(stages.gains(state, lambda: None))
    assert signals[-1].ber <= 0.5
    (paths,) = stages.rays(state, lambda: None)
    assert len(np.unique(paths.photon)) == stages.RAYS
    assert list(stages.fading(state, lambda: None))
    assert list(stages.coverage(state, lambda *progress: None))
