"""Tables and pictures of one run or several."""
