"""What is believed of parameters before any record, and what it means for a claim."""
