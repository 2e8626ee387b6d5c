"""View of the scene in the browser."""

from __future__ import annotations

from typing import Any

from trame.widgets import vtk


class SceneView(vtk.VtkLocalView):
    """View that is drawn by the browser.

    Parameters
    ----------
    window : vtkRenderWindow
        Window of the scene.
    **options
        Attributes of the element.
    """

    def __init__(self, window: Any, **options: Any) -> None:
        super().__init__(window, **options)
        self._window = window
        # the description of a scene lacks the angle of view
        name = self.server.trigger_name(lambda: self.push_camera())
        self.on_ready = f"if ($event && !framed) {{ framed = true; trigger('{name}') }}"

    def push_changes(self) -> None:
        """Send the parts that have changed to the open page.

        `update` describes the whole scene besides, for a page that is loaded later, which takes as
        long again: it follows at the end of the work.
        """
        if self.server.protocol:
            changes = self._helper.scene(self._window, new_state=False)
            self.server.protocol.publish("trame.vtk.delta", changes)
