"""Named studies: declare, run, score against truth, report; and the command line."""
