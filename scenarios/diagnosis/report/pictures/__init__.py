"""Which figures a diagnosis gets, what they show of it, and the process that draws them."""
