"""A score of pedestrian models: how likely recorded people are among simulated ones. See definition.md."""
