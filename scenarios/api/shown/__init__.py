"""What results show of themselves: parameters, effects, tables, HTML."""
