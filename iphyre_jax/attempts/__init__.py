"""Attempts: how soon an agent solves a game if it may try several times.

`protocol` lets an agent try each game k times; `metrics` makes curves, AUCCESS and intervals of what came out; `agents`
and `planner` propose plans without a learned model; `policies` lets trained policies try (the extra `train`).
"""
