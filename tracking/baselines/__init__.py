"""Baseline trackers, compared with the default one; they also follow markers of any form.

Each measures the position of a marker near its expected position: as the centroid of the pixels
that it covers, c = Σ w·x/Σ w (`detect`, `centroid`, `chromatouch`), or by the shift d of its window
since rest, argmin Σ (I(x + d) − I₀(x))² (`lk`).
"""
