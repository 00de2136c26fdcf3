"""Worlds on a CPU, played by the host in executables from compiler processes."""
