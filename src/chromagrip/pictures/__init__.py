"""Pictures of one's own: markers tracked and forces estimated from files or a camera."""
