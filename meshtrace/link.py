"""One link, described: water, bubbles, sources, receivers, and the physics that is wished."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Annotated, Any, Literal, NamedTuple

import pydantic
from pydantic import Field, field_validator, model_validator

from meshtrace.optics.bubbles import HallNovarini
from meshtrace.optics.water import Water

Finite = Annotated[float, Field(allow_inf_nan=False)]
Position = tuple[Finite, Finite]


class _Model(pydantic.BaseModel, frozen=True, extra="forbid"):
    """Validated, frozen, comparable; loads back from its own `model_dump`."""


class _Pointed(_Model, frozen=True):
    position: Position = (0.0, 0.0)
    depth: float = Field(10.0, gt=0.0, le=12_000.0, allow_inf_nan=False)
    zenith_deg: float = Field(0.0, ge=0.0, le=180.0, allow_inf_nan=False)
    azimuth_deg: Finite = 0.0
    power_mw: float = Field(100.0, gt=0.0, allow_inf_nan=False)
    wavelength_nm: float = Field(470.0, ge=200.0, le=1200.0, allow_inf_nan=False)

    @property
    def axis(self) -> tuple[float, float, float]:
        """Unit vector along which the source shines."""
        return _unit(self.zenith_deg, self.azimuth_deg)


class Led(_Pointed, frozen=True):
    """Lambertian lamp under water, I(theta) = (m + 1) / (2 pi) cos^m(theta) per unit power.

    Parameters
    ----------
    depth : float
        Depth below still water [m], 0 < depth <= 12 000.
    half_angle_deg : float
        Half-angle at half power theta_1/2 [deg], 0.001 <= theta_1/2 < 90; the order is
        m = -ln 2 / ln cos theta_1/2.
    position : tuple of float
        Horizontal position (x, y) [m].
    zenith_deg, azimuth_deg : float
        Where the lamp points; 0 is straight up.
    power_mw : float
        Emitted optical power [mW]; the weight of the source in a list of sources.
    wavelength_nm : float
        Wavelength in vacuum [nm].

    Notes
    -----
    Paper, text below eq. theta_phi_ini.

    Examples
    --------
    >>> round(Led(half_angle_deg=10.0).order, 6)
    45.277602
    """

    kind: Literal["led"] = "led"
    half_angle_deg: float = Field(10.0, ge=1e-3, lt=90.0, allow_inf_nan=False)

    @property
    def order(self) -> float:
        """Lambertian order m."""
        return -math.log(2.0) / math.log(math.cos(math.radians(self.half_angle_deg)))


class GaussianBeam(_Pointed, frozen=True):
    """Laser-like beam: Gaussian in position and in angle, 1/e^2 at waist and divergence.

    Parameters
    ----------
    divergence_deg : float
        Half-angle at 1/e^2 of the on-axis intensity [deg], 0 <= divergence < 60.
    waist : float
        Radius at 1/e^2 of the on-axis irradiance at the source [m], >= 0.
    """

    kind: Literal["gaussian-beam"] = "gaussian-beam"
    divergence_deg: float = Field(1.0, ge=0.0, lt=60.0, allow_inf_nan=False)
    waist: float = Field(0.0, ge=0.0, allow_inf_nan=False)


class TopHatBeam(_Pointed, frozen=True):
    """Beam uniform over a disk and over a cone of directions.

    Parameters
    ----------
    divergence_deg : float
        Half-angle of the cone [deg], 0 <= divergence <= 90.
    radius : float
        Radius of the disk [m], >= 0.
    """

    kind: Literal["top-hat-beam"] = "top-hat-beam"
    divergence_deg: float = Field(1.0, ge=0.0, le=90.0, allow_inf_nan=False)
    radius: float = Field(0.0, ge=0.0, allow_inf_nan=False)


class IsotropicSource(_Pointed, frozen=True):
    """Point source that shines equally in all directions."""

    kind: Literal["isotropic"] = "isotropic"


class _AirSource(_Model, frozen=True):
    half_width: float = Field(5.0, gt=0.0, allow_inf_nan=False)
    position: Position = (0.0, 0.0)
    power_mw: float = Field(100.0, gt=0.0, allow_inf_nan=False)
    wavelength_nm: float = Field(470.0, ge=200.0, le=1200.0, allow_inf_nan=False)


class Sun(_AirSource, frozen=True):
    """Collimated light from the air onto a square of the sea.

    Parameters
    ----------
    zenith_deg : float
        Zenith angle of the sun in air [deg], 0 <= zenith < 89.
    azimuth_deg : float
        Direction that the light travels to, from +x counter-clockwise [deg].
    half_width : float
        Half-width of the lit square at still water [m]; every photon starts on it.
    position : tuple of float
        Centre of the square [m].

    Notes
    -----
    Tallies over whole horizontal planes, divided by the power, are those of an infinitely wide
    beam of unit power per unit area: E of the plane over E_d just above the sea.
    """

    kind: Literal["sun"] = "sun"
    zenith_deg: float = Field(0.0, ge=0.0, lt=89.0, allow_inf_nan=False)
    azimuth_deg: Finite = 0.0


class UniformSky(_AirSource, frozen=True):
    """Sky of equal radiance over the upper hemisphere, onto a square of the sea."""

    kind: Literal["uniform-sky"] = "uniform-sky"


class CardioidalSky(_AirSource, frozen=True):
    """Heavily overcast sky, L(theta) ~ 1 + 2 cos theta, onto a square of the sea.

    References
    ----------
    P. Moon and D. E. Spencer, "Illumination from a non-uniform sky", Illum. Eng. 37 (1942).
    """

    kind: Literal["cardioidal-sky"] = "cardioidal-sky"


Source = Annotated[
    Led | GaussianBeam | TopHatBeam | IsotropicSource | Sun | UniformSky | CardioidalSky,
    Field(discriminator="kind"),
]


class Receiver(_Model, frozen=True):
    """Disk that collects light in the air, seen from below.

    A photon counts if it meets the disk within the field of view: |q - center| <= radius and
    d . axis >= cos(fov / 2).

    Parameters
    ----------
    height : float
        Height above still water [m], > 0.
    radius : float
        Radius of the aperture [m], > 0.
    fov_deg : float
        Full angle of the field of view [deg], 0 < fov <= 180.
    position : tuple of float
        Horizontal position (x, y) [m].
    tilt_deg, tilt_azimuth_deg : float
        The receiver looks down; tilt leans its line of sight from nadir towards the azimuth
        (from +x counter-clockwise) [deg], 0 <= tilt < 90.

    Notes
    -----
    The paper tests the position of the surface crossing instead of the angle (eq.
    condition_2), which accepts a superset: `Physics(fov="paper_position")`.
    """

    kind: Literal["receiver"] = "receiver"
    height: float = Field(5.0, gt=0.0, allow_inf_nan=False)
    radius: float = Field(0.05, gt=0.0, allow_inf_nan=False)
    fov_deg: float = Field(60.0, gt=0.0, le=180.0, allow_inf_nan=False)
    position: Position = (0.0, 0.0)
    tilt_deg: float = Field(0.0, ge=0.0, lt=90.0, allow_inf_nan=False)
    tilt_azimuth_deg: Finite = 0.0

    @property
    def center(self) -> tuple[float, float, float]:
        """Centre of the disk [m]."""
        return (*self.position, self.height)

    @property
    def axis(self) -> tuple[float, float, float]:
        """Direction of light at normal incidence: opposite to the line of sight."""
        x, y, z = _unit(self.tilt_deg, self.tilt_azimuth_deg)
        return (-x, -y, z)


class WaterAperture(_Model, frozen=True):
    """Disk that counts light in the water without stopping it.

    Parameters
    ----------
    depth : float
        Depth of its centre [m], > 0.
    radius : float
        Radius [m], > 0.
    fov_deg : float
        Full angle of the field of view [deg], 0 < fov <= 180.
    zenith_deg, azimuth_deg : float
        Direction of the light at normal incidence; 0 counts light that goes up, 180 down.
    """

    kind: Literal["water-aperture"] = "water-aperture"
    depth: float = Field(1.0, gt=0.0, allow_inf_nan=False)
    radius: float = Field(0.05, gt=0.0, allow_inf_nan=False)
    fov_deg: float = Field(180.0, gt=0.0, le=180.0, allow_inf_nan=False)
    position: Position = (0.0, 0.0)
    zenith_deg: float = Field(0.0, ge=0.0, le=180.0, allow_inf_nan=False)
    azimuth_deg: Finite = 0.0

    @property
    def center(self) -> tuple[float, float, float]:
        """Centre of the disk [m]."""
        return (*self.position, -self.depth)

    @property
    def axis(self) -> tuple[float, float, float]:
        """Direction of light at normal incidence."""
        return _unit(self.zenith_deg, self.azimuth_deg)


Aperture = Annotated[Receiver | WaterAperture, Field(discriminator="kind")]


class IrradiancePlanes(_Model, frozen=True):
    """Horizontal planes in the water on which irradiances and radiances are scored.

    Parameters
    ----------
    depths : tuple of float
        Depths [m], > 0, rising.
    n_cosines, n_azimuths : int
        Bins of the radiance in the cosine of the zenith angle of the light's travel
        (from +1, straight up, to -1) and in its azimuth; 0 for none.
    """

    depths: tuple[Annotated[float, Field(gt=0.0, allow_inf_nan=False)], ...]
    n_cosines: int = Field(0, ge=0, le=1000)
    n_azimuths: int = Field(1, ge=1, le=1000)

    @field_validator("depths")
    @classmethod
    def _rising(cls, depths: tuple[float, ...]) -> tuple[float, ...]:
        if not depths or any(b <= a for a, b in pairwise(depths)):
            raise ValueError("allowed at least one depth, strictly rising")
        return depths


class Whitecaps(_Model, frozen=True):
    """Foam on the surface, opaque: T_u = 1 - W multiplies every crossing once.

    Parameters
    ----------
    wind_speed : float
        U10 [m s-1], 0 <= U10 <= 30.
    model : str
        "w_0225": 1 - T_u = 1.2e-5 U^3.3, times (0.225 U - 0.99) above 9 m/s;
        "paper_0255": the same with the printed 0.255; "monahan80": 2.95e-6 U^3.52.

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
        """T_u, not below 0."""
        u = self.wind_speed
        if self.model == "monahan80":
            cover = 2.95e-6 * u**3.52
        else:
            cover = 1.2e-5 * u**3.3
            if u > 9.0:
                cover *= (0.255 if self.model == "paper_0255" else 0.225) * u - 0.99
        return max(1.0 - cover, 0.0)


class Physics(_Model, frozen=True):
    """Switches where the right physics and the paper's printed form differ.

    The first value is the physical default; `Physics.paper()` sets all printed forms.

    Parameters
    ----------
    snell : {"physical", "paper"}
        sin theta_t = n1/n2 sin theta_i, or the printed n2/n1 (E2).
    direction : {"vector", "paper"}
        Vector form of the refracted direction, or the sine of its components (E3).
    fresnel : {"weight", "roulette", "paper_both"}
        Transmittance as weight, as probability, or both as printed (E4).
    absorption : {"continuous", "implicit", "analog", "paper"}
        exp(-a path) with free paths from b; albedo as weight at each scattering; as
        probability; or as printed in Algorithm 1, where every interaction weights by the
        albedo and turns only with that probability (E5).
    free_path : {"exact", "local_c"}
        Delta tracking, or c at the start of the path (E6).
    reflected : {"trace", "kill"}
        Follow light that the surface sends back into the water, or end it (E15).
    second_hit : {"trace", "ignore"}
        Let light in the air meet another wave, or not (E15).
    fov : {"angle", "paper_position"}
        Field of view by angle, or by the printed test of the position (E11).
    unresolved : {"tilt", "none"}
        Tilt the normal at every crossing by random slopes of the waves that the mesh leaves out
        (`TriangleMesh.unresolved`), or bend light at the mesh alone, as in the paper.
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
    def paper(cls) -> Physics:
        """Return all forms as the paper prints them."""
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


WaterSource = Led | GaussianBeam | TopHatBeam | IsotropicSource
"""Sources in the water, which have a depth and an axis."""


class Footprint(NamedTuple):
    """The part of the surface that a link needs, as keyword arguments of `SurfaceModel.mesh`."""

    center: tuple[float, float]
    extent: float
    spacing: float
    fine_extent: float
    coarse_spacing: float


class Link(_Model, frozen=True):
    """A link from sources to receivers through water, surface and air.

    Parameters
    ----------
    water : Water
        Absorption, scattering, refractive index, bottom.
    bubbles : HallNovarini or None
        Bubbles below the surface.
    transmitter : source or tuple of sources
        `Led`, `GaussianBeam`, `TopHatBeam`, `IsotropicSource`, `Sun`, `UniformSky`,
        `CardioidalSky`. Several share the photons in proportion to their power.
    receiver : Receiver, WaterAperture or tuple of them
        Apertures; each has its own gain.
    whitecaps : Whitecaps or None
        Foam on the surface.
    planes : IrradiancePlanes or None
        Irradiance planes in the water.
    n_air : float
        Refractive index of the air.
    physics : Physics, "physical" or "paper"
        Switches between right physics and printed forms.

    Notes
    -----
    `Link()` is the paper's default link (Table of link parameters) without bubbles.
    """

    water: Water = Water()
    bubbles: HallNovarini | None = None
    transmitter: Source | tuple[Source, ...] = Led()
    receiver: Aperture | tuple[Aperture, ...] = Receiver()
    whitecaps: Whitecaps | None = None
    planes: IrradiancePlanes | None = None
    n_air: float = Field(1.0, ge=1.0, le=2.0, allow_inf_nan=False)
    physics: Physics = Physics()

    @field_validator("physics", mode="before")
    @classmethod
    def _preset(cls, physics: Any) -> Any:
        if physics == "physical":
            return Physics()
        if physics == "paper":
            return Physics.paper()
        if isinstance(physics, str):
            raise ValueError('allowed "physical", "paper" or a table of switches')
        return physics

    @model_validator(mode="after")
    def _consistent(self) -> Link:
        if not self.transmitters:
            raise ValueError("transmitter: (), allowed at least one source")
        bottom = self.water.bottom_depth
        for item in (*self.transmitters, *self.receivers):
            depth = getattr(item, "depth", 0.0)
            if bottom is not None and depth >= bottom:
                raise ValueError(
                    f"{item.kind}.depth: {depth:g} m, allowed less than water.bottom_depth "
                    f"{bottom:g} m"
                )
        return self

    @property
    def transmitters(self) -> tuple[Source, ...]:
        """The sources as a tuple."""
        return self.transmitter if isinstance(self.transmitter, tuple) else (self.transmitter,)

    @property
    def receivers(self) -> tuple[Aperture, ...]:
        """The apertures as a tuple."""
        return self.receiver if isinstance(self.receiver, tuple) else (self.receiver,)

    def footprint(self) -> Footprint:
        """Return where the surface must be meshed, and how finely.

        Notes
        -----
        The fine part covers where the unscattered light of a rough sea can cross to a
        receiver: a slope s moves the crossing by beta s with beta = (n-1) h d / (d + n h).
        The extent reaches to where the water leaves e^-6 of the light that goes straight up.
        """
        lateral = [abs(v) for item in (*self.transmitters, *self.receivers) for v in item.position]
        height = max((r.height for r in self.receivers if isinstance(r, Receiver)), default=1.0)
        radius = max((r.radius for r in self.receivers), default=0.0)
        depth = max((getattr(t, "depth", 1.0) for t in self.transmitters), default=1.0)
        n = self.water.n / self.n_air
        beta = (n - 1.0) * height * depth / (depth + n * height)
        fine = max(2.5 * beta + radius + max(lateral), 1.0)
        lamps = any(hasattr(t, "depth") for t in self.transmitters)
        reach = 10.0 * depth if lamps else 50.0
        if self.water.a > 0.0:
            reach = min(reach, math.sqrt((depth + 6.0 / self.water.a) ** 2 - depth**2))
        width = max(
            (t.half_width for t in self.transmitters if hasattr(t, "half_width")), default=0
        )
        extent = fine + max(reach, 5.0) + width
        return Footprint((0.0, 0.0), extent, 0.1, fine, 1.0)


def _unit(zenith_deg: float, azimuth_deg: float) -> tuple[float, float, float]:
    zenith, azimuth = math.radians(zenith_deg), math.radians(azimuth_deg)
    s = math.sin(zenith)
    return s * math.cos(azimuth), s * math.sin(azimuth), math.cos(zenith)
