"""Names and links in folders of strangers."""

import os
from pathlib import Path

import pytest

from chromagrip import UserError
from chromagrip.strange_files import inside, refuse_links, shortened


@pytest.mark.parametrize(
    "name",
    ["", ".", "..", "../x", "a/../../x", "a/..", "/etc/passwd", "a//b", "a/", "./a", "a\\b",
     "a\0b", "a\nb", "\x1b[2J"],
)  # fmt: skip
def test_a_name_stays_inside(tmp_path: Path, name: str) -> None:
    for follow in (False, True):
        with pytest.raises(UserError, match="expected a name inside the folder"):
            inside(tmp_path, name, follow_links=follow)


def test_plain_names_are_joined(tmp_path: Path) -> None:
    for name in ("a", "a/b.png", "a b", "ä", "..a", "a..", "c:d" if os.name != "nt" else "cd"):
        assert inside(tmp_path, name) == tmp_path / name


def test_a_link_that_leaves_is_refused(tmp_path: Path) -> None:
    home, secret = tmp_path / "home", tmp_path / "secret"
    (home / "sub").mkdir(parents=True)
    secret.write_text("s")
    (home / "kept").write_text("k")
    (home / "own").symlink_to("kept")
    (home / "sub" / "up").symlink_to("../kept")
    (home / "loop").symlink_to("loop")
    alias = tmp_path / "alias"  # the user's own name of the folder
    alias.symlink_to(home)
    for folder in (home, alias):
        refuse_links(folder)
        for name in ("own", "sub/up", "kept", "missing", "loop"):
            assert inside(folder, name) == folder / name
    for name, target in (("out", secret), ("sub/far", "../../secret"), ("gone", "/nowhere"),
                         ("folder", tmp_path), ("twice", "out")):  # fmt: skip
        (home / name).symlink_to(target)
        below = f"{name}/secret" if name == "folder" else name
        with pytest.raises(UserError, match=r"leads out of its folder; give --follow-links"):
            inside(home, below)
        assert inside(home, below, follow_links=True) == home / below
        with pytest.raises(UserError, match="--follow-links"):
            refuse_links(home)
        refuse_links(home, follow_links=True)
        if name != "out":
            (home / name).unlink()


def test_a_pipe_is_no_file(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")  # reading it would wait for ever
    for follow in (False, True):
        with pytest.raises(UserError, match="is no file"):
            refuse_links(tmp_path, follow)


def test_a_long_value_is_shortened() -> None:
    assert shortened("a") == "'a'"
    assert len(shortened("x" * 5000)) == 80
    assert "\n" not in shortened("a\nb")
