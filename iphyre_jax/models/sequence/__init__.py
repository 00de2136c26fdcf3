"""Sequence models: a causal transformer over returns, states and actions that is asked for a high return."""
