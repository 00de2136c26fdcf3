"""Analyses of games, agents and people, each a table that a command regenerates: `iphyre-jax analyse`.

What takes long is a row: computed once, kept as JSON in a folder, and not computed again. `iphyre_jax.kept_rows` keeps
rows; the modules here compute them (`search`, `orders`, `slack`, ...) or make tables of them.
"""
