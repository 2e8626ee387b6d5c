"""Background light of a receiver: rays back to sky and sun, over the same mesh as the link."""

from __future__ import annotations

import math
from typing import Any, Unpack

from meshtrace.daylight.light import Daylight
from meshtrace.engine.backward.above import seen_from_air
from meshtrace.engine.backward.submerged import seen_from_water
from meshtrace.engine.backward.view import only_aperture
from meshtrace.engine.setup.case import HasCase, resolve
from meshtrace.engine.setup.meshing import mesh_for
from meshtrace.engine.setup.options import Meshing, Shortcuts
from meshtrace.errors import Refused, require_kind, require_whole, require_word
from meshtrace.link import Link
from meshtrace.mesh import MeshSource, TriangleMesh
from meshtrace.parallel import default_threads
from meshtrace.results.background import Background
from meshtrace.results.provenance import provenance
from meshtrace.stored import SHIFTS


def background(
    link: Link | HasCase,
    surface: MeshSource | TriangleMesh | None = None,
    day: Daylight | None = None,
    *,
    photons: int = 4096,
    seed: int = 1,
    water: str | None = None,
    mesh: Meshing | None = None,
    threads: int | None = None,
    **options: Unpack[Shortcuts],
) -> Background:
    """Return the background light of the receiver of a link.

    Parameters
    ----------
    link : Link or Scenario
        The link, with one receiver.
    surface : MeshSource or TriangleMesh, optional
        The sea, as in `simulate`.
    day : Daylight, optional
        Light above the sea; by default that of a scenario.
    photons : int
        Rays from the receiver, 32 ... 10 000 000.
    seed : int
        Key of the random numbers.
    water : {"quasi-single", "walk", "none"}, optional
        Light out of the water, by default `day.water`.
    mesh : Meshing, optional
        Time and resolution of the surface.
    threads : int, optional
        Threads, all cores by default; the result does not depend on them.
    **options
        Fields of `Meshing`.

    Returns
    -------
    Background

    Raises
    ------
    Refused
        If an option is out of range, or the link has several receivers.

    Notes
    -----
    Not modelled: Raman scattering, fluorescence, polarised skylight. Beyond the mesh the sea is
    level.

    Examples
    --------
    >>> from meshtrace.surfaces import FlatSea
    >>> found = background(Link(), FlatSea(), Daylight(direct=1.42, diffuse=0.295))
    >>> f"{found.parts['sky']:.2e}"
    '2.08e-03'
    """
    day = getattr(link, "daylight", None) if day is None else day
    require_kind(day, Daylight | None, "day")
    if day is None:
        raise Refused("day", None, "a Daylight")
    require_whole(photons, SHIFTS, 10_000_000, "photons")
    require_whole(seed, 0, 2**64 - 1, "seed")
    if water is not None:
        require_word(water, ("quasi-single", "walk", "none"), "water")
        day = day.replace(water=water)
    case = resolve(link, surface, mesh=mesh, **options)
    found, config = mesh_for(case.link, case.surface, case.meshing)
    run = {"photons": photons, "seed": seed, **case.meshing.model_dump()}
    origin = {**provenance(case.link, config, run), "daylight": day.model_dump(mode="json")}
    inputs = day, photons, seed, case.meshing.normals, default_threads(threads)
    return background_over(case.link, found, *inputs, origin)


def background_over(
    link: Link, mesh: TriangleMesh, day: Daylight, photons: int, seed: int, normals: str,
    threads: int, origin: dict[str, Any],
) -> Background:  # fmt: skip
    """Return the background of the one receiver of a link over a mesh, of checked inputs."""
    aperture = only_aperture(link)
    seen = seen_from_air if aperture.center[2] > 0.0 else seen_from_water
    by_shift = seen(link, mesh, day, photons, seed, normals, threads)
    error = math.sqrt(SHIFTS)
    total = by_shift.sum(axis=1)
    sin2 = math.sin(math.radians(0.5 * aperture.fov_deg)) ** 2
    return Background(
        part_radiance=by_shift.mean(axis=0),
        part_radiance_stderr=by_shift.std(axis=0, ddof=1) / error,
        radiance=float(total.mean()),
        radiance_stderr=float(total.std(ddof=1)) / error,
        acceptance=math.pi**2 * aperture.radius**2 * sin2,
        wavelength_nm=day.wavelength_nm,
        provenance=origin,
    )
