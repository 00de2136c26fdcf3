"""Programs that our compiler processes compiled, as parts of the user's programs: read, linked and called."""
