"""Agents that are no policies of `train`: language models."""
