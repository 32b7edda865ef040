"""The thesis's node model: a slice of the fingertip as a chain of nodes on springs."""
