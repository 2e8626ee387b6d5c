"""Phase functions of sea water and of bubbles, and their distribution functions."""

from pathlib import Path

import meshtrace as mt
from meshtrace import viz


def main(folder: Path) -> None:
    viz.use_style()
    phases = {
        "Fournier-Forand": mt.FournierForand(n=1.1, mu=3.5835),
        "Petzold": mt.Petzold(),
        "Henyey-Greenstein, g = 0.924": mt.HenyeyGreenstein(g=0.924),
        "bubbles (Mie)": mt.HallNovarini(wind_speed=13.0).phase_function(),
    }
    ax = viz.plot_phase_function({name: phase.pdf for name, phase in phases.items()})
    ax.figure.savefig(folder / "phase_functions.png")
    ax = viz.plot_phase_cdf({name: phase.cdf for name, phase in phases.items()})
    ax.figure.savefig(folder / "phase_cdf.png")


if __name__ == "__main__":
    main(Path(__file__).parent)
