"""Visualisation: 3D scenes, movies, web pages, files for ParaView, and plots of results.

Everything here needs the `viz` extra; modules load when a name is first used.
"""

from importlib.util import find_spec

import lazy_loader

if not all(find_spec(name) for name in ("matplotlib", "pyvista", "trame_vtk", "imageio")):
    raise ImportError('viz needs extra packages: pip install "meshtrace[viz]"')

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "export": ["export_scene", "save_picture", "save_vtk", "to_pyvista"],
        "html": ["save_html"],
        "movie": ["save_movie"],
        "plots_curves": [
            "plot_ber",
            "plot_bubble_profile",
            "plot_curves",
            "plot_phase_cdf",
            "plot_phase_function",
            "plot_spectrum",
            "plot_spreading",
            "plot_sweep",
        ],
        "plots_gain": [
            "plot_autocorrelation",
            "plot_coverage",
            "plot_fates",
            "plot_gain_cdf",
            "plot_gain_pdf",
            "plot_gain_series",
        ],
        "plots_signal": ["plot_eye", "plot_impulse_response"],
        "plots_study": ["plot_convergence", "plot_performance"],
        "light": ["add_coverage", "add_footprint", "add_paths", "select_paths"],
        "parts": ["add_bubbles", "add_receiver", "add_surface", "add_transmitter", "add_uav"],
        "scenes": ["SceneStyle", "scene"],
        "show": ["view"],
        "stage": ["Scene", "Stage", "add_compass", "add_key", "add_labels", "add_scale", "look"],
        "style": ["axis_label", "use_style", "water_map"],
    },
)
