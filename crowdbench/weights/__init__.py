"""Trained weights on disk: safetensors files, and the cards that describe them."""
