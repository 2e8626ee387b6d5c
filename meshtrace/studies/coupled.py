"""The tilt inside of the transport: a flight turns the receiver while the sea moves.

Aperture and field of view of every photon are those of the tilted receiver, instead of the factor
h_alpha behind the transport.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from os import cpu_count
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray


from meshtrace.link import Link
from meshtrace.mesh import SurfaceModel
from meshtrace.studies.series import GainSeries
from meshtrace.transport.forced import SHIFTS, ForcedDetection, Parts, crossing_reach
from meshtrace.transport.simulate import mesh_for, provenance
from meshtrace.uav.airframe import Flight, Uav
from meshtrace.uav.wind import Dryden

FloatArray = NDArray[np.float64]


class CoupledSeries(NamedTuple):
    """Gains with the tilt in them, and the flight that caused it."""

    series: GainSeries
    flight: Flight


def coupled_series(
    link: Link,
    sea: SurfaceModel,
    times: ArrayLike,
    uav: Uav,
    wind: Dryden,
    seed: int = 1,
    *,
    photons: int = 2048,
    normals: Literal["vertex", "facet"] = "vertex",
    extent: float | None = None,
    spacing: float | None = None,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> CoupledSeries:
    """Return the gain over a moving sea under a receiver that a flight tilts.

    At each time the receiver takes the tilt and azimuth of the simulated flight, and the sea its
    mesh: the tilt acts in the cosine of the aperture and in the field of view of every photon.

    Parameters
    ----------
    link : Link
        The link, with one receiver that looks straight down.
    sea : SurfaceModel
        The sea; time moves its waves.
    times : array_like, shape (n,)
        Evenly spaced times [s], n >= 2.
    uav : Uav
        The airframe.
    wind : Dryden
        Wind at the UAV.
    seed : int
        Seed of the chains and of the gusts.
    photons : int
        Chains, drawn with the same numbers at all times.
    normals, extent, spacing, threads
        As in `simulate`; the result does not depend on the threads.
    progress : callable, optional
        Called with 1 after each time.

    Returns
    -------
    CoupledSeries
        Series of the gain, and flight.

    Raises
    ------
    ValueError
        If the receiver is tilted already, or the times are not evenly spaced.

    Notes
    -----
    Departs from the paper, where a separate factor h_alpha = cos(alpha) [alpha <= fov / 2]
    multiplies the gain. That factor is right for light that arrives straight from below. Scattered
    light fills a cone: the gain falls below the factor where a part of the cone leaves the field
    of view, and does not vanish at once beyond its edge. An aperture that is off the axis of the
    light also gains or loses by the azimuth of the tilt, which the factor does not know.

    Examples
    --------
    >>> from meshtrace.surfaces import FlatSea
    >>> calm = Dryden(wind_speed=0.0)
    >>> coupled = coupled_series(Link(), FlatSea(), [0.0, 1.0], Uav(), calm, photons=256)
    >>> coupled.flight.tilt.angle.tolist()
    [0.0, 0.0]
    """
    receiver = receiver_of(link)
    if receiver.tilt_deg != 0.0:
        raise ValueError(f"receiver.tilt_deg: {receiver.tilt_deg}, allowed 0: the flight tilts it")
    flight = uav.simulate_flight(wind, times, seed)
    still = mesh_for(link, sea, float(flight.times[0]), extent, spacing, crossing_reach(link))[0]
    crest = 1.5 * float(still.bounds[1, 2])

    def frame(i: int) -> Parts:
        tilted = _tilted(link, float(flight.tilt.angle[i]), float(flight.tilt.azimuth[i]))
        reach, time = crossing_reach(tilted), float(flight.times[i])
        mesh = mesh_for(tilted, sea, time, extent, spacing, reach)[0]
        return ForcedDetection(tilted, photons, seed, normals, crest=crest).evaluate(mesh)

    parts = []
    with ThreadPoolExecutor(threads or cpu_count() or 1) as pool:
        for part in pool.map(frame, range(len(flight.times))):
            parts.append(part)
            if progress is not None:
                progress(1)
    run = {
        "estimator": "forced",
        "photons": photons,
        "seed": seed,
        "normals": normals,
        "extent": extent,
        "spacing": spacing,
    }
    origin = {
        **provenance(link, sea.to_config(), run),
        "uav": uav.model_dump(mode="json"),
        "wind": wind.model_dump(mode="json"),
    }
    return CoupledSeries(_series_of(parts, flight.times, origin), flight)


def _tilted(link: Link, angle: float, azimuth: float) -> Link:
    tilt = {"tilt_deg": math.degrees(angle), "tilt_azimuth_deg": math.degrees(azimuth)}
    return link.model_copy(update={"receiver": receiver_of(link).model_copy(update=tilt)})


def _series_of(parts: Sequence[Parts], times: FloatArray, origin: dict[str, Any]) -> GainSeries:
    shifts = np.mean([part.scattered[0] for part in parts], axis=0)
    return GainSeries(
        along="time",
        coordinate=times,
        gain=np.array([part.gain[0] for part in parts]),
        gain_stderr=np.array([part.stderr[0] for part in parts]),
        gain_ballistic=np.array([part.ballistic[0] for part in parts]),
        mean_stderr=float(shifts.std(ddof=1) / math.sqrt(SHIFTS)),
        provenance=origin,
    )
