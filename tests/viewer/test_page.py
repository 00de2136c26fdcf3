"""The replay page: it is self-contained, its tapes hold the frames, and text stays text."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from iphyre_jax import SceneBuilder, load_scene
from iphyre_jax.viewer import pack
from iphyre_jax.viewer.page import SCRIPTS, json_for_script, page_file, replay_page, write_replay
from iphyre_jax.viewer.play.server import SCRIPTS as PLAY_SCRIPTS
from iphyre_jax.viewer.recording import Recording, record
from iphyre_jax.viewer.sheets import start_of

HOSTILE = "</script><script>alert(1)</script><!--"


@pytest.fixture(scope="module")
def solved() -> Recording:
    return record(load_scene("hole"), [-1, -1, 83, 32])


def test_a_tape_holds_the_frames(solved: Recording) -> None:
    """Unpack the tape like `pages/tape.js`; the browser tests check that script."""
    grown = np.frombuffer(zlib.decompress(base64.b64decode(pack.pack_tape(solved))), "<i4").astype(np.int64)
    frames = solved.steps + 1
    columns = grown[: 5 * frames].reshape(5, frames).cumsum(axis=1)
    pose = columns[:3].T * [pack.LENGTH_UNIT, pack.LENGTH_UNIT, pack.ANGLE_UNIT]
    np.testing.assert_allclose(pose, solved.poses[:, 6], atol=pack.LENGTH_UNIT)
    np.testing.assert_allclose(columns[3:].T * pack.SPEED_UNIT, solved.velocities[:, 6], atol=pack.SPEED_UNIT)
    counts = grown[5 * frames : 6 * frames].cumsum()
    touching = np.isfinite(solved.contacts[:, :, 0])
    np.testing.assert_array_equal(counts, touching.sum(axis=1))
    points = grown[6 * frames :].reshape(-1, 2).cumsum(axis=0) * pack.CONTACT_UNIT
    np.testing.assert_allclose(points, solved.contacts[touching], atol=pack.CONTACT_UNIT)


def test_a_world_that_is_not_finite_can_be_packed(solved: Recording) -> None:
    broken = Recording.of_poses(solved.scene, solved.plan, solved.poses)
    broken.poses[5:] = np.inf
    broken.velocities[5:] = -np.inf
    pack.pack_tape(broken)


def test_the_page_allows_its_own_script_and_style_only(solved: Recording) -> None:
    page = replay_page([("agent", solved)])
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]+)"', page)
    assert policy
    for tag in ("script", "style"):
        ((text,),) = (re.findall(rf"<{tag}>(.*?)</{tag}>", page, re.DOTALL),)
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert f"{tag}-src 'sha256-{digest}'" in policy[1]
    assert policy[1].startswith("default-src 'none'; ")
    assert not re.search(r"(src|href|action)\s*=", page.split("<script>")[0])


def test_names_cannot_end_the_data(solved: Recording) -> None:
    builder = SceneBuilder(HOSTILE)
    builder.ball((250, 340))
    page = replay_page([(HOSTILE, solved), ("b", start_of(builder.build()))], title=HOSTILE)
    assert page.count("</script>") == 2
    assert "alert(1)</script" not in page
    data = json.loads(page.split('id="data">')[1].split("</script>")[0])
    assert data["plays"][0]["agent"] == data["title"] == data["scenes"][1]["name"] == HOSTILE


@pytest.mark.parametrize(
    "name",
    [
        "a\u2028alert(1)\u2029b",
        "\u202e</script><script>alert(1)",
        "\"'><b onfocus=alert(1)>",
        "nul\0 \x1b[2J",
        "\ud800",
    ],
)
def test_names_of_any_characters_stay_data(name: str, solved: Recording) -> None:
    """Line separators would end a line of script, and overrides turn round what a reader of the file sees."""
    page = replay_page([(name, solved)], title=name)
    head, _, rest = page.partition('id="data">')
    data = rest.partition("</script>")[0]
    assert data.isascii()
    assert data.isprintable()
    assert "<" not in data
    assert json.loads(data)["plays"][0]["agent"] == json.loads(data)["title"] == name
    for part in (head, rest.removeprefix(data)):
        assert name not in part
    page.encode()


def test_json_for_scripts_has_no_markup() -> None:
    assert "<" not in json_for_script({"<a>": ["</script>", "<!--", "]]>"]})


def test_pages_write_text_never_markup() -> None:
    """No script turns text into elements or code."""
    markup = re.compile(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\b|new Function")
    for name in {*SCRIPTS, *PLAY_SCRIPTS}:
        assert not markup.search(page_file(name)), name


def test_a_page_needs_a_play() -> None:
    with pytest.raises(ValueError, match="plays: expected at least one"):
        replay_page([])


@pytest.mark.parametrize(
    ("name", "plays", "message"),
    [
        (".", [], "path: expected the name of a file, got the folder '.'"),
        ("no/x.html", [], "path: expected a file in a folder that exists, got 'no/x.html'"),
        ("x.txt", [], "path: expected a file name that ends in .html, .htm, got 'x.txt'"),
        ("x.html", None, "plays: expected a sequence of plays, got None"),
        ("x.html", [("agent", None)], "plays: expected plays, got a list of 2"),
    ],
)
def test_what_is_no_page_or_no_play_is_told_before_anything_is_played(
    name: str, plays: Any, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        write_replay(name, plays)
