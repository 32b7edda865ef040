"""The simulated camera: membrane, renderer and noise behind one call."""

import numpy as np
from numpy.typing import NDArray

from .model import State
from .render import Frame, MembraneMap, Renderer, SensorDesign, add_noise


class SimulatedCamera:
    """Takes frames of a state of the node model; the same seed gives the same bytes.

    Parameters
    ----------
    sensor: design that is seen
    renderer: draws it; closed with the camera
    nodes: of the chain
    noise: standard deviation [grey levels]
    seed: of the noise
    """

    def __init__(
        self, sensor: SensorDesign, renderer: Renderer, nodes: int, noise: float, seed: int
    ) -> None:
        self._renderer = renderer
        self._membrane = MembraneMap(sensor, nodes)
        self._noise = noise
        self._seed = seed

    def expose(self, state: State, index: int) -> Frame:
        """Frame number `index` of the run, of that state."""
        image = self._renderer.render(self._membrane(state.deformation.seen))
        return self._noisy(image, state.time, index)

    def expose_rest(self, state: State, count: int) -> list[Frame]:
        """`count` frames of one still state, numbered from the end so that no run repeats them."""
        image = self._renderer.render(self._membrane(state.deformation.seen))
        return [self._noisy(image.copy(), state.time, 2**32 - 1 - i) for i in range(count)]

    def close(self) -> None:
        """Release the renderer."""
        self._renderer.close()

    def _noisy(self, image: NDArray[np.uint8], time: float, index: int) -> Frame:
        add_noise(image, self._noise, self._seed, index)
        return Frame(image=image, time=time)
