"""The 24 links on which the estimators of the scattered light are compared, for estimators.md.

They span clear, coastal and harbour water; receivers on the axis, aside, tilted, of narrow and wide
view; still water, waves with random slopes and waves resolved without them; lamps, lasers and
extended lamps; light that goes up and down; four phase functions; a bottom, layers and bubbles.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import meshtrace as mt
from meshtrace.engine.setup.ends import crossing_reach
from meshtrace.engine.setup.meshing import mesh_for
from meshtrace.engine.setup.options import resolve
from meshtrace.fading import resolve_band
from meshtrace.surfaces import Band, Elfouhaily, FlatSea, JonswapSea, SinusoidalSea, SpectralSea

CLEAR = mt.Water(a=0.114, b=0.037)
COASTAL = mt.Water(a=0.179, b=0.219)
HARBOUR = mt.Water(a=0.366, b=1.824)
TURBID = mt.Water(a=0.1, b=2.0)
HG = mt.HenyeyGreenstein(g=0.9)
ISOTROPIC = mt.Water(a=0.1, b=0.5, phase=mt.HenyeyGreenstein(g=0.0))
LAYERS = ((0.0, 0.05, 0.1), (3.0, 0.1, 0.6), (8.0, 0.2, 0.2))
COASTAL_BEAM = mt.Water.from_type("petzold-coastal", a=0.179, b=0.219)
STILL = FlatSea()


class Case(NamedTuple):
    """A link over a surface, and what of it the table names."""

    link: mt.Link
    surface: Any
    wide: float | None = None
    """Radius of the apertures [m] for the comparison with analog photons; None: as they are."""

    def widened(self) -> mt.Link:
        """Return the link with apertures that analog photons hit."""
        if self.wide is None:
            return self.link
        ends = tuple(r.replace(radius=self.wide) for r in self.link.receivers)
        return self.link.replace(receiver=ends if len(ends) > 1 else ends[0])


def mesh_of(link: mt.Link, surface: Any) -> mt.TriangleMesh:
    """Return the mesh of a surface, its band resolved for the link where it was left open."""
    case = resolve(link, surface)
    return mesh_for(case.link, case.surface, reach=crossing_reach(case.link))[0]


def _aside(x: float, **options: Any) -> mt.Receiver:
    return mt.Receiver(position=(x, 0.0), **options)


def _laser(divergence_deg: float, wind_speed: float, **options: Any) -> mt.Link:
    """Return a laser at 20 m below a receiver at 30 m, in coastal water with bubbles."""
    return mt.Link(
        water=COASTAL_BEAM,
        bubbles=mt.HallNovarini(wind_speed=wind_speed),
        transmitter=mt.GaussianBeam(
            depth=20.0, divergence_deg=divergence_deg, wavelength_nm=450.0, **options
        ),
        receiver=mt.Receiver(height=30.0, radius=0.05, fov_deg=60.0),
    )


def _resolved(wind_speed: float) -> SpectralSea:
    """Return a sea of waves up to 20 rad/s and none beyond."""
    spectrum = Elfouhaily(wind_speed=wind_speed, fetch=30e3)
    low = 0.6 * spectrum.omega_p
    return SpectralSea(
        spectrum=spectrum,
        spreading="elfouhaily",
        mss="band",
        waves=Band(omega_min=low, omega_max=20.0, d_omega=0.3, d_theta=0.174),
        seed=5,
    )


def _turbid_aside(water: mt.Water) -> Case:
    lamp = mt.Led(depth=10.0, half_angle_deg=20.0)
    link = mt.Link(water=water, transmitter=lamp, receiver=_aside(4.0, height=4.0, fov_deg=120.0))
    return Case(link, JonswapSea(wind_speed=5.0, seed=1), 1.0)


LINKS = {
    "default, 5 m/s": Case(mt.Link(), JonswapSea(wind_speed=5.0, seed=1), 0.5),
    "LED 60, view 179, Petzold": Case(
        mt.Link(
            water=mt.Water.from_type("petzold-clear", a=0.114, b=0.037),
            transmitter=mt.Led(half_angle_deg=60.0),
            receiver=mt.Receiver(fov_deg=179.0),
        ),
        STILL,
        1.0,
    ),
    "tilted 40": Case(mt.Link(receiver=mt.Receiver(tilt_deg=40.0)), STILL, 2.0),
    "10 m aside, view 20": Case(mt.Link(receiver=_aside(10.0, fov_deg=20.0)), STILL, 2.0),
    "two receivers, 3 m/s": Case(
        mt.Link(
            transmitter=mt.Led(half_angle_deg=30.0),
            receiver=(mt.Receiver(), _aside(5.0, tilt_deg=20.0)),
        ),
        JonswapSea(wind_speed=3.0, seed=2),
        1.0,
    ),
    "focus by a sinusoid": Case(
        mt.Link(), SinusoidalSea(amplitude=0.1, wavelength=2.0, phase=0.4), 0.5
    ),
    "coastal, 14 m aside": Case(
        mt.Link(
            water=COASTAL,
            transmitter=mt.Led(depth=8.0, half_angle_deg=20.0),
            receiver=_aside(14.0, height=3.0, radius=1.0, fov_deg=120.0),
        ),
        STILL,
        2.0,
    ),
    "coastal, LED 60, 20 m aside": Case(
        mt.Link(
            water=COASTAL,
            transmitter=mt.Led(depth=4.0, half_angle_deg=60.0),
            receiver=_aside(20.0, height=3.0, radius=1.0, fov_deg=120.0),
        ),
        STILL,
        2.0,
    ),
    "coastal, LED 60, 12 m aside, 8 m/s": Case(
        mt.Link(
            water=COASTAL,
            transmitter=mt.Led(depth=4.0, half_angle_deg=60.0),
            receiver=_aside(12.0, height=3.0, radius=1.0, fov_deg=60.0),
        ),
        JonswapSea(wind_speed=8.0, seed=23),
        2.0,
    ),
    "harbour, 1.5 m": Case(
        mt.Link(water=HARBOUR, transmitter=mt.Led(depth=1.5), receiver=mt.Receiver(radius=1.0)),
        STILL,
    ),
    "harbour, 2.1 m aside, tilted, 8 m/s": Case(
        mt.Link(
            water=HARBOUR,
            transmitter=mt.Led(depth=2.5, half_angle_deg=5.0),
            receiver=_aside(2.116, radius=1.0, tilt_deg=32.617, tilt_azimuth_deg=12.184),
        ),
        JonswapSea(wind_speed=8.0, seed=23),
        2.0,
    ),
    "harbour, 7.6 m aside": Case(
        mt.Link(
            water=HARBOUR,
            transmitter=mt.Led(depth=3.0),
            receiver=_aside(7.57, height=3.0, radius=1.0, fov_deg=40.0),
        ),
        STILL,
        2.0,
    ),
    "laser 1 deg, fading 8 m/s": Case(
        _laser(1.0, 8.0),
        resolve_band(_laser(1.0, 8.0), JonswapSea(wind_speed=8.0, seed=1), "fading"),
        2.0,
    ),
    "laser 0.1 deg, 13 m/s": Case(_laser(0.1, 13.0), JonswapSea(wind_speed=13.0, seed=1), 2.0),
    "laser 2 deg, 3 m/s": Case(_laser(2.0, 3.0), JonswapSea(wind_speed=3.0, seed=1), 2.0),
    "laser 0.5 deg, resolved 8 m/s": Case(_laser(0.5, 8.0), _resolved(8.0), 2.0),
    "lamp of 0.3 m, HG, 5 m/s": Case(
        mt.Link(
            water=COASTAL.replace(phase=HG),
            transmitter=mt.TopHatBeam(depth=8.0, divergence_deg=5.0, radius=0.3),
            receiver=_aside(1.0),
        ),
        JonswapSea(wind_speed=5.0, seed=3),
        0.5,
    ),
    "b z = 20, 4 m aside, HG, 5 m/s": _turbid_aside(TURBID.replace(phase=HG)),
    "b z = 20, 4 m aside, 5 m/s": _turbid_aside(TURBID),
    "isotropic, LED 60": Case(
        mt.Link(
            water=ISOTROPIC,
            transmitter=mt.Led(depth=3.0, half_angle_deg=60.0),
            receiver=mt.Receiver(height=3.0, radius=1.0, fov_deg=160.0),
        ),
        STILL,
    ),
    "bottom, 8 m/s": Case(
        mt.Link(
            water=mt.Water(a=0.1, b=0.3, bottom_depth=6.0, bottom_albedo=0.5),
            transmitter=mt.Led(depth=3.0, half_angle_deg=60.0),
            receiver=mt.Receiver(height=3.0, radius=1.0, fov_deg=160.0),
        ),
        JonswapSea(wind_speed=8.0, seed=23),
    ),
    "layers, bubbles, foam, 10 m/s": Case(
        mt.Link(
            water=mt.Water(layers=LAYERS, phase=mt.HenyeyGreenstein(g=0.5)),
            bubbles=mt.HallNovarini(wind_speed=10.0),
            whitecaps=mt.Whitecaps(wind_speed=10.0),
            transmitter=mt.Led(depth=6.0, half_angle_deg=30.0),
            receiver=mt.Receiver(radius=0.2),
        ),
        JonswapSea(wind_speed=10.0, seed=4),
        1.0,
    ),
    "down, 2 m aside, 8 m/s": Case(
        mt.Link(
            water=COASTAL,
            transmitter=mt.AirLed(height=3.0, half_angle_deg=30.0),
            receiver=mt.WaterReceiver(depth=5.0, position=(2.0, 0.0), fov_deg=120.0),
        ),
        JonswapSea(wind_speed=8.0, seed=23),
        0.5,
    ),
    "dark, resolved 5 m/s": Case(mt.Link(receiver=_aside(4.0, fov_deg=30.0)), _resolved(5.0), 1.0),
}
