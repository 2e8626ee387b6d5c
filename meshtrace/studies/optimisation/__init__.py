"""Optimisation of a link over common seas, validated on fresh ones."""

from meshtrace.studies.optimisation.result import Optimum, Validation
from meshtrace.studies.optimisation.study import optimize

__all__ = ["Optimum", "Validation", "optimize"]
