"""Sweeps: settings × scenes × seeds, each run once, with intervals, a table and a map."""
