"""A window that shows pictures as they come, if there is a display."""

import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray


class Window:
    """Window of matplotlib; without a display it prints a notice and stays closed.

    Parameters
    ----------
    title: title of the window
    """

    def __init__(self, title: str) -> None:
        from matplotlib import pyplot

        self._figure: Any = pyplot.figure(title)
        self._picture: Any = None
        if self._figure.canvas.required_interactive_framework is None:
            print('chromagrip: no display found; render_mode="human" is off', file=sys.stderr)
            self.close()
            return
        self._axes = self._figure.add_axes((0.0, 0.0, 1.0, 1.0))
        self._axes.set_axis_off()
        pyplot.show(block=False)

    def draw(self, image: NDArray[np.uint8]) -> None:
        """Show a picture."""
        if self._figure is None:
            return
        if self._picture is None:
            self._picture = self._axes.imshow(image)
        self._picture.set_data(image)
        self._figure.canvas.draw_idle()
        self._figure.canvas.flush_events()

    def close(self) -> None:
        """Close the window; closing it again does nothing."""
        if self._figure is not None:
            from matplotlib import pyplot

            pyplot.close(self._figure)
            self._figure = None
