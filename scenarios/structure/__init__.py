"""Model structure from records: the terms of each coefficient that the maneuvers support.

``study`` reads records, forms coefficients, offers terms and has them chosen; ``report`` makes the
table, figures, page, ``structure.json`` and the vehicle file for ``identify``. The method is in
`ident.structure`.
"""
