"""`meshtrace ber`: from the gain to bits."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import typer
from typer import Option

from meshtrace.cli.app import app
from meshtrace.cli.console import finite, numbers, over_seas, scenario_of
from meshtrace.cli.options import (
    SERIES_CHAINS,
    AsJson,
    Chains,
    LinkFile,
    Output,
    Seed,
    Settings,
    Threads,
    Trust,
    grouped,
)
from meshtrace.cli.outputs import check_output, save
from meshtrace.errors import Refused

if TYPE_CHECKING:
    from meshtrace.studies.performance.tables import LinkPerformance


@dataclass(frozen=True)
class Study:
    """Conditions of the bits."""

    bit_rates: str = Option("1e6,5e6,1e7", metavar="LIST", help="Bit rates [bit/s].")
    depths: str | None = Option(
        None, metavar="START:STOP:STEP", help="Depths [m], or a list; needed for the range."
    )
    winds: str | None = Option(
        None, "--wind", metavar="LIST", help="Wind speeds [m/s], such as 0,5,13."
    )
    preset: str | None = Option(None, metavar="NAME", help="physical, paper or paper-ranges.")
    limit: float = Option(1e-3, metavar="BER", help="Largest bit error rate of a working link.")
    realizations: int | None = Option(
        None, "-n", "--realizations", help="Independent seas per depth: 200, or 50 with --depths."
    )


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


@app.command()
@grouped
def ber(
    *,
    link: LinkFile = None,
    study: Study,
    uav: str | None = Option(None, metavar="NAME", help="Airframe that tilts the receiver."),
    light: Light,
    coupled: bool = Option(False, "--coupled", help="Apply the tilt to every photon."),
    output: Output = None,
    as_json: AsJson = False,
    photons: Chains = SERIES_CHAINS,
    seed: Seed = None,
    threads: Threads = None,
    settings: Settings = None,
    trust: Trust = False,
) -> None:
    """Print bit error rate, outage, margin, capacity and range of a link."""
    from meshtrace.mesh import RandomSea
    from meshtrace.studies.performance.link_performance import link_performance
    from meshtrace.studies.performance.tables import DepthSweep

    run = {"photons": photons, "seed": seed, "threads": threads}
    scenarios = []
    for speed in [None] if study.winds is None else numbers("--wind", study.winds):
        given = {"detector.preset": study.preset, "uav.preset": uav, "wind_speed": speed}
        given |= light.changes()
        changes = [f"{key}={value}" for key, value in given.items() if value is not None]
        scenarios.append(scenario_of(link, [*(settings or []), *changes], trust=trust, **run))
    check_output(output, link)
    realizations = study.realizations
    if realizations is None:
        realizations = 200 if study.depths is None else 50
    asked: dict[str, Any] = {
        "bit_rate": numbers("--bit-rates", study.bit_rates),
        "depths": None if study.depths is None else numbers("--depths", study.depths),
        "limit": study.limit,
        "realizations": realizations,
        "coupled": coupled,
    }
    many = [coupled or isinstance(s.surface, RandomSea) for s in scenarios]
    seas = sum(realizations if m else 1 for m in many) * len(asked["depths"] or [0])
    with over_seas(seas, as_json) as step:
        found = [(s.wind_speed, link_performance(s, progress=step, **asked)) for s in scenarios]
    if as_json:
        typer.echo(json.dumps([_plain(*one) for one in found], allow_nan=False))
    else:
        texts = [f"wind {speed:g} m/s\n\n{p.summary()}" for speed, p in found]
        typer.echo("\n\n".join(texts))
    speeds, performances = zip(*found, strict=True)
    result = performances[0] if len(found) == 1 else DepthSweep(speeds, performances)
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
