"""Read-outs that were trained at their first use, kept in the user's cache folder by design.

<cache>/chromagrip/readouts/<digest>.npz        <cache>: XDG_CACHE_HOME, LOCALAPPDATA or ~/.cache
"""

import hashlib
from dataclasses import asdict
from pathlib import Path
from typing import Any

import msgspec

from ...errors import UserError
from ...model import REFERENCE_NODES, Fingertip
from ...render import SensorDesign
from ...user_cache import user_cache

#: Version of the training: raise it with its ranges, its method and the content of a read-out's
#: file, so that no read-out of an earlier training is found.
TRAINING = 3
#: Folder of the kept read-outs in that of our caches.
_FOLDER = "readouts"
#: Digits to which markers of a file are told apart, in their unit on the skin.
_DIGITS = 9


def training_key(sensor: SensorDesign, fingertip: Fingertip) -> bytes:
    """All that a read-out depends on beside the noise of the camera, as JSON.

    Files that the design names count by their content. Neither the description nor the spread of
    the stiffness changes what is learned, and a read-out is trained on the chain, not on silicone.
    """
    design: dict[str, Any] = msgspec.to_builtins(sensor)
    del design["description"], design["silicone"]
    design["skin"].pop("stiffness_deviation", None)
    if "path" in design["layout"]:
        design["layout"]["path"] = sensor.places.round(_DIGITS).tolist()
    if sensor.camera.calibration:
        camera: Any = sensor.view.camera
        design["camera"]["calibration"] = asdict(camera)
    values = {"training": TRAINING, "sensor": design, "fingertip": vars(fingertip)}
    return msgspec.json.encode(values, order="deterministic")


def kept_path(design: SensorDesign) -> Path:
    """Where the read-out of a design is kept, once it is trained.

    Raises
    ------
    UserError
        Where there is no cache folder.
    """
    folder = user_cache()
    if not folder.is_absolute():
        raise UserError(
            f"read-outs cannot be kept: there is no cache folder {folder.parent}; set "
            "XDG_CACHE_HOME to a folder that can be written"
        )
    nominal = Fingertip.of_radius(design.shape.radius, nodes=REFERENCE_NODES, law="split")
    digest = hashlib.sha256(training_key(design, nominal)).hexdigest()[:20]
    return folder / _FOLDER / f"{digest}.npz"


def kept_readout(design: SensorDesign) -> Path | None:
    """Read-out that is kept for a design; None if there is none."""
    try:
        path = kept_path(design)
        return path if path.is_file() else None
    except (UserError, OSError):  # no cache folder, or one that cannot be read
        return None
