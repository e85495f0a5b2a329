"""Training of networks: a file for each method, their options in `config`, and one `runner`."""
