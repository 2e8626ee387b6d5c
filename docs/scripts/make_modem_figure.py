"""Draw the packet error rates of the table "A modem from end to end" in traces.md.

`examples/drivers/modem.py` gives the numbers of the table.
"""

import re

import numpy as np
from places import DOCS, STATIC

from meshtrace import viz

NUMBER = re.compile(r"[0-9.]+(?:e-?\d+)?")
PACKETS = 100


def main() -> None:
    """Write the figure."""
    page = (DOCS / "traces.md").read_text(encoding="utf-8")
    lines = page.split("<!-- modem -->")[1].split("<!-- end modem -->")[0].strip().splitlines()[2:]
    rows = np.array([[NUMBER.findall(cell)[0] for cell in line.split("|")[1:-1]] for line in lines])
    margin, alone, formula, spread, bound = rows.astype(float).T
    viz.use_style()
    axes = viz.marks.axes(None)
    for found, ideal, name, look in (
        (alone, formula, "no interleaver", "o:"),
        (spread, bound, "interleaver of 1 s", "s--"),
    ):
        error = np.sqrt(np.maximum(found * (1.0 - found), 0.01) / PACKETS)
        seen = np.maximum(found, 1.0 / PACKETS)
        bars = axes.errorbar(
            margin, seen, error, fmt=look[0], ms=5, capsize=2, label=f"code, {name}"
        )
        axes.plot(margin, ideal, look[1:], color=bars[0].get_color(), label=f"ideal code, {name}")
    axes.set(yscale="log", ylim=(3e-3, 1.5), xlabel="mean optical margin [dB]")
    axes.set_ylabel("packet error rate, outage")
    axes.legend()
    viz.save_picture(axes.figure, STATIC / "modem.png")


if __name__ == "__main__":
    main()
