"""Descriptions as data: validated, frozen models, and families of models by kind."""

from meshtrace.models.family import GROUP, Family
from meshtrace.models.model import (
    Finite,
    Floats,
    Model,
    NonNegative,
    Position,
    Positive,
    allowed_by,
)

__all__ = [
    "GROUP",
    "Family",
    "Finite",
    "Floats",
    "Model",
    "NonNegative",
    "Position",
    "Positive",
    "allowed_by",
]
