"""Link files: TOML to a link, a sea and run options, and back.

A scenario is everything that one run depends on. This is the only package that joins the core
with `meshtrace.surfaces`, by late imports.
"""

from meshtrace.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
