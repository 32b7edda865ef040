"""chromagrip."""
