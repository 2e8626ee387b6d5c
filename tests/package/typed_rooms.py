"""Wrong uses of all rooms, for mypy: an error that it does not find is an unused ignore.

mypy runs without the plugin of pydantic, as that of a user does. The right uses below must pass.
"""

import numpy as np

import meshtrace as mt
from meshtrace.comms import OokLink
from meshtrace.surfaces import FlatSea, JonswapSea, SpectralSea
from meshtrace.viz import SceneStyle

x: int = FlatSea(height=0.1).nonsense  # type: ignore[attr-defined]
y: int = SceneStyle().nonsense  # type: ignore[attr-defined]
FlatSea(hieght=1.0)  # type: ignore[call-arg]
FlatSea(height="a")  # type: ignore[arg-type]
mt.Led(dept="10")  # type: ignore[call-arg]
mt.Led(depth="10")  # type: ignore[arg-type]
mt.Link(transmiter=mt.Led())  # type: ignore[call-arg]
mt.Link(receiver=3)  # type: ignore[arg-type]
mt.Water(a=0.1, phase=3)  # type: ignore[arg-type]
mt.Meshing(tim=3.0)  # type: ignore[call-arg]
JonswapSea(wind=3.0)  # type: ignore[call-arg]
OokLink(bitrate=1e6)  # type: ignore[call-arg]
mt.simulate(mt.Link(), photon=3)  # type: ignore[call-overload]
mt.simulate(mt.Link(), photons="many")  # type: ignore[call-overload]
mt.background(mt.Link(), photon=3)  # type: ignore[call-overload]
mt.time_series(mt.Link(), photon=3)  # type: ignore[call-overload]
mt.depth_sweep(mt.Link(), limits=1e-3)  # type: ignore[call-arg]
WRONG = mt.simulate(mt.Link()).gian  # type: ignore[attr-defined]

LINK = mt.Link(
    transmitter={"kind": "led", "depth": 10.0},
    receiver=[mt.Receiver(height=5), mt.Receiver(height=np.float64(6.0))],
    water=mt.Water(a=0.1, b=0.05, phase="petzold"),
    bubbles=None,
)
GAIN = mt.simulate(LINK, JonswapSea(seed=1), photons=64, rtol=0.01).gain
COLOURS = mt.simulate(LINK, wavelengths_nm=[470.0, 530.0], record=[mt.Arrivals()], time=0.1)
SPREADING: float = SpectralSea(spectrum="jonswap", spreading="elfouhaily").spreading.half_range
