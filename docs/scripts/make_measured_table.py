"""Write the tables of measured.md and draw its figures: all rows as ratios, curves with points.

python docs/scripts/make_measured_table.py [TABLE.nc]   # of meshtrace validate --suite measured
python docs/scripts/make_measured_table.py shares       # of a laser by phase function

The suite takes some three CPU minutes, the shares five more.
"""

from __future__ import annotations

import re
import sys
from importlib.metadata import version
from itertools import accumulate
from urllib.parse import quote

import matplotlib
import numpy as np
from matplotlib.ticker import NullFormatter
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
    heads = ["phase function", "b_b/b", "surface", "r c", "4° of 58°", "2° of 58°"]
    rows = []
    for phase in PHASES:
        for surface in ("absent", "flat")[: 1 + (phase in UNDER_SURFACE)]:
            light = beams.laser_light(phase, 0.1463, 1.0, surface, LENGTHS, CHUNKS)[:, :, 0]
            for i, length in enumerate(LENGTHS):
                cells = [
                    beams.share_of(light[:, i, :cone].sum(axis=1), light[:, i, :3].sum(axis=1))
                    for cone in (2, 1)
                ]
                name = phase.replace("ff", "Fournier-Forand").rsplit(" 0.", 1)[0]
                share = f"{beams.phase_of(phase).backscatter_fraction:.4f}"
                shown = [f"{value:.5f}({1e5 * error:.0f})" for value, error in cells]
                rows.append([name, share, surface, f"{length:g}", *shown])
        print(*rows[-2:], sep="\n", flush=True)
    (GENERATED / "measured_shares_table.md").write_text(
        table_of(heads, rows) + "\n", encoding="utf-8"
    )


TICKS = {0.25: "÷4", 0.5: "÷2", 0.8: "0.8", 1.0: "1", 1.25: "1.25", 2.0: "×2", 4.0: "×4"}


def comparable(table):
    """Return the rows of a table whose measured and computed values have a ratio."""
    data = table.to_dataset()
    return data.isel(row=(data.observed > 0.0) & (data.computed > 0.0) & (data.observed_low > 0.0))


def draw_ratios(ax, data, y, edge) -> None:
    """Draw computed over measured values at heights y; those below an edge are arrows on it."""
    ratio = (data.computed / data.observed).to_numpy()
    inside = data.verdict.to_numpy() == "inside"
    for at, color, mark, label in (
        (inside, COLORS[0], "o", "computed, inside"), (~inside, COLORS[1], "D", "outside"),
    ):  # fmt: skip
        ax.plot(ratio[at], y[at], mark, ms=5, color=color, mec="white", mew=0.6, label=label)
    beyond = ratio < edge
    ax.plot(np.full(beyond.sum(), 1.03 * edge), y[beyond], "<", ms=5, color=COLORS[0])


def save_ratios(figure, ax, limits, size, name) -> None:
    """Finish the axis of the ratio, with letters of a size [pt], and write the picture."""
    ax.axvline(1.0, color="black", lw=0.8)
    ax.set(xscale="log", xlim=limits)
    ticks = [tick for tick in TICKS if limits[0] < tick < limits[1]]
    ax.set_xticks(ticks, [TICKS[tick] for tick in ticks], fontsize=size)
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.minorticks_off()
    ax.grid(axis="y", visible=False)
    ax.set_xlabel("computed / measured", fontsize=size + 1)
    ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, frameon=False, fontsize=size)
    figure.savefig(STATIC / f"measured_{name}.png", dpi=150 if name == "rows" else 200)


def draw_rows(table) -> None:
    """Draw computed over measured values with their ends, each row on a line."""
    from matplotlib import pyplot as plt

    data = comparable(table)
    names = data.experiment.to_numpy().tolist()
    y = -np.arange(data.sizes["row"], dtype=float)
    figure, ax = plt.subplots(figsize=(7.2, 1.0 + 0.19 * np.ptp(y)), layout="constrained")
    parts = "observed_low", "observed_high", "band_low", "band_high"
    left, right, low, high = (data[part].to_numpy() / data.observed.to_numpy() for part in parts)
    ax.barh(y, right - left, left=left, height=0.7, color="#d0d0d0", lw=0, label="measured")
    inside = data.verdict.to_numpy() == "inside"
    ax.hlines(y, np.maximum(low, 0.1), high, color=np.where(inside, *COLORS[:2]), lw=2.2)
    draw_ratios(ax, data, y, 0.2)
    ax.plot([], [], color=COLORS[0], lw=2.2, label="band of open inputs")
    beside = ax.get_yaxis_transform()
    for name in dict.fromkeys(names):
        first = y[names.index(name)]
        ax.axhline(first + 0.5, color="#bbbbbb", lw=0.5)
        ax.text(1.01, first, name.title(), transform=beside, va="center", fontsize=7)
    printed = [str(word).replace("K_d", "$K_d$").replace(" deg", "°") for word in
               data.observable.to_numpy()]  # fmt: skip
    ax.set_yticks(y, printed, fontsize=7)
    ax.set_ylim(y.min() - 0.6, 0.6)
    save_ratios(figure, ax, (0.2, 8.0), 8, "rows")
    plt.close(figure)


def draw_forest(table) -> None:
    """Draw computed over measured values, those of each experiment on a line below its title."""
    from matplotlib import pyplot as plt

    data = comparable(table)
    names = list(dict.fromkeys(data.experiment.to_numpy().tolist()))
    y = -np.array([names.index(name) for name in data.experiment.to_numpy()], float)
    # [inch] as narrow as letters of 9 points allow, which a phone of 390 pixels shows as large
    figure, ax = plt.subplots(figsize=(4.8, 1.0 + 0.4 * len(names)), layout="constrained")
    draw_ratios(ax, data, y, 0.3)
    known, within = measured.experiments(), ax.get_yaxis_transform()
    clear = {"facecolor": "white", "edgecolor": "none", "pad": 0.5}
    for i, name in enumerate(names):
        title = known[name].title
        ax.text(0.01, 0.4 - i, title, transform=within, va="center", fontsize=9, bbox=clear)
    ax.set_yticks([])
    ax.set_ylim(y.min() - 0.5, 0.7)
    save_ratios(figure, ax, (0.3, 3.0), 9, "forest")
    plt.close(figure)


def draw(experiment, table) -> None:
    """Draw the rows of an experiment: bands in colour, measured values in black."""
    from matplotlib import pyplot as plt

    data = table.to_dataset()
    data = data.isel(row=np.array(table.experiment) == experiment.name)
    series = np.array([row.series for row in experiment.records])
    figure, ax = plt.subplots(figsize=(4.6, 3.0), layout="constrained")
    chosen = [name for name in dict.fromkeys(series) if name != "ratio"]
    for i, name in enumerate(chosen):
        label = NAMES.get(name, name) if len(chosen) > 1 else ""
        span = float(np.ptp(data.abscissa.to_numpy()))
        draw_series(ax, data.isel(row=series == name), span, i, len(chosen), label)
    ax.set(xlabel=experiment.abscissa, ylabel=experiment.ordinate, ylim=(0.0, None))
    # few points leave no corner that is free in every picture
    title = None if is_printed(experiment) else "the source prints no measured value"
    figure.legend(loc="outside upper left", ncols=2, fontsize=7.5, title=title)
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
               color=color, alpha=0.3, hatch="////" * i)  # fmt: skip
        ax.plot(x + aside, rows.computed, "_", ms=9, mew=2, color=color, label=name)
        x = x + 2.0 * aside
    low, high = rows.observed_low.to_numpy(), rows.observed_high.to_numpy()
    if np.isfinite(low).any():
        value = rows.observed.to_numpy()
        ax.errorbar(x, value, (value - low, high - value), fmt="os"[i % 2], ms=4, lw=1.0,
                    capsize=2, color="black", mfc="white" if i % 2 else "black",
                    label=f"measured{', ' * bool(label)}{label}")  # fmt: skip


def is_printed(experiment) -> bool:
    """Return whether the source prints any of the values that are computed."""
    return any(np.isfinite(row.low) for row in experiment.records)


def has_curve(experiment) -> bool:
    """Return whether the rows lie along an abscissa; others are in the picture of all rows."""
    return experiment.abscissa != "row"


def section(experiment, rows: list[str]) -> str:
    """Return source, measurement, inputs that dominate a row, rows, and why one is not inside."""
    listed = "\n".join(rows)
    doi = f", [doi](https://doi.org/{quote(experiment.doi)})" if experiment.doi else ""
    dominant = {row.rpartition("; ")[2] for row in rows}
    unknowns = "; ".join(
        f"{u.name.replace('_', ' ')} {u.nominal} ({', '.join(map(str, u.others))})"
        + f" {u.unit}" * (u.unit != "1")
        for u in experiment.unknowns
        if u.name.replace("_", " ") in dominant
    )
    picture = f"_static/measured_{experiment.name.replace('-', '_')}.png"
    kind = "" if experiment.kind == "number" else "; in kind"
    shown = "computed bands alone, as the source prints no value"
    shown = "measured values beside computed bands" if is_printed(experiment) else shown
    alt = f"{experiment.title}: {shown}"
    found = f"\n*Found.* {opening(experiment.findings)}\n" if ", **" in listed else ""
    return f"""({experiment.name})=
## {experiment.title}

{experiment.source}{doi}. Read: {experiment.read}{kind}.

{experiment.measured} *Open:* {unknowns}.

{listed}
{found}""" + (f"\n![{alt}]({picture})\n" if has_curve(experiment) else "")


def opening(text: str, words: int = 16) -> str:
    """Return the first sentences of a text with as many words or more."""
    sentences = re.split(r"(?<=[a-z0-9)%][.]) (?=[A-Z])", text)
    ends = accumulate(len(sentence.split()) for sentence in sentences)
    return " ".join(sentences[: 1 + next(i for i, end in enumerate(ends) if end >= words)])


def row_of(table, i: int) -> str:
    """Return a row as an item of a list: intervals with a dash, verdicts but "inside"."""
    _, quantity, unit, observed, computed, band, verdict, dominant = table.text_rows()[i]
    unit = "" if unit == "1" else f" [{unit}]"
    computed = f"{computed.replace(' +- ', '±')} ({band.replace(' to ', '–')})"
    verdict = "" if verdict == "inside" else f", **{verdict}**"
    return f"- {quantity}{unit}: {observed.replace(' to ', '–')}; {computed}{verdict}; {dominant}"


def main() -> None:
    if "shares" in sys.argv[1:]:
        write_shares()
        return
    matplotlib.use("Agg")
    viz.use_style()
    table = measured.MeasuredTable.load(sys.argv[1]) if sys.argv[1:] else measured.run()
    about = f"Version {version('meshtrace')}; {table._headline()}."
    known = measured.experiments().values()
    rows = {e.name: [] for e in known}
    for i, name in enumerate(table.experiment):
        rows[name].append(row_of(table, i))
    parts = [about, *(section(e, rows[e.name]) for e in known)]
    (GENERATED / "measured_table.md").write_text("\n\n".join(parts), encoding="utf-8")
    draw_rows(table)
    draw_forest(table)
    for experiment in filter(has_curve, known):
        draw(experiment, table)


if __name__ == "__main__":
    main()
