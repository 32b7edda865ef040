"""Controllers in the scenes of two fingers: what they hold, drop, turn and crush."""
