"""Draw absorption and scattering over wavelength: constituents, and types of water.

python docs/scripts/make_water_figure.py
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from places import STATIC

import meshtrace as mt
from meshtrace import viz
from meshtrace.optics import Constituents

WATERS = {
    "sea water": Constituents(),
    **{f"chlorophyll {c:g} mg m$^{{-3}}$": Constituents(chlorophyll=c) for c in (0.05, 0.5, 5.0)},
    "0.5, minerals 2 g m$^{-3}$": Constituents(chlorophyll=0.5, minerals=2.0),
}
TYPES = ("jerlov-IB", "jerlov-II", "jerlov-3C")


def main(folder: Path) -> None:
    viz.use_style()
    figure, axes = plt.subplots(1, 2, figsize=(10.5, 4.0), sharex=True, layout="constrained")
    waters = {name: mt.Water(spectrum=s, wavelength_nm=470.0) for name, s in WATERS.items()}
    waters |= {name: mt.Water.from_type(name) for name in TYPES}
    for name, water in waters.items():
        last = 650.0 if name == "jerlov-3C" else 700.0
        data = water.spectra(np.arange(400.0, last + 1.0, 5.0))
        for ax, quantity in zip(axes, "ab", strict=True):
            look = {"lw": 3.5, "alpha": 0.5} if name in TYPES else {}
            ax.plot(data.wavelength_nm, data[quantity], label=name, **look)
    for ax, text in zip(axes, ("absorption $a$", "scattering $b$"), strict=True):
        ax.set(yscale="log", xlim=(400.0, 700.0), ylabel=f"{text} [m$^{{-1}}$]")
        ax.set_xlabel("wavelength [nm]")
        viz.marks.finished(ax, legend=False)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right center")
    figure.savefig(folder / "water_spectra.png")
    plt.close(figure)


if __name__ == "__main__":
    main(STATIC)
