"""Run by `make wheel` in an environment that holds the wheel without extras: is the package whole, and alone?"""

import re
import sys
from importlib.metadata import distribution, distributions, requires
from importlib.resources import files


def name_of(requirement: str) -> str:
    """The normal form of the name in a requirement (PEP 503)."""
    return re.sub(r"[-_.]+", "-", re.split(r"[^A-Za-z0-9._-]", requirement, maxsplit=1)[0]).lower()


def needed(name: str, found: set[str] | None = None) -> set[str]:
    """The distribution and everything that it requires without extras."""
    found = set() if found is None else found
    if name not in found:
        found.add(name)
        for requirement in requires(name) or []:
            if "extra ==" not in requirement:
                needed(name_of(requirement), found)
    return found


def main() -> None:
    """Look at what is installed, import the package, load every game and play one."""
    import iphyre_jax

    assert "site-packages" in str(files("iphyre_jax")), f"not the wheel's: {iphyre_jax.__file__}"
    assert iphyre_jax.__version__ == distribution("iphyre-jax").version
    assert files("iphyre_jax").joinpath("py.typed").is_file()
    pages = files("iphyre_jax").joinpath("viewer", "pages")
    assert {"play.html", "replay.html", "style.css", "stage.js"} <= {page.name for page in pages.iterdir()}
    weights = {file.name for file in files("iphyre_jax").joinpath("train", "weights").iterdir()}
    assert {"ppo-i.npz", "ppo-i.json", "ddpg-i.npz"} <= weights, weights
    licences = {file.name for file in distribution("iphyre-jax").files or [] if ".dist-info" in str(file)}
    assert {"LICENSE", "NOTICE"} <= licences, licences

    installed = {name_of(found.metadata["Name"]) for found in distributions()}
    foreign = installed - needed("jax") - needed("numpy") - {"iphyre-jax", "pip", "setuptools"}
    assert not foreign, f"more than jax and numpy is installed: {foreign}"

    games = [game for names in iphyre_jax.SPLITS.values() for game in names]
    assert len({iphyre_jax.load_scene(game) for game in games}) == 50

    from jax._src import xla_bridge

    assert not xla_bridge._backends, "importing started a backend"
    result = iphyre_jax.simulate("support", [[0, -1]], fps=10)
    print(
        f"iphyre_jax {iphyre_jax.__version__}: {len(games)} games load; support played in {int(result.steps[0])} steps"
    )


if __name__ == "__main__":
    sys.exit(main())
