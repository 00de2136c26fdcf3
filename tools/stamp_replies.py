"""Give the hand-written replies the hash of the present prompt, after its texts have changed.

The replies themselves stay. They say what a person would answer about a game, whatever the wording of the question.
"""

from __future__ import annotations

import json

from iphyre_jax.agents.language.prompts import VERSION, Prompt
from iphyre_jax.agents.language.transcripts import handwritten_file, scene_hash
from iphyre_jax.files import replace_text
from iphyre_jax.scenes import load_scene


def main() -> None:
    """Rewrite the file."""
    prompt = Prompt("plain", "in-advance", "outcome")
    stamp = {"name": prompt.name, "version": VERSION, "hash": prompt.hash}
    file = handwritten_file()
    lines = [json.loads(line) for line in file.read_text("utf-8").splitlines()]
    stamped = [{**line, "prompt": stamp, "scene": scene_hash(load_scene(line["game"]))} for line in lines]
    replace_text(file, "".join(json.dumps(line) + "\n" for line in stamped))


if __name__ == "__main__":
    main()
