"""Teaching labs: marimo notebooks, one a lab, with the computations behind them and the
instructor's keys apart.
"""
