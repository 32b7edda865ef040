"""Grasps outside what a read-out was trained on, and scores of what it says of them."""
