"""The algorithms and what they share; `base.Algorithm` has the methods that each must have."""
