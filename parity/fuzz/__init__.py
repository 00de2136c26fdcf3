"""Random scenes, played in both engines and made small where they differ."""
