"""Profiles of the given files, or stand-ins for them."""

from __future__ import annotations

import numpy as np

from meshtrace.paper.profiles import WaterProfile, load_profiles
from meshtrace.paper.registry import Setting


def profiles_of(setting: Setting) -> list[WaterProfile]:
    """Return the profiles of the given files, or stand-ins for them.

    Raises
    ------
    Refused
        If a file cannot be read.
    """
    if not setting.profiles:
        return stand_ins()
    return [profile for path in setting.profiles for profile in load_profiles(path)]


def stand_ins() -> list[WaterProfile]:
    """Return invented profiles: the data of the paper cannot be distributed.

    A mixed layer as in the paper, and two profiles with sharper thermoclines.
    """
    z = np.linspace(0.0, 100.0, 201)
    shapes = (("stand-in, mixed", 80.0, 20.0, 2.0, 0.1), ("stand-in, weak", 40.0, 10.0, 2.0, 0.3))
    sharp = ("stand-in, sharp", 25.0, 2.0, 4.0, 0.6)
    return [
        WaterProfile(
            z,
            26.0 - 0.5 * drop * (1.0 + np.tanh((z - middle) / width)),
            35.2 + 0.5 * fresh * np.tanh((z - middle) / width),
            name=name,
        )
        for name, middle, width, drop, fresh in (*shapes, sharp)
    ]
