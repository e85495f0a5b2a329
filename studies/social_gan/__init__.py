"""Social GAN: its training, and errors of predictors on recorded tracks and on simulated crowds."""
