"""Networks of outcome classifiers: the paper's and ours."""
