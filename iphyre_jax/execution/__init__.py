"""Compiled programs and everything that runs them: layouts, compiler processes, cache folder, threads, devices."""
