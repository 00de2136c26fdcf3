"""Search the forty games for good plans at 60 steps a second and write `iphyre_jax/viewer/best_plans.json`.

Takes some minutes. A game whose plan in the file is as good or better keeps it.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import iphyre_jax
from iphyre_jax.viewer.plays import Play, play_from_json, play_to_json
from iphyre_jax.viewer.search import search

FILE = Path(iphyre_jax.__file__).parent / "viewer" / "best_plans.json"
AGENT = "best plan known"


def main() -> None:
    """Search, compare, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("games", nargs="*", default=list(iphyre_jax.GAMES))
    parser.add_argument("--plans", type=int, default=2048)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    iphyre_jax.configure()
    known = _known()
    for game in options.games:
        found = search(iphyre_jax.load_scene(game), plans=options.plans, seed=options.seed)
        old = known[game].record() if game in known else None
        best = found if old is None or found.reward > old.reward else old
        facts = {"seed": options.seed, "plans": options.plans}
        known[game] = play_from_json(play_to_json(best, AGENT, facts), game)
        print(f"{game}: {best.reward:.2f} ({'solved' if best.success else 'not solved'})", flush=True)
        lines = [_line(known[name]) for name in iphyre_jax.GAMES if name in known]
        source = "random search in this simulator, docs/best_plans.py; 60 steps a second, float64, fresh space"
        text = ",\n  ".join(json.dumps(line) for line in lines)
        FILE.write_text(f'{{"source": {json.dumps(source)},\n "plays": [\n  {text}\n ]}}\n', "utf-8")


def _known() -> dict[str, Play]:
    """Return the plans of the file as it is."""
    if not FILE.is_file():
        return {}
    return {line["scene"]: play_from_json(line, str(FILE)) for line in json.loads(FILE.read_text("utf-8"))["plays"]}


def _line(play: Play) -> dict[str, object]:
    return play_to_json(play.record(), AGENT, {})


if __name__ == "__main__":
    main()
