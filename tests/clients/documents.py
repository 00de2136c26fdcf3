"""Runs the lines of docs/guide/clients/ that need other libraries: `documents.py jax` or `documents.py torch`."""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from pathlib import Path

PAGES = Path(__file__).parents[2] / "docs" / "guide" / "clients"
NEEDS = {
    "stable-baselines3": "torch",
    "cleanrl": "torch",
    "purejaxrl-rejax": "jax",
    "gymnax": "jax",
    "brax": "jax",
    "flashbax": "jax",
    "jumanji": "jax",
    "dm-env": "jax",
}
LINES = re.compile(r"^```py\n(.*?)^```\n", re.MULTILINE | re.DOTALL)


def main(have: str) -> int:
    """Run each example as a file of its own; 0 if all end well."""
    found = {page.stem: LINES.findall(page.read_text("utf-8")) for page in PAGES.glob("*.md")}
    missing = NEEDS.keys() - {page for page, examples in found.items() if examples}
    if missing:
        print(f"{PAGES}: expected examples of {', '.join(sorted(missing))}")
        return 1
    failed = 0
    for page in (page for page, library in NEEDS.items() if library == have):
        for example in found[page]:
            with tempfile.TemporaryDirectory() as folder:
                script = Path(folder) / "example.py"
                script.write_text(example, "utf-8")
                done = subprocess.run([sys.executable, str(script)], check=False)
            failed += done.returncode != 0
            print(f"{page}.md: {'ran' if done.returncode == 0 else 'FAILED'}", flush=True)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
