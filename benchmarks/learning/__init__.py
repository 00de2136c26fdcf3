"""Results of agents that learn: their rows, seed by seed, and the documents of what is there."""
