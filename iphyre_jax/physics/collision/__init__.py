"""What touches what: shapes, broad phase, narrow phase, and the contact points in the order of the reference."""
