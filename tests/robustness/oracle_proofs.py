"""Plays every plan of the shipped oracle again, in float64: the best, the widest, the proof of each feasible order.

python tests/robustness/oracle_proofs.py; exits 1 if one does not end as stated.
"""

import sys

import numpy as np

from iphyre_jax.analyses import oracle
from iphyre_jax.analyses.orders import executed_order
from iphyre_jax.analyses.search import play_plans_of
from iphyre_jax.analyses.slack import slack_of
from iphyre_jax.execution.configuration import configure
from iphyre_jax.scenes import load_scene


def wrong_plans(fps: int) -> tuple[int, int]:
    """Plans that do not end as stated, and all plans, of a rate."""
    wrong = total = 0
    for game, row in oracle.shipped(fps).items():
        plans = np.array([row["plan"], *(found["plan"] for found in row["orders"])])
        reward, success, steps = play_plans_of(load_scene(game), plans, fps, oracle.RESETS[fps], "float64")
        orders = [tuple(found["order"]) for found in row["orders"]]
        played = [executed_order(plan, end) for plan, end in zip(plans[1:], steps[1:].tolist(), strict=True)]
        bad = int(reward[0] != row["reward"]) + int(success[0] != row["solved"])
        bad += sum(a != b for a, b in zip(orders, played, strict=True)) + int((~success[1:]).sum())
        if row["widest_plan"] is not None:
            widest = np.array(row["widest_plan"])
            _, solved, _ = play_plans_of(load_scene(game), widest[None], fps, oracle.RESETS[fps], "float64")
            slack = slack_of(load_scene(game), widest, fps, oracle.RESETS[fps])
            bad, total = bad + int(not solved[0] or slack != row["widest_slack"]), total + 1
        wrong, total = wrong + bad, total + len(plans)
    return wrong, total


def main() -> None:
    """Play, count, print."""
    configure()
    bad = 0
    for fps in oracle.RATES:
        wrong, total = wrong_plans(fps)
        bad += wrong
        print(f"{fps} steps a second: {total} plans, {wrong} end otherwise")
    sys.exit(bad > 0)


if __name__ == "__main__":
    main()
