"""What each command takes, one file a command; where a few only list what there is, one for all of them."""
