"""Datasets at addresses, such as `s3://bucket/data`; needs the extra `cloud`.

A dataset at an address is made in a folder of the user's cache, and each sequence is copied when it
is complete, its `files.json` last. Readers copy what they read into the same folder. So a dataset
has the same files at an address as in a folder, and nothing half-copied looks whole.
"""

import hashlib
import os
import shutil
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from ..errors import UserError
from ..extras import install_command, need
from ..folders import filling, part_of, prepared, user_cache, whole_folder
from ..strange_files import refuse_links
from .folder import (
    FILES,
    MANIFEST,
    RECIPE,
    Place,
    file_digest,
    is_sequence,
    is_shared,
    read_files,
    read_manifest,
)

#: File of the parts of a dataset, which its manifest does not list.
SPLIT = "split.json"


def is_address(place: Place) -> bool:
    """Return True for an address of fsspec, False for a folder of this machine."""
    return "://" in os.fspath(place)


def fetched(place: Place, follow_links: bool = False) -> Path:
    """Folder with a complete dataset: the given one, or a copy of that at an address.

    Every reader of a dataset begins here. Only names of the format are accepted, so that no file
    outside of the folder is read or written.

    Parameters
    ----------
    place: folder or address
    follow_links: whether links in the folder may lead out of it, as in caches of hubs

    Raises
    ------
    UserError
        When there is no complete dataset at the address, it does not answer, or a link leads out
        of the folder.
    """
    if not is_address(place):
        folder = Path(place)
        if folder.is_dir():
            refuse_links(folder, follow_links)
        return folder
    address, folder = os.fspath(place), _cached(place)
    with _blaming(address):
        fs, root = _opened(address)
        if not fs.exists(f"{root}/{MANIFEST}"):
            raise UserError(f"{address} is no dataset, or not whole; it has no {MANIFEST}")
        if Path(root).is_dir() and "file" in fs.protocol:
            refuse_links(Path(root), follow_links)
        folder.mkdir(parents=True, exist_ok=True)
        with filling(folder, wait=True):  # others may read the same address
            (folder / SPLIT).unlink(missing_ok=True)
            for name in (MANIFEST, RECIPE, SPLIT):
                if fs.exists(f"{root}/{name}"):
                    _get(fs, f"{root}/{name}", folder / name)
            manifest = read_manifest(folder)
            for name, digest in manifest["files"].items():
                if not (folder / name).is_file() or file_digest(folder / name) != digest:
                    _get(fs, f"{root}/{name}", folder / name)
            for name, digest in manifest["sequences"].items():
                _fetch_sequence(fs, root, folder, name, digest)
    return folder


def fetch_begun(address: str) -> Path:
    """Folder for making a dataset that is copied to an address, with the sequences there so far.

    Raises
    ------
    UserError
        When the address does not answer.
    """
    folder = _cached(address)
    with _blaming(address):
        fs, root = _opened(address)
        if not fs.exists(f"{root}/{RECIPE}"):
            shutil.rmtree(folder, ignore_errors=True)
            return folder
        folder.mkdir(parents=True, exist_ok=True)
        if fs.exists(f"{root}/{MANIFEST}"):  # it is not whole while it grows
            fs.rm_file(f"{root}/{MANIFEST}")
        for path in fs.find(root):
            name = path.removeprefix(root).lstrip("/")
            where, _, file = name.rpartition("/")
            if is_sequence(where) and file == FILES:
                if not (folder / where).is_dir():
                    with suppress(UserError):  # it is made again
                        _fetch_sequence(fs, root, folder, where, None)
            elif is_shared(name) or name == SPLIT:
                _get(fs, path, folder / name)
    return folder


def has_dataset(address: str) -> bool:
    """Return True if there is a dataset at an address, complete or not."""
    with _blaming(address):
        fs, root = _opened(address)
        return bool(fs.exists(f"{root}/{RECIPE}"))


class Sender:
    """Copies whole sequences of a folder to an address as they come, and other files at the end.

    Parameters
    ----------
    folder, address: source and destination of the copies
    """

    def __init__(self, folder: Path, address: str) -> None:
        self._folder, self._address, self._last = folder, address, 0.0
        with _blaming(address):
            fs, root = _opened(address)
            there = fs.find(root) if fs.exists(root) else []
        sent = {path.split("/")[-2] for path in there if path.endswith(f"/{FILES}")}
        self._sent = {name for name in sent if is_sequence(name) and (folder / name).is_dir()}

    def again(self, names: Iterable[str]) -> None:
        """Copy these sequences again, because they are made again."""
        self._sent.difference_update(names)

    def send(self) -> None:
        """Copy new sequences, at most once in a few seconds."""
        every = 3.0  # time between two copies [s]
        if time.monotonic() < self._last + every:
            return
        with _blaming(self._address):
            fs, root = _opened(self._address)
            for one in sorted(self._folder.glob("sequence-*")):
                if one.name not in self._sent:
                    # A sequence without it is not complete.
                    for file in sorted(one.iterdir(), key=lambda f: f.name == FILES):
                        fs.put_file(str(file), f"{root}/{one.name}/{file.name}")
                    self._sent.add(one.name)
        self._last = time.monotonic()

    def finish(self) -> None:
        """Copy the remaining files, the manifest last."""
        self._last = 0.0
        self.send()
        with _blaming(self._address):
            fs, root = _opened(self._address)
            files = [f.relative_to(self._folder) for f in self._folder.rglob("*") if f.is_file()]
            rest = [f for f in files if not f.parts[0].startswith((".", "sequence-"))]
            for file in sorted(rest, key=lambda f: f.name == MANIFEST):
                fs.put_file(str(self._folder / file), f"{root}/{file.as_posix()}")


def put(file: Path, address: str) -> None:
    """Copy a file to an address."""
    with _blaming(address):
        fs, root = _opened(address)
        fs.put_file(str(file), f"{root}/{file.name}")


@contextmanager
def staged(out: Place) -> Iterator[Path]:
    """Folder to be filled, which gets its name, or goes to an address, when it is complete.

    An exception inside leaves nothing.

    Raises
    ------
    UserError
        When there is something already, or it cannot be written.
    """
    if not is_address(out):
        folder = Path(out)
        made = [path for path in (folder, *folder.parents) if not path.exists()]
        try:
            with prepared(folder, overwrite=None), whole_folder(folder) as part:
                yield part
        except BaseException:
            with suppress(OSError):
                for path in made:
                    path.rmdir()
            raise
        return
    address = os.fspath(out)
    with _blaming(address):
        fs, root = _opened(address)
        if fs.exists(root) and fs.find(root):
            raise UserError(f"{address} is not empty; choose another address")
    with tempfile.TemporaryDirectory() as temporary:
        whole = Path(temporary) / "out"
        whole.mkdir()
        yield whole
        Sender(whole, address).finish()


def _cached(address: Place) -> Path:
    name = hashlib.sha256(os.fspath(address).encode()).hexdigest()[:24]
    return user_cache() / "datasets" / name


def _opened(address: str) -> tuple[Any, str]:
    """File system of an address, and the path in it."""
    fs, root = need("fsspec", "cloud").core.url_to_fs(address)
    fs.invalidate_cache()  # others may have written there
    return fs, str(root).rstrip("/")


def _get(fs: Any, path: str, target: Path) -> None:
    """Copy a file, which gets its name when it is complete."""
    target.parent.mkdir(parents=True, exist_ok=True)
    part = part_of(target)
    fs.get_file(path, str(part))
    part.replace(target)


def _fetch_sequence(fs: Any, root: str, folder: Path, name: str, digest: str | None) -> None:
    """Copy a sequence that the folder does not have as it is at the address."""
    final = folder / name
    if (final / FILES).is_file() and digest in (None, file_digest(final / FILES)):
        return
    shutil.rmtree(final, ignore_errors=True)
    there = {path.rpartition("/")[2]: path for path in fs.find(f"{root}/{name}")}
    with whole_folder(final) as part:
        _copy(fs, there, FILES, part)
        for file in read_files(part)["files"]:
            _copy(fs, there, file, part)


def _copy(fs: Any, there: dict[str, str], name: str, folder: Path) -> None:
    """Copy a file of those that are there."""
    if name not in there:
        raise UserError(f"{folder.name}: {name} is missing at the address")
    fs.get_file(there[name], str(folder / name))


@contextmanager
def _blaming(address: str) -> Iterator[None]:
    """Say in a sentence what fails at an address; each kind of storage has errors of its own."""
    try:
        yield
    except UserError:
        raise
    except ImportError as error:
        text = f"{address} cannot be used: {error}: {install_command('cloud')}"
        raise UserError(text) from error
    except Exception as error:
        text = (str(error) or type(error).__name__).splitlines()[0]
        raise UserError(f"{address} cannot be used: {text}") from error
