"""Pictures of domes of silicone, what estimators read in them, and the rows of it."""
