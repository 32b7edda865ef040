"""Datasets at addresses of fsspec, such as `s3://bucket/data`; needs the extra `cloud`.

A dataset is made, read and exported in a folder of the user's cache, and copied from or to its
address as a whole, the manifest last.
"""

import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from ..errors import UserError
from ..extras import install_command, need
from ..folders import filling, prepared, user_cache, whole_folder
from ..strange_files import refuse_links
from .folder import FILES, MANIFEST, RECIPE, SPLIT, Place, file_digest, read_files, read_manifest


def is_address(place: Place) -> bool:
    """Return True for an address of fsspec, False for a folder of this machine."""
    return "://" in os.fspath(place)


def fetched(place: Place, follow_links: bool = False) -> Path:
    """Folder with a complete dataset: the given one, or a copy of that at an address.

    Every reader of a dataset begins here. Only names of the format are copied, so that no file
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
    folder = _cached(place)
    with _opened(place) as (fs, root):
        if not fs.exists(f"{root}/{MANIFEST}"):
            raise UserError(f"{place} is no dataset, or not whole; it has no {MANIFEST}")
        if Path(root).is_dir() and "file" in fs.protocol:
            refuse_links(Path(root), follow_links)

        def get(name: str, target: Path) -> None:
            target.parent.mkdir(parents=True, exist_ok=True)
            fs.get_file(f"{root}/{name}", str(target))

        folder.mkdir(parents=True, exist_ok=True)
        with filling(folder, wait=True):  # others may read the same address
            (folder / SPLIT).unlink(missing_ok=True)
            for name in (MANIFEST, RECIPE, SPLIT):
                if fs.exists(f"{root}/{name}"):
                    get(name, folder / name)
            manifest = read_manifest(folder)
            for name, digest in manifest["files"].items():
                if _lacks(folder / name, digest):
                    get(name, folder / name)
            for name, digest in manifest["sequences"].items():
                if _lacks(folder / name / FILES, digest):
                    shutil.rmtree(folder / name, ignore_errors=True)
                    with whole_folder(folder / name) as part:
                        get(f"{name}/{FILES}", part / FILES)
                        for file in read_files(part)["files"]:
                            get(f"{name}/{file}", part / file)
    return folder


def _lacks(path: Path, digest: str) -> bool:
    return not path.is_file() or file_digest(path) != digest


def begun(address: Place, resume: bool) -> Path:
    """Folder in which a dataset is made that goes to an address, with what there is of it.

    That is the whole dataset at the address, or what an interrupted run left on this machine.

    Raises
    ------
    UserError
        When there is something at the address and it is not resumed.
    """
    if not resume:
        _check_empty(address, "go on with --resume, or choose another")
        shutil.rmtree(_cached(address), ignore_errors=True)
        return _cached(address)
    with _opened(address) as (fs, root):
        return fetched(address) if fs.exists(f"{root}/{MANIFEST}") else _cached(address)


def send(folder: Path, address: Place) -> None:
    """Copy a folder to an address; a dataset is whole there at the end, with its manifest."""
    with _opened(address) as (fs, root):
        if fs.exists(f"{root}/{MANIFEST}"):
            fs.rm_file(f"{root}/{MANIFEST}")
        files = [file.relative_to(folder) for file in folder.rglob("*") if file.is_file()]
        for file in sorted(files, key=lambda file: (file.name == MANIFEST, file)):
            if not file.parts[0].startswith("."):  # a lock
                fs.put_file(str(folder / file), f"{root}/{file.as_posix()}")


def send_file(file: Path, address: Place) -> None:
    """Copy a file of a dataset to its address; nothing is to be copied for a folder."""
    if not is_address(address):
        return
    with _opened(address) as (fs, root):
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
    if is_address(out):
        _check_empty(out, "choose another")
        with tempfile.TemporaryDirectory() as temporary:
            yield Path(temporary)
            send(Path(temporary), out)
        return
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


def _check_empty(address: Place, advice: str) -> None:
    with _opened(address) as (fs, root):
        if fs.exists(root) and fs.find(root):
            raise UserError(f"{address} is not empty; {advice}")


def _cached(address: Place) -> Path:
    name = hashlib.sha256(os.fspath(address).encode()).hexdigest()[:24]
    return user_cache() / "datasets" / name


@contextmanager
def _opened(address: Place) -> Iterator[tuple[Any, str]]:
    """File system of an address, and the path in it; says in a sentence what fails there."""
    try:
        fs, root = need("fsspec", "cloud").core.url_to_fs(os.fspath(address))
        fs.invalidate_cache()  # others may have written there
        yield fs, str(root).rstrip("/")
    except UserError:
        raise
    except ImportError as error:
        text = f"{address} cannot be used: {error}: {install_command('cloud')}"
        raise UserError(text) from error
    except Exception as error:  # each kind of storage has errors of its own
        text = (str(error) or type(error).__name__).splitlines()[0]
        raise UserError(f"{address} cannot be used: {text}") from error
