"""Programs compiled apart: processes that compile, a folder that keeps, a client that runs."""
