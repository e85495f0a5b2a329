"""Prediction errors of Social GAN and other predictors, on recorded tracks and on simulated crowds."""
