"""What a run of two fingers is recorded and shown as."""
