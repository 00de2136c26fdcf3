"""The two engines, played side by side and looked into."""
