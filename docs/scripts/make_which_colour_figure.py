"""Write the table and draw the figure of guides/which_colour.md: best wavelength against depth.

python docs/scripts/make_which_colour_figure.py       # some two CPU minutes

Gains are means over seas, each with chains of its own; all wavelengths have common paths. Standard
errors are those of a jackknife over the seas. The background light is that of a sea whose slopes
count nearly all by their density: it has the mean glint, to 0.3 %.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from places import GENERATED, STATIC
from scipy.interpolate import PchipInterpolator

import meshtrace as mt
from meshtrace import viz
from meshtrace.comms.budget import required_gain
from meshtrace.optics import Constituents
from meshtrace.surfaces import JonswapSea

WATERS = {
    "clear ocean, C = 0.03": Constituents(chlorophyll=0.03),
    "ocean, C = 0.3": Constituents(chlorophyll=0.3),
    "ocean, C = 1": Constituents(chlorophyll=1.0),
    "ocean, C = 3": Constituents(chlorophyll=3.0),
    "coast": Constituents(chlorophyll=2.0, cdom=0.3, minerals=1.0),
}
"""Waters of the figure; C in mg m-3."""

DEPTHS = (2.0, 5.0, 10.0, 20.0, 40.0)
DEEPEST = {"ocean, C = 1": 20.0, "ocean, C = 3": 20.0, "coast": 10.0}  # else the last
ROWS = (10.0, 20.0, 40.0)  # depths of the table [m]
WAVELENGTHS = np.array(sorted({*range(400, 621, 10), 532}), float)
CHOICES = (450.0, 470.0, 520.0, 532.0)
FILTERS = {"night": 0.0, "day, 2 nm": 2.0, "day, 10 nm": 10.0}  # [nm]
DRAWN = ("night", "day, 2 nm")
SEAS = 3
MESH = mt.Meshing(spacing=0.3, waves="mean")
SWELL = mt.Meshing(spacing=0.3, waves=1.2)
"""Mesh of the background."""

COUNTS = np.append(0.0, np.geomspace(1e9, 1e14, 16))
"""Background counts [s-1] between which the light needed is interpolated."""

DAY = mt.Daylight.clear_sky(30.0, width_nm=20.0)
FLAT = 0.5  # [dB]
LEVELS = (0.0, FLAT, 1.0, 2.0, 4.0, 8.0)
SHADES = ("#08306B", "#2171B5", "#6BAED6", "#9ECAE1", "#C6DBEF", "#F7FBFF")


class Margins(NamedTuple):
    """Margins [dB] over wavelength: all seas, and without each of them (seas, n)."""

    whole: Any
    without: Any

    @property
    def best(self) -> float:
        """Wavelength of the largest margin [nm]."""
        return float(WAVELENGTHS[self.whole.argmax()])

    @property
    def lost(self) -> Any:
        """Margin below that of the best wavelength [dB]."""
        return self.whole.max() - self.whole

    @property
    def flat(self) -> str:
        """Ranges of wavelengths that lose less than `FLAT` [nm]."""
        inside = np.concatenate([[0], self.lost < FLAT, [0]]).astype(int)
        starts, ends = (np.flatnonzero(np.diff(inside) == step) for step in (1, -1))
        ranges = zip(WAVELENGTHS[starts], WAVELENGTHS[ends - 1], strict=True)
        return ", ".join(f"{a:.0f} to {b:.0f}" if a < b else f"{a:.0f}" for a, b in ranges)

    def error(self, values: Any) -> float:
        """Return the standard error of the numbers that leave out each sea."""
        n = len(values)
        return float(np.sqrt((n - 1) / n * ((values - np.mean(values)) ** 2).sum()))


def link_in(water: mt.Water) -> mt.Link:
    return mt.Link(water=water, receiver=mt.Receiver(fov_deg=20.0))


def sea(seed: int) -> JonswapSea:
    return JonswapSea(wind_speed=5.0, seed=seed)


@cache
def needed() -> Callable[[Any], Any]:
    """Return the function that gives the gain needed, times wavelength [nm], of background counts.

    The detector counts photons: with one efficiency for all colours the counts that it needs
    follow from the counts of the background alone.
    """
    ook = mt.OokLink.of_link(link_in(mt.Water()), bit_rate=1e6)
    gains = [required_gain(ook.replace(background_rate=rate), 1e-3) for rate in COUNTS]
    curve = PchipInterpolator(np.log1p(COUNTS), np.log(gains), extrapolate=False)
    return lambda counts: np.exp(curve(np.log1p(counts))) * 1e9 * ook.led.wavelength


def required(link: mt.Link) -> dict[str, np.ndarray]:
    """Return the gain needed at 1 Mbit/s over wavelength, under each light."""
    light = mt.background(link, sea(1), DAY, photons=2048, mesh=SWELL, wavelengths_nm=WAVELENGTHS)
    ooks = [mt.OokLink.of_link(link.at_wavelength(nm), bit_rate=1e6) for nm in WAVELENGTHS]
    per_nm = np.array([
        found.count_rate(ook.replace("optics.filter_width_nm", 1.0))
        for ook, (_, found) in zip(ooks, light, strict=True)
    ])  # fmt: skip
    return {name: needed()(width * per_nm) / WAVELENGTHS for name, width in FILTERS.items()}


def leave_one_out(values: np.ndarray) -> np.ndarray:
    """Return the mean over seas and the means without each of them, (1 + seas, ...)."""
    others = (values.sum(axis=0) - values) / (len(values) - 1)
    return np.concatenate([values.mean(axis=0)[None], others])


def margins(link: mt.Link, depth: float, need: dict[str, np.ndarray]) -> dict[str, Margins]:
    """Return the margins at a depth under each light."""
    at = link.at_depth(depth)
    found = [
        mt.simulate(at, sea(i), photons=1024, seed=i, mesh=MESH, wavelengths_nm=WAVELENGTHS)
        for i in range(1, SEAS + 1)
    ]
    gain = leave_one_out(np.array([f["gain"].to_numpy()[:, 0] for f in found]))
    rows = {light: 10.0 * np.log10(gain / of) for light, of in need.items()}
    return {light: Margins(row[0], row[1:]) for light, row in rows.items()}


def table_row(water: str, depth: float, light: str, found: Margins) -> str:
    best, at = int(found.whole.argmax()), WAVELENGTHS.tolist()
    flat, error = found.flat.replace(" to ", "–"), found.error(found.without[:, best])
    margin = f"{found.whole[best]:.1f}±{max(math.ceil(10.0 * error), 1) / 10.0:.1f}"
    cells = [water, f"{depth:g}", light.partition(",")[0], f"{found.best:.0f}", flat, margin]
    cells += [f"{found.lost[at.index(choice)]:.2f}" for choice in CHOICES]
    return f"| {' | '.join(cells)} |"


def main(folder: Path) -> None:
    head = "| water | depth [m] | light | best [nm] | flat [nm] | margin [dB] |"
    lines = [head + "".join(f" {nm:g} nm |" for nm in CHOICES), "|---" * (6 + len(CHOICES)) + "|"]
    drawn: dict[str, dict[float, dict[str, Margins]]] = {}
    for name, spectrum in WATERS.items():
        link = link_in(mt.Water(spectrum=spectrum, wavelength_nm=470.0))
        need = required(link)
        depths = [d for d in DEPTHS if d <= DEEPEST.get(name, DEPTHS[-1])]
        drawn[name] = {d: margins(link, d, need) for d in depths}
        lines += [
            table_row(name, d, light, found)
            for d in ROWS if d in drawn[name] for light, found in drawn[name][d].items()
            if light in DRAWN
        ]  # fmt: skip
    (GENERATED / "which_colour_table.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    draw(drawn, folder)


def draw(drawn: dict[str, dict[float, dict[str, Margins]]], folder: Path) -> None:
    viz.use_style()
    figure, axes = plt.subplots(
        len(DRAWN), len(drawn), figsize=(10.0, 5.0), sharex="col", sharey=True
    )
    for row, light in zip(axes, DRAWN, strict=True):
        for ax, (name, by_depth) in zip(row, drawn.items(), strict=True):
            found = [at[light] for at in by_depth.values()]
            lost = np.transpose([f.lost for f in found])
            shades = ax.contourf(list(by_depth), WAVELENGTHS, lost, LEVELS, colors=SHADES,
                                 extend="max")  # fmt: skip
            ax.plot(list(by_depth), [f.best for f in found], "wo", mec="k", ms=5.0, clip_on=False)
            if ax in axes[0]:
                ax.set_title(name, fontsize=10)
            else:
                ax.set_xlabel("depth [m]")
            ax.grid(visible=False)
        row[0].set_ylabel(f"{light}\nwavelength [nm]")
    figure.colorbar(shades, ax=axes, label="margin lost [dB optical]", pad=0.01, fraction=0.03)
    figure.savefig(folder / "which_colour.png")
    plt.close(figure)


if __name__ == "__main__":
    main(STATIC)
