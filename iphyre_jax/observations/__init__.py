"""What an agent sees of a world: the official rows, velocities and time, pictures."""
