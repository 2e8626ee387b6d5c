"""Independent checks of the engine, in one table.

`meshtrace validate` compares it with closed forms and quadratures. Published tables, and the two
estimators against each other, are tests: they need more photons than a command should take.
"""

from meshtrace.validation.closed_forms import LIMIT, SUITE, Check, format_table, validate

__all__ = ["LIMIT", "SUITE", "Check", "format_table", "validate"]
