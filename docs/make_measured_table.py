"""Write the tables of measured.md and draw its figures: measured points over computed bands.

python docs/make_measured_table.py [shares]     # with the shares of a laser by phase function

The suite takes some three CPU minutes, the shares ten more.
"""

from __future__ import annotations

import math
import sys
from importlib.metadata import version
from pathlib import Path

import matplotlib
import numpy as np

from meshtrace import viz
from meshtrace.validation import measured
from meshtrace.validation.measured import beams

HERE = Path(__file__).parent
PHASES = ("clear", "coastal", "harbour", "average", "ff 0.005", "ff 0.01", "ff 0.0183", "ff 0.03")
LENGTHS, CHUNKS = (4.0, 20.0), 220
COLORS = ("#0072b2", "#d55e00", "#009e73")
NAMES = {"up": "up the wind", "cross": "across the wind", "clear": "clear", "overcast": "overcast"}


def table_of(heads, rows) -> str:
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def write_shares() -> None:
    """Write the share of the power within cones, by phase function and reference power."""
    heads = ["phase function", "b_b/b", "surface", "r c", *(
        f"{angle}° of {whole}" for whole in ("58°", "all") for angle in (4, 2)
    )]  # fmt: skip
    rows = []
    for phase in PHASES:
        for surface in ("absent", "flat"):
            light = beams.laser_light(phase, 0.1463, 1.0, surface, LENGTHS, CHUNKS)[:, :, 0]
            for i, length in enumerate(LENGTHS):
                cells = [
                    beams.share_of(light[:, i, :cone].sum(axis=1), light[:, i, :whole].sum(axis=1))
                    for whole in (3, 4)
                    for cone in (2, 1)
                ]
                name = phase.replace("ff", "Fournier-Forand").rsplit(" 0.", 1)[0]
                share = f"{beams.phase_of(phase).backscatter_fraction:.4f}"
                shown = [f"{value:.5f} ± {error:.5f}" for value, error in cells]
                rows.append([name, share, surface, f"{length:g}", *shown])
        print(*rows[-4:], sep="\n", flush=True)
    (HERE / "measured_shares.md").write_text(table_of(heads, rows) + "\n", encoding="utf-8")


def draw(experiment, table) -> None:
    """Draw the rows of an experiment: bands in colour, measured values in black."""
    from matplotlib import pyplot as plt

    data = table.to_dataset()
    data = data.isel(row=np.array(table.experiment) == experiment.name)
    series = np.array([row.series for row in experiment.rows])
    figure, ax = plt.subplots(figsize=(4.6, 3.0), layout="constrained")
    lying = experiment.abscissa == "row"
    chosen = [s for s in dict.fromkeys(series) if s != "ratio" or lying]
    if lying:
        draw_lying(ax, data, experiment.ordinate)
    else:
        for i, name in enumerate(chosen):
            label = NAMES.get(name, name) if len(chosen) > 1 else ""
            draw_series(ax, data.isel(row=series == name), COLORS[i % 3], i, label)
        ax.set(xlabel=experiment.abscissa, ylabel=experiment.ordinate)
        if len(chosen) > 3:
            label_types(ax, data, series)
        elif len(chosen) > 1:
            ax.legend(frameon=False)
        high, low = float(data.band_high.max()), float(data.band_low.min())
        ax.set_ylim(0.0 if low > -0.2 * high else None, None)
    figure.savefig(HERE / "_static" / f"measured_{experiment.name.replace('-', '_')}.png", dpi=200)
    plt.close(figure)


def label_types(ax, data, series) -> None:
    """Write the names of many series beside their last points."""
    for name in dict.fromkeys(series):
        rows = data.isel(row=series == name)
        at, value = float(rows.abscissa[-1]), float(rows.computed[-1])
        ax.annotate(name, (at, value), (8, 0), textcoords="offset points", va="center", fontsize=8)
    ax.margins(x=0.15)


def draw_series(ax, rows, color, i, label) -> None:
    """Draw band, nominal values and measured values against the abscissa."""
    x = rows.abscissa.to_numpy()
    if len(x) > 1:
        ax.fill_between(x, rows.band_low, rows.band_high, color=color, alpha=0.2, lw=0)
        ax.plot(x, rows.computed, color=color, lw=1.4, label=f"computed {label}".strip())
    else:
        away = rows.computed - rows.band_low, rows.band_high - rows.computed
        ax.errorbar(x, rows.computed, away, fmt="s", ms=4, lw=5, color=color, alpha=0.5,
                    label=f"computed {label}".strip())  # fmt: skip
    points = centre(rows)
    if np.isfinite(points[0]).any():
        ax.errorbar(x, points[0], points[1:], fmt="os^D"[i % 4], ms=4, lw=1.0, capsize=2,
                    color="black", mfc="white" if i % 2 else "black",
                    label=f"measured {label}".strip())  # fmt: skip


def centre(rows):
    """Return measured value, and its distances to both ends."""
    low, high = rows.observed_low.to_numpy(), rows.observed_high.to_numpy()
    value = rows.observed.fillna(0.5 * (rows.observed_low + rows.observed_high)).to_numpy()
    return value, value - low, high - value


def draw_lying(ax, rows, label) -> None:
    """Draw one line a row: thick band, nominal value, thin measured interval."""
    low, high = rows.band_low.to_numpy(), rows.band_high.to_numpy()
    y = np.arange(len(low))[::-1].astype(float)
    ax.barh(y, high - low, left=low, height=0.36, color=COLORS[0], alpha=0.25, label="band")
    ax.plot(rows.computed, y, "|", ms=14, mew=2, color=COLORS[0], label="computed")
    for i, at in enumerate(y):
        a, b = float(rows.observed_low[i]), float(rows.observed_high[i])
        if math.isinf(b):
            ax.annotate("", (1.1 * high.max(), at - 0.3), (a, at - 0.3),
                        arrowprops={"arrowstyle": "->", "lw": 1.2})  # fmt: skip
            ax.plot([a], [at - 0.3], "|", color="black", ms=8)
        else:
            ax.plot([a, b], [at - 0.3] * 2, "|-", color="black", lw=1.2, ms=8)
        if np.isfinite(rows.observed[i]) and not math.isinf(b):
            ax.plot(rows.observed[i], at - 0.3, "o", color="black", ms=4)
    ax.plot([], [], "|-", color="black", label="measured")
    names = [wrapped(str(name)) for name in rows.observable.to_numpy()]
    ax.set_yticks(y, names)
    ax.set(xlabel=label, ylim=(-0.75, len(y) - 0.4))
    ax.legend(loc="lower center", bbox_to_anchor=(0.4, 1.0), ncols=3, frameon=False)


def wrapped(text: str) -> str:
    import textwrap

    return "\n".join(textwrap.wrap(text, 24))


def main() -> None:
    if "shares" in sys.argv[1:]:
        write_shares()
        return
    matplotlib.use("Agg")
    viz.use_style()
    table = measured.run(progress=print)
    rows = [
        [f"[{name}](#{name})", *(cell.replace("|", "/") for cell in cells)]
        for name, *cells in table.rows()
    ]
    about = f"Version {version('meshtrace')}, `docs/make_measured_table.py`: {table._headline()}."
    text = f"{about}\n\n{table_of(measured.HEADINGS, rows)}\n"
    (HERE / "measured_table.md").write_text(text, encoding="utf-8")
    for experiment in measured.experiments().values():
        draw(experiment, table)


if __name__ == "__main__":
    main()
