"""Datasets for PyTorch, where it is installed: a wheel of some hundred megabytes."""

from pathlib import Path

import numpy as np
import pytest

from chromagrip import UserError
from chromagrip.dataset import load_sequences
from chromagrip.dataset.make import make
from chromagrip.dataset.recipe import load_recipe
from chromagrip.dataset.split import split
from chromagrip.dataset.torch import Frames

torch = pytest.importorskip("torch")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data") / "tiny"
    make(load_recipe("tiny"), folder)
    split(folder, {"train": 0.6, "test": 0.4})
    return folder


def test_items_are_those_of_the_dataset(made: Path) -> None:
    frames = Frames(
        str(made), labels=("margin", "normal_n", "x_px", "visible", "slip_state"), with_rest=True
    )
    assert len(frames) == 21
    loaded = list(load_sequences(made))
    for index in (0, 9, 20, -1):
        item, one, t = frames[index], loaded[index // 7], index % 7
        assert (item["sequence"], item["frame"]) == (one.number, t)
        assert (item["image"].numpy().transpose(1, 2, 0) == list(one.images())[t]).all()
        assert item["x_px"].dtype == torch.float32
        np.testing.assert_array_equal(item["x_px"].numpy(), one.markers["x_px"][t])
        np.testing.assert_array_equal(item["visible"].numpy(), one.markers["visible"][t])
        for name in ("margin", "normal_n"):
            np.testing.assert_allclose(item[name].numpy(), one.frames[name][t], rtol=1e-6)
    with pytest.raises(IndexError):
        frames[21]


def test_workers_share_nothing_and_noise_has_its_size(made: Path) -> None:
    noisy = Frames(made, "train", noise=8.0, seed=3)
    clean = Frames(made, "train")
    assert len(noisy) + len(Frames(made, "test")) == 21
    loader = torch.utils.data.DataLoader(noisy, batch_size=5, num_workers=2)
    batches = torch.cat([batch["image"] for batch in loader])
    assert all((batches[k] == noisy[k]["image"]).all() for k in range(len(noisy)))
    middle = (slice(None), slice(200, 280), slice(280, 360))
    off = noisy[1]["image"][middle].float() - clean[1]["image"][middle].float()
    within = clean[1]["image"][middle] < 220  # where nothing is clipped
    assert off[within].std() == pytest.approx(8.0, rel=0.1)
    assert (noisy[1]["image"] != Frames(made, "train", noise=8.0, seed=4)[1]["image"]).any()


def test_a_label_or_a_part_that_there_is_not_is_said(made: Path) -> None:
    with pytest.raises(UserError, match=r"no label 'flow' in .*; there is frame, time_s"):
        Frames(made, labels=("flow",))
    with pytest.raises(UserError, match="no part 'dev'"):
        Frames(made, "dev")
    with pytest.raises(UserError, match="noise = -1"):
        Frames(made, noise=-1)
