"""Compare our pictures of the games' starts with the official ones, which `parity.official.record` records.

    python -m parity.official.pictures FILE SHEET

Each pixel is assigned the nearest of the drawing's colours. Our edges are anti-aliased and the official ones are not,
so pixels at an edge may differ. Inner pixels have a neighbourhood of one colour in the official picture, and neither
picture has a thin mark (a spring, a radius, the dot of a joint) there.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from iphyre_jax.compat import IPHYRE
from iphyre_jax.observations.drawing import BALL, ELIMINABLE, FIXED, LINK, MOVING, RADIUS_LINE
from parity.tolerances import PICTURE_ALL, PICTURE_INNER

Picture = NDArray[np.uint8]

WHITE = (255, 255, 255)
COLOURS = np.array([WHITE, BALL, ELIMINABLE, FIXED, MOVING, RADIUS_LINE, LINK], np.int32)
MARKS = 5  # index of the first colour of thin marks
COLUMNS, SIDE = 10, 150  # of the contact sheet, px


def nearest_colours(picture: Picture) -> NDArray[np.int64]:
    """The index of the nearest colour of each pixel, (600, 600)."""
    away = np.abs(picture[:, :, None, :].astype(np.int32) - COLOURS).sum(-1)
    return away.argmin(-1)


def inner_pixels(colour: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which pixels share their colour with every pixel within two px and are no mark, (600, 600)."""
    padded = np.pad(colour, 2, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (5, 5)).reshape(*colour.shape, 25)
    return (windows == colour[:, :, None]).all(-1) & (colour < MARKS)


def differences(ours: Picture, official: Picture) -> tuple[float, float]:
    """The share of pixels with another colour, among all and among the inner ones."""
    one, other = nearest_colours(ours), nearest_colours(official)
    far = inner_pixels(other) & (one < MARKS)  # our mark may lie beside the official one
    return float((one != other).mean()), float((one != other)[far].mean())


def contact_sheet(pairs: list[tuple[Picture, Picture]], file: Path) -> None:
    """Save small copies of the pictures, each official drawing above ours."""
    rows = -(-len(pairs) // COLUMNS)
    page = Image.new("RGB", (COLUMNS * SIDE, rows * (2 * SIDE + 10)), "white")
    for index, pair in enumerate(pairs):
        left, top = index % COLUMNS * SIDE, index // COLUMNS * (2 * SIDE + 10)
        for k, picture in enumerate(pair):
            small = Image.fromarray(picture).resize((SIDE - 4, SIDE - 4), Image.Resampling.LANCZOS)
            page.paste(small, (left, top + k * SIDE))
    page.save(file)


def main() -> int:
    """Compare a file of official pictures; return 1 if one exceeds the tolerances."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("sheet", type=Path)
    options = parser.parse_args()
    pairs: list[tuple[Picture, Picture]] = []
    rows: list[tuple[str, float, float]] = []
    with np.load(options.file) as file:
        for game in file.files:
            simulator = IPHYRE(game)
            simulator.reset()
            pairs.append((file[game], simulator.picture()))
            rows.append((game, *differences(pairs[-1][1], pairs[-1][0])))
    contact_sheet(pairs, options.sheet)
    for game, all_, inner_ in rows:
        print(f"{game:28} {all_:8.3%} of all pixels have another colour, {inner_:8.3%} of the inner ones")
    far = [game for game, all_, inner_ in rows if all_ > PICTURE_ALL or inner_ > PICTURE_INNER]
    print(f"{len(rows)} pictures, {len(far)} beyond the tolerances; side by side in {options.sheet}")
    return 1 if far else 0


if __name__ == "__main__":
    sys.exit(main())
