"""The grip loop on frames from outside: the same tracker, reconstructor, controller and record."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..by_name import Choice, name_of
from ..errors import UserError
from ..loop.latency import Arrived, HoldingController
from ..loop.methods import Methods, choose, readable
from ..loop.record import Record, Result
from ..loop.run import ANSWER_WITHIN_S, check_asked
from ..loop.run_files import RunFiles
from ..loop.sample import Sample
from ..output.logs.write import LogFormat
from ..output.processes import one_thread
from ..render import Frame
from ..scene.controllers import CONTROLLERS
from ..scene.fingers import need_one_finger
from ..scene.scene import Scene
from ..sensing.reader import Reader, scene_reader
from ..sources import FrameSource, open_source
from ..sources.feed import Feed
from ..tracking import SensorCalibration
from .gripper import GRIPPERS, Gripper, HeldGripper

#: Time in which the next frame must come [s].
FRAME_WITHIN_S = 5.0


def run_outside(
    scene: Scene,
    source: Choice | FrameSource,
    out: Path | None = None,
    *,
    gripper: Choice | Gripper = "simulated",
    gripper_arguments: Mapping[str, Any] | None = None,
    overwrite: bool = False,
    fps: float | None = None,
    frame_within_s: float = FRAME_WITHIN_S,
    log: Sequence[LogFormat] = (),
    answer_within_s: float = ANSWER_WITHIN_S,
    progress: Callable[[int, int | None], None] = lambda done, total: None,
) -> Result:
    """Run a scene's controller on frames from outside; with `out`, write trace and summary.

    Also after an interruption or a failure the results so far are written, and the grip stays.

    Parameters
    ----------
    scene: scene with controller, sensor, calibration and length of the run
    source: source of the frames, see `open_source`
    out: run folder, made if missing (default: no files are written)
    gripper: name, `module:Class`, class, or an object with `command` (default `simulated`)
    gripper_arguments: arguments of a class, by name
    overwrite: whether to write over an earlier run's files
    fps: rate of frames without times of their own [Hz]
    frame_within_s: time in which the next frame must come (default 5) [s]
    log: formats in which the run is also written into `out`, see `loop.run.run`
    answer_within_s: time in which controller and gripper must answer (default 60) [s]
    progress: function called with the number of frames done, and None

    Raises
    ------
    UserError
        For an argument that cannot be used, and when source, controller or gripper fail.
    """
    scene, methods, known = _checked(scene)
    check_asked(out, None, log, answer_within_s)
    opened = open_source(source, fps)
    made = GRIPPERS.build(gripper, gripper_arguments)
    held = HeldGripper(made, name_of(gripper), answer_within_s)
    limit = math.inf if scene.controller in CONTROLLERS.entries else answer_within_s
    files = None if out is None else RunFiles(out, overwrite, scene, log=log, drawn=False)
    with files or nullcontext(), one_thread(), closing(Feed(opened, frame_within_s)) as feed:
        record, ended = Record(scene, methods, known, files), False
        try:
            for sample in grasp_outside(scene, methods, known, feed, held, limit):
                record.add(sample)
                progress(sample.index + 1, None)
            ended = True
        finally:
            result = record.finish(
                complete=ended,
                gross_slip=None,
                **feed.counts,
                source=opened.name,
                gripper=name_of(gripper),
            )
    return result


def _checked(scene: Scene) -> tuple[Scene, Methods, SensorCalibration]:
    """Check a scene for frames from outside; returns it with its methods and calibration."""
    need_one_finger(scene, "frames from outside are those of")
    if scene.path != "camera":
        raise UserError('frames from outside are read by the camera path; set path = "camera"')
    scene, methods = choose(scene, controller=None)
    known = readable(scene, methods)
    if known is None:
        raise UserError(f"sensor {scene.sensor} is a flat pad, for which no estimator has forces")
    return scene, methods, known


def grasp_outside(
    scene: Scene,
    methods: Methods,
    known: SensorCalibration,
    feed: Feed,
    gripper: HeldGripper,
    answer_within: float,
) -> Iterator[Sample]:
    """Run a grasp on frames as they come, until `duration_s` has passed or the source ends.

    The first command is 0 N, and the first frames must show the unloaded sensor. After a failure
    the last safe force is commanded again; at the end no further command is sent.

    Parameters
    ----------
    scene: controller, sensor, `camera.rest_frames` and `duration_s`; its object is not used
    methods: controller, tracker and reconstructor
    known: calibration of the sensor
    feed: feed of the frames
    gripper: gripper that is commanded
    answer_within: time in which the controller must answer [s]

    Raises
    ------
    UserError
        When a frame does not come in time or cannot be used, or controller or gripper fail; the
        message gives the force at which the grip stays.
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
    """Command the last safe force again if an error ends the loop."""
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
    """Make a reader, with the first frames as those of the unloaded sensor."""
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
