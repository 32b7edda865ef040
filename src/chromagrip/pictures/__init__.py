"""The user's own pictures: markers tracked and forces estimated, from files or a camera."""
