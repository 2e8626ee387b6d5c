"""Aircraft with a receiver: gusts, tilt and airframe."""

from meshtrace.uav.airframe import UAVS, Flight, FlightRecord, Route, Uav
from meshtrace.uav.wind import Dryden

__all__ = ["UAVS", "Dryden", "Flight", "FlightRecord", "Route", "Uav"]
