"""Draw the answer of guides/design.md: the reserve as given and with the best optics, by light.

python docs/scripts/make_design_figure.py [FIXED.nc GIMBAL.nc]     # results of `meshtrace design`

Without results the two links of the guide are designed first, some 80 CPU seconds.
"""

from __future__ import annotations

import re
import sys

import matplotlib as mpl

mpl.use("agg")

import matplotlib.pyplot as plt
import numpy as np
from places import DOCS, STATIC

import meshtrace as mt
from meshtrace.apps import Design, design
from meshtrace.viz import use_style
from meshtrace.viz.style import number

MOUNTS = ("fixed mount", "gimbal")
LIGHTS = ("night", "day")
CLOSES, SHORT = "#0072b2", "#d55e00"


def designs() -> list[Design]:
    """Return the designs of the link of the guide, on a fixed mount and on a gimbal."""
    guide = (DOCS / "guides" / "design.md").read_text("utf-8")
    toml = re.findall(r"^```toml\n(.*?)^```", guide, re.M | re.S)[0]
    changes = ({}, {"uav.gimbal": True})
    return [design(mt.Scenario.from_toml(toml, changes=change)) for change in changes]


def main() -> None:
    """Draw both reserves of each mount and light on one line."""
    use_style()
    found = [Design.load(path) for path in sys.argv[1:]] or designs()
    # [inch] as narrow as letters of 9 points allow, which a phone of 390 pixels shows as large
    figure, ax = plt.subplots(figsize=(4.8, 3.0), layout="constrained")
    rows = [(m, light, d) for m, d in zip(MOUNTS, found, strict=True) for light in LIGHTS]
    for y, (_, light, d) in zip(np.arange(len(rows))[::-1], rows, strict=True):
        given, best = d.at(light).reserve, d.reserve_together(light)
        color = CLOSES if best >= 0.0 else SHORT
        ax.annotate("", (best, y), (given, y), arrowprops={"arrowstyle": "-|>", "color": color,
                    "lw": 2.5, "shrinkA": 0, "shrinkB": 0})  # fmt: skip
        ax.plot(given, y, "o", color="black", ms=6)
        verdict = "closes" if best >= 0.0 else "short"
        text = f"{number(best, '+.1f')} dB: {verdict}"
        clear = {"facecolor": "white", "edgecolor": "none", "pad": 0.5}
        ax.text(best + 1.0, y, text, va="center", fontsize=9, color=color, bbox=clear)
        ax.text(given - 1.0, y, number(given, "+.1f"), va="center", ha="right", fontsize=9)
    ax.axvline(0.0, color="black", lw=1.0)
    ax.set_yticks(np.arange(len(rows))[::-1], [f"{mount},\n{light}" for mount, light, _ in rows])
    ax.set(xlim=(-45.0, 55.0), ylim=(-0.6, len(rows) - 0.4))
    ax.set_xlabel("reserve [dB]: dot as given,\narrow with the best lens, view and filter")
    ax.grid(axis="y", visible=False)
    figure.savefig(STATIC / "design.png", dpi=200)


if __name__ == "__main__":
    main()
