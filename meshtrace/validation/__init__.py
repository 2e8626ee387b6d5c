"""Independent checks of the engine, in one table.

Closed forms and quadratures, published tables, and the two estimators against each other.
`meshtrace validate` prints them; the tests of published tables run the same problems longer.
"""

from meshtrace.validation.check import LIMIT, Check, format_table
from meshtrace.validation.suite import SUITE, validate

__all__ = ["LIMIT", "SUITE", "Check", "format_table", "validate"]
