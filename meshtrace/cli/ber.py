"""`meshtrace ber`: from the gain to bits."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated, Any

import typer

from meshtrace.cli.app import app
from meshtrace.cli.console import (
    finite,
    numbers,
    over_seas,
    scenario_of,
    warnings_as_lines,
)
from meshtrace.cli.options import (
    SERIES_CHAINS,
    AsJson,
    Chains,
    LinkFile,
    Output,
    Seed,
    Settings,
    Threads,
)
from meshtrace.files import check_writable

if TYPE_CHECKING:
    from meshtrace.scenario import Scenario
    from meshtrace.studies.performance.tables import LinkPerformance


@app.command()
def ber(
    link: LinkFile = None,
    bit_rates: Annotated[
        str, typer.Option(metavar="LIST", help="Bit rates [bit/s], as in 1e6,5e6,1e7.")
    ] = "1e6,5e6,1e7",
    depths: Annotated[
        str | None,
        typer.Option(metavar="START:STOP:STEP", help="Depths [m], or a list; for the range."),
    ] = None,
    winds: Annotated[
        str | None,
        typer.Option("--wind", metavar="LIST", help="Wind speeds [m/s], as in 0,5,13."),
    ] = None,
    preset: Annotated[
        str | None, typer.Option(metavar="NAME", help="physical, paper or paper-ranges.")
    ] = None,
    limit: Annotated[
        float, typer.Option(metavar="BER", help="Bit error rate that counts as success.")
    ] = 1e-3,
    realizations: Annotated[
        int | None,
        typer.Option(
            "--realizations", "-n", help="Independent seas at each depth: 200, or 50 with --depths."
        ),
    ] = None,
    uav: Annotated[
        str | None, typer.Option(metavar="NAME", help="Airframe that tilts the receiver.")
    ] = None,
    coupled: Annotated[
        bool, typer.Option("--coupled", help="Let the tilt act on every photon.")
    ] = False,
    output: Output = None,
    as_json: AsJson = False,
    photons: Chains = SERIES_CHAINS,
    seed: Seed = None,
    threads: Threads = None,
    settings: Settings = None,
) -> None:
    """Print bit error rate, outage, margin, capacity and range of a link."""
    from meshtrace.studies.performance.link_performance import link_performance

    given = {"detector.preset": preset, "uav.preset": uav}
    changes = [f"{key}={value}" for key, value in given.items() if value is not None]
    options = {"photons": photons, "seed": seed, "threads": threads}
    speeds = [None] if winds is None else numbers("--wind", winds)
    scenarios = [
        scenario_of(
            link,
            [*(settings or []), *changes, *([] if u is None else [f"wind_speed={u}"])],
            options,
        )
        for u in speeds
    ]
    if output is not None:
        check_writable(output, [link])
    if realizations is None:
        realizations = 200 if depths is None else 50
    asked: dict[str, Any] = {
        "bit_rate": numbers("--bit-rates", bit_rates),
        "depths": None if depths is None else numbers("--depths", depths),
        "limit": limit,
        "realizations": realizations,
        "coupled": coupled,
    }
    seas = sum(_seas(s, realizations, coupled) for s in scenarios) * len(asked["depths"] or [0])
    with warnings_as_lines(), over_seas(seas, as_json) as step:
        found = [(s.wind_speed, link_performance(s, progress=step, **asked)) for s in scenarios]
    if as_json:
        typer.echo(json.dumps(_performance_data(found), allow_nan=False))
    for speed, performance in () if as_json else found:
        typer.echo(f"wind {speed:g} m/s\n\n{performance.summary()}\n")
    if output is not None:
        _sweep(found).save(output)
        if not as_json:
            typer.echo(f"written to {output}")


def _seas(scenario: Scenario, realizations: int, coupled: bool) -> int:
    """Return the number of surfaces per depth of a link's performance."""
    from meshtrace.mesh import RandomSea

    return realizations if coupled or isinstance(scenario.surface, RandomSea) else 1


def _sweep(found: list[tuple[float, LinkPerformance]]) -> Any:
    """Return the result to save: one performance, or those of several winds."""
    from meshtrace.studies.performance.tables import DepthSweep

    if len(found) == 1:
        return found[0][1]
    return DepthSweep(tuple(u for u, _ in found), tuple(p for _, p in found))


def _performance_data(found: list[tuple[float, LinkPerformance]]) -> list[dict[str, Any]]:
    """Return performances as plain data for JSON."""
    return [
        {
            "wind_speed": speed,
            "limit": performance.limit,
            "confidence": performance.confidence,
            "status": performance.status,
            "figures": [finite(figures) for figures in performance.figures],
            "ranges": [
                {"bit_rate": rate, "range": finite(value)}
                for rate, value in zip(
                    performance.bit_rates, performance.range_at_ber(), strict=True
                )
            ],
            "provenance": performance.provenance,
        }
        for speed, performance in found
    ]
