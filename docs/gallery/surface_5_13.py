"""
The sea at 5 and at 13 m/s
==========================

The same phases at two winds, as a viewer sees them and by slope.
"""

# sphinx_gallery_thumbnail_path = 'gallery/pictures/surface_13_water.png'

from meshtrace import viz
from meshtrace.surfaces import JonswapSea

for wind_speed in (5.0, 13.0):
    sea = JonswapSea(wind_speed=wind_speed, fetch=30e3, omega_max=9.0, seed=7)
    mesh = sea.mesh(extent=30.0, spacing=0.12)
    z = mesh.vertices[:, 2]
    print(f"{wind_speed:g} m/s: {len(mesh.faces)} facets from {z.min():.2f} to {z.max():.2f} m")
    for color, limit in (("water", None), ("slope", 0.5)):
        plotter = viz.scene(
            None,
            mesh,
            style=viz.SceneStyle(
                color=color,
                color_limit=limit,
                opacity=1.0,
                labels=False,
                off_screen=True,
                window_size=(1440, 810),
            ),
        )
        viz.add_scale(plotter)
        viz.add_compass(plotter, wind_speed)
        viz.add_caption(plotter, f"JONSWAP sea, wind {wind_speed:g} m/s, fetch 30 km, seed 7")
        viz.save_picture(plotter, f"surface_{wind_speed:g}_{color}.png")
        plotter.close()
