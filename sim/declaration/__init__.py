"""What a model is: parameters, signals, effects, equations, the compiled system."""

from sim.declaration.user_model import own_model

__all__ = ["own_model"]
