"""The simulated camera: membrane, flaws, renderer, defects and noise."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ..by_name import blaming, name_of
from ..model import DomeState, SoftBody, State
from ..render import (
    Defects,
    DomeMap,
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
Image = NDArray[np.uint8]

#: Number of the first frame at rest; the others count down from it. No run reaches them.
REST_NUMBER = 2**32 - 1


def map_of(
    sensor: SensorDesign, body: int | SoftBody, places: Array | None
) -> Callable[[Array], Membrane]:
    """Map from the displacements `carried` of a state to the membrane.

    Parameters
    ----------
    sensor: design of the sensor
    body: number of nodes of the chain, or silicone
    places: places of the markers of each layer, shape (2, M, 2); None: as designed
    """
    if isinstance(body, SoftBody):  # else the number of nodes of a chain
        return DomeMap(sensor, body, places)
    return MembraneMap(sensor, body, places)


class SimulatedCamera:
    """Takes frames of states of a body; the same seed gives the same bytes.

    That holds for one family of processors and the same versions of the libraries.

    Parameters
    ----------
    sensor: design in the image
    renderer: renderer of the sensor; it is closed with the camera
    body: number of nodes of the chain, or silicone
    noise: standard deviation of a pixel [grey levels]
    seed: seed of the noise and of all defects
    defects: defects of the sensor and its image (default: no defects)
    membrane_map: map from the displacements `carried` of a state to the membrane (default:
        `map_of` the sensor)
    picture: function applied to each finished picture (default: no change)
    """

    def __init__(
        self,
        sensor: SensorDesign,
        renderer: Renderer,
        body: int | SoftBody,
        noise: float,
        seed: int,
        defects: Defects | None = None,
        membrane_map: Callable[[Array], Membrane] | None = None,
        picture: Callable[[Image], Image] | None = None,
    ) -> None:
        defects = defects or Defects()
        self._renderer = renderer
        self._flaws = Flaws(sensor, defects, seed)
        places = self._flaws.places
        self._map = membrane_map or map_of(sensor, body, places)
        self._picture = picture
        self._imaging = Imaging(sensor, defects, seed)
        # In frame periods before a frame's instant, when its light was gathered.
        self._shutter = shutter_times(defects, 1.0)
        self._failure = f"renderer {name_of(renderer)} failed"
        self._before: Array | None = None
        self._membrane: tuple[Array, Membrane] | None = None
        self._still: tuple[Array, Image] | None = None
        self._noise = noise
        self._seed = seed

    def membrane(self, displacement: Array) -> Membrane:
        """Membrane of this specimen for the displacements `carried` of a state."""
        # Labels and picture of a frame share one membrane.
        if self._membrane is None or not np.array_equal(self._membrane[0], displacement):
            self._membrane = displacement.copy(), self._flaws(self._map(displacement))
        return self._membrane[1]

    def expose(self, state: State | DomeState, index: int, before: Array | None = None) -> Frame:
        """Take frame number `index` of the run, which shows a state.

        Parameters
        ----------
        state: state of the body
        index: number of the frame, which determines its noise
        before: displacements `carried` of the frame before, from which the skin moves evenly while
            the shutter is open (default: those of the last picture)
        """
        clean = self._clean(state, index, before)
        shared = self._still is not None and clean is self._still[1]
        return self._finish(clean, state.time, index, shared)

    def _clean(self, state: State | DomeState, index: int, before: Array | None = None) -> Image:
        """Take the same picture before `add_noise`, shape (H, W, 3); do not change it."""
        displacement = state.carried
        if before is None:
            before = displacement if self._before is None else self._before
        self._before = displacement.copy()
        moved = displacement - before
        if moved.any():
            images = [self._render(displacement + t * moved) for t in self._shutter]
        else:  # the same picture as long as nothing moves
            if self._still is None or not np.array_equal(self._still[0], displacement):
                self._still = self._before, self._render(displacement)
            images = [self._still[1]]
        return self._imaging.measured(images, index)

    def expose_rest(self, state: State | DomeState, count: int) -> list[Frame]:
        """Take `count` frames of one state at rest, with noise that no frame of a run has."""
        image = self._render(state.carried)
        numbers = [REST_NUMBER - i for i in range(count)]
        cleans = [self._imaging.measured(image, number) for number in numbers]
        return [
            self._finish(clean, state.time, number, shared=clean is image)
            for clean, number in zip(cleans, numbers, strict=True)
        ]

    def close(self) -> None:
        """Release the renderer."""
        self._renderer.close()

    def _render(self, displacement: Array) -> Image:
        membrane = self.membrane(displacement)
        with blaming(self._failure, SystemExit):
            return self._renderer.render(membrane)

    def _finish(self, clean: Image, time: float, index: int, shared: bool) -> Frame:
        """Add noise to a picture and make its frame; a shared picture is copied first."""
        image = np.empty_like(clean) if shared else clean
        add_noise(clean, self._noise, self._seed, index, out=image)
        image = self._imaging.compressed(image)
        if self._picture is not None:
            image = self._picture(image)
        return Frame(image=image, time=time)
