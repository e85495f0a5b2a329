"""The tables of Li et al. (2020), and the claims of the paper."""
