"""The live page of a running grasp; not built yet."""
