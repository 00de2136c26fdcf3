"""What outcome classifiers learn from and are tested on, as arrays."""
