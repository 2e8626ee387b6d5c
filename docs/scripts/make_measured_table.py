"""Write the tables of measured.md and draw its figures: measured points over computed bands.

python docs/scripts/make_measured_table.py [TABLE.nc]   # of meshtrace validate --suite measured
python docs/scripts/make_measured_table.py shares       # of a laser by phase function

The suite takes some three CPU minutes, the shares five more.
"""

from __future__ import annotations

import math
import sys
import textwrap
from importlib.metadata import version
from urllib.parse import quote

import matplotlib
import numpy as np
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter
from places import GENERATED, STATIC

from meshtrace import viz
from meshtrace.apps import measured
from meshtrace.apps.measured import beams

PHASES = ("clear", "coastal", "harbour", "average", "ff 0.005", "ff 0.01", "ff 0.0183", "ff 0.03")
LENGTHS, CHUNKS = (4.0, 20.0), 128
UNDER_SURFACE = ("average", "ff 0.01")
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
        for surface in ("absent", "flat")[: 1 + (phase in UNDER_SURFACE)]:
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
        print(*rows[-2:], sep="\n", flush=True)
    (GENERATED / "measured_shares_table.md").write_text(
        table_of(heads, rows) + "\n", encoding="utf-8"
    )


def draw(experiment, table) -> None:
    """Draw the rows of an experiment: bands in colour, measured values in black."""
    from matplotlib import pyplot as plt

    data = table.to_dataset()
    data = data.isel(row=np.array(table.experiment) == experiment.name)
    series = np.array([row.series for row in experiment.rows])
    lying = experiment.abscissa == "row"
    height = 1.1 + 0.46 * len(series) if lying else 3.0
    figure, ax = plt.subplots(figsize=(4.6, height), layout="constrained")
    if lying:
        draw_lying(ax, data, experiment.ordinate)
    else:
        chosen = [name for name in dict.fromkeys(series) if name != "ratio"]
        for i, name in enumerate(chosen):
            label = NAMES.get(name, name) if len(chosen) > 1 else ""
            span = float(np.ptp(data.abscissa.to_numpy()))
            draw_series(ax, data.isel(row=series == name), span, i, len(chosen), label)
        ax.set(xlabel=experiment.abscissa, ylabel=experiment.ordinate, ylim=(0.0, None))
        ax.legend(frameon=False, fontsize=8)
    name = experiment.name.replace("-", "_")
    figure.savefig(STATIC / f"measured_{name}.png", dpi=200, bbox_inches="tight")
    plt.close(figure)


def draw_series(ax, rows, span, i, series, label) -> None:
    """Draw band, nominal values and measured values against the abscissa."""
    x, color = rows.abscissa.to_numpy(), COLORS[i]
    away = rows.computed - rows.band_low, rows.band_high - rows.computed
    name = f"computed, with band{', ' * bool(label)}{label}"
    if len(x) > 3:
        ax.fill_between(x, rows.band_low, rows.band_high, color=color, alpha=0.2, lw=0)
        ax.plot(x, rows.computed, color=color, lw=1.4, label=name)
    else:  # no line through few points
        aside = 0.02 * span * (2 * i - series + 1)
        ax.bar(x + aside, sum(away), bottom=rows.band_low, width=0.02 * span,
               color=color, alpha=0.3)  # fmt: skip
        ax.plot(x + aside, rows.computed, "_", ms=9, mew=2, color=color, label=name)
        x = x + 2.0 * aside
    low, high = rows.observed_low.to_numpy(), rows.observed_high.to_numpy()
    if np.isfinite(low).any():
        value = rows.observed.to_numpy()
        ax.errorbar(x, value, (value - low, high - value), fmt="os"[i % 2], ms=4, lw=1.0,
                    capsize=2, color="black", mfc="white" if i % 2 else "black",
                    label=f"measured{', ' * bool(label)}{label}")  # fmt: skip


def draw_lying(ax, rows, label) -> None:
    """Draw each row on a line: band, nominal value, and below it the measured interval."""
    low, high = rows.band_low.to_numpy(), rows.band_high.to_numpy()
    left, right = rows.observed_low.to_numpy(), rows.observed_high.to_numpy()
    y = np.arange(len(low))[::-1].astype(float)
    ax.barh(y, high - low, left=low, height=0.36, color=COLORS[0], alpha=0.25, label="band")
    ax.plot(rows.computed, y, "|", ms=12, mew=2, color=COLORS[0], label="computed")
    every = np.concatenate([low, high, left, right])
    every = every[np.isfinite(every)]  # limits that are open, and predictions without a measurement
    if low.min() > 0.0 and every.max() > 20.0 * every.min() > 0.0:
        ax.set(xscale="log", xlim=(every.min() / 1.2, every.max() * 1.2))
        ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        ax.xaxis.set_minor_formatter(NullFormatter())
    else:
        margin = 0.08 * np.ptp(every)
        ax.set_xlim(every.min() - margin, every.max() + margin)
    measured = np.isfinite(left)
    lines = left, right, rows.observed.to_numpy(), y - 0.32
    for a, b, value, at in zip(*(line[measured] for line in lines), strict=True):
        ends = "|>" if math.isinf(b) else "||"
        stop = ax.get_xlim()[1] * 0.98 if math.isinf(b) else b
        ax.plot([a, stop], [at, at], color="black", lw=1.2)
        for place, mark in zip((a, stop), ends, strict=True):
            ax.plot(place, at, mark, color="black", ms=6)
        if np.isfinite(value):
            ax.plot(value, at, "o", color="black", ms=4)
    ax.plot([], [], "|-", color="black", label="measured")
    ax.set_yticks(
        y, [wrapped(str(name)).replace("K_d", "$K_d$") for name in rows.observable.to_numpy()]
    )
    ax.set(xlabel=label, ylim=(-0.65, len(y) - 0.6))
    ax.grid(axis="y", visible=False)
    ax.legend(loc="lower center", bbox_to_anchor=(0.4, 1.0), ncols=3, frameon=False, fontsize=8)


def wrapped(text: str) -> str:
    return "\n".join(textwrap.wrap(text, 26))


def section(experiment) -> str:
    """Return the text of an experiment: source, measurement, inputs and findings."""
    doi = f", [doi](https://doi.org/{quote(experiment.doi)})" if experiment.doi else ""
    unknowns = "\n".join(
        f"- `{u.name}` {u.nominal} ({', '.join(map(str, u.others))}) {u.unit}: {u.authority}"
        for u in experiment.unknowns
    ).replace(" 1: ", ": ")
    picture = f"_static/measured_{experiment.name.replace('-', '_')}.png"
    kind = "" if experiment.kind == "number" else "; in kind"
    return f"""({experiment.name})=
## {experiment.title}

{experiment.source}{doi}. Read: {experiment.read}{kind}.

*Measured.* {experiment.measured}

*Tests* {experiment.tests}.

*Not reported.* {experiment.unreported} Inputs, nominal (other values):

{unknowns}

![Measured values beside computed bands]({picture})

*Found.* {experiment.findings}
"""


def main() -> None:
    if "shares" in sys.argv[1:]:
        write_shares()
        return
    matplotlib.use("Agg")
    viz.use_style()
    table = measured.MeasuredTable.load(sys.argv[1]) if sys.argv[1:] else measured.run()
    rows = [
        [f"[{name}](#{name})", *(cell.replace("|", "/") for cell in cells)]
        for name, *cells in table.text_rows()
    ]
    script = "docs/scripts/make_measured_table.py"
    about = f"Version {version('meshtrace')}, `{script}`; {table._headline()}."
    known = measured.experiments().values()
    parts = [about, table_of(measured.HEADINGS, rows), *map(section, known)]
    (GENERATED / "measured_table.md").write_text("\n\n".join(parts), encoding="utf-8")
    for experiment in known:
        draw(experiment, table)


if __name__ == "__main__":
    main()
