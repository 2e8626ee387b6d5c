"""Applications: each answers one question with the public names of meshtrace.

The explorer; design, optimisation and inference; irradiance and caustics; channel traces and
channel models; comparisons with measurements and with other codes.
"""

from meshtrace.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
