"""On-line identification of a stream of rows: lines, rows, filter bank, display and results."""
