"""Train a small network to read the safety margin off marker displacements of a dataset.

    chromagrip dataset make force --n 300 --out data/force
    chromagrip dataset make examples/other-renderer.toml --out data/other
    python examples/train_margin.py data/force data/other

It learns from labels of the first dataset and is tested on objects it has not seen: on what a
tracker finds in their pictures, and in those of another renderer. chromagrip's own read-out, which
knows neither dataset, reads the same tracks. Needs the extra `learn`.
"""

import sys
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree
from sklearn.decomposition import PCA
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from chromagrip.dataset_folder import Loaded, load_sequences, sequence_name
from chromagrip.dataset_split import split
from chromagrip.render import Frame
from chromagrip.sources import read_picture
from chromagrip.tracking import MarkerTracker, NoEstimateError, Palette, load_reconstructor
from chromagrip.tracking.calibration import load_calibration

KNOWN = load_calibration("thesis")
REST = KNOWN.sensor.view.project(KNOWN.sensor.shape.points(KNOWN.sensor.places, 0.0))
NOISE = 0.01  # of a tracked marker [px]


def labelled(one: Loaded) -> np.ndarray:
    """Displacements of the markers since rest, as the labels have them, shape (T, 4M)."""
    return (one.places - one.places[0]).reshape(len(one.places), -1)


def tracked(one: Loaded) -> tuple[np.ndarray, np.ndarray]:
    """The same as a tracker finds them, and Γ as our own reconstructor reads them, shape (T,)."""
    noise = float(one.values["camera.noise_levels"])
    tracker = MarkerTracker(Palette.of_sensor(KNOWN.sensor), noise)
    rest = tracker.reset([Frame(image=read_picture(one.rest), time=-1.0)])
    number = KDTree(rest.position[0]).query(REST)[1]  # in the design's order
    forces = load_reconstructor("sequential")(KNOWN, rest)
    moved, margins = [], []
    for k, image in enumerate(one.images()):
        tracks = tracker.update(Frame(image=image, time=k / one.scene.camera.rate_hz))
        moved.append(np.nan_to_num(tracks.position - rest.position)[:, number].ravel())
        try:
            field = forces.update(tracks)
            margins.append(field.safety_margin(field.friction_reading.value))
        except NoEstimateError:
            margins.append(np.nan)
    return np.array(moved), np.array(margins)


def rms(said: np.ndarray, true: np.ndarray) -> str:
    """Error where something was said."""
    off = (said - true)[np.isfinite(said)]
    return f"{np.sqrt((off**2).mean()):.3f}"


def main() -> None:
    folder, other = map(Path, sys.argv[1:3])
    parts = split(folder, {"train": 0.85, "test": 0.15})
    rng = np.random.default_rng(0)
    taught, asked = [], []
    for one in load_sequences(folder):
        margin = one.frames["margin"]
        there = np.isfinite(margin)
        if sequence_name(one.number) in parts["train"]:
            x = labelled(one)[there]
            taught.append((x + NOISE * rng.standard_normal(x.shape), margin[there]))
        else:
            asked.append(one)
    x, y = (np.concatenate(values) for values in zip(*taught, strict=True))
    print(f"learning from {len(y)} frames")
    network = MLPRegressor((128, 64), early_stopping=True, max_iter=300, random_state=0)
    model = make_pipeline(PCA(40, random_state=0), StandardScaler(), network).fit(x, y)
    for name, sequences in (("unseen objects", asked), ("other renderer", load_sequences(other))):
        said, own, true = [], [], []
        for one in sequences:
            moved, read = tracked(one)
            there = np.isfinite(one.frames["margin"])
            said.append(model.predict(moved[there]))
            own.append(read[there])
            true.append(one.frames["margin"][there])
        truth = np.concatenate(true)
        print(f"{name}, RMS error of Γ over {len(truth)} frames")
        print(f"  small network   {rms(np.concatenate(said), truth)}")
        print(f"  our read-out    {rms(np.concatenate(own), truth)}")
        print(f"  constant answer {rms(np.full(len(truth), y.mean()), truth)}")


if __name__ == "__main__":
    main()
