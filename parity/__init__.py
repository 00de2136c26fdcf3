"""Comparison of the solver with the reference engine, pymunk 7.3.

``python -m parity`` runs it; ``parity.engines.reference`` is the only module of the project that imports pymunk.
"""
