"""The replay page: one HTML file that contains everything it needs and makes no requests."""

from __future__ import annotations

import base64
import hashlib
import json
import os
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Final

import iphyre_jax
from iphyre_jax.checks import check_instance, is_list, show
from iphyre_jax.files import check_output, replace_bytes
from iphyre_jax.scenes import Scene, scene_to_dict
from iphyre_jax.viewer import themes
from iphyre_jax.viewer.pack import pack_play
from iphyre_jax.viewer.plays import Play
from iphyre_jax.viewer.recording import Recording

SCRIPTS: Final = ("tape.js", "stage.js", "clock.js", "deck.js", "replay.js")  # each uses the ones before it
MAX_BYTES: Final = 100_000_000  # of one page


def page_file(name: str) -> str:
    """Return a file of the folder pages, as text."""
    return files(__package__).joinpath("pages", name).read_text("utf-8")


def replay_page(plays: Sequence[tuple[str, Recording]], *, title: str = "I-PHYRE replay") -> str:
    """Return the HTML of a page that plays recordings.

    Args:
        plays: the name of each player, and the recording.
        title: the title of the page.

    Raises:
        ValueError: there is no play.
    """
    if not is_list(plays) or not plays:
        raise ValueError(f"plays: expected at least one, got {show(plays)}")
    scenes: dict[Scene, int] = {}
    entries = []
    for agent, recording in plays:
        place = scenes.setdefault(recording.scene, len(scenes))
        entries.append({"agent": agent, "scene": place, **pack_play(recording)})
    data = {
        "title": title,
        "version": iphyre_jax.__version__,
        "themes": themes.as_json(),
        "scenes": [scene_to_dict(scene) for scene in scenes],
        "plays": entries,
    }
    scripts = "".join(page_file(name) for name in SCRIPTS)
    style = page_file("style.css")
    sources = f"script-src {_hash_source(scripts)}; style-src {_hash_source(style)}"
    policy = f"default-src 'none'; {sources}; base-uri 'none'; form-action 'none'"
    parts = {"POLICY": policy, "STYLE": style, "SCRIPT": scripts, "DATA": json_for_script(data)}
    head, *rest = page_file("replay.html").split("<!--")
    return head + "".join(parts[key] + tail for key, _, tail in (part.partition("-->") for part in rest))


def json_for_script(data: object) -> str:
    """Return JSON for a script element; it cannot end the element or begin a comment."""
    return json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def _hash_source(text: str) -> str:
    """Return the source expression that allows exactly this text in a content security policy."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def write_replay(path: str | os.PathLike[str], plays: Sequence[Play], *, title: str = "I-PHYRE replay") -> list[str]:
    """Replay plans and write a replay page. An existing file is replaced as a whole.

    Args:
        path: the file; its folder must exist.
        plays: the plays to show.
        title: the title of the page.

    Returns:
        One line for each play whose result differs from its file.

    Raises:
        OSError: the file cannot be written.
        ValueError: there is no play, something else is none, the path is no .html file in a folder that exists, or the
            page would exceed 100 MB.
    """
    check_output("path", Path(path), (".html", ".htm"))
    if not is_list(plays):
        raise ValueError(f"plays: expected a sequence of plays, got {show(plays)}")
    for play in plays:
        check_instance("plays", play, Play, "plays")
    recordings = [(play, play.record()) for play in plays]
    page = replay_page([(play.agent, recording) for play, recording in recordings], title=title).encode()
    if len(page) > MAX_BYTES:
        raise ValueError(f"{path}: expected a page of at most {MAX_BYTES} bytes, got {len(page)}; show fewer plays")
    replace_bytes(Path(path), page)
    changed = ((play, play.difference(recording)) for play, recording in recordings)
    return [f"{play.agent}, {play.scene.name}: the file says {text}" for play, text in changed if text]
