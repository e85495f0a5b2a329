"""A ladder: the score of one search with increasing knowledge of the crowd."""
