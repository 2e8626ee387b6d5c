"""Figure of the fates of photons, for the paper's flow chart of its algorithm."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

import meshtrace as mt
from meshtrace.paper.canvas import dataset, form_panels
from meshtrace.paper.links import FORMS, RADIUS, scenario
from meshtrace.paper.registry import FigureOutput, Number, Setting, row
from meshtrace.results.gain import FATE_MEANING, Fate
from meshtrace.viz import plot_fates

WIND = 13.0


def fates(setting: Setting, photons: int) -> FigureOutput:
    """Draw shares of the light by fate."""
    picture, axes = form_panels(width=6.4)
    shares = {}
    for form, ax in axes.items():
        made = scenario(WIND, form, receiver={"radius": RADIUS}, run={"estimator": "analog"})
        options: Any = {"estimator": "analog", "photons": photons, **setting.run}
        result = mt.simulate(made.link, made.surface, **options)
        plot_fates(result, ax=ax)
        shares[form] = {name: tally.weight for name, tally in result.fates.items()}
    table = pd.DataFrame(shares).fillna(0.0)
    numbers = [
        row(
            "share",
            [Number(s, float(np.sqrt(max(s * photons, 0.0)) / photons)) for s in both],
            fate=FATE_MEANING[Fate[str(name).upper()]],
        )
        for name, both in zip(table.index, table.to_numpy(), strict=True)
        if max(both) > 0.0
    ]
    data = dataset(
        ("form", "fate"), {"fate_weight": table.to_numpy().T}, form=FORMS, fate=table.index
    )
    return FigureOutput(picture, data, numbers, {"wind": WIND, "radius": RADIUS})
