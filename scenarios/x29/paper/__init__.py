"""NASA TM-101722 itself: what its own numbers say, and its tables beside ours."""
