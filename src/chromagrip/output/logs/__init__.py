"""Logs of runs in the formats of other tools: MCAP and Rerun."""
