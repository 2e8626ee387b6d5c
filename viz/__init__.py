"""Visualisation: 3D scenes, movies, web pages, files for ParaView, and plots of results.

Everything here needs the `viz` extra; modules load when a name is first used.
"""

from importlib.util import find_spec

import lazy_loader

if not all(find_spec(name) for name in ("matplotlib", "pyvista", "trame_vtk", "imageio")):
    raise ImportError('viz needs extra packages: pip install "meshtrace[viz]"')

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
