"""Which sigma of a campaign is wrong, by how much, and why: found by computing the same runs with one thing changed."""
