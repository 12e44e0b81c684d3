"""Models of studies written for other programs.

``model`` is the model of a study with its values, compiled, and its equations as a list of
operations, found by calling them once with symbols; ``targets`` (a Python module among them),
``fmu``, ``jsbsim`` and ``dave_ml`` write it. A further target is one file with a function from
``ExportedModel`` to text or bytes, and a line in ``_WRITERS`` there.

Delays and lags that have a state form are written as states; effects that need the whole record are
left out, which the file and the command say.
"""
