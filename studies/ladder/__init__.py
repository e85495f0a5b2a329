"""A ladder: the success of one search with ever more knowledge of the crowd."""
