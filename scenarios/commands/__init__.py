"""What each command of the command line does, one file a family.

It may import everything in `scenarios` but `cli`. To add a command: a function with its options in
`scenarios/cli/study_commands.py` or `scenarios/cli/record_commands.py`, a function here that reads,
works, writes and prints, and a test that runs it as a user does.
"""
