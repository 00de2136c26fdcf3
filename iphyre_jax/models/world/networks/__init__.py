"""Networks of the world models: plain functions of trees of arrays."""
