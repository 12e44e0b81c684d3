"""Jobs for which several programs compete: what is to be done, who does it, and how near the
answers must be.
"""
