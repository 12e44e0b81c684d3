"""Models of studies written for other programs.

``model`` has the model of a study, and its equations as a list of operations, which are found by
calling them once with symbols. ``targets`` lists the targets and writes Python modules; ``fmu``,
``jsbsim`` and ``dave_ml`` write the others; ``fmi2.c`` is the part of a unit's source that no model
changes. A further target is one file with a function from
``ExportedModel`` to text or bytes, and a line in ``_WRITERS`` of ``targets``.

Delays and lags that have a state form are written as states. Effects that need the whole record are
left out; the file and the command name them.
"""
