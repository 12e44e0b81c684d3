"""Declaration of a model: parameters, signals, effects, equations, and the compiled system."""

from sim.declaration.user_model import own_model

__all__ = ["own_model"]
