import numpy as np
import pytest


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Overlays of nothing, as large ones take most of the time."""
    small = np.zeros((16, 16, 3), np.uint8)
    monkeypatch.setattr("chromagrip.pictures.track.TrackDrawing", lambda *_: lambda *_: small)
