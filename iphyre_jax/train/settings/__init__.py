"""The settings of a training run: of its agent, of the run, and presets."""
