"""Social GAN with its pooling module, from the weights `sgan_pooled`, for the comparison in README.md."""

from functools import partial

from crowdbench.predict import load_social_gan

predictor = partial(load_social_gan, "sgan_pooled", modes=20, rescaled=False, device="cpu")
