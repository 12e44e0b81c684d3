"""How often the tracing loop and the estimators are right: run as ``python -m exam``, not
installed.
"""
