"""Many worlds of any mixture of games in one step: by the host, or inside the user's program."""
