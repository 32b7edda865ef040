"""Pictures, a `Reader`, a controller, and a gripper of your own: the grip loop in one process.

`Camera` and `Gripper` stand for your hardware: a simulated object of chromatouch-2022 is between
them. Whatever has a method `command` is a gripper, also for
`chromagrip grasp --source camera:0 --gripper my_gripper:Gripper`.
"""

from collections.abc import Iterator

import numpy as np
from msgspec.structs import replace

import chromagrip

SCENE = replace(chromagrip.load_scene("chromatouch-2022"), path="truth")


class Gripper:
    """Takes grip forces, and passes on what the hardware can hold."""

    least, most = 0.2, 8.0  # N

    def __init__(self) -> None:
        self.force = 0.0

    def command(self, force: float) -> None:
        """Grip with a force from now on [N]."""
        self.force = float(np.clip(force, self.least, self.most))  # here a driver sends it


class Camera:
    """Takes pictures of a fingertip, of which the first show it without contact."""

    def __init__(self, rig: chromagrip.Rig, gripper: Gripper) -> None:
        self.rig, self.gripper = rig, gripper
        rig.reset()
        self.resting = [frame.image for frame in rig.sensors[0].rest_frames(8)]

    def pictures(self) -> Iterator[tuple[float, np.ndarray]]:
        """Yield time [s] and picture, while the gripper holds its newest force."""
        while not self.rig.done:
            self.rig.step(self.gripper.force)
            yield self.rig.time, self.rig.picture().image


def main() -> None:
    gripper = Gripper()
    with chromagrip.open(SCENE) as rig:
        camera = Camera(rig, gripper)
        reader = chromagrip.Reader(SCENE.sensor, camera.resting, noise=2.0)
        controller = SCENE.build_controller()
        gripper.command(1.0)
        margins = []
        for time, picture in camera.pictures():
            reading = reader.update(picture, time)
            gripper.command(controller.command(reading.held).force)
            margins.append(rig.truth.field.safety_margin(rig.truth.friction))
            if len(margins) % 60 == 0:
                print(f"{time:.1f} s: grip {gripper.force:.2f} N, Γ {reading.margin:.2f}")
    held = np.abs(np.array(margins[-60:]) - 0.3)
    print(f"true Γ within 0.3 ± {held.max():.2f} in the last second")
    assert held.max() < 0.1


if __name__ == "__main__":
    main()
