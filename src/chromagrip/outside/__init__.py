"""The grip loop outside of the simulation: frames of a camera, and a gripper that takes forces."""
