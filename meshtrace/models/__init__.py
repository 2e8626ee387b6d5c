"""Descriptions as data: validated, frozen models, and families of models by kind."""

from meshtrace.models.family import GROUP as GROUP
from meshtrace.models.family import Family as Family
from meshtrace.models.family import import_modules as import_modules
from meshtrace.models.family import modules_of as modules_of
from meshtrace.models.family import trusting as trusting
from meshtrace.models.model import Finite as Finite
from meshtrace.models.model import Floats as Floats
from meshtrace.models.model import Model as Model
from meshtrace.models.model import NonNegative as NonNegative
from meshtrace.models.model import Position as Position
from meshtrace.models.model import Positive as Positive
from meshtrace.models.model import allowed_by as allowed_by
