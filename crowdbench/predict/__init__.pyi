from .linear import ConstantVelocity as ConstantVelocity
from .linear import ConstantVelocitySampled as ConstantVelocitySampled
from .linear import Linear as Linear
from .linear import Oracle as Oracle
from .predictor import predict as predict
from .predictor import validate_prediction as validate_prediction
from .social_gan import load_social_gan as load_social_gan
from .social_gan import scatter as scatter
