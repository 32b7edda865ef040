"""The grip loop outside of the simulation: a real camera's frames and a real gripper."""
