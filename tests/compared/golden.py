"""Draw the golden pictures of a checkout elsewhere: `golden.py TREE FOLDER`."""

import runpy
import shutil
import sys
from pathlib import Path

if __name__ == "__main__":
    tree, folder = map(Path, sys.argv[1:])
    script = folder / "make.py"
    shutil.copy(tree / "fixtures" / "golden" / "make.py", script)
    runpy.run_path(str(script), run_name="__main__")
    script.unlink()
