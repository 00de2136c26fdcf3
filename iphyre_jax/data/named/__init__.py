"""The data sets that have a name (`sets`), and what some of them are made of: edge pairs, plays of variations."""
