"""Draw docs/_static/tornado.png: the range gained or lost by 10 % of each parameter.

The default link at 40 m over still water; the need is the gain at 40 m.
"""

import matplotlib as mpl

mpl.use("agg")

import matplotlib.pyplot as plt
from places import STATIC

import meshtrace as mt
from meshtrace.surfaces import FlatSea
from meshtrace.viz import plot_tornado, use_style

NAMES = [
    "water.a", "water.b", "water.n", "water.phase.n", "water.phase.mu",
    "transmitter.half_angle_deg", "receiver.height", "receiver.radius", "receiver.fov_deg",
]  # fmt: skip


def main():
    use_style()
    link = mt.Link().at_depth(40.0)
    s = mt.sensitivities(link, FlatSea(), wrt=NAMES, quantity="range", ook=None)
    print(s.summary())
    figure, ax = plt.subplots(figsize=(6.4, 4.0))
    plot_tornado(s, change=0.1, ax=ax)
    figure.savefig(STATIC / "tornado.png", dpi=110)


if __name__ == "__main__":
    main()
