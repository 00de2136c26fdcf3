"""Learned models of the games. They need the extra `train`."""
