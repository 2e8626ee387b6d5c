"""The aircraft that carries a receiver: gusts, tilt and airframe."""

from meshtrace.uav.airframe import Uav
from meshtrace.uav.wind import Dryden

__all__ = ["Dryden", "Uav"]
