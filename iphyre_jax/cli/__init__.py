"""The command iphyre-jax."""
