"""The tracing loop: from a fitted model's residual to the effect that the model lacks."""
