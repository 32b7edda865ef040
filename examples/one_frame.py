"""Each stage by itself: press the fingertip, take a picture, estimate the forces from it."""

import numpy as np

from chromagrip.model import ContactObject, Fingertip, contact_forces, rest_state, step
from chromagrip.render import Frame, MembraneMap, add_noise, load_sensor, open_renderer
from chromagrip.tracking import MarkerTracker, Palette, load_calibration, load_reconstructor

GRIP, LOAD = 2.0, 0.5  # N


def main() -> None:
    tip, obj, sensor = Fingertip(), ContactObject(friction=0.5), load_sensor("thesis")
    membrane, painter = MembraneMap(sensor, tip.nodes), open_renderer("painter", sensor)

    def picture(displacement: np.ndarray, index: int) -> Frame:
        image = painter.render(membrane(displacement))
        add_noise(image, sigma=2.0, seed=0, index=index)
        return Frame(image=image, time=0.01 * index)

    tracker = MarkerTracker(Palette.of_sensor(sensor), noise=2.0)
    rest = tracker.reset([picture(np.zeros((tip.nodes, 2)), 1000 + k) for k in range(16)])
    reconstructor = load_reconstructor("sequential")(load_calibration("thesis"), rest)

    state = rest_state(tip)
    for k in range(50):
        for _ in range(10):
            state = step(tip, obj, state, 1e-3, GRIP, LOAD if k > 5 else 0.0)
        estimate = reconstructor.update(tracker.update(picture(state.deformation.seen, k)))

    truth = contact_forces(tip, obj, state)
    for name, forces in (("true", truth), ("from pixels", estimate)):
        normal, friction = forces.total_normal, forces.total_friction
        print(f"{name:>12}: normal {normal:.2f} N, friction {friction:.2f} N")
    assert abs(estimate.total_normal - truth.total_normal) < 0.15 * truth.total_normal
    assert abs(estimate.total_friction - truth.total_friction) < 0.05


if __name__ == "__main__":
    main()
