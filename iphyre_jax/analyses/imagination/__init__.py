"""Imagination: a planner that imagines plans in a simulator that is wrong by some pixels, and people beside it."""
