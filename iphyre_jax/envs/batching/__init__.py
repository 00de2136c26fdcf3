"""What worlds on the host and inside of the user's program share, and many decisions of a batch (`unroll`)."""
