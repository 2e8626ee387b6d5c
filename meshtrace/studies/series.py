"""Many surfaces with one set of chains: moving seas, flights, ensembles."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import chain, islice
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshtrace.errors import Refused, require_finite, require_kind, require_whole
from meshtrace.fading.resolving import band_fading
from meshtrace.link import Link
from meshtrace.mesh import MeshSource, SurfaceModel, TriangleMesh
from meshtrace.models import Floats
from meshtrace.parallel import ordered_map, paced, trim_memory
from meshtrace.results.series import GainSeries
from meshtrace.stored import SHIFTS
from meshtrace.studies.inputs import Inputs, resolve_chains
from meshtrace.transport.forced import MANY_SEAS, ForcedDetection, TypicalSea
from meshtrace.transport.parts import Parts
from meshtrace.uav.airframe import Flight, FlightRecord, Uav
from meshtrace.uav.route import Route
from meshtrace.uav.wind import Dryden

if TYPE_CHECKING:
    from meshtrace.scenario import Scenario

_STATISTICS = 50  # gains, the least for a comparison with the closed form
_TRIM_EVERY = 16  # surfaces, after which free memory returns to the system


def time_series(
    link: Link | Scenario,
    surface: MeshSource | None = None,
    times: ArrayLike | None = None,
    *,
    flight: Flight | None = None,
    route: Route | None = None,
    photons: int | None = None,
    seed: int | None = None,
    normals: Literal["vertex", "facet"] | None = None,
    extent: float | None = None,
    spacing: float | None = None,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> GainSeries:
    """Return the gain over a moving sea, by forced detection with one set of chains.

    Parameters
    ----------
    link : Link or Scenario
        The link, or a scenario: `time_series(scenario, times)`. Options that are not given are
        those of the scenario.
    surface : MeshSource, optional
        The sea, whose phases stay while time moves its waves, or meshes in time. A sea whose band
        is left open has all waves that make the light of the link fade (`fading.resolve_band`).
    times : array_like, shape (n,)
        Times [s]; evenly spaced with a flight.
    flight : Flight, optional
        Aircraft that tilts the receiver, or the lamp of a downlink, whose own tilt has to be 0.
        The tilt acts in the cosine of the aperture and in the field of view of every photon, or
        in the pattern of the lamp.
    route : Route, optional
        Waypoints of the receiver, or the lamp of a downlink, whose own position they replace.
    photons : int, optional
        Chains, common to all times; 2048 by default.
    seed : int, optional
        Seed of the chains and of the gusts, 1 by default.
    normals, extent, spacing, threads
        As in `simulate`; the result does not depend on the threads.
    progress : callable, optional
        Called with 1 after each time.

    Returns
    -------
    GainSeries

    Raises
    ------
    Refused
        If an option is out of range, or a flight tilts a receiver that is tilted already.

    Notes
    -----
    All times share the chains: the Monte Carlo noise is common to them and cancels in
    differences.

    From 50 gains on, the provenance holds the closed form of the scintillation index of unscattered
    light (`fading.band_fading`), which `GainSeries.summary` prints beside the measured one, and a
    warning is issued if the band of waves omits more than a tenth of the fading.

    With a flight it departs from the paper, where a separate factor h_alpha = cos(alpha)
    [alpha <= fov / 2] multiplies the gain. That factor is right for light that arrives straight
    from below. Scattered light fills a cone: the gain falls below the factor where a part of the
    cone leaves the field of view, and does not vanish at once beyond its edge. An aperture off
    the axis of the light also gains or loses by the azimuth of the tilt, which the factor omits.

    Examples
    --------
    >>> import meshtrace as mt
    >>> from meshtrace.surfaces import FlatSea
    >>> flight = mt.Flight(mt.Uav(), mt.Dryden(wind_speed=13.0))
    >>> level = mt.time_series(mt.Link(), FlatSea(), [0.0, 1.0], photons=256)
    >>> flown = mt.time_series(mt.Link(), FlatSea(), [0.0, 1.0], photons=256, flight=flight)
    >>> (flown.gain < level.gain).all()
    np.True_
    """
    if times is None and not isinstance(surface, MeshSource):
        surface, times = None, surface
    inputs = resolve_chains(
        link, surface, fading=True, photons=photons, seed=seed, normals=normals, extent=extent,
        spacing=spacing, threads=threads,
    )  # fmt: skip
    at = require_finite(times, "times", "finite times (n,) [s], n >= 1")
    require_kind(flight, Flight | None, "flight")
    require_kind(route, Route | None, "route")
    flight = flight and flight.checked()
    if inputs.scenario is not None and inputs.scenario.meshing.time != 0.0:
        raise Refused("sea.time", inputs.scenario.meshing.time, "0 with times")
    series = over_times(inputs, at, flight, progress, route)
    return series if flight or route else _beside_closed_form(inputs, series)


def over_times(
    inputs: Inputs,
    times: Floats,
    flight: Flight | None = None,
    progress: Callable[[int], None] | None = None,
    route: Route | None = None,
) -> GainSeries:
    """Return the gains at times (n,) [s] of resolved inputs, see `time_series`."""
    origin = inputs.provenance()
    if flight is None and route is None:
        parts = common_chains(inputs, ((inputs.surface, float(t)) for t in times))
        return gain_series(inputs.link, "time", times, parts, origin, progress)
    changes: dict[str, Any] = {}
    if flight is not None:
        origin |= inputs.of_flight(flight)
        changes |= _tilts(inputs, times, flight)
    if route is not None:
        origin["route"] = route.model_dump(mode="json")
        changes |= route.at(times, inputs.link.air_end[1].height)._asdict()
    rows = [dict(zip(changes, row, strict=True)) for row in zip(*changes.values(), strict=True)]
    parts = _frames(inputs, times, [_moved(inputs.link, row) for row in rows])
    return gain_series(inputs.link, "time", times, parts, origin, progress)


def ensemble(
    link: Link | Scenario,
    n_realizations: int,
    surface: SurfaceModel | None = None,
    *,
    wind_speed: float | None = None,
    photons: int | None = None,
    seed: int | None = None,
    normals: Literal["vertex", "facet"] | None = None,
    time: float | None = None,
    extent: float | None = None,
    spacing: float | None = None,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> GainSeries:
    """Return the gains over independent realizations of a sea, by forced detection.

    Parameters
    ----------
    link : Link or Scenario
        The link, or a scenario; options that are not given are those of the scenario.
    n_realizations : int
        Realizations, each with its own random phases.
    surface : SurfaceModel with seed, optional
        The sea; by default that of `wind_speed`. A sea whose band is left open has all waves that
        make the light of the link fade (`fading.resolve_band`).
    wind_speed : float, optional
        Wind of the default sea [m s-1]: that of the link's bubbles or whitecaps, or 5.
    photons : int, optional
        Chains, common to all realizations; 2048 by default.
    seed : int, optional
        Seed of the chains, 1 by default, and, by `numpy.random.SeedSequence([seed, i])`, of the
        phases of realization i.
    normals, time, extent, spacing, threads
        As in `simulate`; the result does not depend on the threads.
    progress : callable, optional
        Called with 1 after each realization.

    Returns
    -------
    GainSeries

    Notes
    -----
    From 50 gains on, the provenance holds the closed form of the scintillation index of unscattered
    light (`fading.band_fading`), which `GainSeries.summary` prints beside the measured one, and a
    warning is issued if the band of waves omits more than a tenth of the fading.
    """
    require_whole(n_realizations, 1, 10_000_000, "n_realizations")
    if surface is None and wind_speed is not None:
        from meshtrace.surfaces import sea_in_wind

        surface = sea_in_wind(wind_speed)
    inputs = resolve_chains(
        link, surface, fading=True, photons=photons, seed=seed, normals=normals, time=time,
        extent=extent, spacing=spacing, threads=threads,
    )  # fmt: skip
    return _beside_closed_form(inputs, over_realizations(inputs, n_realizations, progress))


def over_realizations(
    inputs: Inputs, n_realizations: int, progress: Callable[[int], None] | None = None
) -> GainSeries:
    """Return the gains over random phases of resolved inputs, see `ensemble`."""
    seeds, surfaces = inputs.realizations(n_realizations)
    parts = common_chains(inputs, surfaces)
    return gain_series(inputs.link, "realization", seeds, parts, inputs.provenance(), progress)


def closed_form(link: Link, sea: MeshSource, n: int, level: int = 3) -> dict[str, Any]:
    """Return `fading.band_fading` as plain data, empty below 50 surfaces; warn of a short band.

    `level` is the stack level of the warning.
    """
    found = band_fading(link, sea) if n >= _STATISTICS else None
    if found is None:
        return {}
    text = found.warning()
    if text:
        warnings.warn(text, stacklevel=level + 1)
    return {"closed_form": found._asdict()}


def _beside_closed_form(inputs: Inputs, series: GainSeries) -> GainSeries:
    """Add the closed form of the scintillation index to a series; warn of a short band."""
    found = closed_form(inputs.link, inputs.surface, len(series.coordinate))
    return replace(series, provenance={**series.provenance, **found})


def common_chains(
    inputs: Inputs, surfaces: Iterator[tuple[MeshSource, float]], lit: Link | None = None
) -> Iterator[Parts]:
    """Yield the parts of the gain over each surface and time, with one set of chains.

    Each mesh is made in the thread that evaluates it, as far as the light of `lit` crosses, by
    default that of the link.
    """

    def mesh(surface: tuple[MeshSource, float]) -> TriangleMesh:
        return inputs.mesh(lit or inputs.link, *surface)

    def evaluate(surface: TriangleMesh | tuple[MeshSource, float]) -> Parts:
        return forced.evaluate(surface if isinstance(surface, TriangleMesh) else mesh(surface))

    first = [mesh(surface) for surface in islice(surfaces, 4)]
    typical = TypicalSea.of(first, MANY_SEAS)
    run, normals = inputs.run, inputs.meshing.normals
    forced = ForcedDetection(inputs.link, run.photons, run.seed, normals, sea=typical)
    jobs: Iterator[TriangleMesh | tuple[MeshSource, float]] = chain(first, surfaces)
    return ordered_map(evaluate, jobs, inputs.threads)


def _tilts(inputs: Inputs, times: Floats, flight: Flight) -> dict[str, Floats]:
    """Return the tilt of the end in the air at each time of a flight [deg]."""
    name, end = inputs.link.air_end
    if end.tilt_deg != 0.0:
        raise Refused(f"{name}.tilt_deg", end.tilt_deg, "0: the flight tilts it")
    record = flight.uav.simulate_flight(inputs.wind_of(flight), times, inputs.run.seed)
    tilt_deg, azimuth_deg = np.degrees(record.tilt)
    return {"tilt_deg": tilt_deg, "tilt_azimuth_deg": azimuth_deg}


def flown_links(inputs: Inputs, times: Floats, flight: Flight) -> list[Link]:
    """Return the link at each time of a flight, its end in the air tilted."""
    tilts = _tilts(inputs, times, flight)
    rows = zip(*tilts.values(), strict=True)
    return [_moved(inputs.link, dict(zip(tilts, row, strict=True))) for row in rows]


def _moved(link: Link, changes: dict[str, Any]) -> Link:
    """Return a link with other values of its end in the air."""
    name, end = link.air_end
    plain = {key: np.asarray(value).tolist() for key, value in changes.items()}
    return link.model_copy(update={name: end.model_copy(update=plain)})


def _frames(inputs: Inputs, times: Floats, links: list[Link]) -> Iterator[Parts]:
    """Yield the parts of the gain of a link at each time, with chains of the same numbers."""
    sea, run, normals = inputs.surface, inputs.run, inputs.meshing.normals
    typical = TypicalSea.of([inputs.mesh(links[0], sea, float(times[0]))], MANY_SEAS)

    def frame(i: int) -> Parts:
        mesh = inputs.mesh(links[i], sea, float(times[i]))
        forced = ForcedDetection(links[i], run.photons, run.seed, normals, sea=typical)
        return forced.evaluate(mesh)

    return ordered_map(frame, range(len(times)), inputs.threads)


def gain_series(
    link: Link,
    along: Literal["time", "realization"],
    coordinate: NDArray[Any],
    parts: Iterator[Parts],
    origin: dict[str, Any],
    progress: Callable[[int], None] | None,
) -> GainSeries:
    """Return the series of the parts over each surface."""
    n, n_rx = len(coordinate), len(link.receivers)
    columns, shifts = np.empty((3, n, n_rx)), np.zeros((n_rx, SHIFTS))
    for i, part in enumerate(paced(parts, n, f"{n:,} seas")):
        columns[:, i] = part.gain, part.stderr, part.ballistic
        shifts += part.shifts
        if i % _TRIM_EVERY == 0:
            trim_memory()
        if progress is not None:
            progress(1)
    mean_stderr = (shifts / max(n, 1)).std(axis=1, ddof=1) / np.sqrt(SHIFTS)
    kept: Any = slice(None) if isinstance(link.receiver, tuple) else 0
    gain, stderr, ballistic = columns[..., kept]
    return GainSeries(along, coordinate, gain, stderr, ballistic, mean_stderr[kept], origin)


class CoupledSeries(NamedTuple):
    """Gains with the tilt in them, and the flight that caused it."""

    series: GainSeries
    flight: FlightRecord


def coupled_series(
    link: Link,
    sea: SurfaceModel,
    times: ArrayLike,
    uav: Uav,
    wind: Dryden,
    seed: int = 1,
    **options: Any,
) -> CoupledSeries:
    """Return a time series with a flight; use `time_series(..., flight=Flight(uav, wind))`."""
    warnings.warn("use time_series(..., flight=Flight(uav, wind))", DeprecationWarning, 2)
    flight = Flight(uav, wind)
    series = time_series(link, sea, times, flight=flight, seed=seed, **options)
    return CoupledSeries(series, uav.simulate_flight(wind, times, seed))
