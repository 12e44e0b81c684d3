"""Effects from outside the aircraft, which act before flow quantities are computed, one file for
an effect or a family.

An event sets ``onset`` and ``per_record`` in its traits. No file imports another effect.
"""
