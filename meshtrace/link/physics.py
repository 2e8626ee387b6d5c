"""Physics of the surface crossing: switches and whitecaps."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from meshtrace.errors import require_word
from meshtrace.models import Model

__all__ = [
    "Physics",
    "Whitecaps",
]


class Whitecaps(Model, frozen=True):
    """Opaque foam on the surface, whose transmittance T_u = 1 - W weights every crossing.

    Parameters
    ----------
    wind_speed : float
        U10 [m s-1], 0 <= U10 <= 30.
    model : {"w_0225", "paper_0255", "monahan80"}
        Share 1 - T_u of the surface. "w_0225" has 1.2e-5 U^3.3, times (0.225 U - 0.99) above
        9 m/s, "paper_0255" the same with the published 0.255, "monahan80" 2.95e-6 U^3.52.

    Notes
    -----
    The paper prints 0.255 in eq. T_u (E12). Only 0.225 continues the branch below 9 m/s, so
    that 0.255 is taken for a misprint.

    References
    ----------
    E. C. Monahan and I. O'Muircheartaigh, J. Phys. Oceanogr. 10, 2094 (1980),
    doi:10.1175/1520-0485(1980)010<2094:OPLDOO>2.0.CO;2.

    Examples
    --------
    >>> round(Whitecaps(wind_speed=13.0).transmittance, 8)
    0.8898777
    """

    wind_speed: float = Field(ge=0.0, le=30.0, allow_inf_nan=False)
    model: Literal["w_0225", "monahan80", "paper_0255"] = "w_0225"

    @property
    def transmittance(self) -> float:
        """Transmittance T_u = 1 - W, at least 0."""
        u = self.wind_speed
        if self.model == "monahan80":
            cover = 2.95e-6 * u**3.52
        else:
            cover = 1.2e-5 * u**3.3
            if u > 9.0:
                # 0.225 gives 1.04 at 9 m/s and nearly continues the curve, 0.255 gives 1.31 (E12)
                cover *= (0.255 if self.model == "paper_0255" else 0.225) * u - 0.99
        # the fits exceed the whole surface within the range of wind speeds
        return max(1.0 - cover, 0.0)


class Physics(Model, frozen=True):
    """Switches between the correct physics and the forms as published.

    The first value is the physical default; `Physics.paper()` sets all forms as published.

    Parameters
    ----------
    snell : {"physical", "paper"}
        sin theta_t = n1/n2 sin theta_i, or the published n2/n1 (E2).
    direction : {"vector", "paper"}
        Vector form of the refracted direction, or the sine of its components (E3).
    fresnel : {"weight", "roulette", "paper_both"}
        Transmittance as weight, as probability, or both as published (E4).
    absorption : {"continuous", "implicit", "analog", "paper"}
        exp(-a path) with free paths from b; albedo as weight at each scattering; as
        probability; or as in Algorithm 1, where every interaction weights by the
        albedo and turns only with that probability (E5).
    free_path : {"exact", "local_c"}
        Delta tracking, or c at the start of the path (E6).
    reflected : {"trace", "kill"}
        Follow light that the surface sends back into the water, or end it (E15).
    second_hit : {"trace", "ignore"}
        Let light in the air meet another wave, or not (E15).
    fov : {"angle", "paper_position"}
        Field of view by angle, or by the paper's test of the position (E11).
    unresolved : {"tilt", "none"}
        Tilt the normal at every crossing by random slopes of the waves that the mesh leaves out, or
        not: light is then bent at the mesh alone, as in the paper (`TriangleMesh.unresolved`).
    """

    snell: Literal["physical", "paper"] = "physical"
    direction: Literal["vector", "paper"] = "vector"
    fresnel: Literal["weight", "roulette", "paper_both"] = "weight"
    absorption: Literal["continuous", "implicit", "analog", "paper"] = "continuous"
    free_path: Literal["exact", "local_c"] = "exact"
    reflected: Literal["trace", "kill"] = "trace"
    second_hit: Literal["trace", "ignore"] = "trace"
    fov: Literal["angle", "paper_position"] = "angle"
    unresolved: Literal["tilt", "none"] = "tilt"

    @classmethod
    def preset(cls, name: str) -> Physics:
        """Return the switches of a preset: "physical" or "paper"."""
        presets = {"physical": cls(), "paper": cls.paper()}
        require_word(name, presets, "physics")
        return presets[name]

    @classmethod
    def paper(cls) -> Physics:
        """Return the physics with all forms as published."""
        return cls(
            snell="paper",
            direction="paper",
            fresnel="paper_both",
            absorption="paper",
            free_path="local_c",
            reflected="kill",
            second_hit="ignore",
            fov="paper_position",
            unresolved="none",
        )
