"""Worlds inside of the user's program."""
