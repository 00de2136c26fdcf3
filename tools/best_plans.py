"""Search the forty games for good plans at 60 steps a second and write `iphyre_jax/viewer/best_plans.json`.

It takes some minutes. A game keeps its plan in the file unless the search finds a better one.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import iphyre_jax
from iphyre_jax.files import read_json_object, replace_text
from iphyre_jax.viewer.plays import play_to_json
from iphyre_jax.viewer.search import search

FILE = Path(iphyre_jax.__file__).parent / "viewer" / "best_plans.json"
AGENT = "best plan known"
SOURCE = "random search in this simulator, tools/best_plans.py; 60 steps a second, float64, fresh space"


def main() -> None:
    """Search, compare, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("games", nargs="*", default=list(iphyre_jax.GAMES))
    parser.add_argument("--plans", type=int, default=2048)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    known = {line["scene"]: line for line in read_json_object(FILE)["plays"]} if FILE.is_file() else {}
    for game in options.games:
        best = search(iphyre_jax.load_scene(game), plans=options.plans, seed=options.seed)
        old = known.get(game)
        if old is None or best.reward > old["result"]["reward"]:
            known[game] = play_to_json(best, AGENT, {"seed": options.seed, "plans": options.plans})
        print(f"{game}: found {best.reward:.2f}, best {known[game]['result']['reward']:.2f}", flush=True)
        lines = [json.dumps(known[name]) for name in iphyre_jax.GAMES if name in known]
        plays = ",\n  ".join(lines)
        replace_text(FILE, f'{{"source": {json.dumps(SOURCE)},\n "plays": [\n  {plays}\n ]}}\n')


if __name__ == "__main__":
    main()
