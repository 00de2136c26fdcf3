"""How fast the simulator is, side by side with the engines it replaces: ``python -m benchmarks``.

Every engine plays the same plans in worker processes of its own (`workers`), in turns, so that whatever else the
machine does falls on all of them. Workers may belong to other virtual environments; they and the driver exchange lines
of JSON.
"""
