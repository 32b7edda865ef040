"""The grip loop on frames from outside: the same tracker, reconstructor and controller."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

from ..errors import UserError
from ..loop.latency import Arrived, HoldingController
from ..loop.methods import Methods
from ..loop.sample import Sample
from ..render import Frame
from ..scene.scene import Scene
from ..sensing.reader import Reader, scene_reader
from ..tracking import SensorCalibration
from .feed import Feed
from .gripper import HeldGripper


def grasp_outside(
    scene: Scene,
    methods: Methods,
    known: SensorCalibration,
    feed: Feed,
    gripper: HeldGripper,
    answer_within: float,
) -> Iterator[Sample]:
    """Frames of a grasp as they come, until the scene is as long as it says, or the source ends.

    The gripper is told 0 N first, and the first frames are taken as those of the unloaded sensor.
    After a failure it is told the last safe force again; at the end it is told nothing more.

    Parameters
    ----------
    scene: controller, sensor, `camera.rest_frames` and `duration_s`; its object is not used
    methods: controller, tracker and reconstructor
    known: calibration of the sensor
    feed: of the frames
    gripper: that grips
    answer_within: time in which the controller must answer [s]

    Raises
    ------
    UserError
        When a frame does not come in time or cannot be used, or controller or gripper fail; it
        says at which force the grip stays.
    """
    controller = HoldingController(methods.build_controller(scene), scene.controller, answer_within)
    with _holding(gripper):
        gripper.command(0.0, "before the first frame")
        reader = _reader(scene, methods, known, feed)
        begin, index = 0.0, 0
        while (frame := feed.next()) is not None:
            begin = frame.time if index == 0 else begin
            frame = replace(frame, time=frame.time - begin)
            if frame.time > scene.duration_s + 1e-9:
                return
            reading = reader.update(frame)
            assert reading.held is not None
            arrived = Arrived(index, reading.held)
            if index == 0:
                controller.start(arrived.observation)
            grip = controller.command([arrived])
            gripper.command(grip, f"at t = {frame.time:.4g} s, frame {index}")
            yield Sample(index=index, time=frame.time, readings=(reading,), grip=grip)
            index += 1


@contextmanager
def _holding(gripper: HeldGripper) -> Iterator[None]:
    """Tell the gripper the last safe force again, whatever ends the loop too early."""
    try:
        yield
    except UserError as error:
        gripper.hold()
        stays = f"; the grip stays at {gripper.force:.4g} N"
        if gripper.force >= 0.0 and "the grip stays" not in str(error):
            raise UserError(f"{error}{stays}") from error.__cause__
        raise
    except BaseException:
        gripper.hold()
        raise


def _reader(scene: Scene, methods: Methods, known: SensorCalibration, feed: Feed) -> Reader:
    """Reader that was given the first frames as those of the unloaded sensor."""
    rest: list[Frame] = []
    for _ in range(scene.camera.rest_frames):
        frame = feed.next()
        if frame is None:
            raise UserError(
                f"{feed.source.name} ended after {len(rest)} frames; the first "
                f"{scene.camera.rest_frames} must show the unloaded sensor (camera.rest_frames)"
            )
        rest.append(frame)
    view = known.sensor.view
    size = rest[0].image.shape[:2]
    if size != (view.height, view.width):
        raise UserError(
            f"{feed.source.name} has frames of {size[1]} × {size[0]} pixels; sensor "
            f"{scene.sensor} has {view.width} × {view.height}"
        )
    return scene_reader(scene, known, methods.tracker, methods.reconstructor, rest)
