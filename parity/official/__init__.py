"""The official class and our environments, compared."""
