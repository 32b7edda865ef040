"""Roll a screw over the dome of 2020: a video of the camera's picture beside the traction.

python examples/rolling_screw.py [VIDEO.mp4 SHEET.png]   # the sheet shows nine of its pictures
"""

import sys
from pathlib import Path

import cv2
import numpy as np
import trimesh

from chromagrip import model, render
from chromagrip.loop.results.dome_picture import TractionPicture
from chromagrip.model import shapes
from chromagrip.output.video import VideoFile

SENSOR, MU, SIDE = render.load_sensor("dome-2020"), 0.6, 480  # side of each picture [px]
DOME = model.Dome(radius=SENSOR.dome.radius, core=SENSOR.dome.core, pitch=0.7e-3)
SCREW, THREAD, GROOVE, LENGTH = 7e-3, 6e-3, 2e-3, 46e-3  # radius, pitch, depth of its thread [m]
DEPTH, SWING, FRAMES = 1.6e-3, np.radians(20.0), 120  # of the press [m], to either side


def screw(path: Path) -> shapes.Shape:
    """A rod along y with one thread, as a mesh in millimetres."""
    turn, along = np.meshgrid(np.linspace(0, 2 * np.pi, 97)[:-1], np.linspace(-0.5, 0.5, 185))
    phase = (along * LENGTH / THREAD - turn / (2 * np.pi)) % 1.0
    radius = SCREW - GROOVE * np.clip(2.0 * abs(2.0 * phase - 1.0) - 0.5, 0.0, 1.0)
    points = np.stack([radius * np.cos(turn), along * LENGTH, radius * np.sin(turn)], axis=-1)
    ends, count = [[0.0, -LENGTH / 2, 0.0], [0.0, LENGTH / 2, 0.0]], turn.shape[1]
    here = np.arange(turn.size).reshape(turn.shape)
    after = np.roll(here, -1, axis=1)
    a, b, c, d = here[:-1].ravel(), after[:-1].ravel(), here[1:].ravel(), after[1:].ravel()
    first, last = np.full(count, here.size), np.full(count, here.size + 1)
    faces = [(a, c, b), (b, c, d), (first, here[0], after[0]), (last, after[-1], here[-1])]
    corners = np.concatenate([np.column_stack(three) for three in faces])
    trimesh.Trimesh(1e3 * np.concatenate([points.reshape(-1, 3), ends]), corners).export(path)
    return shapes.mesh(path, scale=1e-3, cells=192, centred=True)


def rolled() -> model.Motion:
    """The screw is pressed at −20° of the dome, and rolls over the apex to +20°."""
    angles = np.concatenate([[-SWING], np.linspace(-SWING, SWING, 81)])
    rest, poses = DOME.radius + SCREW, np.zeros((82, 6))
    apart = rest - np.array([-0.1e-3, *[DEPTH] * 81])  # between its axis and the dome's centre
    poses[:, 0], poses[:, 2] = apart * np.sin(angles), apart * np.cos(angles) - rest
    poses[:, 4] = (angles - angles[0]) * rest / SCREW  # about y: it rolls and does not slide
    return model.Motion(times=np.concatenate([[0.0], np.linspace(0.2, 1.0, 81)]), poses=poses)


def middle(picture: np.ndarray, text: str) -> np.ndarray:
    """The middle of a picture, 24 mm wide, with a caption."""
    out = len(picture) // 5
    part = cv2.resize(picture[out:-out, out:-out], (SIDE, SIDE), interpolation=cv2.INTER_CUBIC)
    cv2.putText(part, text, (10, SIDE - 12), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (90, 90, 90), 1, 16)
    return cv2.rectangle(part, (0, 0), (SIDE - 1, SIDE - 1), (200, 200, 200))


def main(video: str = "screw.mp4", sheet: str = "screw.png") -> None:
    solid = model.Solid(shape=screw(Path(video).with_suffix(".stl")), friction=MU)
    run = model.simulate_contact(DOME, solid, rolled(), 1.0 / FRAMES, keep=1000)
    markers, painter = render.DomeMap(SENSOR, DOME), render.open_renderer("painter", SENSOR)
    traction, pictures = TractionPicture(DOME), []
    for state in (*run.states, *run.states[::-1]):  # there and back
        field = model.dome_forces(DOME, state)
        seen, below = painter.render(markers(state.linear)), traction.draw(field, MU)
        text = f"pressure and friction, {field.total_normal:.1f} N"
        pictures.append(np.hstack([middle(seen, "camera"), middle(below, text)]))
    with VideoFile(Path(video), 30, 18) as film:
        for picture in pictures:
            film.append(picture)
    nine = [pictures[k] for k in np.linspace(FRAMES // 6, FRAMES, 9).astype(int)]
    rows = [np.hstack([cv2.resize(p, (600, 300)) for p in nine[k : k + 3]]) for k in (0, 3, 6)]
    cv2.imwrite(sheet, np.vstack(rows)[..., ::-1])
    print(f"{len(pictures)} pictures in {video}, {run.touching.max()} nodes touch at most")


if __name__ == "__main__":
    main(*sys.argv[1:])
