"""The server of the play page: a person plays the games, draws scenes and compares plays."""
