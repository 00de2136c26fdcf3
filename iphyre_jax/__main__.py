"""`python -m iphyre_jax`: the same as the command `iphyre-jax`."""

from iphyre_jax.cli.main import main

if __name__ == "__main__":
    main()
