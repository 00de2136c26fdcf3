"""What a fault script found, as a file of build/faults/ that `report.py` turns into docs/results/faults.md."""

from __future__ import annotations

import re
from pathlib import Path

from iphyre_jax.files import replace_json
from iphyre_jax.provenance import provenance

FOLDER = Path(__file__).parents[2] / "build" / "faults"
SLUG = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")


def record(check: str, promise: str, tried: int, survived: int, lost: int, seconds: float) -> None:
    """Write build/faults/CHECK.json and print one line.

    Args:
        check: name of the check, a slug such as "attempts-cut".
        promise: what is promised, one short sentence.
        tried: faults tried.
        survived: of them, those after which all was as promised.
        lost: things that a user was told were safe and that are gone.
        seconds: that the check took.

    Raises:
        ValueError: one line; a name or a count that cannot be.
    """
    if not SLUG.fullmatch(check):
        raise ValueError(f"check: expected a slug such as attempts-cut, got {check!r}")
    if not 0 <= survived <= tried or tried < 1 or lost < 0:
        raise ValueError(f"{check}: expected 0 <= survived <= tried and lost >= 0, got {survived}, {tried}, {lost}")
    content = {"check": check, "promise": promise, "tried": tried, "survived": survived, "lost": lost}
    FOLDER.mkdir(parents=True, exist_ok=True)
    replace_json(FOLDER / f"{check}.json", {**content, "seconds": round(seconds, 1), **provenance()})
    print(f"{check}: tried {tried}, survived {survived}, lost {lost}", flush=True)
