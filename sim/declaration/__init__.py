"""What a model is: parameters, signals, effects, equations, the compiled system."""
