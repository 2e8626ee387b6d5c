"""`meshtrace optimize`: the best link within bounds."""

from __future__ import annotations

from typing import Any

from typer import Option

from meshtrace.cli.app import app
from meshtrace.cli.console import numbers, progress
from meshtrace.cli.options import SERIES_CHAINS, Case, Chains, LinkFile, grouped
from meshtrace.cli.outputs import Written
from meshtrace.errors import Refused


@app.command("optimize")
@grouped
def optimize_command(
    *,
    link: LinkFile = None,
    over: list[str] = Option(
        metavar="KEY=LOW,HIGH",
        help="Variable and bounds, such as receiver.fov_deg=6,90; repeatable.",
    ),
    objective: str = Option("outage", metavar="WORD", help="outage, gain, range or margin."),
    hover: str | None = Option(None, metavar="X,Y", help="Std. dev. of the place [m]."),
    realizations: int = Option(64, "-n", "--realizations", min=1, help="Independent seas."),
    quantile: float = Option(0.01, metavar="Q", help="Quantile of the gain for outage."),
    method: str = Option("auto", metavar="WORD", help="auto, bounded, cobyqa or global."),
    written: Written,
    photons: Chains = SERIES_CHAINS,
    case: Case,
) -> None:
    """Search the best values of parameters over common seas, and check them on fresh ones."""
    from meshtrace.studies.optimisation import optimize

    bounds = {}
    for text in over:
        key, equals, values = text.partition("=")
        pair = numbers("--over", values) if equals else []
        if len(pair) != 2:
            raise Refused("--over", text, "KEY=LOW,HIGH, as in receiver.fov_deg=6,90")
        bounds[key] = (pair[0], pair[1])
    hovering = (0.0, 0.0) if hover is None else tuple(numbers("--hover", hover))
    scenario = case.scenario(link)
    written.check(link)
    asked: Any = {
        "objective": objective,
        "hover_std": hovering,
        "realizations": realizations,
        "quantile": quantile,
        "method": method,
        "photons": int(numbers("--photons", photons)[0]),
        "seed": scenario.run.seed,
    }
    with progress(None, False, "candidates", "forced") as (_, advance):
        found = optimize(scenario, over=bounds, progress=advance, **asked)
    written.write(found)
