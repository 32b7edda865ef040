"""Record a part of a live grasp whose sliders are moved: `live_recording.py SCENE FOLDER`.

What happens is told by the number of the frame, so that every recording is the same.
"""

import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from chromagrip import load_scene
from chromagrip.live.record import Recorder
from chromagrip.live.session import Session, Shown

#: Frames at which it begins, at which sliders move, and at which it ends.
BEGIN, MOVE, END = 10, 25, 45
#: A dome is slow through the camera.
CHANGES: dict[str, dict[str, object]] = {"dome-1": {"path": "truth"}}
PATIENCE_S = 120.0


def record(scene: str, folder: Path) -> str:
    """Record a scene into folder/001; the last sentence of the recorder."""
    told: list[str] = []
    recorder = Recorder(folder, told.append)
    frames = 0

    def ask(**values: float) -> None:
        if hasattr(session, "wish"):  # as it was called at 9f69240 and before
            session.wish(replace(session.wishes, **values))
        else:
            session.ask(replace(session.sliders, **values))

    def show(_: Shown) -> None:  # in the thread of the grasp, between two frames
        nonlocal frames
        frames += 1
        if frames == MOVE:
            ask(load=0.5, friction=0.7)
        recorder.wanted = BEGIN <= frames < END

    session = Session(load_scene(scene, CHANGES.get(scene, {})), show, told.append, recorder)
    ask(load=0.2)
    with session:
        until = time.monotonic() + PATIENCE_S
        while frames <= END and time.monotonic() < until:
            session.check()
            time.sleep(0.02)
    return told[-1]


if __name__ == "__main__":
    with tempfile.TemporaryDirectory(dir=sys.argv[2]) as temporary:
        said = record(sys.argv[1], Path(temporary))
        if not said.startswith("recorded"):
            sys.exit(said)
        for file in (Path(temporary) / "001").iterdir():
            file.rename(Path(sys.argv[2]) / file.name)
