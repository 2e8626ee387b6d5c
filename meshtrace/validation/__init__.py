"""Independent checks of the engine, in one table.

`meshtrace validate` compares it with closed forms and quadratures. Published tables, and the two
estimators against each other, are tests: they need more photons than a command should take.
"""

from meshtrace.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
