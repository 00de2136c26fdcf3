"""A folder that only this user can write."""

from __future__ import annotations

import os
import stat
from pathlib import Path

OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH


def private_folder(folder: Path) -> Path:
    """Return the folder, made with mode 0700 if it is missing.

    Compiled programs are machine code: whoever can write the folder could run code as this user.

    Raises:
        ValueError: one line; it cannot be made, or somebody else owns it or may write it.
    """
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        about = folder.stat()
    except OSError as error:
        raise ValueError(f"cache: cannot use {folder}: {error.strerror}") from None
    if hasattr(os, "geteuid"):  # elsewhere the system keeps a user's folders from the others
        if about.st_uid != os.geteuid():
            raise ValueError(f"cache: {folder} belongs to another user")
        if about.st_mode & OTHERS_WRITE:
            raise ValueError(f"cache: others may write {folder}; expected mode 0700")
    return folder
