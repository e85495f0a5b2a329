"""A ladder: the success of one search with increasing knowledge of the crowd."""
