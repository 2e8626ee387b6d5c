"""
Nonlinear waves
===============

Profiles of a linear, a choppy and a second-order sea with the same phases: crests of nonlinear
waves are higher and sharper, troughs flatter.
"""

# sphinx_gallery_thumbnail_path = 'gallery/pictures/nonlinear_profiles.png'

import matplotlib.pyplot as plt
import numpy as np

from meshtrace import viz
from meshtrace.surfaces import JonswapSea, MeasuredSea

KINDS = {"linear": {}, "choppy": {"choppy": True}, "second order": {"order": 2}}


def draw(ax: plt.Axes, sea: JonswapSea | MeasuredSea, middle: tuple[float, float], half: float):
    """Draw the profiles through a point, along x."""
    x = np.linspace(-half, half, 1201)
    for name, changes in KINDS.items():
        z = sea.model_copy(update=changes).elevation(middle[0] + x, middle[1])
        ax.plot(x, z, label=name)
        print(f"{name:12} {half:4g} m to both sides: {z.min():6.3f} to {z.max():5.3f} m")
    ax.set_xlim(-half, half)
    viz.marks.finished(ax, ylabel="elevation [m]", legend=False)


viz.use_style()
figure, (top, bottom) = plt.subplots(2, 1, figsize=(8.0, 6.0), layout="constrained")
k, a = np.pi, 0.12
wave = MeasuredSea(omega=[np.sqrt(9.81 * k)], theta=[0.0], variance=[[0.5 * a**2]], capillary=False)
draw(top, wave, (wave.components.phase[0] / k, 0.0), 2.2)
top.set_title(f"one wave of 2 m, a k = {a * k:.2f}")

sea = JonswapSea(wind_speed=13.0, waves="scaled", seed=4)
sea = sea.replace(waves=sea.band.replace(d_theta=np.pi / 6))  # few directions: high crests
axis = np.arange(-100.0, 100.0, 0.5)
i, j = np.unravel_index(np.argmax(sea.grid(axis, axis)[0]), (len(axis), len(axis)))
draw(bottom, sea, (axis[i], axis[j]), 25.0)
bottom.set_title("JONSWAP sea at 13 m/s, along the wind, through a high crest")
bottom.set_xlabel("x [m]")
bottom.legend(loc="upper left")
viz.save_picture(figure, "nonlinear_profiles.png")
