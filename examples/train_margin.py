"""Train a small network to read the safety margin off marker displacements of a dataset.

    python examples/train_margin.py [SEQUENCES FOLDER]   # few, unless told; the folder is kept

It learns from labels; it is tested on what a tracker finds in pictures of objects that it has not
seen, and in those of another renderer, beside chromagrip's own read-out. Needs the extra `learn`.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
from msgspec.structs import replace
from scipy.spatial import KDTree
from sklearn.decomposition import PCA
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline

from chromagrip.dataset.folder import Loaded, load_sequences, sequence_name
from chromagrip.dataset.make import make
from chromagrip.dataset.recipe import load_recipe
from chromagrip.dataset.split import split
from chromagrip.loop.grasp import known_sensor
from chromagrip.loop.observers import CameraObserver
from chromagrip.output.pictures import read_picture
from chromagrip.render import Frame
from chromagrip.render.drawing.gl import gl_problem

TRACKED = 0.02  # noise of a tracker's places, of which labels have none [px]


def tracked(one: Loaded) -> tuple[np.ndarray, list[float]]:
    """Displacements that a tracker finds, (T, 4M), and Γ as our own read-out has it, (T,)."""
    known, scene = known_sensor(one.scene), one.scene
    noise, window = scene.camera.noise_levels, scene.safety_margin.friction_window_s
    rest = Frame(image=read_picture(one.rest), time=-1.0)
    observer = CameraObserver(known, "fit", "auto", noise, window, [rest])
    designed = known.sensor.view.project(known.sensor.shape.points(known.sensor.places, 0.0))
    number = KDTree(observer.rest.position[0]).query(designed)[1]  # in the labels' order
    film = zip(one.images(), one.frames["time_s"], strict=True)
    seen = [observer.observe(Frame(image=image, time=time)) for image, time in film]
    moved = np.stack([tracks.position for _, tracks in seen]) - observer.rest.position
    return np.nan_to_num(moved)[:, :, number].reshape(len(moved), -1), [s.margin for s, _ in seen]


def main(count: int, folder: Path) -> None:
    force = replace(load_recipe("force"), sequences=count)
    x, y, tests = [], [], {"unseen objects": []}
    if gl_problem() is None:
        scene = {**force.scene, "renderer": "pyrender", "duration_s": 0.25}
        mesh = replace(force, seed=1, sequences=max(1, count // 30), scene=scene)
        make(mesh, folder / "mesh", workers=2, resume=True)
        tests["other renderer"] = load_sequences(folder / "mesh")
    make(force, folder / "force", workers=2, resume=True)
    parts = split(folder / "force", {"train": 0.9, "test": 0.1})
    for one in load_sequences(folder / "force"):
        if sequence_name(one.number) in parts["test"]:
            tests["unseen objects"].append(one)
        else:
            touches = np.isfinite(one.frames["margin"])
            x.append((one.places - one.places[0]).reshape(len(touches), -1)[touches])
            y.append(one.frames["margin"][touches])
    x, y = np.concatenate(x), np.concatenate(y)
    x += TRACKED * np.random.default_rng(0).standard_normal(x.shape)
    network = MLPRegressor(hidden_layer_sizes=(128, 64), early_stopping=True, random_state=0)
    model = make_pipeline(PCA(40, whiten=True, random_state=0), network).fit(x, y)
    for name, asked in tests.items():
        read = [(*tracked(one), one.frames["margin"]) for one in asked]
        moved, own, true = (np.concatenate(values) for values in zip(*read, strict=True))
        learnt, mean = np.clip(model.predict(moved), 0.0, 1.0), np.full(len(true), y.mean())
        for who, said in (("network", learnt), ("our read-out", own), ("one answer", mean)):
            off = (said - true)[np.isfinite(said - true)]
            print(f"{name}, {who}: error of Γ {np.sqrt((off**2).mean()):.3f}, {len(off)} frames")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as scratch:
        main(int((sys.argv[1:2] or ["10"])[0]), Path((sys.argv[2:3] or [scratch])[0]))
