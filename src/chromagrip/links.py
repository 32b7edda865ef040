"""The four stages of a checkout, which are symbolic links to folders at its root.

By default Git on Windows writes text files in their place.
"""

import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType

STAGES = ("model", "render", "tracking", "control")
#: Command that makes the links of a checkout.
MEND = (
    "git config core.symlinks true && git checkout -- src/chromagrip "
    "(on Windows, turn Developer Mode on first)"
)


def problem() -> str | None:
    """Name the missing stages in one sentence; None if all are present."""
    here = Path(__file__).parent
    lost = [name for name in STAGES if not (here / name / "__init__.py").is_file()]
    if not lost:
        return None
    return f"the checkout has no symbolic links in {here} ({', '.join(lost)}); run: {MEND}"


class _Refusal:
    """Module finder that refuses to import a stage."""

    def __init__(self, sentence: str) -> None:
        self._sentence = sentence

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Refuse a stage; leave every other module to the other finders."""
        package, _, stage = name.rpartition(".")
        if package == __package__ and stage in STAGES:
            raise ImportError(self._sentence, name=name)
        return None


def guard() -> None:
    """Make every import of a missing stage fail with the sentence of `problem`."""
    sentence = problem()
    if sentence is not None:
        sys.meta_path.insert(0, _Refusal(sentence))
