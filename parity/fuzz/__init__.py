"""Random scenes, played in both engines; those that differ are made small."""
