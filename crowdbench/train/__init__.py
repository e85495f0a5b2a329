"""Training of networks: a file for each method, the requests for it, and what the methods share."""
