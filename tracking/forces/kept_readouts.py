"""Read-outs that are trained at first use and then stored in the user's cache folder.

<cache>/chromagrip/readouts/<digest>.npz        <cache>: XDG_CACHE_HOME, LOCALAPPDATA or ~/.cache
"""

import hashlib
from dataclasses import asdict
from pathlib import Path
from typing import Any

import msgspec

from ...errors import UserError
from ...folders import user_cache
from ...model import REFERENCE_NODES, Fingertip
from ...render import SensorDesign

#: Version of the training: raise it when its ranges, its method or the content of a read-out's file
#: change, so that read-outs of an earlier training are not used.
TRAINING = 3
#: Folder of the stored read-outs in the cache folder of chromagrip.
_FOLDER = "readouts"
#: Decimal digits of marker positions that count, in their unit on the skin.
_DIGITS = 9


def training_key(sensor: SensorDesign, fingertip: Fingertip) -> bytes:
    """Everything that a read-out depends on except the noise of the camera, as JSON.

    Files that the design names count by their content. Description, spread of the stiffness and
    silicone are left out: a read-out is trained on the chain and does not depend on them.
    """
    design: dict[str, Any] = msgspec.to_builtins(sensor)
    del design["description"], design["silicone"]
    design["skin"].pop("stiffness_deviation", None)
    if "path" in design["layout"]:
        design["layout"]["path"] = sensor.places.round(_DIGITS).tolist()
    design["camera"]["model"] = sensor.camera.model or "fisheye"  # as long as it had that default
    if sensor.camera.calibration:
        camera: Any = sensor.view.camera
        design["camera"]["calibration"] = asdict(camera)
    values = {"training": TRAINING, "sensor": design, "fingertip": vars(fingertip)}
    return msgspec.json.encode(values, order="deterministic")


def kept_path(design: SensorDesign) -> Path:
    """Path of the cached read-out of a design, whether it exists or not.

    Raises
    ------
    UserError
        When there is no cache folder.
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
    """Path of the cached read-out of a design; None if it does not exist."""
    try:
        path = kept_path(design)
        return path if path.is_file() else None
    except (UserError, OSError):  # no cache folder, or one that cannot be read
        return None
