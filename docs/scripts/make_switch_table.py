"""Measure the effect of each physics switch on the default gain, for paper.md."""

from __future__ import annotations

import warnings

import numpy as np
from places import write_table

import meshtrace as mt
from meshtrace.surfaces import JonswapSea

WIND = 13.0


def default_link(**changes: object) -> mt.Link:
    """Return the paper's link at 13 m/s with everything physical, but for `changes`."""
    parts: dict[str, object] = {
        "bubbles": mt.HallNovarini(wind_speed=WIND),
        "whitecaps": mt.Whitecaps(wind_speed=WIND),
    }
    return mt.Link(**{**parts, **changes})


def bubbles(**changes: object) -> dict[str, object]:
    """Return changed bubbles."""
    return {"bubbles": mt.HallNovarini(wind_speed=WIND, **changes)}


def physics(**changes: str) -> dict[str, object]:
    """Return changed physics."""
    return {"physics": mt.Physics(**changes)}


PAPER_WATER = mt.Water(phase=mt.FournierForand(cdf_coef="paper"))
CASES: list[tuple[str, str, dict[str, object]]] = [
    ("E1", 'phase `cdf_coef = "paper"`', {"water": PAPER_WATER}),
    ("E2", '`snell = "paper"`', physics(snell="paper")),
    ("E3", '`direction = "paper"`', physics(direction="paper")),
    ("E4", '`fresnel = "paper_both"`', physics(fresnel="paper_both")),
    ("E4", '`fresnel = "roulette"`', physics(fresnel="roulette")),
    ("E5", '`absorption = "implicit"`', physics(absorption="implicit")),
    ("E5", '`absorption = "paper"`', physics(absorption="paper")),
    ("E6", '`free_path = "local_c"`', physics(free_path="local_c")),
    ("E8", 'bubbles `psi = "paper"`', bubbles(psi="paper")),
    ("E8b", "bubbles `q = 2.0`", bubbles(q=2.0)),
    ("E10", 'bubbles `depth = "clamped"`', bubbles(depth="clamped")),
    ("E10", 'bubbles `depth = "mean_level"`', bubbles(depth="mean_level")),
    ("", '`unresolved = "none"`', physics(unresolved="none")),
    ("E11", '`fov = "paper_position"`', physics(fov="paper_position")),
    (
        "E12",
        'whitecaps `"monahan80"`',
        {"whitecaps": mt.Whitecaps(wind_speed=WIND, model="monahan80")},
    ),
    (
        "E12",
        'whitecaps `"paper_0255"`',
        {"whitecaps": mt.Whitecaps(wind_speed=WIND, model="paper_0255")},
    ),
    ("E12", "no whitecaps", {"whitecaps": None}),
    ("E15", '`reflected = "kill"`', physics(reflected="kill")),
    ("E15", '`second_hit = "ignore"`', physics(second_hit="ignore")),
    ("", "no bubbles", {"bubbles": None}),
    (
        "",
        'all forms as published, `physics = "paper"`',
        {
            "physics": mt.Physics.paper(),
            "water": PAPER_WATER,
            "whitecaps": mt.Whitecaps(wind_speed=WIND, model="paper_0255"),
            "bubbles": mt.HallNovarini(wind_speed=WIND, psi="paper", q=2.0, depth="mean_level"),
        },
    ),
]


def wide(link: mt.Link) -> mt.Link:
    """Return the link with an aperture of 0.25 m, for analog photons."""
    return link.model_copy(update={"receiver": mt.Receiver(radius=0.25)})


def table(photons: int = 40_000_000, chains: int = 200_000) -> str:
    """Return the table: gain over the default gain, forced where it can, else analog."""
    sea = JonswapSea(wind_speed=WIND, seed=7, waves="paper")
    base = mt.simulate(default_link(), sea, photons=chains)
    analog = mt.simulate(wide(default_link()), sea, estimator="analog", photons=photons)
    rows = [
        "| erratum | switch | gain over default | standard error | estimator |",
        "|---|---|---|---|---|",
    ]
    for erratum, name, changes in CASES:
        link = default_link(**changes)
        try:
            r, b, how = mt.simulate(link, sea, photons=chains), base, "forced"
            if erratum in ("E15",):
                raise ValueError
        except ValueError:
            r = mt.simulate(wide(link), sea, estimator="analog", photons=photons, seed=2)
            b, how = analog, "analog, r = 0.25 m"
        ratio = r.gain / b.gain
        error = ratio * np.hypot(r.gain_stderr / r.gain, b.gain_stderr / b.gain)
        rows.append(f"| {erratum} | {name} | {ratio:.4f} | {error:.4f} | {how} |")
        print(rows[-1], flush=True)
    head = (
        f"Default gain at {WIND:g} m/s (one sea, seed 7, bubbles and whitecaps on): "
        f"{base.gain:.4e} +- {base.gain_stderr:.1e} (forced), aperture of 0.25 m: "
        f"{analog.gain:.4e} +- {analog.gain_stderr:.1e} (analog).\n\n"
    )
    return head + "\n".join(rows)


if __name__ == "__main__":
    warnings.simplefilter("ignore", mt.DomainWarning)
    write_table("switch", table())
