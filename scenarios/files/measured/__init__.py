"""Files of measured records: cells, columns, and the JSON file beside them."""
