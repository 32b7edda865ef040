"""Scenes, motions and scores that benches, charts and maps share."""
