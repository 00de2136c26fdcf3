"""One decision of many worlds of any games: on the host, or inside the user's program."""
