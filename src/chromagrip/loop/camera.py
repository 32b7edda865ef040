"""The simulated camera: membrane, flaws, renderer, defects and noise behind one call."""

import numpy as np
from numpy.typing import NDArray

from ..model import State
from ..render import (
    Defects,
    Flaws,
    Frame,
    Imaging,
    Membrane,
    MembraneMap,
    Renderer,
    SensorDesign,
    add_noise,
    shutter_times,
)

Array = NDArray[np.float64]


class SimulatedCamera:
    """Takes frames of a state of the node model; the same seed gives the same bytes.

    Parameters
    ----------
    sensor: design that is seen
    renderer: draws it; closed with the camera
    nodes: of the chain
    noise: standard deviation [grey levels]
    seed: of the noise and of every defect
    defects: of the sensor and its image
    """

    def __init__(
        self,
        sensor: SensorDesign,
        renderer: Renderer,
        nodes: int,
        noise: float,
        seed: int,
        defects: Defects | None = None,
    ) -> None:
        defects = defects or Defects()
        self._renderer = renderer
        self._flaws = Flaws(sensor, defects, seed)
        self._map = MembraneMap(sensor, nodes, self._flaws.places)
        self._imaging = Imaging(sensor, defects, seed)
        # In periods: how long before a frame's instant its light was gathered.
        self._shutter = shutter_times(defects, 1.0)
        self._before: Array | None = None
        self._carried: tuple[Array, Membrane] | None = None
        self._still: NDArray[np.uint8] | None = None
        self._noise = noise
        self._seed = seed

    def membrane(self, seen: Array) -> Membrane:
        """Markers of this specimen, for node displacements relative to the rigid part (N, 2)."""
        # Labels and picture of a frame are of the same membrane.
        if self._carried is None or not np.array_equal(self._carried[0], seen):
            self._carried = seen.copy(), self._flaws(self._map(seen))
        return self._carried[1]

    def expose(self, state: State, index: int) -> Frame:
        """Frame number `index` of the run, of that state.

        With an open shutter the skin moves on evenly from where the frame before saw it.
        """
        seen = state.deformation.seen
        before = seen if self._before is None else self._before
        self._before = seen.copy()
        moved = seen - before
        if moved.any():
            images = [self._renderer.render(self.membrane(seen + t * moved)) for t in self._shutter]
            self._still = None
        else:  # the same picture as long as nothing moves
            if self._still is None:
                self._still = self._renderer.render(self.membrane(seen))
            images = [self._still.copy()]
        return self._finish(images, state.time, index)

    def expose_rest(self, state: State, count: int) -> list[Frame]:
        """`count` frames of one still state, numbered from the end so that no run repeats them."""
        image = self._renderer.render(self.membrane(state.deformation.seen))
        return [self._finish([image.copy()], state.time, 2**32 - 1 - i) for i in range(count)]

    def close(self) -> None:
        """Release the renderer."""
        self._renderer.close()

    def _finish(self, images: list[NDArray[np.uint8]], time: float, index: int) -> Frame:
        image = self._imaging(images, index)
        add_noise(image, self._noise, self._seed, index)
        return Frame(image=image, time=time)
