"""Builds take the four stages from their folders at the root, not from the links to them.

A checkout without symbolic links has text files in place of the links, which would be packed.
"""

from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

STAGES = ("model", "render", "tracking", "control")
MEND = (
    "git config core.symlinks true && git checkout -- src/chromagrip "
    "(on Windows, turn Developer Mode on first)"
)


class StagesHook(BuildHookInterface[Any]):
    """Adds the stages to a wheel or a source distribution, and refuses to build without them."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Name the folder of each stage, and its place in the package."""
        root = Path(self.root)
        package = "src/chromagrip" if self.target_name == "sdist" else "chromagrip"
        for stage in STAGES:
            # An unpacked source distribution has the folder in place of the link.
            folder, linked = root / stage, root / "src/chromagrip" / stage
            source = next(filter(_is_package, (folder, linked)), None)
            if source is None:
                self.app.abort(f"cannot build chromagrip: there is no folder {folder}")
            elif version != "editable":
                build_data["force_include"][str(source)] = f"{package}/{stage}"
            elif not _is_package(linked):
                self.app.abort(
                    "cannot install chromagrip as editable: the checkout has no symbolic links; "
                    f"run: {MEND}"
                )


def _is_package(folder: Path) -> bool:
    return (folder / "__init__.py").is_file()
