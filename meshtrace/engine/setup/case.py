"""Inputs of a run: link, surface and options, from a link or a scenario."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol, runtime_checkable

from meshtrace.engine.setup.options import Meshing, Run, run_keys
from meshtrace.errors import Described, Refused, require_keys, require_kind
from meshtrace.fading.resolving import resolve_band
from meshtrace.link import Link
from meshtrace.mesh import MeshSource, TriangleMesh, require_surface
from meshtrace.parallel import default_threads

DEFAULT_WIND_SPEED = 5.0
"""Wind speed of the default sea [m s-1], over a link that names none."""


class Case(NamedTuple):
    """A link over a surface, the options of its run, and further provenance."""

    link: Link
    surface: MeshSource | TriangleMesh
    run: Run = Run()
    meshing: Meshing = Meshing()
    origin: Mapping[str, Any] = MappingProxyType({})

    def with_options(self, mesh: Meshing | None = None, **options: Any) -> Case:
        """Return the case with fields of `Run`, of its estimator and of `Meshing` replaced."""
        require_kind(mesh, Meshing | None, "mesh")
        require_keys(options, list(dict.fromkeys([*Meshing.model_fields, *run_keys()])))
        given = {key: options.pop(key) for key in Meshing.model_fields if key in options}
        meshing = (self.meshing if mesh is None else mesh).replace(**given)
        return self._replace(run=self.run.replace(**options), meshing=meshing)

    def with_waves(self, fading: bool = False) -> Case:
        """Return the case over the sea with the waves that its mesh holds.

        `fading` says whether the answer of the study is about fading, see `resolve_band`.
        """
        surface = resolve_band(self.link, self.surface, self.meshing.waves, fading)
        return self._replace(surface=surface, meshing=self.meshing.replace(waves=None))

    @property
    def threads(self) -> int:
        """Threads of the run, all cores by default."""
        return default_threads(self.run.threads)


@runtime_checkable
class HasCase(Protocol):
    """A description that holds link, surface and options, such as a Scenario."""

    def case(
        self,
        surface: MeshSource | TriangleMesh | None = None,
        fading: bool = False,
        mesh: Meshing | None = None,
        **options: Any,
    ) -> Case:
        """Return the inputs of the run, with other ones where they are given; see `resolve`."""
        ...


def resolve(
    link: Link | HasCase,
    surface: MeshSource | TriangleMesh | None = None,
    fading: bool = False,
    mesh: Meshing | None = None,
    **options: Any,
) -> Case:
    """Return the case of a link and a surface, or of a scenario.

    Parameters
    ----------
    link : Link or Scenario
        A scenario includes its surface and options.
    surface : MeshSource or TriangleMesh, optional
        By default that of the scenario; over a link the JONSWAP sea of the wind of its bubbles
        and whitecaps, or of 5 m/s.
    fading : bool
        Whether the answer of the study is about fading: a sea whose waves were left open then has
        all that make the light of the link fade (`fading.resolve_band`).
    mesh : Meshing, optional
        Time, resolution and waves of the surface.
    **options
        Fields of `Run`, of its estimator and of `Meshing`.

    Returns
    -------
    Case
        With the waves of the mesh in its surface: those of `meshing` are None.

    Raises
    ------
    Refused
        If one of them is something else, or the sea has no such waves.
    """
    if isinstance(link, HasCase):
        return link.case(surface, fading, mesh, **options)
    if not isinstance(link, Link):
        raise Refused("link", Described(type(link).__name__), "a Link or a Scenario")
    if surface is None:
        from meshtrace.surfaces import sea_in_wind

        wind_speed = DEFAULT_WIND_SPEED if link.wind_speed is None else link.wind_speed
        surface = sea_in_wind(wind_speed)
    require_surface(surface)
    return Case(link, surface).with_options(mesh, **options).with_waves(fading)
