"""Speed of the simulator beside the engines it replaces: ``python -m benchmarks``.

Every engine plays the same plans in worker processes of its own (`workers`). The engines take turns, so that other load
on the machine falls on all of them. Workers may belong to other virtual environments; they and the driver exchange
lines of JSON.
"""
