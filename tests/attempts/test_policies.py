from dataclasses import replace

import jax
import pytest

from iphyre_jax.attempts.policies import policy_attempts
from iphyre_jax.train.algos.registry import init
from iphyre_jax.train.settings.run import preset
from iphyre_jax.train.storage.pretrained import load_pretrained

GAMES = ["support", "noisy_support"]


@pytest.mark.slow
def test_greedy_first_then_sampled_and_the_same_again() -> None:
    policy = load_pretrained("ppo-i-smooth")
    found, again = (
        policy_attempts(policy.config, policy.state, 2, greedy_first=True, games=GAMES, runs=3) for _ in range(2)
    )
    shipped = {game["game"]: game["greedy"]["reward"] for game in policy.scores["games"]}
    for rewards, game in zip(found.reward[:, :, 0].tolist(), GAMES, strict=True):
        assert rewards == pytest.approx([shipped[game]] * 3)
    assert len(set(found.reward[:, :, 1].ravel().tolist())) > 1  # sampled ones differ
    assert found.reward.tolist() == again.reward.tolist()


def test_a_rate_that_the_policy_cannot_play_at_is_refused() -> None:
    config = replace(preset("ppo", "on-the-fly"), fps=60, prediction="objects-unlimited")
    state = init(config, jax.random.key(0))
    with pytest.raises(ValueError, match=r"^fps: expected 60 with a world model, which learned at that rate, got 10$"):
        policy_attempts(config, state, fps=10, games=["support"])
