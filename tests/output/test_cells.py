"""Results of many runs in a file."""

import re
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


def test_damage_is_one_sentence_or_does_not_matter(tmp_path: Path) -> None:
    path = tmp_path / "cells.csv"
    write_cells(CELLS, path)
    whole, refused = path.read_text(), 0
    for damage in ("", "x", "0.1,", "\0", "\n\n,,,,", "\xe9", '"'):
        for place in range(0, len(whole), 7):
            path.write_text(whole[:place] + damage + whole[place + 1 :], encoding="latin-1")
            said = ""
            try:
                cells = list(read_cells(path, Cell))
            except UserError as error:
                cells, said, refused = [], str(error), refused + 1
            assert all(isinstance(cell.force, float) for cell in cells)
            assert not said or re.fullmatch(r".*, line \d+, is no result of this work .*", said)
    assert refused > 30
