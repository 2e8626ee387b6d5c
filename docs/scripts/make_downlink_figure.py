"""Draw both directions over the same seas, and the flicker of a downlink against its height.

python docs/scripts/make_downlink_figure.py       # some two CPU minutes
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from places import STATIC

import meshtrace as mt
from meshtrace import viz
from meshtrace.fading import scintillation_of_spectrum
from meshtrace.surfaces import Elfouhaily, SpectralSea

SEAS = 80
OMEGA_MAX = 16.0
HEIGHTS = np.geomspace(2.0, 100.0, 12)
SEA = SpectralSea(
    spectrum=Elfouhaily(wind_speed=5.0, fetch=30e3),
    spreading="elfouhaily",
    mss="elfouhaily",
    omega_max=OMEGA_MAX,
)
WIDE = mt.Link(receiver=mt.Receiver(fov_deg=120.0))


def at_height(height: float) -> mt.Link:
    return WIDE.replace("receiver.height", height)


def main(folder: Path) -> None:
    viz.use_style()
    both = mt.duplex(WIDE, WIDE.mirrored(), SEA, realizations=SEAS, photons=64)
    print(both.summary())

    figure, (left, right) = plt.subplots(1, 2, figsize=(8.6, 3.8), layout="constrained")
    n2 = WIDE.water.n**2
    left.plot(n2 * both.up.gain, both.down.gain, "o", ms=3)
    ends = np.array([0.0, 1.05 * both.down.gain.max()])
    left.plot(ends, ends, color="0.5", lw=1.0, label="down = n² up")
    left.set(xlabel="n² times the gain up", ylabel="gain down", xlim=ends, ylim=ends)
    left.set_title(f"{SEAS} seas, correlation {both.correlation:.3f}")
    viz.marks.finished(left)

    for name, links in (
        ("up", [at_height(h) for h in HEIGHTS]),
        ("down", [at_height(h).mirrored() for h in HEIGHTS]),
    ):
        index = [scintillation_of_spectrum(link, SEA, OMEGA_MAX) for link in links]
        print(name, np.round(index, 4).tolist())
        right.plot(HEIGHTS, index, "o-", ms=3, label=name)
    right.set(xscale="log", xlabel="height [m]", ylabel="scintillation index")
    right.set_xticks([2, 5, 10, 20, 50, 100], ["2", "5", "10", "20", "50", "100"])
    right.set_title("closed form, unscattered light")
    viz.marks.finished(right)
    figure.savefig(folder / "downlink.png", dpi=130)


if __name__ == "__main__":
    main(STATIC)
