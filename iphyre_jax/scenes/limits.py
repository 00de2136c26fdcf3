"""The bounds of a valid scene, each with its unit and its reason."""

from typing import Final

MAX_OBJECTS: Final = 12  # rows of the official observation (IPHYREEnv.py)
MAX_ELIMINABLE: Final = 6  # entries of the official plan (IPHYREEnv.py)
MAX_COORDINATE: Final = 10_000.0  # px; the screen is 600 px, and float32 resolves hardly 0.001 px out there
MIN_LENGTH: Final = 1e-3  # px; a shorter bar, radius or pin has no direction, or no moment, in float32
MAX_NAME: Final = 100  # characters of a scene's name
MAX_FILE_BYTES: Final = 1_000_000  # a scene of 12 objects takes about 1 kB
