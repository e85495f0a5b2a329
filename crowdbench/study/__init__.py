"""Studies: a file that says which runs are made, and the tables printed from them."""
