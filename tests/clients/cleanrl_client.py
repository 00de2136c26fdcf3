"""PPO in the manner of CleanRL's single file: PyTorch, gymnasium's vector environment or EnvPool's calls.

Written anew; what it shares with CleanRL's are the calls: `gym.make_vec` and `RecordEpisodeStatistics`, or `reset` and
`step` of a pool, with NumPy in and out.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from score import Score, leave, now, record
from torch import nn, optim
from torch.distributions.categorical import Categorical

from iphyre_jax.adapters import HostPool

GAME = "on-the-fly-hole-v1"
WORLDS, STEPS, UPDATES = 32, 64, 50
EPOCHS, MINIBATCHES = 4, 4
GAMMA, LAMBDA, CLIP, ENTROPY, VALUE, RATE, NORM = 0.999, 0.95, 0.2, 0.01, 0.5, 1e-3, 0.5
SCALE = 0.01  # of rewards


def layer(inputs: int, outputs: int, scale: float = 2**0.5) -> nn.Linear:
    """Return a layer with orthogonal weights."""
    linear = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(linear.weight, scale)
    nn.init.zeros_(linear.bias)
    return linear


class Agent(nn.Module):
    """An actor and a critic of two layers each."""

    def __init__(self, size: int, actions: int) -> None:
        super().__init__()
        tower = lambda out, scale: nn.Sequential(  # noqa: E731
            layer(size, 64), nn.Tanh(), layer(64, 64), nn.Tanh(), layer(64, out, scale)
        )
        self.critic, self.actor = tower(1, 1.0), tower(actions, 0.01)

    def get_value(self, x: torch.Tensor) -> torch.Tensor:
        """Return the values."""
        return self.critic(x)[..., 0]

    def get_action_and_value(self, x: torch.Tensor, action: torch.Tensor | None = None) -> tuple[torch.Tensor, ...]:
        """Return actions, their log-probabilities, the entropies and the values."""
        policy = Categorical(logits=self.actor(x))
        action = policy.sample() if action is None else action
        return action, policy.log_prob(action), policy.entropy(), self.get_value(x)


def train(envs: Any, size: int, actions: int) -> tuple[Agent, list[float]]:
    """Train; return the agent and the rewards of all episodes in the order of their ends."""
    torch.manual_seed(0)
    agent = Agent(size, actions)
    optimizer = optim.Adam(agent.parameters(), lr=RATE, eps=1e-5)
    next_obs, _ = envs.reset()
    next_obs, next_done = torch.as_tensor(next_obs), torch.zeros(WORLDS)
    totals, ended = np.zeros(WORLDS), []
    for _ in range(UPDATES):
        rows: dict[str, list[torch.Tensor]] = {name: [] for name in ("obs", "actions", "logprobs", "values", "dones")}
        rewards = []
        for _ in range(STEPS):
            with torch.no_grad():
                action, logprob, _, value = agent.get_action_and_value(next_obs)
            for name, part in zip(rows, (next_obs, action, logprob, value, next_done), strict=True):
                rows[name].append(part)
            next_obs, reward, terminations, truncations, _ = envs.step(action.numpy())
            next_done = np.logical_or(terminations, truncations)
            totals += reward
            ended.extend(totals[next_done].tolist())
            totals[next_done] = 0.0
            rewards.append(torch.as_tensor(reward, dtype=torch.float32) * SCALE)
            next_obs, next_done = torch.as_tensor(next_obs), torch.as_tensor(next_done).float()
        batch = {name: torch.stack(parts) for name, parts in rows.items()}
        with torch.no_grad():
            next_value = agent.get_value(next_obs)
        advantages, last = torch.zeros(STEPS, WORLDS), torch.zeros(WORLDS)
        for t in reversed(range(STEPS)):
            done, later = (next_done, next_value) if t == STEPS - 1 else (batch["dones"][t + 1], batch["values"][t + 1])
            delta = rewards[t] + GAMMA * later * (1 - done) - batch["values"][t]
            advantages[t] = last = delta + GAMMA * LAMBDA * (1 - done) * last
        learn(agent, optimizer, {**batch, "advantages": advantages, "returns": advantages + batch["values"]})
    return agent, ended


def learn(agent: Agent, optimizer: optim.Optimizer, batch: dict[str, torch.Tensor]) -> None:
    """Make the passes of an update."""
    flat = {name: part.reshape(-1, *part.shape[2:]) for name, part in batch.items()}
    for _ in range(EPOCHS):
        for rows in torch.randperm(WORLDS * STEPS).reshape(MINIBATCHES, -1):
            part = {name: values[rows] for name, values in flat.items()}
            _, logprob, entropy, value = agent.get_action_and_value(part["obs"], part["actions"])
            ratio = (logprob - part["logprobs"]).exp()
            advantage = (part["advantages"] - part["advantages"].mean()) / (part["advantages"].std() + 1e-8)
            policy_loss = -torch.min(advantage * ratio, advantage * ratio.clamp(1 - CLIP, 1 + CLIP)).mean()
            value_loss = 0.5 * (value - part["returns"]).square().mean()
            loss = policy_loss - ENTROPY * entropy.mean() + VALUE * value_loss
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), NORM)
            optimizer.step()


def random_score(envs: Any, actions: int) -> Score:
    """Return the score of random actions: the first episode of each world."""
    rng = np.random.default_rng(0)
    envs.reset()
    totals, over = np.zeros(WORLDS), np.zeros(WORLDS, bool)
    while not over.all():
        _, reward, terminated, truncated, _ = envs.step(rng.integers(actions, size=WORLDS))
        totals += np.where(over, 0.0, reward)
        over |= terminated | truncated
    return Score.of(totals)


def vector_environment() -> tuple[Any, int, int]:
    """Return gymnasium's, by id."""
    envs = gym.make_vec(f"iphyre_jax.gym:iphyre/{GAME}", num_envs=WORLDS)
    envs = gym.wrappers.vector.RecordEpisodeStatistics(envs)
    return envs, envs.single_observation_space.shape[0], int(envs.single_action_space.n)


def pool() -> tuple[Any, int, int]:
    """Return a pool with EnvPool's calls."""
    envs = HostPool(GAME.replace("-hole", "/hole"), num_envs=WORLDS, seed=0)
    return envs, envs.observation_space.shape[0], envs.action_space.n


def client(name: str, package: str, what: str, make: Callable[[], tuple[Any, int, int]]) -> bool:
    """Train over one interface and write the record; the score is that of the last tenth of the episodes."""
    start = now()
    envs, size, actions = make()
    _, ended = train(envs, size, actions)
    random = random_score(envs, actions)
    envs.close()
    score = Score.of(ended[-max(len(ended) // 10, 20) :])
    ran = f"PPO in CleanRL's calls over {what}, {WORLDS} worlds, {WORLDS * STEPS * UPDATES} decisions, {GAME}"
    return record(name, package, ran, since=start, score=score, random=random)


if __name__ == "__main__":
    torch.set_num_threads(1)
    results = [
        client("cleanrl-ppo", "torch", "gymnasium.make_vec and RecordEpisodeStatistics", vector_environment),
        client("envpool-ppo", "torch", "HostPool (EnvPool's calls)", pool),
    ]
    leave(all(results))
