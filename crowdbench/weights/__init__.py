"""Trained weights on disk: safetensors files, each with a card that describes it."""
