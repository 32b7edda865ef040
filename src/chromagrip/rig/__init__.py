"""Two fingers and environments around the grip loop; not built yet."""
