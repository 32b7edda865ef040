"""What a run is made of: scenes and their files, controllers by name, the gripper's actuator."""

from .scene import Scene, load_scene, scene_names

__all__ = ["Scene", "load_scene", "scene_names"]
