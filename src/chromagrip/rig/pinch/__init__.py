"""Two fingers that hold one object: rig, runs, traces and pictures."""
