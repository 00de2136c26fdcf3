"""The algorithms and what they share; registry lists the functions that each must have."""
