"""Outcome classifiers: from the start of a scene and a plan to whether the plan solves it."""
