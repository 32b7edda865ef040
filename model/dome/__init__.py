"""The fingertip as a dome of linear silicone in three dimensions; not built yet."""
