"""What the records of a study determine and what only the priors do."""
