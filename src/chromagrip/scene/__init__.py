"""Scenes, which define a run: their files, controllers by name, and the gripper's actuator."""

from .scene import Scene, load_scene, scene_names

__all__ = ["Scene", "load_scene", "scene_names"]
