"""NASA TM-101722 itself: its procedure on our record, what its own numbers say, and both beside each other."""
