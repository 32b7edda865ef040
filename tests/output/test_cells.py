"""Results of many runs in a file."""

from dataclasses import dataclass
from pathlib import Path

import pytest

from chromagrip.errors import UserError
from chromagrip.output.cells import read_cells, write_cells


@dataclass(frozen=True)
class Cell:
    """One run."""

    name: str
    seed: int
    force: float


CELLS = [Cell(name=f"run {number}", seed=number, force=0.1 * number) for number in range(4)]


def test_what_was_written_is_read_to_the_last_digit(tmp_path: Path) -> None:
    write_cells(CELLS, tmp_path / "cells.csv")
    assert list(read_cells(tmp_path / "cells.csv", Cell)) == CELLS
    assert not list(read_cells(tmp_path / "none.csv", Cell))
    with pytest.raises(UserError, match="cannot be read"):
        list(read_cells(tmp_path, Cell))


def test_damage_is_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "cells.csv"
    write_cells(CELLS, path)
    path.write_text(path.read_text().replace("0.2", "x"))
    with pytest.raises(UserError, match="line 4, is no result of this work"):
        list(read_cells(path, Cell))
