"""The play page's server: a person plays, draws scenes and compares, against the real simulator."""
