"""Force reconstruction on the chain's plane."""
