"""Frequency responses of records.

It may import `preparation`, `pages`, `plots`, `terminal`, `files` and `ident.frequency_response`.
Figures: `scenarios/plots/low_order.py`.
"""
