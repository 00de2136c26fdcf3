"""Learning to play: configuration, networks, PPO, evaluation and run folders. Needs the extra `train`."""
