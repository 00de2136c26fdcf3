"""Make the pictures of the README: `make pictures`."""

from __future__ import annotations

from pathlib import Path

import iphyre_jax
from iphyre_jax.viewer.films import save, save_picture
from iphyre_jax.viewer.frames import Look
from iphyre_jax.viewer.load_plays import best_plays
from iphyre_jax.viewer.sheets import contact_sheet, start_of

FOLDER = Path(__file__).parents[1] / "docs" / "pictures"
SOLVED = "fill"
MAX_BYTES = 400_000  # of one file, because the repository holds them


def main() -> None:
    """Write a film of a solved game and a contact sheet of the forty games; check the sizes of all pictures."""
    FOLDER.mkdir(exist_ok=True)
    save(FOLDER / "solved.gif", best_plays()[SOLVED].record(), Look(size=300, trails=True), hold=2)
    starts = [start_of(iphyre_jax.load_scene(game)) for game in iphyre_jax.GAMES]
    save_picture(FOLDER / "games.png", contact_sheet(starts, frame=0))
    for file in sorted(FOLDER.iterdir()):
        size = file.stat().st_size
        print(f"{file.name}: {size / 1000:.0f} kB")
        if size > MAX_BYTES:
            raise SystemExit(f"{file}: expected at most {MAX_BYTES} bytes, got {size}")


if __name__ == "__main__":
    main()
