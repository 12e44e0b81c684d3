"""What campaigns of the tracing loop are judged by: verdicts, names, their probabilities, and
sigmas, over many flights whose truth is known.
"""
