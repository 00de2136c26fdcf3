"""Runs the lines of docs/guide/clients.md that need other libraries: `documents.py jax` or `documents.py torch`."""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs" / "guide" / "clients.md"
NEEDS = {
    "Stable-Baselines3": "torch",
    "CleanRL": "torch",
    "PureJaxRL and rejax": "jax",
    "gymnax": "jax",
    "brax": "jax",
    "flashbax": "jax",
    "jumanji": "jax",
    "dm_env": "jax",
}
SECTION = re.compile(r"^## (.+?)\n(.*?)(?=^## |\Z)", re.MULTILINE | re.DOTALL)
LINES = re.compile(r"^```py\n(.*?)^```\n", re.MULTILINE | re.DOTALL)


def main(have: str) -> int:
    """Run each example as a file of its own; 0 if all end well."""
    found = {title: LINES.findall(text) for title, text in SECTION.findall(PAGE.read_text("utf-8"))}
    missing = NEEDS.keys() - {title for title, examples in found.items() if examples}
    if missing:
        print(f"{PAGE}: expected examples of {', '.join(sorted(missing))}")
        return 1
    failed = 0
    for title in (title for title, library in NEEDS.items() if library == have):
        for example in found[title]:
            with tempfile.TemporaryDirectory() as folder:
                script = Path(folder) / "example.py"
                script.write_text(example, "utf-8")
                done = subprocess.run([sys.executable, str(script)], check=False)
            failed += done.returncode != 0
            print(f"{PAGE.name}: {title}: {'ran' if done.returncode == 0 else 'FAILED'}", flush=True)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
