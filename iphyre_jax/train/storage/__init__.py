"""Run folders, checkpoints, logs and the trained policies of the package."""
