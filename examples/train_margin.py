"""Train a small network to estimate the safety margin from marker displacements of a dataset.

    python examples/train_margin.py [SEQUENCES FOLDER]   # 10 by default; a given folder is kept

It is tested on tracked pictures of unseen objects and of another renderer. Needs the extra `learn`.
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

from chromagrip import Reader, dataset
from chromagrip.render import gl_problem
from chromagrip.sensing.reader import known_sensor

NOISE = 0.02  # of tracked positions, which labels do not have [px]


def tracked(sequence: dataset.Loaded) -> tuple[np.ndarray, list[float]]:
    """Tracked displacements, (T, 4M), and Γ by chromagrip's own read-out, (T,)."""
    scene, known = sequence.scene, known_sensor(sequence.scene)
    noise, window = scene.camera.noise_levels, scene.safety_margin.friction_window_s
    reader = Reader(known, [sequence.pictures.rest], noise=noise, window=window)
    designed = known.sensor.view.project(known.sensor.shape.points(known.sensor.places, 0.0))
    number = KDTree(reader.rest.position[0]).query(designed)[1]  # in the labels' order
    pictures = zip(sequence.images(), sequence.frames["time_s"], strict=True)
    readings = [reader.update(image, time) for image, time in pictures]
    moved = np.stack([one.tracks.position for one in readings]) - reader.rest.position
    displacement = np.nan_to_num(moved)[:, :, number].reshape(len(moved), -1)
    return displacement, [one.margin for one in readings]


def main(count: int, folder: Path) -> None:
    force = replace(dataset.load_recipe("force"), sequences=count)
    x, y, tests = [], [], {"unseen objects": []}
    if gl_problem() is None:
        other = {**force.scene, "renderer": "pyrender", "duration_s": 0.25}
        mesh = replace(force, seed=1, sequences=max(1, count // 30), scene=other)
        dataset.make_dataset(mesh, folder / "mesh", workers=2, resume=True)
        tests["other renderer"] = dataset.load_sequences(folder / "mesh")
    dataset.make_dataset(force, folder / "force", workers=2, resume=True)
    parts = dataset.split_dataset(folder / "force", {"train": 0.9, "test": 0.1})
    for sequence in dataset.load_sequences(folder / "force"):
        if dataset.sequence_name(sequence.number) in parts["test"]:
            tests["unseen objects"].append(sequence)
        else:
            contact = np.isfinite(sequence.frames["margin"])
            x.append((sequence.places - sequence.places[0]).reshape(len(contact), -1)[contact])
            y.append(sequence.frames["margin"][contact])
    x, y = np.concatenate(x), np.concatenate(y)
    x += NOISE * np.random.default_rng(0).standard_normal(x.shape)
    network = MLPRegressor(hidden_layer_sizes=(128, 64), early_stopping=True, random_state=0)
    model = make_pipeline(PCA(40, whiten=True, random_state=0), network).fit(x, y)
    for name, sequences in tests.items():
        read = [(*tracked(sequence), sequence.frames["margin"]) for sequence in sequences]
        displacement, own, true = (np.concatenate(values) for values in zip(*read, strict=True))
        learnt = np.clip(model.predict(displacement), 0.0, 1.0)
        for method, margin in (("network", learnt), ("read-out", own), ("constant", y.mean())):
            error = np.sqrt(np.nanmean((margin - true) ** 2))
            print(f"{name}, {method}: RMS error of Γ {error:.3f}")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as scratch:
        main(int((sys.argv[1:2] or ["10"])[0]), Path((sys.argv[2:3] or [scratch])[0]))
