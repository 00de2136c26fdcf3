"""Where pymunk is not installed, the comparison with it is left out; the golden files stand in for it."""

from importlib.util import find_spec

collect_ignore_glob = [] if find_spec("pymunk") else ["test_[!g]*.py", "engines/*", "fuzz/*", "reports/*"]
