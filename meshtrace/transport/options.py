"""What a run may be asked for besides its link and its sea: when and how, each with its default.

`Sampling` are the keys of [sea] that say how it is triangulated, `Run` is the table [run].
"""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field, field_validator, model_validator

from meshtrace.errors import require_word
from meshtrace.models import Model
from meshtrace.transport.simulate import DEFAULT_PHOTONS


class Sampling(Model, frozen=True):
    """When the sea is triangulated, and how finely.

    Parameters
    ----------
    time : float
        Time of the sea [s].
    extent, spacing : float, optional
        Half-width and spacing of the mesh [m]; by default those of `Link.footprint`.
    """

    time: float = Field(0.0, allow_inf_nan=False)
    extent: float | None = Field(None, gt=0.0, allow_inf_nan=False)
    spacing: float | None = Field(None, gt=0.0, allow_inf_nan=False)


class Run(Model, frozen=True):
    """Options of `meshtrace.transport.simulate`, under the same names.

    Parameters
    ----------
    estimator : {"forced", "analog"}
        How the gain is estimated.
    photons : int
        Chains (forced) or photons (analog); the default is that of `simulate`.
    rtol : float, optional
        Relative standard error to reach.
    seed : int
        Key of the random numbers.
    normals : {"vertex", "facet"}
        Normals of the surface.
    threads : int, optional
        Threads, all cores by default.
    reflected_photons, batch_size, first_photon, max_surface_events, max_events, roulette
        See `meshtrace.transport.simulate`.
    """

    estimator: str = next(iter(DEFAULT_PHOTONS))
    photons: int = Field(ge=1, le=2**53)
    rtol: float | None = Field(None, ge=1e-6, le=1.0, allow_inf_nan=False)
    seed: int = Field(1, ge=0, lt=2**64)
    normals: Literal["vertex", "facet"] = "vertex"
    threads: int | None = Field(None, ge=1, le=1024)
    reflected_photons: int = Field(0, ge=0, le=2**53)
    batch_size: int = Field(2**17, ge=4096, le=2**18, multiple_of=4096)
    first_photon: int = Field(0, ge=0, le=2**53)
    max_surface_events: int = Field(10, ge=1, le=2**31)
    max_events: int = Field(100_000, ge=1, le=2**31)
    roulette: float | None = Field(None, ge=0.0, le=1.0, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _default_photons(cls, data: Any) -> Any:
        estimator = data.get("estimator", next(iter(DEFAULT_PHOTONS)))
        return {"photons": DEFAULT_PHOTONS.get(str(estimator), 1), **data}

    @field_validator("estimator")
    @classmethod
    def _known_estimator(cls, estimator: str) -> str:
        require_word(estimator, DEFAULT_PHOTONS, "estimator")
        return estimator
