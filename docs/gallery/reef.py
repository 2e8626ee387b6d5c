"""
A reef below the link
=====================

Bodies are meshes of triangles beside the sea: here a reef of 80 000 facets, which
``examples/reef.py`` makes. The lamp shines down; what the reef reflects leaves the water.
"""

# sphinx_gallery_thumbnail_path = 'gallery/pictures/reef.png'

import runpy
import tempfile
from pathlib import Path

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import JonswapSea

make = runpy.run_path(str(Path(__file__).parents[2] / "examples" / "reef.py"))["reef"]
with tempfile.TemporaryDirectory() as folder:
    file = Path(folder, "reef.ply")
    make(80_000).export(file)
    reef = mt.Body(file, albedo=0.3, position=(0.0, 0.0, -12.5))
    lamp = mt.Led(depth=9.0, half_angle_deg=25.0, zenith_deg=180.0)
    link = mt.Link(water=mt.Water(a=0.05, b=0.04), transmitter=lamp, objects=reef)
    sea = JonswapSea(wind_speed=5.0, seed=1)
    plotter = viz.scene(link, sea, paths=400, style=viz.SceneStyle(off_screen=True))
    viz.save_picture(plotter, "reef.png")
    plotter.close()
