"""The live page of a running grasp: sliders, the fingertip in three dimensions, curves."""
