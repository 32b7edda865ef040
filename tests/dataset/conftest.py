"""What tests of datasets share."""

from pathlib import Path

import pytest

from chromagrip.dataset.make import make
from chromagrip.dataset.recipe import load_recipe


@pytest.fixture(scope="session")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tiny dataset, made by one process; not to be changed."""
    folder = tmp_path_factory.mktemp("data") / "tiny"
    make(load_recipe("tiny"), folder)
    return folder
