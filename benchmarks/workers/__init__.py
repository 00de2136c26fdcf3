"""The processes that play. Nothing here or above may import more than the standard library: environments differ."""
