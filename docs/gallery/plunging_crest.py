"""
Light in a plunging crest
=========================

A fan of beams under a plunging crest, a mesh that overhangs: light that meets the surface beyond
the critical angle follows the jet to its tip, the rest is refracted into the air and through the
tube.

.. image:: /gallery/pictures/plunging_crest.png
   :alt: Light guided by the jet of a plunging crest and refracted into its tube

The crest and the picture are those of ``examples/plunging_crest.py`` in the repository, which also
prints the fates of the light.
"""

# sphinx_gallery_thumbnail_path = 'gallery/pictures/plunging_crest.png'

import runpy
from pathlib import Path

example = Path(__file__).parents[2] / "examples" / "plunging_crest.py"
runpy.run_path(str(example), run_name="__main__")
