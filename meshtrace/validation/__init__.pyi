from .closed_forms import LIMIT as LIMIT
from .closed_forms import SUITE as SUITE
from .closed_forms import Check as Check
from .closed_forms import format_table as format_table
from .closed_forms import validate as validate
