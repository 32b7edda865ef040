"""Test of off-screen OpenGL on this machine, in a subprocess because it may crash."""

import os
import subprocess
import sys
from functools import lru_cache

from ...extras import missing

#: Command that installs the libraries for an off-screen context on Debian.
MEND = "sudo apt-get install libegl1 libgl1 libgl1-mesa-dri libxrender1"

#: Program of the subprocess: it fails if no off-screen context can be opened.
_PROBE = """
import pyrender
renderer = pyrender.OffscreenRenderer(8, 8)
scene = pyrender.Scene()
scene.add(pyrender.OrthographicCamera(xmag=1.0, ymag=1.0))
renderer.render(scene)
renderer.delete()
"""


def prepare() -> None:
    """Select off-screen rendering; call this before the first import of pyrender."""
    os.environ.setdefault("PYOPENGL_PLATFORM", "egl")


@lru_cache(maxsize=1)
def gl_problem() -> str | None:
    """Test off-screen OpenGL; return the reason if it does not work, else None."""
    absent = missing("gl")
    if absent is not None:
        return absent
    prepare()
    try:
        probe = subprocess.run(
            [sys.executable, "-c", _PROBE], capture_output=True, text=True, timeout=120, check=False
        )
    except subprocess.TimeoutExpired:
        return "opening an off-screen context took over two minutes"
    if probe.returncode == 0:
        return None
    lines = probe.stderr.strip().splitlines()
    return f"no off-screen OpenGL context: {lines[-1] if lines else 'the probe crashed'}"
