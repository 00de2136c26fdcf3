"""Turn recordings into JSON values for the pages. `pages/tape.js` unpacks what `pack_tape` packs.

A tape holds all frames of a recording: little-endian int32, deflated, in base 64. It stores differences from frame to
frame, column by column: x, y and angle of every moving object, then their velocities, then the number of contacts.
After that come x and y of the contacts, frame by frame. The units are below.
"""

from __future__ import annotations

import base64
import zlib

import numpy as np

from iphyre_jax.viewer.plays import result_of
from iphyre_jax.viewer.recording import Recording

LENGTH_UNIT = 1 / 64  # px
ANGLE_UNIT = 1 / 4096  # rad
SPEED_UNIT = 1 / 4  # px/s
CONTACT_UNIT = 1 / 4  # px
LARGEST = 2.0**29  # largest number in its unit, so that differences fit into int32


def pack_play(recording: Recording) -> dict[str, object]:
    """Return plan, settings, result and tape of a recording."""
    return {
        "plan": list(recording.plan),
        "fps": recording.fps,
        "dtype": recording.dtype,
        "resets": recording.resets,
        **result_of(recording),
        "fault": recording.fault,
        "tape": pack_tape(recording),
    }


def pack_tape(recording: Recording) -> str:
    """Return the frames of a recording as a tape; the docstring of this module describes it."""
    moving = np.flatnonzero(recording.scene.dynamic)
    poses = recording.poses[:, moving] / np.array([LENGTH_UNIT, LENGTH_UNIT, ANGLE_UNIT])
    frames = len(poses)
    columns = np.concatenate(
        [poses.reshape(frames, -1), recording.velocities[:, moving].reshape(frames, -1) / SPEED_UNIT], axis=1
    )
    touching = np.isfinite(recording.contacts[:, :, 0])
    counts = touching.sum(axis=1)
    points = recording.contacts[touching] / CONTACT_UNIT
    grown = np.diff(_whole(columns), axis=0, prepend=0)
    # x and y of contacts are stored as pairs; each coordinate has its own differences.
    parts = [grown.T.ravel(), np.diff(counts, prepend=0), np.diff(_whole(points), axis=0, prepend=0).ravel()]
    return base64.b64encode(zlib.compress(np.concatenate(parts).astype("<i4").tobytes(), 6)).decode()


def _whole(values: np.ndarray) -> np.ndarray:
    """Round to integers. Numbers that are not finite are clipped to the largest ones, so that they can be shown."""
    return np.rint(np.nan_to_num(values, nan=0.0, posinf=LARGEST, neginf=-LARGEST).clip(-LARGEST, LARGEST)).astype(
        np.int64
    )
