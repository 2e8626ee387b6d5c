"""Hovering multirotor: balance of wind and thrust, tilt of the receiver that it carries."""

from __future__ import annotations

from typing import Annotated, Literal, NamedTuple

import numpy as np
import pydantic
from numpy.typing import ArrayLike

from meshtrace.checks import Shape
from meshtrace.errors import Described, Refused, require_between, require_kind
from meshtrace.models import Floats, Model, Positive

from .tilt import ExactTiltLaw, GammaTiltLaw, TiltFactors, h_alpha
from .wind import Dryden, squared_wind_moments

GRAVITY = 9.81  # [m s-2], the paper's value


class Tilt(NamedTuple):
    """Tilt of the receiver: `angle` from the vertical and `azimuth` of its line of sight [rad].

    The airframe leans into the wind, so the line of sight of a receiver fixed under it leans
    down-wind: it points along (sin angle cos azimuth, sin angle sin azimuth, -cos angle).
    """

    angle: Floats
    azimuth: Floats


class Uav(Model, frozen=True):
    """Hovering multirotor that balances the wind's drag by tilting.

    tan(alpha) = K V^2,  K = C_D rho A / (2 m g)

    Parameters
    ----------
    mass : float
        Take-off mass m [kg].
    drag_coefficient : float
        C_D [1].
    area : float
        Equivalent flat area A [m2].
    air_density : float
        rho [kg m-3]; the paper's 1.293 is air at 0 degrees C, tropical air has 1.17 (K -9.5 %).
    gimbal : bool
        Receiver on a gimbal that holds it vertical: its tilt is 0.

    Notes
    -----
    V^2 contains the vertical gust, as in the paper. Balance of the horizontal forces would take the
    horizontal wind only; the vertical part adds less than 1 % to E[V^2].

    References
    ----------
    Palomaki et al. (2017), J. Atmos. Oceanic Technol. 34, 1183, doi:10.1175/JTECH-D-16-0177.1.

    Examples
    --------
    >>> round(UAVS["dji-m300-rtk"].tilt_coefficient, 9)
    0.001574723
    """

    mass: Positive = 8.37
    drag_coefficient: Positive = 0.8
    area: Positive = 0.25
    air_density: float = pydantic.Field(default=1.293, gt=0.0, le=2.0, allow_inf_nan=False)
    gimbal: bool = False

    @property
    def tilt_coefficient(self) -> float:
        """K = C_D rho A / (2 m g) [s2 m-2]."""
        return self.drag_coefficient * self.air_density * self.area / (2.0 * self.mass * GRAVITY)

    def tilt(self, wind: Annotated[ArrayLike, Shape("... 3")]) -> Tilt:
        """Return the tilt of the receiver in a wind, alpha = arctan(K V^2), down-wind.

        Parameters
        ----------
        wind : array_like
            Wind vectors (..., 3) [m s-1], such as those of `Dryden.simulate_wind`.

        Returns
        -------
        Tilt
            Angle and azimuth (...) [rad]; zeros behind a gimbal.
        """
        v = np.asarray(wind)
        if self.gimbal:
            return Tilt(np.zeros(v.shape[:-1]), np.zeros(v.shape[:-1]))
        angle = np.arctan(self.tilt_coefficient * np.sum(v * v, axis=-1))
        return Tilt(angle, np.arctan2(v[..., 1], v[..., 0]))

    def tilt_law(
        self, wind: Dryden, law: Literal["exact", "gamma"] = "exact"
    ) -> ExactTiltLaw | GammaTiltLaw:
        """Return the law of the tilt angle in a wind.

        Parameters
        ----------
        wind : Dryden
            Wind at the UAV.
        law : {"exact", "gamma"}
            Exact law of V^2 (three Gaussian components), or the paper's Gamma law of the same mean
            and variance.

        Returns
        -------
        ExactTiltLaw or GammaTiltLaw
            The law.

        Raises
        ------
        Refused
            If the tilt does not vary (gimbal or calm), or `law` is not one of the two names.
        """
        # a constant tilt has no density
        if self.gimbal or not np.all(wind.std > 0.0):
            raise Refused("tilt_law", Described("constant tilt"), "no gimbal, a wind with gusts")
        mean_wind, std = wind.mean_wind, wind.std
        if law == "exact":
            # gusts across the wind have the deviation of those along it
            return ExactTiltLaw(
                tilt_coefficient=self.tilt_coefficient,
                mean_speed=mean_wind[0],
                std_horizontal=std[0],
                std_vertical=std[2],
            )
        mean, variance = squared_wind_moments(mean_wind, std)
        # a Gamma law has the mean k b and the variance k b^2
        return GammaTiltLaw(
            tilt_coefficient=self.tilt_coefficient, shape=mean**2 / variance, scale=variance / mean
        )

    def tilt_factors(self, wind: Dryden, fov: float) -> TiltFactors:
        """Return the law of the factor h_alpha in a wind; a single value for a constant tilt.

        Parameters
        ----------
        wind : Dryden
            Wind at the UAV.
        fov : float
            Full field of view [rad].
        """
        require_kind(wind, Dryden, "wind")
        if self.gimbal or not np.all(wind.std > 0.0):
            angle = self.tilt(wind.mean_wind[None]).angle
            return TiltFactors(h_alpha(angle, fov), np.ones(1), None, fov)
        return self.tilt_law(wind).factors(fov)


class Flight(NamedTuple):
    """An aircraft in a wind: the tilt of the receiver that it carries.

    Parameters
    ----------
    uav : Uav
        Airframe.
    wind : Dryden, optional
        Wind at the aircraft; by default that over the sea, at the height of the receiver.
    coupled : bool
        Whether the tilt acts on every photon, rather than as a factor h_alpha on the gain; a time
        series is always coupled.
    time_step : float
        Time between the realizations of a coupled link performance [s].
    """

    uav: Uav = Uav()
    wind: Dryden | None = None
    coupled: bool = False
    time_step: float = 0.5

    def checked(self) -> Flight:
        """Return the flight; refuse fields of a wrong type."""
        require_kind(self.uav, Uav, "flight.uav")
        require_kind(self.wind, Dryden | None, "flight.wind")
        require_kind(self.coupled, bool, "flight.coupled")
        require_between(self.time_step, 0.0, 1e6, "flight.time_step")
        return self


UAVS: dict[str, Uav] = {
    "dji-m300-rtk": Uav(),
    "dji-m300-rtk-no-payload": Uav(mass=6.3),
    "dji-m300-rtk-max-takeoff": Uav(mass=9.0),
}
"""Airframes by name. The paper's mass is 8.37 kg; drag coefficient and area are the paper's CFD
estimates for all three."""
