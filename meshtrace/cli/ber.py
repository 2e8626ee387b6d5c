"""The work of `meshtrace ber`: from the gain to bits."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import typer
from typer import Option

from meshtrace.cli.console import finite, progress
from meshtrace.cli.made import Study
from meshtrace.cli.options import AsJson, Changes, LinkFile, Output, Seed, Threads
from meshtrace.cli.outputs import check_output, save
from meshtrace.cli.reading import numbers
from meshtrace.errors import Refused

if TYPE_CHECKING:
    from meshtrace.studies.performance import LinkPerformance


@dataclass(frozen=True)
class Light:
    """Light of the day at the receiver."""

    daylight: str | None = Option(
        None, metavar="NAME", help="clear, overcast, uniform, moon, night or none."
    )
    sun_zenith: float | None = Option(None, metavar="DEG", help="Zenith angle of sun or moon.")
    sun_elevation: float | None = Option(None, metavar="DEG", help="90 minus the zenith angle.")
    filter_nm: float | None = Option(None, metavar="NM", help="Width of the optical filter.")

    def changes(self) -> dict[str, Any]:
        """Return the settings of the link file; an angle alone stands for a clear sky."""
        zenith = self.sun_zenith
        if self.sun_elevation is not None:
            if zenith is not None:
                raise Refused("--sun-elevation", self.sun_elevation, "without --sun-zenith")
            if not 1.0 <= self.sun_elevation <= 90.0:
                allowed = "1 to 90 (below the horizon: --daylight night)"
                raise Refused("--sun-elevation", self.sun_elevation, allowed)
            zenith = 90.0 - self.sun_elevation
        filtered = {"detector.optics.filter_width_nm": self.filter_nm}
        if self.daylight is None and zenith is None:
            return filtered
        model = self.daylight or "clear"
        return {"daylight.model": model, "daylight.sun_zenith_deg": zenith, **filtered}


def ber(
    study: Study,
    asked: dict[str, Any],
    *,
    link: LinkFile = None,
    realizations: int | None = Option(
        None, "-n", "--realizations", help="Independent seas per depth: 200, or 50 with --depths."
    ),
    winds: str | None = Option(
        None, "--wind", metavar="LIST", help="Wind speeds [m/s], such as 0,5,13."
    ),
    preset: str | None = Option(None, metavar="NAME", help="physical, paper or paper-ranges."),
    uav: str | None = Option(None, metavar="NAME", help="Airframe that tilts the receiver."),
    light: Light,
    coupled: bool = Option(False, "--coupled", help="Apply the tilt to every photon."),
    output: Output = None,
    as_json: AsJson = False,
    seed: Seed = None,
    threads: Threads = None,
    changes: Changes,
) -> None:
    """Evaluate a link in each wind."""
    from meshtrace.mesh import RandomSea
    from meshtrace.studies.performance import DepthSweep
    from meshtrace.uav.airframe import Flight

    given = {"detector.preset": preset, "uav.preset": uav, **light.changes()}
    given |= {"run.seed": seed, "run.threads": threads}
    speeds = [None] if winds is None else numbers("--wind", winds)
    scenarios = [changes.scenario(link, given | {"wind_speed": speed}) for speed in speeds]
    check_output(output, link)
    if realizations is None:
        realizations = 50 if "depths" in asked else 200
    many = [coupled or isinstance(s.surface, RandomSea) for s in scenarios]
    seas = sum(realizations if m else 1 for m in many) * len(asked.get("depths", [0]))
    asked["realizations"] = realizations
    flights = [Flight(s.uav, coupled=True) if coupled and s.uav else None for s in scenarios]
    if coupled and None in flights:
        raise Refused("--coupled", True, "with an aircraft that tilts the receiver")
    with progress(seas, as_json, study.doing, study.kernels) as (_, advance):
        found = [
            (s.wind_speed, study.functions[0](s, flight=flight, progress=advance, **asked))
            for s, flight in zip(scenarios, flights, strict=True)
        ]
    if as_json:
        typer.echo(json.dumps([_plain(*one) for one in found], allow_nan=False))
    else:
        texts = [f"wind {speed:g} m/s\n\n{p.summary()}" for speed, p in found]
        typer.echo("\n\n".join(texts))
    winds_of, performances = zip(*found, strict=True)
    result = performances[0] if len(found) == 1 else DepthSweep(winds_of, performances)
    save(result, output, as_json)


def _plain(speed: float, performance: LinkPerformance) -> dict[str, Any]:
    """Return the performance in a wind as plain data for JSON."""
    ranges = zip(performance.bit_rates, performance.range_at_ber(), strict=True)
    return {
        "wind_speed": speed,
        "limit": performance.limit,
        "confidence": performance.confidence,
        "status": performance.status,
        "light": performance.light,
        "figures": finite(performance.figures),
        "ranges": [{"bit_rate": rate, "range": finite(value)} for rate, value in ranges],
        "provenance": performance.provenance,
    }
